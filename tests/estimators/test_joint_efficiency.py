"""Factor graph and Kalman filter against the Cramér-Rao bound: nearly efficient, with honest sigmas and innovations.

8 units of two grades here, 2,000 of three with ``-m slow``; ``benchmarks/efficiency.py`` runs 2,000 of each grade.
Claims and their statistical bounds are those of :mod:`efficiency`: limit plus 3.5 standard errors at this
size.
"""

import math
from functools import partial

import efficiency
import numpy as np
import pytest
from accuracy_trials import GRADES, Trial, run
from efficiency import LIMITS, UnitTrials, bound_sigma, criteria, summarise

from srt.sensor_errors import N_PARAMETERS

pytest.importorskip("gtsam")
pytest.importorskip("filterpy")
threadpoolctl = pytest.importorskip("threadpoolctl")

ESTIMATORS = ("graph", "ekf", "closed-form")
FIRST_SEED = {grade: 40_000 + 10_000 * i for i, grade in enumerate(GRADES)}


def missed(claims):
    return [c for c in claims if not c.holds]


@pytest.mark.parametrize(
    ("grade", "count"),
    [(g, 4) for g in ("navigation", "tactical")] + [pytest.param(g, 667, marks=pytest.mark.slow) for g in GRADES],
)
def test_graph_and_filter_are_nearly_efficient(grade, count):
    """All criteria in one test, or each worker would simulate the units anew; 50 Hz shows the same as 100 Hz."""
    trial = partial(
        efficiency.calibrate_unit, grade=grade, estimators=ESTIMATORS, innovations_every=5, sample_rate_hz=50.0
    )
    # The runner uses every core: threads waiting for each other over matrices this small would take most of the time.
    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        units = run(trial, range(FIRST_SEED[grade], FIRST_SEED[grade] + count))
    found, claims = summarise(grade, units)
    assert not missed(claims)
    for name, (mean, largest) in LIMITS.items():
        # The sigmas say the same without any scatter; but for the gyro bias, which chance may take for a wandering one.
        own = found[name].own[:24]
        assert own.mean() < mean
        assert own.max() < largest
        assert own.min() > 0.99
    # Held to what is claimed of the others, the closed form fails: these samples are large enough to tell.
    as_graph = criteria("graph", found["closed-form"])
    assert [c.name.split(" (")[0] for c in missed(as_graph)] == [
        "graph: rms / bound, mean",
        "graph: rms / bound, largest",
    ]


def made_up(count, *, error=1.0, sigma=1.0, colour=0.0, seed=1):
    """Units of an estimator with errors and sigmas of so many times the bound, and innovations that may be coloured."""
    rng = np.random.default_rng(seed)
    bound = bound_sigma("navigation")
    units = []
    for _ in range(count):
        z = rng.standard_normal(N_PARAMETERS) * error
        trial = Trial(z * bound, sigma * bound, float(z @ z) / sigma**2 / N_PARAMETERS, "converged", 3)
        v = rng.standard_normal(17 * 12 + 1)
        v = (v[1:] + colour * v[:-1]) / math.hypot(1.0, colour)
        units.append(UnitTrials({"graph": trial}, tuple(v.reshape(17, 12))))
    return units


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
    _, claims = summarise("navigation", made_up(400, **fault))
    caught = " ".join(c.name for c in missed(claims))
    assert all(word in caught for word in what)
    assert len(missed(claims)) == len(what)
