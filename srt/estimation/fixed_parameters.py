"""Uncertainty of fixed parameters, which enters the covariance of the estimated ones."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.observability import admission_sigma
from srt.model.prior import PRIOR_SIGMA, prior_sigma
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors, expand_names

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


POSE_FRAME: Final = ("accel_misalignment_xy", "accel_misalignment_xz", "accel_misalignment_yz")
"""Parameters that define the axes of poses alone: x along accelerometer x, y in the plane of accelerometers x and y."""


def in_frame_of_poses(recording: Recording, options: Options) -> Options:
    """Options that fix :data:`POSE_FRAME` if the recording has only poses, and no label or fixture states attitudes.

    Only the magnitude of gravity is then measured, and it does not depend on the orientation of the axes.
    """
    labels = recording.sequences
    if not labels or not all(label.pose for label in labels) or _attitudes_stated(recording):
        return options
    return replace(options, hold=(*options.hold, *(name for name in POSE_FRAME if name not in options.hold)))


def _attitudes_stated(recording: Recording) -> bool:
    return recording.fixture is not None and all(label.down is not None for label in recording.sequences)


def fixed_sigma(data: PreparedRecording, options: Options) -> Array:
    """1-sigma of every parameter's initial value, for the case that it is fixed, shape (27,), SI.

    Values given by the user, and asymmetries fixed on request, count as exact. An initial estimate from the fixture is
    as accurate as the fixture (its accelerometer bias also absorbs the neglected asymmetry). Otherwise the prior sigma
    applies; without a fixture it is the wide one that also decides which parameters are observed, in all estimators.
    """
    if isinstance(options.start, SensorErrors):
        return np.zeros(N_PARAMETERS)
    fixture = data.recording.fixture
    sigma = admission_sigma() if fixture is None else prior_sigma()
    if options.start == "auto" and fixture is not None and data.nominal is not None:
        accuracy = float(np.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad))
        for group in ("gyro_scale", "gyro_orthogonality", "accel_scale", "accel_misalignment"):
            sigma[GROUP_SLICES[group]] = accuracy
        sigma[GROUP_SLICES["accel_bias"]] = data.gravity * float(np.hypot(accuracy, PRIOR_SIGMA["accel_asymmetry"]))
        sigma[GROUP_SLICES["gyro_bias"]] = EARTH_RATE_RAD_S
        # Each rotation has its own error, which counts less over many revolutions.
        angles = [s.axes * s.angles_rad[:, None] for s in data.catalogue if s is not None and len(s.rotations) == 1]
        turned = np.sqrt(np.sum(np.concatenate([np.zeros((1, 3)), *angles]) ** 2, axis=0))
        scale = sigma[GROUP_SLICES["gyro_scale"]]
        scale[:] = np.minimum(scale, fixture.rotation_sigma_rad / np.maximum(turned, 1e-9))
    axes = POSE_FRAME if data.posed.all() and data.nominal is None else ()
    exact = [INDEX[name] for name in options.fixed_names if "asymmetry" in name or name in axes]
    sigma[exact] = 0.0
    return sigma


_LEAST_HORIZONTAL: Final = 0.1
"""Share of horizontal rotations below which gravity shows no gyro error: a tenth also allows for inclined axes."""
_REMEDIES: Final = {
    "gyro_scale": "a rotation about the axis while it is horizontal, or a run at a stated rate about it",
    "gyro_asymmetry": "rotations about the axis in both senses while it is horizontal",
    "gyro_orthogonality": "half turns about both axes in alternation",
    "accel_bias": "poses with the axis up, down and horizontal",
    "accel_scale": "poses with the axis up and down",
    "accel_asymmetry": "poses with the axis up, down, horizontal and inclined",
    "accel_misalignment": "half turns about axes near both, and poses between them",
    "gyro_bias": "longer rests",
}
"""Motion that makes the parameters of a group observable; one text for all axes, so that a list shows it once."""


def seen_by_earth_rate_alone(data: PreparedRecording) -> dict[str, str]:
    """Gyro errors that are fixed in a test of poses, stated rates and rotations about the vertical, with reasons.

    Only the Earth's rate shows them.

    If they are estimated, the unknown heading of each pose brings the square of the rate noise into them: gyro scale
    factors were up to 4 sigma too large.
    """
    if not all(label.pose or label.rate is not None for label in data.labels) and not _about_vertical(data):
        return {}
    rated = any(label.rate is not None for label in data.labels)
    groups = ["gyro_orthogonality"] if rated else ["gyro_scale", "gyro_asymmetry", "gyro_orthogonality"]
    return {name: reason_not_observed(name) for name in expand_names(groups)}


def _about_vertical(data: PreparedRecording) -> bool:
    """True if all rotations are about the vertical: their horizontal parts are a small share of the summed angles."""
    stream, windows = data.rotation_stream, data.windows
    horizontal = total = 0.0
    for k, (first, last) in enumerate(stream.rotation.tolist()):
        rest = 0.5 * (windows.gyro_mean[data.start[k]] + windows.gyro_mean[data.end[k]])
        turned = (stream.smooth[:, first:last] - rest[:, None] * stream.interval_s[first:last]).T
        force = windows.accel_mean[data.start[k]]
        horizontal += np.linalg.norm(np.cross(turned, force / np.linalg.norm(force)), axis=1).sum()
        total += np.linalg.norm(turned, axis=1).sum()
    return bool(horizontal < _LEAST_HORIZONTAL * total)


def reason_not_observed(name: str) -> str:
    """Reason text of a parameter that the data do not show, with what to add to the test."""
    group = next(group for group in _REMEDIES if name.startswith(group))
    return f"not distinguishable from the other parameters by this recording: add {_REMEDIES[group]}"


def reason_on_request(name: str, sigma: Array, data: PreparedRecording) -> str:
    """Reason text of a parameter that the user fixed, or that defines the axes."""
    if name in POSE_FRAME and data.posed.all() and data.nominal is None:
        return "zero by definition of the axes: x along accelerometer x, y in the plane of accelerometers x and y"
    return "fixed on request" + (", taken as exact" if sigma[INDEX[name]] == 0.0 else "")
