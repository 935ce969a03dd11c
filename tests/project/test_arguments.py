"""Wrong arguments of the public functions: one sentence of what is expected, where the argument comes in."""

import numpy as np
import pytest

import srt
from srt.sensor_errors import N_PARAMETERS

N = 300
TIME = 0.01 * np.arange(1, N + 1)
GYRO = np.random.default_rng(1).normal(size=(N, 3)) * 1e-3
ACCEL = GYRO + np.array([0.0, 0.0, 9.8])
TEXTS = dict.fromkeys(("time", *(f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz")), ["a"] * N)
MASKED = np.ma.masked_array(GYRO, mask=GYRO > 3e-3 - 1e-9)
COMPLEX = GYRO + 1j
SITE = srt.Site(9.8)
HUGE = 10**400
"""Integer that no float can hold."""


@pytest.fixture(scope="module")
def recording():
    return srt.Recording(TIME, GYRO, ACCEL, SITE)


@pytest.fixture(scope="module")
def unit():
    covariance = 1e-10 * np.eye(N_PARAMETERS)
    errors = srt.SensorErrors(np.zeros(N_PARAMETERS))
    return srt.Calibration("closed-form", status="converged", message="Done.", errors=errors, covariance=covariance)


def refused(call, words):
    with pytest.raises(srt.InputError) as caught:
        call()
    sentence = str(caught.value)
    assert words in sentence
    assert sentence.endswith(".")
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: srt.Applier(None), "An Applier needs a calibration, but an object of type NoneType was given"),
        (lambda: srt.merge_calibrations([1, 2]), "Merging needs calibrations"),
        (lambda: srt.merge_calibrations(5), "Merging needs a list of calibrations"),
        (lambda: srt.write_recording(5, "x"), "write_recording needs a recording"),
        (lambda: srt.diagnose(GYRO), "diagnose needs a recording"),
        (lambda: srt.recognise(GYRO), "recognise needs a recording"),
        (lambda: srt.find_turns(GYRO), "find_turns needs a recording"),
        (lambda: srt.load_calibration(None), "needs a path"),
        (lambda: srt.certificate(5), "A certificate needs a calibration"),
        (lambda: srt.read((TIME, GYRO, ACCEL), like=5), "like= needs a recording"),
        (lambda: srt.read((TIME, GYRO, ACCEL), columns=5), "columns= needs"),
        (lambda: srt.read((None, GYRO, ACCEL), sample_rate_hz="x"), "sample_rate_hz= needs a number"),
        (lambda: srt.calibrate((TIME, GYRO, ACCEL), gravity_m_s2=9.8, options=5), "options= needs srt.Options"),
        (lambda: srt.calibrate((TIME, None, ACCEL), gravity_m_s2=9.8), "there is no gyro; expected are gyro and accel"),
        (lambda: srt.calibrate((TIME, GYRO, None), gravity_m_s2=9.8), "there is no accel"),
        (lambda: srt.calibrate((TIME, GYRO, ACCEL), ["ekf"], gravity_m_s2=9.8, checks=False), "name of an estimator"),
        (lambda: srt.read("nolog.csv"), "There is no file nolog.csv: check the path."),
        (lambda: srt.read("norecording"), "There is no recording norecording: check the path."),
        (lambda: srt.read((TIME, GYRO, ACCEL), gravity_m_s2=HUGE), "site.gravity_m_s2 is 1000"),
        (lambda: srt.read((None, GYRO, ACCEL), sample_rate_hz=HUGE), "but a positive number of at most 1e+06 in Hz"),
        (lambda: srt.read(([0, HUGE], GYRO, ACCEL), gravity_m_s2=9.8), "time does not consist of numbers"),
        (lambda: srt.SensorErrors.from_dict({"gyro_scale_x": HUGE}), "does not consist of numbers"),
        (lambda: srt.Options(max_playbacks=10**5000), "max_playbacks is an integer of more than 4300 digits; a number"),
        (lambda: srt.Options(targets={"gyro_scale": HUGE}), "it must be a positive sigma"),
        (lambda: srt.Recording(TIME, GYRO, ACCEL, 9.8), "The field site of a recording needs a Site"),
        (lambda: srt.Recording(TIME, GYRO, ACCEL, SITE, sequences=(5,)), "needs a tuple of SequenceLabel"),
    ],
)
def test_another_class_is_refused(call, words):
    refused(call, words)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64])
