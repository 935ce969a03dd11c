"""Verdict on a calibration: sound, partial, doubtful or failed, with the reason; for all commands and reports.

The verdict compares the residuals with the noise of the sensors first, as stated or as the stationary windows show it.
Noise that was added to explain larger residuals, and the factor on the sigmas, come second.

A failed status precedes all others, in the order outside_model, not_converged, inconsistent. The status "partial" (some
parameters fixed) may have any verdict: its observed parameters are judged like those of a complete calibration. The
verdict "partial" is on a calibration without a doubt that lacks parameters which such a recording should show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from scipy.special import stdtrit

from srt.sensor_errors import N_PARAMETERS, collapse_names

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from srt.result.consistency import AddedNoise, ChiSquareTest, Consistency
    from srt.result.diagnostics import Diagnostics
    from srt.result.noise_figures import NoiseFigures

USABLE: Final = ("converged", "partial")
"""Statuses with valid values and sigmas; the verdict on all others is "failed"."""
WITHOUT_VALUES: Final = ("not_converged", "outside_model")
"""Statuses of an iteration that ended without a solution: its last values say nothing about the unit."""
SOUND, PARTIAL, DOUBTFUL, FAILED = "sound", "partial", "doubtful", "failed"
MISFIT_PROBABILITY: Final = 1e-3
"""p-value of chi-square below which residuals count as larger than the noise: one false alarm in 1000 recordings."""
UNUSUAL: Final = 0.05
"""p-value below which an agreement is called weak: 5 %, the customary level."""
LARGEST_RATIO: Final = 3.0
"""Residuals over the noise of the sensors (Birge ratio) beyond which a missing noise source is no explanation.

A noise figure that is wrong by a factor of three is a wrong figure; labels, windows or the sensor model are next."""

_MANY: Final = 30
"""Degrees of freedom from which Student's factor of a 95 % interval, 2.04, is taken as the normal one."""
LEFT_TO_RESIDUALS: Final = frozenset({
    "gap_in_sequence", "gyro_clipped", "accel_clipped",  # these sequences are left out
    "sequence_missing", "window_short",  # the sigmas are larger, or parameters are not observed
    "bump", "creep",  # such a window is integrated
    "noisy_window",  # its noise is in the covariance
    "wrong_angle", "vibration", "spectral_line", "gyro_noise", "accel_noise",  # what was measured is used and corrected
    "temperature_unit", "temperature_drift",  # no reading is wrong
})  # fmt: skip
"""Warnings that leave the verdict to the residuals. Every other warning makes it doubtful: the readings or statements
that it names are in the result, and residuals that agree do not show by how much they move it."""

NEGLIGIBLE_SHIFT: Final = 0.5
"""Largest shift of any sensor error, in its sigma, that leaves the verdict to the residuals: errors grow by 12 %."""

OF_FIXTURE: Final = {
    "turned_angle_rad": "rotations",
    "start_angle_rad": "start angles",
    "alignment_rad": "alignment",
    "wobble_rad": "axis wobble",
}
"""Kinds of added noise that are errors of the fixture, in words."""
_ANGLES: Final = ("turned_angle_rad", "start_angle_rad")
"""Those of single angles: a wrong one is beyond them, and the result names it."""

_SMALLEST: Final = 1e-99
"""p-value below which only this limit is shown: smaller ones underflow."""


class Judged(Protocol):
    """Attributes of a calibration that the verdict is made from; :class:`srt.Calibration` has them."""

    @property
    def status(self) -> str:
        """Status."""

    @property
    def message(self) -> str:
        """Message of the status."""

    @property
    def consistency(self) -> Consistency | None:
        """Consistency of the measurements."""

    @property
    def noise(self) -> NoiseFigures:
        """Noise as used, with the factor on the sigmas."""

    @property
    def diagnostics(self) -> Diagnostics:
        """Further results."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a calibration.

    Attributes
    ----------
    word : str
        "sound": the residuals agree with the noise of the sensors. "partial": they do, but parameters that such a
        recording should show are not observed. "doubtful": they do not agree, and the sigmas were enlarged; or nothing
        tests them. "failed": the status is not usable.
    reason : str
        Sentences.
    """

    word: str
    reason: str

    def __str__(self) -> str:
        return f"{self.word.capitalize()}. {self.reason}"


