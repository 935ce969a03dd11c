"""The verdict on a calibration: one function of its status and of the chi-square of its residuals."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from g_sensitive import with_g_sensitivity

import srt
from srt.diagnosis.faults import FAULTS
from srt.estimation import calibration_builder
from srt.estimation.error_sources import NO_ERRORS
from srt.estimation.leave_one_out import consistency
from srt.result.calibration import STATUSES
from srt.result.consistency import AddedNoise, ChiSquareTest
from srt.result.diagnostics import Diagnostics, Drift, Fault
from srt.result.noise_figures import NoiseFigures
from srt.result.verdict import DOUBTFUL, FAILED, LEFT_TO_RESIDUALS, SOUND, USABLE
from srt.sensor_errors import N_PARAMETERS, SensorErrors

OBSERVED = np.ones(N_PARAMETERS, dtype=bool)
UNIT = srt.Calibration("ekf", "converged", "It ended.", SensorErrors(np.zeros(N_PARAMETERS)), np.eye(N_PARAMETERS))


def judged(statistic, freedom, *, status="converged", diagnostics=None, noise=None, **evidence):
    """Verdict on a calibration whose residuals have a chi-square against the noise of the sensors."""
    own = consistency([], np.eye(N_PARAMETERS), OBSERVED, statistic, freedom)
    test = ChiSquareTest(chi_square=statistic, degrees_of_freedom=freedom, probability=own.probability)
    found = srt.Calibration(
        "closed-form", status, "It ended.", SensorErrors(np.zeros(N_PARAMETERS)), np.eye(N_PARAMETERS)
    )
    evidence = replace(own, own_noise=test, **evidence)
    return replace(
        found, consistency=evidence, diagnostics=diagnostics or Diagnostics(), noise=NoiseFigures(**noise or {})
    ).judgement


@pytest.mark.parametrize(
    ("statistic", "freedom", "word", "reason"),
    [
        (44.0, 44, SOUND, "The residuals agree with the sensors' own noise (chi-square 44 for 44"),
        (60.4, 44, SOUND, "The residuals agree with the sensors' own noise (chi-square 60.4 for 44"),
        (60.6, 44, SOUND, "less well than in 19 of 20 tests"),
        (78.7, 44, SOUND, "p = 0.001"),
        (79.0, 44, DOUBTFUL, "larger than the sensors' own noise explains"),
        (10.0, 44, SOUND, "better than the sensors' own noise allows"),
        (0.0, 0, DOUBTFUL, "cannot be tested"),
    ],
)
def test_agreement_with_the_sensors_noise_comes_first(statistic, freedom, word, reason):
    """chi-square of 44 degrees of freedom exceeds 60.48 with p = 0.05, 78.75 with 1e-3 (tables of the distribution)."""
    found = judged(statistic, freedom)
    assert found.word == word
    assert reason in found.reason
    assert str(found).startswith(word.capitalize() + ". ")


def test_added_noise_and_the_factor_are_told_after_the_agreement():
    added = {"rotation_rad": AddedNoise(added=1e-3, own=1e-4), "force_m_s2": AddedNoise(added=0.0, own=1e-4)}
    found = judged(200.0, 44, added_noise=added, sigma_factor=(1.0, 2.5))
    assert found.word == DOUBTFUL
    assert found.reason.endswith(
        "Added noise, 1-sigma: 0.057° per rotation (own noise: 0.0057° per rotation). The sigmas are 1 to 2.5 times "
        "those of the sensors' own noise."
    )
    assert "multiplied by 2.1." in judged(200.0, 44, noise={"sigma_inflation": 2.13}).reason


def test_a_fixture_less_accurate_than_stated_is_told_and_no_doubt():
    worse = {kind: AddedNoise(added=9e-4, own=1e-4) for kind in ("start_angle_rad", "turned_angle_rad")}
    told = (
        "The fixture is less accurate than stated: rotations 0.91 mrad, 0.1 stated; start angles 0.91 mrad, 0.1 stated"
    )
    wobble = {"wobble_rad": AddedNoise(added=1e-5, own=1e-6)}
    for added, ending in ((worse, "."), (worse | wobble, "; axis wobble 0.01 mrad, 0.001 assumed.")):
        found = judged(44.0, 44, added_noise=added, sigma_factor=(1.0, 1.0))
        assert found.word == SOUND
        assert found.reason.endswith(told + ending)
    # Wobble alone is what other small errors look like, whatever the rotations are.
    del worse["start_angle_rad"]
    found = judged(200.0, 44, added_noise=worse | wobble, sigma_factor=(1.0, 1.1))
    assert found.word == DOUBTFUL
    assert "rotations 0.91 mrad, 0.1 stated. Added noise, 1-sigma: 10 µrad of axis wobble per pose" in found.reason


def test_effects_besides_the_27_errors_are_told():
    row = Drift(sensor="accel", form="linear", modelled=True)
    found = judged(44.0, 44, diagnostics=replace(with_g_sensitivity(np.zeros((3, 3))), drift=(row,)))
    assert found.word == SOUND
    assert found.reason.endswith(
        "Modelled besides the 27 errors: a bias drift of the accelerometers (linear), the g-sensitivity of the gyros."
    )
    assert "besides" not in judged(44.0, 44, diagnostics=Diagnostics(drift=(replace(row, modelled=False),))).reason


def test_few_degrees_of_freedom_widen_the_interval():
    """Student's t for 95 %: 3.18 with 3 degrees of freedom, 2.04 with 30 (tables)."""
    few = judged(40.0, 3, noise={"sigma_inflation": 3.65}).reason
    assert few.endswith("It rests on 3 degrees of freedom (known to 41 %): a 95 % interval is ± 3.2 sigma.")
    assert "interval" not in judged(100.0, 30, noise={"sigma_inflation": 1.83}).reason


