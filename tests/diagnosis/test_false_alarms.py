"""False-alarm probability of all checks together: the sum of what the single tests allow; and the limits it gives."""

import numpy as np
import pytest
from scipy import stats

from srt.diagnosis import false_alarms
from srt.noise import drift_forms
from srt.sequences import clipping, vibration

PER_RECORDING = 1e-4
"""Probability by design of any finding, or of a drift in the calibration, in a recording without a fault."""
IN_WINDOWS = ("rotation", "oscillation", "bumps", "creep", "noise")
OVER_SEQUENCES = ("lost samples", "lags", "settling", "joined units", "drift of scale factors")
OF_SAMPLES = ("repeated samples", "spikes", "truncation")
OF_RATES = ("absent Earth rate", "latitude", "north", "drift of bias", "noise of gyros", "noise of accelerometers")
OF_RESULT = ("moves that contradict a closed form",)


def test_all_checks_together_raise_a_finding_in_one_of_10000_recordings():
    tests = len((*IN_WINDOWS, *OVER_SEQUENCES, *OF_SAMPLES, *OF_RATES, *OF_RESULT))
    total = tests * false_alarms.FALSE_ALARM + vibration.FALSE_ALARM + drift_forms.FALSE_ALARM
    total += 12 * (clipping._CHANCE + 0.5**clipping._PILE)
    assert 0.5 * PER_RECORDING < total <= PER_RECORDING


@pytest.mark.parametrize(
    ("name", "freedom", "distribution"),
    [
        ("normal", (), stats.norm()),
        ("t", (7.0,), stats.t(7.0)),
        ("chi-square", (3.0,), stats.chi2(3.0)),
        ("F", (1.0, 40.0), stats.f(1.0, 40.0)),
    ],
)
def test_a_statistic_exceeds_its_limit_with_its_share_of_the_false_alarms(name, freedom, distribution):
    """Quantiles are inverted by iteration: 1e-9 of the probability."""
    alone = distribution.sf(false_alarms.limit(name, *freedom))
    assert alone == pytest.approx(false_alarms.FALSE_ALARM, rel=1e-9)
    one_of_six = distribution.sf(false_alarms.limit(name, *freedom, tests=3, both_sides=True, shared=1e-3))
    assert one_of_six == pytest.approx(1e-3 / 6.0, rel=1e-9)


def test_limits_have_the_shape_of_the_degrees_of_freedom():
    freedom = np.array([[2.0, 5.0, 9.0]])
    assert false_alarms.limit("chi-square", freedom).shape == freedom.shape


@pytest.mark.parametrize("quantile", [0.5, 0.9])
def test_sigma_from_a_quantile_scatters_as_its_degrees_of_freedom_state(quantile):
    """2000 sigmas from 400 values: their mean within four of its sigmas, their variance within 4 sqrt(2 / 2000)."""
    n, trials = 400, 2000
    found = false_alarms.robust_sigma(np.random.default_rng(5).normal(0.0, 3.0, (trials, n)), 1, quantile) / 3.0
    variance = 0.5 / false_alarms.robust_freedom(n, quantile)
    # The median of so many magnitudes is biased by less than 1 / n.
    assert found.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(variance / trials) + 1.0 / n)
    assert found.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / trials))
