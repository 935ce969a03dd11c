"""Factor graph and Kalman filter against the Cramér-Rao bound: nearly efficient, with honest sigmas and innovations.

4 units of two grades here, 667 of three with ``-m campaign``. Claims and their statistical bounds are those of
``honesty.py efficiency``: limit plus 3.5 standard errors at this size.
"""

import math

import numpy as np
import pytest
from accuracy_trials import GRADES
from honesty import LARGEST_RMS, MEAN_RMS, missed
from honesty_trials import bound_si, efficient
from studies import Score

from srt.model.table1 import SEQUENCES
from srt.sensor_errors import N_PARAMETERS

pytest.importorskip("gtsam")
pytest.importorskip("filterpy")
threadpoolctl = pytest.importorskip("threadpoolctl")

ESTIMATORS = ("graph", "ekf", "closed-form")
FIRST_UNIT = 30_000


def missed_by_innovations(scores):
    """Whiteness and unit variance of the innovations: pooled variance, lag-one correlation, NIS of each sequence."""
    runs = [s.innovations for s in scores if s.innovations]
    series = [np.concatenate(run) for run in runs]
    squares, number = sum(float(v @ v) for v in series), sum(len(v) for v in series)
    products, pairs = sum(float(v[1:] @ v[:-1]) for v in series), sum(len(v) - 1 for v in series)
    freedom = np.array([len(v) for v in runs[0]])
    nis = np.mean([[float(v @ v) for v in run] for run in runs], axis=0) / freedom
    off = {"variance": (squares / number - 1.0) / math.sqrt(2.0 / number)}
    off["correlation"] = products / squares * math.sqrt(pairs)
    by_sequence = (nis - 1.0) / np.sqrt(2.0 / freedom / len(runs))
    off |= {f"sequence {name}": ratio for name, ratio in zip(SEQUENCES, by_sequence, strict=True)}
    return [name for name, ratio in off.items() if abs(ratio) > 3.5]


@pytest.mark.parametrize(
    ("grade", "count"),
    [pytest.param("navigation", 4, marks=pytest.mark.slow), ("tactical", 4)]
    + [pytest.param(g, 667, marks=pytest.mark.campaign) for g in GRADES],
)
def test_graph_and_filter_are_nearly_efficient(grade, count):
    """All criteria in one test, or each worker would simulate the units anew; 50 Hz shows the same as 100 Hz."""
    # The runner uses every core: threads waiting for each other over matrices this small would take most of the time.
    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        rows = [
            efficient((grade,), FIRST_UNIT + k, ESTIMATORS, sample_rate_hz=50.0, innovations=k % 5 == 0)
            for k in range(count)
        ]
    found = {name: [row[name] for row in rows] for name in ESTIMATORS}
    for name in ("graph", "ekf"):
        assert missed(found[name], efficient=True) == []
        # The sigmas say the same without any scatter; but for the gyro bias, which chance may take for a wandering one.
        own = np.sqrt(np.mean([(s.sigma / s.bound) ** 2 for s in found[name]], axis=0))[:24]
        assert own.mean() < MEAN_RMS
        assert own.max() < LARGEST_RMS
        assert own.min() > 0.99
    assert missed_by_innovations(found["ekf"]) == []
    assert missed(found["closed-form"], efficient=False) == []
    # Held to what is claimed of the others, the closed form fails: these samples are large enough to tell.
    assert missed(found["closed-form"], efficient=True) == ["mean", "largest"]


def made_up(count, *, error=1.0, sigma=1.0, colour=0.0, seed=1):
    """Units of an estimator with errors and sigmas of so many times the bound, and innovations that may be coloured."""
    rng = np.random.default_rng(seed)
    bound = bound_si("navigation")
    scores = []
    for _ in range(count):
        z = rng.standard_normal(N_PARAMETERS) * error
        v = rng.standard_normal(17 * 12 + 1)
        v = (v[1:] + colour * v[:-1]) / math.hypot(1.0, colour)
        known = {"nees": float(z @ z) / sigma**2, "freedom": N_PARAMETERS, "innovations": tuple(v.reshape(17, 12))}
        scores.append(Score("converged", "sound", z * bound, z / sigma, sigma * bound, bound=bound, **known))
    return scores


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ({"error": 1.15, "sigma": 1.15}, {"mean", "largest"}),
        ({"sigma": 0.9}, {"NEES / 27", "coverage"}),
        ({"error": 0.85, "sigma": 0.85}, {"smallest"}),
        ({"colour": 0.1}, {"correlation"}),
    ],
    ids=["inefficient", "overconfident", "better than the bound", "coloured"],
)
def test_each_criterion_catches_its_fault(fault, what):
    scores = made_up(400, **fault)
    assert {*missed(scores, efficient=True), *missed_by_innovations(scores)} == what
