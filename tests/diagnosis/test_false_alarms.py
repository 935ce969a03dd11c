"""False-alarm probability of all checks together: the sum of what the single tests allow."""

from srt.diagnosis import false_alarms, repeated_samples, rotation_readings
from srt.noise import drift_forms
from srt.sequences import clipping, vibration

PER_RECORDING = 1e-4
"""Probability by design of any finding, or of a drift in the calibration, in a recording without a fault."""
IN_WINDOWS = ("oscillation", "bumps", "creep", "noise")
OVER_SEQUENCES = ("lost samples", "lags", "settling", "joined units", "drift of scale factors")
OF_RATES = ("absent Earth rate", "latitude", "north", "drift of bias", "noise of gyros", "noise of accelerometers")
SPIKES = 5e-6
"""By the derivation at the limit of a spike."""


def test_all_checks_together_raise_a_finding_in_one_of_10000_recordings():
    tests = len((*IN_WINDOWS, *OVER_SEQUENCES, *OF_RATES))
    total = tests * false_alarms.FALSE_ALARM + vibration.FALSE_ALARM + rotation_readings._BY_NOISE
    total += 12 * (clipping._CHANCE + 0.5**clipping._PILE)
    total += 11 * repeated_samples.FALSE_ALARM + SPIKES + drift_forms.FALSE_ALARM
    assert 0.5 * PER_RECORDING < total <= PER_RECORDING
