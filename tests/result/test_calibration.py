"""Calibration as a value and as a document."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import accuracy_trials
import numpy as np
import pytest

import srt
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import table1_motion
from srt.exceptions import InputError
from srt.result.document import from_document, to_document
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES
from srt.types import Array


@pytest.fixture(scope="module")
def unit():
    rng = np.random.default_rng(11)
    truth = accuracy_trials.normal_errors(rng, 1e-2, 1e-3)
    motion = table1_motion(site=accuracy_trials.SITE, sample_rate_hz=50.0, dwell_s=4.0)
    return read_out(motion, truth), truth


@pytest.fixture(scope="module")
def calibration(unit):
    return srt.calibrate(unit[0])


def test_file_round_trip(calibration, tmp_path):
    calibration.save(tmp_path / "unit.json")
    again = srt.load_calibration(tmp_path / "unit.json")
    assert again.to_dict() == calibration.to_dict()
    np.testing.assert_array_equal(again.covariance, calibration.covariance)
    text = (tmp_path / "unit.json").read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text


def test_covariance_is_the_sum_of_its_contributions(calibration):
    total = np.sqrt(sum(s**2 for s in calibration.contributions.values()))
    np.testing.assert_allclose(total, calibration.sigma, rtol=1e-9)


def edited(calibration, **changes):
    return calibration.to_dict() | changes


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"format": "other"}, "no calibration file"),
        ({"version": 2}, "version"),
        ({"status": "fine"}, "status"),
        ({"covariance": [[0.0]]}, "covariance"),
        ({"parameters": []}, "27 sensor errors"),
        ({"temperature": {"mean_c": 25.0}}, r"temperature\.range_c is missing"),
        ({"temperature": {"mean_c": 25.0, "range_c": -1.0}}, "range must not be negative"),
        ({"temperature": 25.0}, r"temperature is 25\.0: an object with keys is expected"),
    ],
)
def test_inconsistent_files_are_refused(calibration, tmp_path, change, fragment):
    path = tmp_path / "unit.json"
    path.write_text(json.dumps(edited(calibration, **change)), encoding="utf-8")
    with pytest.raises(srt.InputError, match=fragment):
        srt.load_calibration(path)


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"status": "perfect"}, "status of a calibration is 'perfect', not one of converged"),
        ({"covariance": -np.eye(27)}, "negative variance: gyro_scale_x"),
        ({"covariance": np.eye(3)}, r"covariance of a calibration has the shape \(3, 3\)"),
        ({"covariance": 2.0 * np.ones((27, 27)) - np.eye(27)}, "correlation above 1"),
        ({"covariance": np.triu(np.ones((27, 27)))}, "not symmetric"),
        ({"U": np.eye(2)}, "U of a calibration has the shape"),
        ({"errors": np.zeros(27)}, r"needs srt\.SensorErrors"),
        ({"fixed": {"gyro_scale_w": "no motion"}}, "holds 'gyro_scale_w' fixed"),
        ({"U_sigma_rad": -1.0}, "a sigma is not negative"),
    ],
)
def test_what_is_no_calibration_is_refused_when_it_is_made(calibration, change, fragment):
    with pytest.raises(srt.InputError, match=fragment):
        replace(calibration, **change)


def test_a_calibration_cannot_be_written_to(calibration):
    given = np.eye(27)
    made = replace(calibration, covariance=given)
    given[0, 0] = 9.0
    assert made.covariance[0, 0] == 1.0
    for values in (made.covariance, made.U, made.errors.vector, *made.contributions.values()):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0


@pytest.mark.parametrize(
    ("path", "value", "fragment"),
    [
        (("parameters", 0, "value"), True, r"parameters\.0\.value is True: a finite number is expected"),
        (("parameters", 0, "observed"), 1, "true or false is expected"),
        (("covariance", 0, 1), False, "covariance is .*: a list of finite numbers is expected"),
        (("frame", "U", 0, 0), True, r"frame\.U is .*: a list of finite numbers is expected"),
        (("noise", "gyro_noise_rad_per_sqrt_s", 1), True, "a list of finite numbers is expected"),
        (("noise", "gyro_noise_rad_per_sqrt_s", 1), -1e-6, "gyro_noise_rad_per_sqrt_s is negative"),
        (("noise", "sigma_inflation"), -1.0, "sigma_inflation is negative"),
    ],
)
def test_values_of_another_kind_are_refused(calibration, tmp_path, path, value, fragment):
    document = json.loads(json.dumps(calibration.to_dict()))
    part = document
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    (tmp_path / "unit.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(srt.InputError, match=fragment):
        srt.load_calibration(tmp_path / "unit.json")


def test_truncated_and_absent_files_are_refused(calibration, tmp_path):
    path = tmp_path / "unit.json"
    calibration.save(path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(srt.InputError, match="truncated"):
        srt.load_calibration(path)
    with pytest.raises(srt.InputError, match="cannot be read"):
        srt.load_calibration(tmp_path / "none.json")


def test_a_sigma_that_contradicts_the_covariance_is_refused(calibration, tmp_path):
    document = calibration.to_dict()
    document["parameters"][3]["sigma"] *= 2.0
    (tmp_path / "unit.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(srt.InputError, match="gyro_asymmetry_x"):
        srt.load_calibration(tmp_path / "unit.json")


def test_increments_and_their_durations_are_refused_alone(calibration):
    good = np.zeros((4, 3))
    for options in ({"kind": "increment"}, {"dt": 0.01}):
        with pytest.raises(srt.InputError):
            calibration.apply(good, good, **options)
    with pytest.raises(InputError, match="kind is 'increments'; it must be 'rate' or 'increment'"):
        calibration.apply(np.zeros(3), np.zeros(3), kind="increments", dt=0.01)


def test_too_few_playbacks_is_a_status(unit):
    result = srt.calibrate(unit[0], max_playbacks=1)
    assert result.status == "not_converged"
    assert "Not converged after 1 iterations" in result.message


def test_coplanar_accelerometers_are_outside_the_model(unit):
    """Axes that hardly see the space diagonal: every face of the cube still reads 0.8 g."""
    recording = unit[0]
    n = np.ones(3) / np.sqrt(3.0)
    flat = recording.accel @ (np.eye(3) - 0.9 * np.outer(n, n))
    broken = srt.Recording(
        recording.time, recording.gyro, flat, recording.site, fixture=recording.fixture, sequences=recording.sequences
    )
    result = srt.calibrate(broken)
    assert (result.status, result.consistency) == ("outside_model", None)
    assert "coplanar" in result.message


def without(recording, *ids):
    return recording.with_sequences(tuple(s for s in recording.sequences if s.id not in ids))


def test_a_missing_sequence_costs_only_its_parameters(unit, calibration):
    recording, truth = unit
    result = srt.calibrate(without(recording, "13"))
    assert result.status == "partial"
    assert set(result.fixed) == {"accel_bias_y", "accel_asymmetry_y"}
    assert "13" in result.fixed["accel_bias_y"]
    seen = result.observed
    assert np.all(result.covariance[~seen] == 0.0)
    # The others do not read what is held to first order; here the held values come from a perfect fixture's start.
    error = np.abs(accuracy_trials.error_in_quoted_units(result, truth))
    assert error[seen][:22].max() < 1e-4


def test_repeated_sequences_are_all_used(unit):
    """Sequence 1 run twice; the same samples labelled twice are refused, as they are no independent data."""
    recording, truth = unit
    motion = table1_motion(site=accuracy_trials.SITE, sample_rate_hz=50.0, dwell_s=4.0, sequences=(*TABLE_1, "1"))
    result = srt.calibrate(read_out(motion, truth))
    assert [r.occurrence for r in result.residuals if r.sequence == "1"] == [1] * 4 + [2] * 4
    assert np.abs(accuracy_trials.error_in_quoted_units(result, truth))[:24].max() < 1e-8
    with pytest.raises(srt.InputError, match="labelled twice"):
        recording.with_sequences(recording.sequences + recording.sequences[:1])


def test_fixed_values_widen_the_parameters_that_depend_on_them():
    """A true asymmetry of 1e-3 shifts the scale factors if 1a-3a are missing: their sigma includes it (prior 1e-3)."""
    recording, truth = accuracy_trials.noisy_recording(7, "navigation")
    result = srt.calibrate(without(recording, "1a", "2a", "3a"))
    scale = GROUP_SLICES["gyro_scale"]
    assert np.all(result.sigma[scale] > 0.9e-3)
    trial = accuracy_trials.score(result, truth)
    assert np.all(np.abs(trial.error[scale] / trial.sigma[scale]) < 3.5)


def test_held_parameters_keep_the_given_values(unit):
    recording, truth = unit
    result = srt.calibrate(recording, hold=("accel_asymmetry", "gyro_bias_x"), start=truth)
    for name in ("accel_asymmetry_y", "gyro_bias_x"):
        assert result.errors[name] == truth[name]
        assert result.fixed[name] == "fixed on request, taken as exact"
        assert np.isnan(result.sigma[INDEX[name]])


def test_no_asymmetry_is_equation_14(unit):
    recording, _ = unit
    result = srt.calibrate(without(recording, "1a", "2a", "3a"), asymmetry=False)
    assert set(result.fixed) == set(NAMES[GROUP_SLICES["gyro_asymmetry"]])
    assert result.status == "partial"


def test_unknown_options_and_estimators_are_named(unit):
    with pytest.raises(srt.InputError, match="averaging"):
        srt.calibrate(unit[0], averaging="linear")
    with pytest.raises(srt.InputError, match="median"):
        srt.calibrate(unit[0], average="median")
    with pytest.raises(srt.InputError, match="closed-form"):
        srt.calibrate(unit[0], "closedform")


def test_an_edited_file_does_not_match_its_digest(calibration, tmp_path):
    """Only the digest shows the edit: a scale factor of 0.5 is inside the sensor model."""
    path = tmp_path / "unit.json"
    calibration.save(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    document["parameters"][INDEX["gyro_scale_x"]]["value"] = 0.5
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError, match=r"unit\.json was changed after it was written .*--trust"):
        srt.load_calibration(path)
    assert srt.load_calibration(path, trust=True).errors["gyro_scale_x"] == 0.5


def test_the_digest_allows_another_layout_and_its_own_absence(calibration, tmp_path):
    path = tmp_path / "unit.json"
    calibration.save(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(document, sort_keys=True, separators=(",", ":")), encoding="utf-8")
    assert srt.load_calibration(path).to_dict() == calibration.to_dict()
    del document["digest"]  # as a file of an earlier version
    path.write_text(json.dumps(document), encoding="utf-8")
    assert srt.load_calibration(path).to_dict() == calibration.to_dict()


@dataclass(frozen=True, kw_only=True)
class Row:
    with_: str
    size: float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Table:
    count: int
    rows: tuple[Row, ...] = ()
    pair: tuple[float, int] | None = None
    by_name: Mapping[str, Row] | None = None
    values: Array | None = None
    origin: str | Mapping[str, str] | None = None
    sure: bool | None = None
    nulls: tuple[str, ...] = ()
    further: Mapping[str, Any] = field(default_factory=dict)


WHOLE = {
    "count": 2,
    "rows": [{"with": "a", "size": 1.5}, {"with": "b", "size": None}],
    "pair": [1, 2],
    "by_name": {"x": {"with": "c", "size": 2}},
    "values": [[1.0, 2.0]],
    "origin": {"srt": "0.1"},
    "sure": None,
    "other": {"any": [1, None]},
}


def test_a_document_is_read_and_written_without_loss():
    table = from_document(Table, WHOLE, "table")
    assert to_document(table) == WHOLE
    assert list(to_document(table)) == list(WHOLE)
    assert table.rows[1] == Row(with_="b", size=None)
    assert table.values.shape == (1, 2)
    assert (table.nulls, table.further) == (("sure",), {"other": {"any": [1, None]}})


def test_none_is_left_out_where_it_is_the_default():
    assert to_document(Table(count=1)) == {"count": 1, "rows": []}
    assert to_document(Table(count=1, nulls=("sure",))) == {"count": 1, "rows": [], "sure": None}
    assert to_document(Row(with_="a", size=None)) == {"with": "a", "size": None}
    assert to_document(Table(count=1, values=np.eye(2)))["values"] == [[1.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"count": 1.5}, "table.count is 1.5: an integer is expected."),
        ({"count": True}, "table.count is True: an integer is expected."),
        ({"sure": 1}, "table.sure is 1: true or false is expected."),
        ({"rows": {}}, "table.rows is {}: a list is expected."),
        ({"rows": [3]}, "table.rows.0 is 3: an object with keys is expected."),
        ({"rows": [{"with": 3, "size": 1.0}]}, "table.rows.0.with is 3: a text is expected."),
        ({"rows": [{"with": "a"}]}, "table.rows.0.size is missing: the file was edited or truncated."),
        (
            {"rows": [{"with": "a", "size": 1.0, "sise": 2.0}]},
            "table.rows.0 has an unknown key, sise (did you mean size?): remove it.",
        ),
        ({"by_name": {"x": {"with": "a", "size": "1"}}}, "table.by_name.x.size is '1': a finite number is expected."),
        ({"by_name": {"x": {"with": "a", "size": 10**400}}}, "a finite number is expected."),
        ({"pair": [1]}, "table.pair is [1]: a list of 2 is expected."),
        ({"values": [[1.0], [1.0, 2.0]]}, "table.values is [[1.0], [1.0, 2.0]]: a list of finite numbers is expected."),
        ({"values": 1.0}, "a list of finite numbers is expected."),
        ({"values": ["1"]}, "a list of finite numbers is expected."),
        ({"origin": 3}, "table.origin is 3: an object with keys is expected."),
    ],
)
def test_a_message_names_the_key_and_what_is_expected(change, sentence):
    with pytest.raises(srt.InputError) as caught:
        from_document(Table, WHOLE | change, "table")
    assert str(caught.value).endswith(sentence)


@pytest.mark.parametrize(
    ("former", "name"), [("held", "fixed"), ("verdict", "consistency"), ("diagnostics.held", "before_integration")]
)
def test_former_names_give_the_same_with_a_warning(calibration, former, name):
    *_, attribute = former.split(".")
    holder = calibration.diagnostics if "." in former else calibration
    with pytest.warns(DeprecationWarning, match=f"is called {name} now"):
        assert getattr(holder, attribute) is getattr(holder, name)
