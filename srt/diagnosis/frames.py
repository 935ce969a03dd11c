"""Axes and frames: signs and names of the axes that are right angles off."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import check, found
from srt.diagnosis.frame_evidence import accel_axes, gravity_relation, gyro_axes, mapping, nearest_axes
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding

    Array = NDArray[np.float64]

_EYE: Final = np.eye(3)


@check(
    "gyro_sign_convention",
    "accel_sign_convention",
    "gyro_axis_flipped",
    "accel_axis_flipped",
    "gyro_axes_swapped",
    "accel_axes_swapped",
    "left_handed",
    "frame_turned",
    "frames_disagree",
)
def axes(evidence: Evidence) -> Iterator[Finding]:
    """Signed permutations of both triads against the labels, on which the turning of gravity must agree."""
    gyro, accel = gyro_axes(evidence), accel_axes(evidence)
    relation = None
    if gyro is None or accel is None or not (_is(gyro, _EYE) and _is(accel, _EYE)):
        relation = gravity_relation(evidence)
        relation = None if relation is None else nearest_axes(relation)
    if gyro is None or accel is None:
        if relation is not None and not _is(relation, _EYE):
            yield _between(relation)
        return
    if _is(gyro, _EYE) and _is(accel, _EYE):
        return
    if relation is not None and not _is(relation, np.linalg.det(accel) * accel @ gyro.T):
        return  # the labels are wrong, not the axes
    yield _named(gyro, accel)


def _is(first: Array, second: Array) -> bool:
    return bool(np.abs(first - second).max() < 0.5)


def _between(relation: Array) -> Finding:
    """Gyros against accelerometers where no label tells which of them is right: the simpler of two explanations."""
    proper = np.linalg.det(relation) > 0.0
    # An improper relation is one of improper gyros; of improper accelerometers it is proper, with the sign reversed.
    if not proper or _is(relation, -_EYE):
        return _named(relation.T, _EYE)
    other = _one_sensor("accel", -relation)
    return other if other is not None else _named(relation.T, _EYE)


def _named(gyro: Array, accel: Array) -> Finding:
    """The fault that these axes are."""
    if _is(accel, _EYE) and (one := _one_sensor("gyro", gyro)) is not None:
        return one
    if _is(gyro, _EYE) and (one := _one_sensor("accel", accel)) is not None:
        return one
    maps = {"gyro_mapping": mapping(gyro), "accel_mapping": mapping(accel)}
    if np.linalg.det(accel) < 0.0 and (_is(gyro, accel) or _is(gyro, -accel)):
        return found("left_handed", **maps)
    if _is(gyro, accel):
        return found("frame_turned", mapping=maps["gyro_mapping"])
    return found("frames_disagree", **maps)


def _one_sensor(sensor: str, axes: Array) -> Finding | None:
    """The fault of one triad alone, if it is one of those that have a name."""
    undo = mapping(axes)
    if _is(axes, -_EYE):
        return found(f"{sensor}_sign_convention", mapping=undo)
    wrong = np.flatnonzero(np.abs(np.diag(axes) - 1.0) > 0.5)
    if len(wrong) == 1:
        return found(f"{sensor}_axis_flipped", axis=AXES[wrong[0]], mapping=undo)
    if len(wrong) == 2 and axes[wrong[0], wrong[1]] > 0.5 and axes[wrong[1], wrong[0]] > 0.5:
        return found(f"{sensor}_axes_swapped", axes=f"{AXES[wrong[0]]} and {AXES[wrong[1]]}", mapping=undo)
    return None
