"""A calibration whose iteration ended without a solution: its status is written and shown, and no value."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_units import calibrated

import srt
from srt.comparison.estimator_comparison import compare
from srt.comparison.fleet import Fleet, FleetUnit
from srt.comparison.outliers import find_outliers
from srt.reports.figures.calibration import calibration_figure
from srt.reports.frames import parameter_frame
from srt.reports.text.calibration_summary import calibration_html, calibration_text
from srt.reports.text.estimator_comparison import parameter_table
from srt.reports.text.fleet import size_table
from srt.result.provenance import Provenance
from srt.sensor_errors import NAMES

VALUE = 2.902425


@pytest.fixture(params=["not_converged", "outside_model"])
def failed(request):
    vector = np.full(len(NAMES), 1e-3)
    vector[0] = VALUE
    return calibrated(status=request.param, errors=srt.SensorErrors(vector))


def test_the_file_has_nulls_and_loads(failed, tmp_path):
    failed.save(tmp_path / "unit.json")
    document = json.loads((tmp_path / "unit.json").read_text())
    assert {(p["value"], p["sigma"], p["observed"]) for p in document["parameters"]} == {(None, None, False)}
    assert document["covariance"] is document["frame"]["U"] is document["frame"]["U_sigma"] is None
    assert document["status"] == failed.status
    loaded = srt.load_calibration(tmp_path / "unit.json")
    assert loaded.to_dict() == failed.to_dict()
    assert np.isnan(loaded.values).all()
    with pytest.raises(srt.InputError, match=f"the status {failed.status} and no values"):
        loaded.apply(np.zeros(3), np.zeros(3))


def test_a_file_with_values_stays_readable_and_shows_none(failed, tmp_path):
    """As earlier versions wrote it, with the values of the last iteration."""
    document = replace(failed, status="inconsistent").to_dict() | {"status": failed.status}
    (tmp_path / "old.json").write_text(json.dumps(document))
    loaded = srt.load_calibration(tmp_path / "old.json")
    assert loaded.to_dict() == failed.to_dict()
    assert "2902425" not in calibration_text(loaded, title="x")


@pytest.mark.parametrize("status", ["converged", "inconsistent"])
def test_a_null_value_needs_a_status_without_solution(failed, tmp_path, status):
    (tmp_path / "bad.json").write_text(json.dumps(failed.to_dict() | {"status": status}))
    with pytest.raises(srt.InputError, match="covariance"):
        srt.load_calibration(tmp_path / "bad.json")


@pytest.mark.parametrize("details", [False, True])
@pytest.mark.parametrize("truth", [None, srt.SensorErrors()])
def test_text_and_html_have_dashes(failed, details, truth):
    text = calibration_text(failed, title="x", details=details, truth=truth)
    assert "0 of 27 measured" in text
    rows = [line.split() for line in text.splitlines() if line.split()[1:2] and line.split()[1] in NAMES]
    assert len(rows) == len(NAMES)
    assert {tuple(row[2:4]) for row in rows} == {("-", "-")}
    assert "fixed" not in text.lower()
    assert "290242" not in calibration_html(failed)


def test_comparison_fleet_figure_and_table_have_none(failed):
    good = calibrated(provenance=Provenance(data_sha256="0" * 64))
    found = compare({"closed-form": good, "graph": failed})
    rows = parameter_table(found, details=True).splitlines()
    assert [line.split()[-1] for line in rows[2:] if line] == ["-"] * len(NAMES)
    estimate = found.as_dict()["estimators"][1]
    assert set(estimate["value"]) == set(estimate["sigma"]) == {None}
    unit = FleetUnit("a", "a", None, failed.status, failed.message, 1, failed.as_written)
    fleet = Fleet((unit,), find_outliers(*np.full((2, 1, len(NAMES)), np.nan)))
    assert {(row["value"], row["sigma"]) for row in fleet.rows()} == {(None, None)}
    assert size_table(fleet).splitlines()[-1].split() == ["a", *"--------"]
    assert parameter_frame(failed)[["value", "sigma"]].isna().all(axis=None)
    figure = calibration_figure(failed)
    drawn = [line.get_ydata() for axes in figure.axes[:8] for line in axes.lines if len(line.get_xdata()) > 2]
    assert not any(np.isfinite(np.asarray(y, dtype=float)).any() for y in drawn)
