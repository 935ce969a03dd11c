"""Certificates of files that were edited or cut are refused."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import calibration

import srt
from srt.reports.certificate import calibration_file, make_certificate
from srt.result.consistency import Consistency, LeaveOneOut
from srt.result.json_file import json_text

# Files that were edited or cut


EDITS = {
    "parameters.0.unit": ["ppm", None, 3],
    "parameters.3.symbol": ["κxx"],
    "parameters.0.value": ["1", None, float("nan"), 1e400, 10**400, True, -3.0],
    "parameters.0.sigma": [0.0, None, "x", 1.0],
    "parameters.0.observed": [False, 1],
    "covariance.0.0": [-1.0, 1.0, None, 10**400],
    "frame.U": [[[1.0]], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], "x"],
    "frame.U_sigma": [-1.0, "x"],
    "status": ["certified", "partial "],
    "version": [0, 2, "1"],
    "format": ["srt-truth"],
    "site": [None, [], "x"],
    "site.latitude_deg": ["45", 10**400],
    "temperature": ["20", {"mean_c": 20.0}],
    "residuals.0.value": [None, "x", 1e400],
    "residuals.0.sigma": [-1.0],
    "residuals.0.component": [None],
    "provenance": [None, []],
    "provenance.serial": [3, ["a"]],
    "provenance.date": [3],
    "provenance.data_sha256": ["abc", 3],
    "provenance.options": ["x"],
    "verdict": [None, [], {"chi_square": 1.0}],
    "verdict.probability": [-1.0, "x"],
    "verdict.sequences": [None, [{}], [3]],
    "verdict.parameters": [
        [{"name": "x", "sigma": 1.0}],
        [{"name": [], "sigma": 1.0}],
        [{"name": "gyro_scale_x", "sigma": 1.0}],
    ],
    "iterations": [None, [{}], [{"max_correction": None}]],
    "warnings": [None, [3]],
    "estimator": [None, 3],
}


def with_verdict(result):
    judged = {"chi_square": 2.0, "degrees_of_freedom": 2, "probability": 0.4}
    shown = {"checkable": "yes", "only_witness_of": (), "lost_without": (), "largest_influence": None, "influence": {}}
    sequences = tuple(LeaveOneOut(sequence=str(k + 1), occurrence=1, **judged, **shown) for k in range(3))
    return replace(result, verdict=Consistency(**judged, sequences=sequences))


@pytest.mark.parametrize("place", EDITS)
def test_an_edited_file_is_refused(tmp_path, place):
    document = json.loads(json_text(with_verdict(calibration()).to_dict()))
    *steps, last = (int(step) if step.isdecimal() else step for step in place.split("."))
    for value in EDITS[place]:
        edited = copy.deepcopy(document)
        part = edited
        for step in steps:
            part = part[step]
        part[last] = value
        (tmp_path / "x.json").write_text(json.dumps(edited))
        with pytest.raises(srt.InputError) as caught:
            calibration_file(tmp_path / "x.json")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 400


def test_a_file_without_a_digest_is_refused(tmp_path):
    """Nothing tells whether its values are those that were written."""
    (tmp_path / "x.json").write_text(json.dumps(calibration().to_dict()))
    srt.load_calibration(tmp_path / "x.json")
    with pytest.raises(srt.InputError, match="has no digest"):
        calibration_file(tmp_path / "x.json")


def test_a_truncated_file_is_refused_wherever_it_was_cut(tmp_path):
    text = json_text(calibration().to_dict())
    for share in np.linspace(0.0, 0.999, 12):
        (tmp_path / "x.json").write_text(text[: int(share * len(text))])
        with pytest.raises(srt.InputError):
            calibration_file(tmp_path / "x.json")
    with pytest.raises(srt.InputError, match="cannot be read"):
        calibration_file(tmp_path / "absent.json")
    with pytest.raises(srt.InputError, match="cannot be read"):
        calibration_file(tmp_path)


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_nothing_is_certified_by_what_did_not_converge(saved, status):
    with pytest.raises(srt.DataError, match="nothing can be certified"):
        make_certificate(saved(calibration(status=status)))
