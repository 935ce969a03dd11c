"""Recordings and calibrations of the command line's tests."""

import pytest
from small_units import calibrated, recorded, simulated

import srt


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    """Make a noisy recording with its truth, which no test changes."""
    return simulated(tmp_path_factory.mktemp("noisy") / "unit-7")


@pytest.fixture(scope="session")
def calibration(recording):
    return srt.calibrate(srt.load_recording(recording))


@pytest.fixture
def unit(tmp_path):
    calibrated().save(tmp_path / "unit.json")
    return tmp_path / "unit.json"


@pytest.fixture
def raw(tmp_path):
    return recorded(tmp_path / "raw")