def verdict_on(calibration: Judged) -> Verdict:
    """Verdict on a calibration, from its status and the chi-square of its residuals."""
    evidence = calibration.consistency
    faults = calibration.diagnostics.faults or ()
    overridden = [f for f in faults if f.effect.startswith("exit")]
    left = LEFT_TO_RESIDUALS | explained(calibration)
    wrong = [f for f in faults if f.effect == "warning" and f.fault not in left]
    if calibration.status not in USABLE:
        return Verdict(FAILED, _failure(calibration))
    if overridden:
        return Verdict(DOUBTFUL, f"A fault that stops a calibration was overridden: {overridden[0].sentence}")
    if evidence is None:
        return Verdict(DOUBTFUL, "The file does not say how well the measurements agree.")
    p = evidence.sensor_noise_test.probability
    if p is None:
        return Verdict(DOUBTFUL, "No measurement is redundant: their agreement cannot be tested.")
    agreement = f"{_agreement(p, merged=evidence.own_noise is None)} ({_chi_square(evidence.sensor_noise_test, p)})."
    worse = _worse_fixture(evidence.added_noise or {})
    added = " ".join(_added(evidence, p, calibration.noise.sigma_inflation or 1.0))
    unseen = [*(fault.sentence for fault in wrong), *(calibration.diagnostics.contradicted or ())]
    found = [f"A fault was found that the residuals may not show: {unseen[0]}"] if unseen else []
    lacking = list(_lacking(calibration.diagnostics.not_shown or ()))
    word = DOUBTFUL if added or found else PARTIAL if lacking else SOUND
    return Verdict(word, " ".join([*found, *lacking, agreement, *modelled(calibration), *worse, added]).rstrip())


def _lacking(names: tuple[str, ...]) -> Iterator[str]:
    """Sentence on the parameters that such a recording should show."""
    if names:
        yield f"Not observed, though such a recording should show them: {', '.join(collapse_names(names))}."


def explained(calibration: Judged) -> set[str]:
    """Faults that a modelled drift or the accuracy found of a fixture explains, or whose effect is negligible.

    The residuals then test for others.
    """
    drift = [row for row in calibration.diagnostics.drift or () if row.modelled]
    out = {f"{row.sensor}_bias_drift" for row in drift}
    out |= {"units_joined" for row in drift if row.form.startswith("step")}
    shifts = ((f.fault, f.details.get("largest_shift_sigma")) for f in calibration.diagnostics.faults or ())
    out |= {fault for fault, shift in shifts if shift is not None and shift < NEGLIGIBLE_SHIFT}
    evidence = calibration.consistency
    return out | {"wrong_angle" for kind in (evidence and evidence.added_noise) or () if kind in _ANGLES}


def modelled(calibration: Judged) -> Iterator[str]:
    """Sentence on the effects that were estimated besides the 27 errors."""
    drift = [row for row in calibration.diagnostics.drift or () if row.modelled]
    sensors = {"gyro": "the gyros", "accel": "the accelerometers"}
    names = [f"a bias drift of {sensors[row.sensor]} ({row.form})" for row in drift]
    if (slow := calibration.diagnostics.undersampling) is not None and slow.noise_free:
        yield f"Readings without noise: the rotations agree to {slow.share:.0e} of their angle."
    elif slow is None and "gyro_noise" in (calibration.noise.floored or ()):
        yield "Readings without noise: the sigmas contain their rounding, and no error of a simulation's integration."
    elif slow is not None:
        names.append(f"motion too fast for the sample rate ({math.degrees(slow.angle_rad):.2g}° per turn)")
    names += ["the g-sensitivity of the gyros"] * (calibration.diagnostics.g_sensitivity is not None)
    if names:
        yield f"Modelled besides the {N_PARAMETERS} errors: {', '.join(names)}."


def _failure(calibration: Judged) -> str:
    own = None if calibration.consistency is None else calibration.consistency.sensor_noise_test
    if own is None or not own.probability or calibration.status == "inconsistent":
        return calibration.message
    return f"{calibration.message} Residuals against the sensors' own noise: {_chi_square(own, own.probability)}."