def test_numbers_of_numpy_are_numbers(recording, tmp_path, kind):
    read = srt.read(recording, latitude_deg=kind(45), height_m=kind(100))
    assert read.site.latitude_rad == pytest.approx(np.pi / 4, rel=1e-15)
    made = srt.Recording(TIME, GYRO, ACCEL, srt.Site(9.8, latitude_rad=kind(1)), fixture=srt.Fixture(kind(1)))
    srt.write_recording(made, tmp_path / "made")
    assert srt.load_recording(tmp_path / "made").site.latitude_rad == 1.0


def test_another_class_is_refused_by_methods(recording, unit, tmp_path):
    refused(lambda: unit.apply(None, ACCEL), "The gyro readings are None")
    refused(lambda: srt.Applier(unit).apply(GYRO, ACCEL, out=5), "out= needs a pair of arrays")
    refused(lambda: srt.Applier(unit, block="x"), "block= needs a whole number")
    refused(lambda: unit.save(5), "needs a path")
    refused(lambda: srt.write_recording(recording, 5), "needs a path")
    pytest.importorskip("matplotlib")
    refused(lambda: srt.plot(recording, tmp_path / "x.xyz"), "name a file that ends in .png or .pdf or .svg")
    refused(lambda: srt.plot(recording, 5), "A figure needs a path")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("values", [MASKED, COMPLEX, TEXTS["time"]], ids=["masked", "complex", "texts"])
def test_arrays_that_would_lose_a_part_are_refused_wherever_they_enter(unit, values):
    """A conversion to float drops mask and imaginary part, at best with a warning."""
    words = "masked" if values is MASKED else "complex" if values is COMPLEX else "does not consist of numbers"
    line = values if isinstance(values, list) else values[:, 0]
    refused(lambda: srt.Recording(TIME, values, ACCEL, SITE), words)
    refused(lambda: srt.Recording(line, GYRO, ACCEL, SITE), words)
    refused(lambda: srt.read((TIME, values, ACCEL), gravity_m_s2=9.8), words)
    refused(lambda: srt.read((line, GYRO, ACCEL), gravity_m_s2=9.8), words)
    refused(
        lambda: srt.read({"gyro": GYRO, "accel": ACCEL, "time": TIME, "temperature": line}, gravity_m_s2=9.8), words
    )
    columns = {f"gyro_{axis}": line for axis in "xyz"}
    refused(lambda: srt.read({"time": TIME, "accel": ACCEL, **columns}, gravity_m_s2=9.8), words)
    refused(lambda: unit.apply(GYRO, ACCEL, kind="increment", dt=line), words)
    if not isinstance(values, list):
        refused(lambda: unit.apply(values, ACCEL), words)
        refused(lambda: unit.apply(GYRO, values), words)


def test_a_frame_of_texts_is_refused_and_one_of_numbers_as_texts_is_read():
    pandas = pytest.importorskip("pandas")
    refused(lambda: srt.read(pandas.DataFrame(TEXTS), gravity_m_s2=9.8), "does not consist of numbers")
    numbers = {"time": TIME, **{f"gyro_{a}": GYRO[:, i] for i, a in enumerate("xyz")}}
    numbers |= {f"accel_{a}": ACCEL[:, i] for i, a in enumerate("xyz")}
    frame = pandas.DataFrame({name: [repr(float(value)) for value in values] for name, values in numbers.items()})
    assert (srt.read(frame, gravity_m_s2=9.8).gyro == GYRO).all()


def test_an_array_of_masks_without_a_masked_value_is_read():
    assert (srt.Recording(TIME, np.ma.masked_array(GYRO), ACCEL, SITE).gyro == GYRO).all()