@pytest.mark.parametrize("status", STATUSES)
def test_a_status_that_is_not_usable_is_failed(status):
    assert (judged(44.0, 44, status=status).word == FAILED) == (status not in USABLE)


def test_an_overridden_fault_is_doubtful():
    fault = Fault(
        fault="labels_exchanged", effect="exit 1", sentence="Labels are exchanged.", details={}, runner_up=None
    )
    found = judged(44.0, 44, diagnostics=Diagnostics(faults=(fault,)))
    assert found.word == DOUBTFUL
    assert found.reason.endswith("Labels are exchanged.")
    informing = replace(fault, fault="gyro_noise", effect="warning")
    assert judged(44.0, 44, diagnostics=Diagnostics(faults=(informing,))).word == SOUND


@pytest.mark.parametrize("name", [name for name, fault in FAULTS.items() if fault.effect in ("warning", "note")])
def test_a_fault_that_residuals_need_not_show_is_doubtful(name):
    """Residuals that agree do not show it: a dead band of consumer gyros moved results 279 sigma, gravity 2780."""
    effect = FAULTS[name].effect
    fault = Fault(fault=name, effect=effect, sentence="A channel is stuck.", details={}, runner_up=None)
    found = judged(44.0, 44, diagnostics=Diagnostics(faults=(fault,)))
    if name in LEFT_TO_RESIDUALS or effect == "note":
        assert found.word == SOUND
        return
    assert found.word == DOUBTFUL
    assert found.reason.startswith(
        "A fault was found that the residuals may not show: A channel is stuck. The residuals agree"
    )


def test_the_file_holds_the_verdict_and_loads_without_one(tmp_path):
    found = srt.Calibration(
        "closed-form", "converged", "Done.", SensorErrors(np.zeros(N_PARAMETERS)), np.eye(N_PARAMETERS)
    )
    assert found.judgement.word == DOUBTFUL  # nothing tells whether the measurements agree
    evidence = consistency([], np.eye(N_PARAMETERS), OBSERVED, 44.0, 44)
    replace(UNIT, consistency=evidence).save(tmp_path / "unit.json")
    document = json.loads((tmp_path / "unit.json").read_text(encoding="utf-8"))
    again = srt.load_calibration(tmp_path / "unit.json")
    assert document["verdict"]["word"] == again.judgement.word == SOUND
    assert document["verdict"]["reason"] == again.judgement.reason
    assert again.consistency == evidence


@pytest.mark.parametrize(("ratio", "status"), [(2.9, "converged"), (3.1, "inconsistent")])
def test_residuals_of_three_times_the_sensors_noise_are_no_calibration(ratio, status):
    """A noise figure that is wrong by a factor of three is a wrong figure, and labels or windows are next."""
    fit = 44 * ratio**2, 44
    result = SimpleNamespace(
        status="converged", message="It ended.", diagnostics=Diagnostics(), sensor_noise_fit=fit, chi_square=44.0,
        degrees_of_freedom=44, unmodelled=NO_ERRORS, scale_change=None,
    )  # fmt: skip
    found, message = calibration_builder._status(
        result, {}, consistency([], np.eye(N_PARAMETERS), OBSERVED, 44.0, 44), free=False
    )
    assert found == status
    assert ("3.1 times as large" in message) == (status == "inconsistent")


def test_a_modelled_drift_of_the_gyros_is_no_fault():
    """The residuals agree with the drift in the model; without the model they do not show it."""
    found = Fault(fault="gyro_bias_drift", effect="warning", sentence="The bias moved.", details={}, runner_up=None)
    for modelled, word in ((True, SOUND), (False, DOUBTFUL)):
        drift = Drift(sensor="gyro", form="linear", change_rad_s=np.ones(3), modelled=modelled)
        diagnostics = Diagnostics(faults=(found,), drift=(drift,))
        assert judged(44.0, 44, diagnostics=diagnostics).word == word