def _agreement(p: float, *, merged: bool) -> str:
    what, noise = ("recordings", "their sigmas") if merged else ("residuals", "the sensors' own noise")
    if p < MISFIT_PROBABILITY:
        return f"The {what} differ by more than {noise} explain" if merged else (
            f"The {what} are larger than {noise} explains"
        )  # fmt: skip
    if p < UNUSUAL:
        return f"The {what} agree with {noise}, less well than in 19 of 20 tests"
    if p > 1.0 - MISFIT_PROBABILITY:
        return f"The {what} agree better than {noise} allows: a stated or estimated noise is too large"
    return f"The {what} agree with {noise}"


def _chi_square(test: ChiSquareTest, p: float) -> str:
    return f"chi-square {test.chi_square:.4g} for {test.degrees_of_freedom} degrees of freedom, {p_value_text(p)}"


def _of_fixture(noise: Mapping[str, AddedNoise]) -> list[str]:
    """Kinds of added noise that show a fixture less accurate than stated; wobble alone can be an error of the unit."""
    worse = "start_angle_rad" in noise or "alignment_rad" in noise
    return [kind for kind in OF_FIXTURE if kind in noise and (worse or kind != "wobble_rad")]


def _worse_fixture(noise: Mapping[str, AddedNoise]) -> Iterator[str]:
    """Sentence on a fixture that is less accurate than stated."""
    parts = [
        f"{OF_FIXTURE[kind]} {1e3 * math.hypot(noise[kind].own, noise[kind].added):.2g} mrad, "
        f"{1e3 * noise[kind].own:.2g} {'assumed' if kind == 'wobble_rad' else 'stated'}"
        for kind in _of_fixture(noise)
    ]
    if parts:
        yield f"The fixture is less accurate than stated: {'; '.join(parts)}."


def _added(evidence: Consistency, p: float, inflation: float) -> Iterator[str]:
    """Sentences on the noise that was added and on the enlarged sigmas; none without a misfit."""
    found = evidence.added_noise or {}
    told = _of_fixture(found)
    noise = {kind: row for kind, row in found.items() if row.added > 0.0 and kind not in told}
    if noise:
        parts = [f"{_size(kind, row.added)} (own noise: {_size(kind, row.own)})" for kind, row in noise.items()]
        yield f"Added noise, 1-sigma: {', '.join(parts)}."
    if inflation > 1.0:
        yield f"All sigmas were multiplied by {inflation:.2g}."
    if noise and evidence.sigma_factor is not None:
        low, high = evidence.sigma_factor
        yield f"The sigmas are {low:.2g} to {high:.2g} times those of the sensors' own noise."
    freedom = evidence.sensor_noise_test.degrees_of_freedom
    if (noise or inflation > 1.0) and freedom < _MANY:
        # The size of the added noise is an estimate of `freedom` squares: Student's distribution.
        yield (
            f"It rests on {freedom} degrees of freedom (known to {100.0 / math.sqrt(2.0 * freedom):.0f} %): a 95 % "
            f"interval is ± {stdtrit(freedom, 0.975):.1f} sigma."
        )
    if p < MISFIT_PROBABILITY and not noise and inflation == 1.0:
        scatter = evidence.between_recordings
        yield "The merged sigmas include the scatter." if scatter else "The sigmas do not include it."
    if evidence.doubtful_recordings:
        yield f"Doubtful by themselves: {', '.join(evidence.doubtful_recordings)}."


_UNITS: Final = {
    "rotation_rad": (math.degrees(1.0), "° per rotation"),
    "force_m_s2": (1.0, " m/s² per window"),
    "rate_rad_s": (math.degrees(1.0) * 3600.0, " °/h per window"),
    "wobble_rad": (1e6, " µrad of axis wobble per pose"),
}
"""Factor and unit of the kinds of added noise."""


def _size(kind: str, value: float) -> str:
    factor, unit = _UNITS[kind]
    return f"{float(f'{value * factor:.2g}'):g}{unit}"  # 140, not 1.4e+02


def p_value_text(p: float) -> str:
    """Text of a p-value with its symbol: "p = 0.3", or a limit."""
    text = probability_text(p)
    return f"p {text[0]} {text[1:]}" if text.startswith("<") else f"p = {text}"


def probability_text(p: float | None) -> str:
    """Text of a probability; empty for None."""
    if p is None:
        return ""
    if p < _SMALLEST:
        return f"<{_SMALLEST:g}"
    return f"{p:.1g}" if p < 0.01 else f"{p:.2f}"
