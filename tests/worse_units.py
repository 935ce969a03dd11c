"""Units of ``benchmarks/worse_recordings.py`` and their calibrations, made once for all tests of a process."""

from dataclasses import replace
from functools import cache

from worse_recordings import CASES, unit_of

import srt


@cache
def unit(case, number):
    """Recording of a unit with a digest, and its errors."""
    recording, errors = unit_of(CASES[case], number)
    return replace(recording, data_sha256=f"{case}, {number}"), errors


@cache
def calibrated(case, number, estimator):
    """Calibration of a unit, with the checks of its recording."""
    return srt.calibrate(unit(case, number)[0], estimator)
