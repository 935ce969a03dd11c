"""Effects that an estimator modelled besides the 27 errors, and the noise that it took from the residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from srt.result.verdict import DOUBTFUL, SOUND

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from srt.result.calibration import Calibration


_SENSORS: Final = {"gyro": "the gyros", "accel": "the accelerometers"}
_ADDED: Final = {
    "rotation_rad": "the rotations",
    "force_m_s2": "the specific forces",
    "rate_rad_s": "the rates at rest",
    "wobble_rad": "the wobble of the axes",
    "start_angle_rad": "the start angles",
    "alignment_rad": "the alignment of the fixture",
}
"""Measurements whose noise is enlarged, by the kind of added noise."""


@dataclass(frozen=True, slots=True)
class ModelledEffects:
    """Effects in the model of one calibration.

    Attributes
    ----------
    names : tuple of str
        Bias drifts, g-sensitivity and added noise, as a sentence names them.
    unused_moves : int
        Recorded moves between the sequences that the estimator does not use.
    enlarged : frozenset of str
        Kinds of noise that the residuals have enlarged; "all" for a factor on all sigmas (Birge ratio).
    freedom : int
        Degrees of freedom of the residuals.
    """

    names: tuple[str, ...]
    unused_moves: int
    enlarged: frozenset[str]
    freedom: int

    @property
    def relative_uncertainty(self) -> float:
        """1-sigma of the covariance over the covariance, √(2/ν), if the residuals have set its scale; else zero."""
        return float((2.0 / max(self.freedom, 1)) ** 0.5) if self.enlarged else 0.0


def modelled_effects(calibration: Calibration) -> ModelledEffects:
    """Effects in the model of a calibration."""
    diagnostics, noise, evidence = calibration.diagnostics, calibration.noise, calibration.verdict
    drift = [term for term in diagnostics.drift or () if term.modelled]
    by_kind = {} if evidence is None or evidence.added_noise is None else evidence.added_noise
    added = {kind for kind, size in by_kind.items() if size.added > 0.0 and kind in _ADDED}
    names = [f"a bias drift of {_SENSORS[term.sensor]} ({term.form})" for term in drift]
    names += ["the g-sensitivity of the gyros"] * (diagnostics.g_sensitivity is not None)
    names += [f"added noise of {measured}" for kind, measured in _ADDED.items() if kind in added]
    return ModelledEffects(
        names=tuple(names),
        unused_moves=diagnostics.unused_moves or 0,
        enlarged=frozenset(added | ({"all"} if (noise.sigma_inflation or 1.0) > 1.0 else set())),
        freedom=noise.degrees_of_freedom or 0,
    )


def verdicts_differ(calibrations: Mapping[str, Calibration]) -> str:
    """Sentence on calibrations of which some are doubtful and others sound, with what only some of them model.

    Parameters
    ----------
    calibrations : mapping of str to Calibration
        Usable ones, by name. Those that do not say how well their measurements agree are not judged.

    Returns
    -------
    str
        Empty if all have the same verdict.
    """
    judged = {name: c for name, c in calibrations.items() if c.verdict}
    doubtful = [name for name, c in judged.items() if c.judgement.word == DOUBTFUL]
    sound = [name for name in judged if name not in doubtful]
    if not doubtful or not sound:
        return ""
    others = "the others" if len(sound) > 1 else sound[0]
    word = "sound" if all(judged[name].judgement.word == SOUND for name in sound) else "not"
    found = "; ".join(_differences({name: modelled_effects(c) for name, c in judged.items()}))
    return (
        f"{joined(doubtful)} {'are' if len(doubtful) > 1 else 'is'} doubtful, {others} {word}"
        f"{f': {found}.' if found else ', though all model the same effects.'}"
    )


def _differences(effects: Mapping[str, ModelledEffects]) -> Iterable[str]:
    """Clauses on the effects that only some of the estimators model, and on moves that some do not use."""
    by_estimators: dict[tuple[str, ...], list[str]] = {}
    for effect in dict.fromkeys(effect for own in effects.values() for effect in own.names):
        having = tuple(name for name, own in effects.items() if effect in own.names)
        by_estimators.setdefault(having, []).append(effect)
    for having, found in by_estimators.items():
        lacking = [name for name in effects if name not in having]
        if lacking:
            models, does = ("models", "model")[len(having) > 1], ("does", "do")[len(lacking) > 1]
            yield f"{joined(having)} {models} {joined(found)}, {joined(lacking)} {does} not"
    for name, own in effects.items():
        if own.unused_moves:
            yield f"{name} does not use the {own.unused_moves} recorded moves"


def joined(names: Iterable[str]) -> str:
    """Names as a sentence lists them: "a, b and c"."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
