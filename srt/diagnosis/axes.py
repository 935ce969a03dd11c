"""Axes and frames: swapped axes and wrong signs.

Two independent sources show them: the labels, and the rotation of gravity in the accelerometers against the gyros
(:mod:`srt.diagnosis.gravity_rotation`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.gravity_rotation import UNEXPLAINED
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


_EYE: Final = np.eye(len(AXES))
_REMEDY: Final = "if the recording was written by hand, {} in its samples file; otherwise convert the log again with"
"""Remedy for a recording without a log that could be converted."""
_BOTH: Final = _REMEDY.format("rename the columns and change their signs")


def axis_permutations(evidence: Evidence) -> Iterator[Finding]:
    """Find signed permutations of both triads relative to the labels, if the rotation of gravity confirms them."""
    gyro, accel = _labelled_axes(evidence)
    if gyro is not None and accel is not None and _is(gyro, _EYE) and _is(accel, _EYE):
        return
    relation = None if evidence.gravity_relation is None else nearest_axes(evidence.gravity_relation)
    if gyro is not None and accel is not None:
        # If the rotation of gravity contradicts the permutations, the labels are wrong, not the axes.
        if relation is None or _is(relation, np.linalg.det(accel) * accel @ gyro.T):
            yield _permutation_finding(gyro, accel)
    elif relation is not None and not _is(relation, _EYE):
        # The simplest fault that explains K. An improper Pg makes K improper; an improper Pa makes K = -Pa, a proper K.
        accel_fault = _one_sensor("accel", -relation) if np.linalg.det(relation) > 0.0 else None
        yield accel_fault or _permutation_finding(relation.T, _EYE)


SIGN_CONVENTION: Final = by_sensor(
    "sign_convention",
    "[All gyro axes have the wrong sign|The accelerometers read gravity, not specific force]",
    "[signs of the measured rotation angles; rotation|direction] of gravity in [the accelerometers against the "
    "gyros|each static pose]",
    "All three [gyros measure rotations with|accelerometers have] the wrong sign[| (at rest, their vector points "
    "down)]: the unit [uses the opposite sign convention|outputs gravity instead of specific force]; "
    f"{_REMEDY.format('change the sign of the three columns')} --map-[gyro|accel] {{mapping}}.",
    "exit 1",
    axis_permutations,
)
AXIS_FLIPPED: Final = by_sensor(
    "axis_flipped",
    "One [gyro|accelerometer] axis has the wrong sign",
    "[rotation angles by axis|direction of gravity in each static pose]",
    "[Gyro|Accelerometer] axis {axis} [measures rotations with|has] the wrong sign, which makes the triad left-handed: "
    f"{_REMEDY.format('change the sign of the column')} --map-[gyro|accel] {{mapping}}.",
    "exit 1",
    axis_permutations,
)
AXES_SWAPPED: Final = by_sensor(
    "axes_swapped",
    "Two [gyro|accelerometer] axes are swapped",
    "[rotation angles by axis|direction of gravity in each static pose]",
    "[Gyro|Accelerometer] axes {axes} are swapped: "
    f"{_REMEDY.format('exchange the names of the two columns')} --map-[gyro|accel] {{mapping}}.",
    "exit 1",
    axis_permutations,
)
LEFT_HANDED: Final = Fault(
    "left_handed",
    "Gyros and accelerometers share a left-handed frame",
    "rotation angles and static poses together",
    "Gyros and accelerometers agree with each other, but their frame is left-handed: "
    f"{_BOTH} --map-gyro {{gyro_mapping}} --map-accel {{accel_mapping}}.",
    "exit 1",
    axis_permutations,
)
FRAME_TURNED: Final = Fault(
    "frame_turned",
    "The axes of the unit are rotated by multiples of 90°",
    "rotation angles and static poses together",
    "Gyros and accelerometers agree with each other, but not with the axes of the labels: mount the unit along "
    f"the axes of the table; or, {_BOTH} --map-gyro {{mapping}} --map-accel {{mapping}}.",
    "exit 1",
    axis_permutations,
)
FRAMES_DISAGREE: Final = Fault(
    "frames_disagree",
    "Gyro and accelerometer frames disagree",
    "rotation of gravity in the accelerometers against the gyros",
    f"Gyros and accelerometers use different axes: {_BOTH} --map-gyro {{gyro_mapping}} --map-accel {{accel_mapping}}.",
    "exit 1",
    axis_permutations,
)


def _is(first: Array, second: Array) -> bool:
    """True if no element differs by 0.5: for the unit rows of two axes, by an angle of 30°."""
    return bool(np.abs(first - second).max() < 0.5)


def _permutation_finding(gyro: Array, accel: Array) -> Finding:
    """Fault for the signed permutations of gyros and accelerometers."""
    for sensor, own, other in (("gyro", gyro, accel), ("accel", accel, gyro)):
        if _is(other, _EYE) and (one := _one_sensor(sensor, own)) is not None:
            return one
    maps = {"gyro_mapping": mapping(gyro), "accel_mapping": mapping(accel)}
    if np.linalg.det(accel) < 0.0 and (_is(gyro, accel) or _is(gyro, -accel)):
        return LEFT_HANDED.found(**maps)
    if _is(gyro, accel):
        return FRAME_TURNED.found(mapping=maps["gyro_mapping"])
    return FRAMES_DISAGREE.found(**maps)


def _one_sensor(sensor: str, axes: Array) -> Finding | None:
    """Fault for a signed permutation of one triad; None if the catalogue has no fault for it."""
    undo = mapping(axes)
    if _is(axes, -_EYE):
        return SIGN_CONVENTION[sensor].found(mapping=undo)
    wrong = np.flatnonzero(np.abs(np.diag(axes) - 1.0) > 0.5)
    if len(wrong) == 1:
        return AXIS_FLIPPED[sensor].found(axis=AXES[wrong[0]], mapping=undo)
    if len(wrong) == 2 and axes[wrong[0], wrong[1]] > 0.5 and axes[wrong[1], wrong[0]] > 0.5:
        return AXES_SWAPPED[sensor].found(axes=f"{AXES[wrong[0]]} and {AXES[wrong[1]]}", mapping=undo)
    return None


def nearest_axes(matrix: Array) -> Array | None:
    """Signed permutation nearest to the directions of the rows of a matrix; None if no permutation is near."""
    length = np.linalg.norm(matrix, axis=1, keepdims=True)
    if not (np.all(np.isfinite(length)) and np.all(length > 0.0)):
        return None
    rows = matrix / length
    nearest = np.trunc(rows / np.abs(rows).max(axis=1, keepdims=True))
    return nearest if _is(rows, nearest) and np.all(np.abs(nearest).sum(axis=0) == 1.0) else None


def _labelled_axes(evidence: Evidence) -> list[Array | None]:
    """Signed permutations Pg of the gyros and Pa of the accelerometers from the labels; None if not determined."""
    if evidence.data is None:
        return [None, None]
    fits = ((evidence.gyro_fit, evidence.rotations.turned), (evidence.accel_fit, evidence.poses[1]))
    return [
        nearest_axes(fit.matrix)
        if fit.rank == 3 and np.sum(fit.residual**2) <= UNEXPLAINED * np.sum((reading - fit.offset) ** 2)
        else None
        for fit, reading in fits
    ]


def mapping(axes: Array) -> str:
    """Axis mapping that reverses a signed permutation, in the form of ``srt convert --map-gyro``: "x,-y,z"."""
    undo = axes.T
    columns = np.argmax(np.abs(undo), axis=1)
    return ",".join(("-" if undo[i, j] < 0.0 else "") + AXES[j] for i, j in enumerate(columns.tolist()))
