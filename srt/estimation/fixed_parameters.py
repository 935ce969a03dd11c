"""Values of fixed parameters, and their uncertainty, which enters the covariance of the estimated ones."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.observability import admission_sigma, observed_limit
from srt.model.prior import prior_sigma
from srt.model.table1 import SEQUENCES
from srt.sensor_errors import (
    DISPLAY_FACTORS,
    DISPLAY_UNITS,
    GROUP_SLICES,
    GROUPS,
    INDEX,
    N_PARAMETERS,
    NAMES,
    OMISSIBLE,
    SensorErrors,
    expand_names,
)
from srt.sequences.manoeuvres import end_attitude

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


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
    """1-sigma of every parameter's value for the case that it is fixed, see :func:`fixed_values`, shape (27,), SI.

    Values given by the user, and asymmetries fixed on request, count as exact. A value from the fixture is as accurate
    as the fixture (its accelerometer bias also absorbs the neglected asymmetry). Otherwise the prior sigma applies;
    without a fixture it is the wide one that also decides which parameters are observed, in all estimators.
    """
    if isinstance(options.start, SensorErrors):
        return np.zeros(N_PARAMETERS)
    key = ("sigma of fixed parameters", options.start, options.fixed_names)
    return data.of_labels(key, lambda: _fixed_sigma(data, options))


def _fixed_sigma(data: PreparedRecording, options: Options) -> Array:
    fixture = data.recording.fixture
    sigma = admission_sigma() if fixture is None else prior_sigma()
    if options.start == "auto" and fixture is not None and data.nominal is not None:
        wide = sigma.copy()
        accuracy = float(np.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad))
        for group in ("gyro_scale", "gyro_orthogonality", "accel_scale", "accel_misalignment"):
            sigma[GROUP_SLICES[group]] = accuracy
        sigma[GROUP_SLICES["accel_bias"]] = data.gravity * float(np.hypot(accuracy, wide[INDEX["accel_asymmetry_x"]]))
        sigma[GROUP_SLICES["gyro_bias"]] = EARTH_RATE_RAD_S
        # Each rotation has its own error, which counts less over many revolutions.
        angles = [s.axes * s.angles_rad[:, None] for s in data.catalogue if s is not None and len(s.rotations) == 1]
        turned = np.sqrt(np.sum(np.concatenate([np.zeros((1, 3)), *angles]) ** 2, axis=0))
        scale = sigma[GROUP_SLICES["gyro_scale"]]
        scale[:] = np.minimum(scale, fixture.rotation_sigma_rad / np.maximum(turned, 1e-9))
        sigma = np.where(determined_by_fixture(data), sigma, wide)
    axes = POSE_FRAME if data.posed.all() and data.nominal is None else ()
    exact = [INDEX[name] for name in options.fixed_names if OMISSIBLE[INDEX[name]] or name in axes]
    sigma[exact] = 0.0
    sigma.flags.writeable = False  # all units of these labels have it in common
    return sigma


def fixed_values(data: PreparedRecording, options: Options, initial: SensorErrors) -> SensorErrors:
    """Values of all parameters for the case that they are fixed.

    They are those given by the user; the mean of a prior; what the fixture's nominal angles give, where these determine
    the parameter; otherwise zero. The initial estimate of other parameters is a fit with a weak prior: it helps the
    iteration, but nothing supports its value where the recording does not.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    initial : SensorErrors
        Initial estimate.
    """
    if isinstance(options.start, SensorErrors):
        return options.start
    otherwise = np.zeros(N_PARAMETERS) if options.prior is None else options.prior.mean.vector
    by_fixture = options.start == "auto" and options.prior is None
    return SensorErrors(np.where(by_fixture & determined_by_fixture(data), initial.vector, otherwise))


def determined_by_fixture(data: PreparedRecording) -> Mask:
    """Mask of the parameters that the nominal angles determine in the initial estimate from the fixture, shape (27,).

    The standard deviations of its least-squares fits, for errors of the fixture's alignment and rotations, are below
    those of an observed parameter. All are False without nominal attitudes.
    """
    return data.of_labels("determined by the fixture", lambda: _determined_by_fixture(data))


def _determined_by_fixture(data: PreparedRecording) -> Mask:
    out = np.zeros(N_PARAMETERS, dtype=np.bool_)
    fixture, nominal = data.recording.fixture, data.nominal
    if fixture is None or nominal is None:
        return out
    labelled = [(k, sequence) for k, sequence in enumerate(data.catalogue) if sequence is not None]
    turned = [s.axes * s.angles_rad[:, None] for _, s in labelled if s.rotations]
    down = [nominal[k, 2] for k, _ in labelled]
    down += [end_attitude(s).T @ nominal[k, 2] for k, s in labelled]
    vertical = np.reshape(down, (-1, 3))
    accuracy = float(np.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad))
    sigma = np.full(N_PARAMETERS, np.inf)
    by_axis = accuracy * _leverage(np.concatenate([np.zeros((1, 3)), *turned]))
    sigma[GROUP_SLICES["gyro_scale"]] = by_axis
    # A symmetric matrix and its rotation have their elements from both axes.
    of_pair = {name: max(by_axis["xyz".index(a)] for a in name[-2:]) for name in NAMES if name[-2:-1] in "xyz"}
    one = np.ones((len(vertical), 1))
    sigma[GROUP_SLICES["accel_bias"]] = data.gravity * accuracy * _leverage(np.hstack([vertical, one]))[3]
    for i, axis in enumerate("xyz"):
        row = accuracy * _leverage(np.hstack([vertical, one, np.abs(vertical[:, i, None])]))[:3]
        sigma[INDEX[f"accel_scale_{axis}"]] = row[i]
        for j, other in enumerate("xyz"):
            if j != i:
                name = f"accel_misalignment_{axis}{other}"
                sigma[INDEX[name]] = max(row[j], of_pair[name])
    for name in expand_names(["gyro_orthogonality"]):
        sigma[INDEX[name]] = of_pair[name]
    sigma[GROUP_SLICES["gyro_bias"]] = 0.0  # the windows measure it but for the Earth rate
    return np.asarray(sigma < observed_limit(prior_sigma()))


def _leverage(design: Array) -> Array:
    """Standard deviations of the unknowns of a least-squares fit by errors of 1, shape (n,); infinite if not unique."""
    _, size, axes = np.linalg.svd(design, full_matrices=True)
    size = np.concatenate([size, np.zeros(axes.shape[0] - size.size)])
    unique = size > _UNIQUE * max(float(size[0]), 1.0)
    out = np.sqrt(np.sum((axes[unique] / size[unique, None]) ** 2, axis=0))
    return np.asarray(np.where(np.any(np.abs(axes[~unique]) > _UNIQUE, axis=0), np.inf, out))


_UNIQUE: Final = 1e-6
"""Smallest relative singular value of a unique fit, and the largest share of an unknown in a direction that is not."""
_LEAST_HORIZONTAL: Final = 0.1
"""Share of horizontal rotations below which gravity shows no gyro error: a tenth also allows for inclined axes."""


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


def parameters_due(data: PreparedRecording) -> Mask:
    """Mask of the parameters that a recording of its kind should show, shape (27,).

    Poses show bias and scale factor of the accelerometers, runs at a stated rate the gyro scale factors of their axes,
    and rotations between poses all errors but the asymmetries. The steps of a protocol need not show
    non-orthogonality and misalignment; a test of Table 1 should show all 27, without sequences 1a-3a ([P], eq. 14) all
    but the gyro asymmetries.
    """
    table_1 = data.nominal is not None and any(name in SEQUENCES for name in data.ids)
    due = ["accel_bias", "accel_scale"]
    due += [f"gyro_scale_{label.rate[0]}" for label in data.labels if label.rate is not None]
    if not seen_by_earth_rate_alone(data):
        due += ["gyro_scale", "gyro_bias"]
        due += ["gyro_orthogonality", "accel_misalignment"] * (table_1 or data.recording.protocol is None)
    due += ["accel_asymmetry"] * table_1
    due += ["gyro_asymmetry"] * (table_1 and any(name in data.ids for name in ("1a", "2a", "3a")))
    return np.isin(NAMES, expand_names(due))


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
    return f"not distinguishable from the other parameters by this recording: add {remedies([name])}"


def remedies(names: Iterable[str]) -> str:
    """Motion to add to a test that makes parameters observable."""
    shown_by = {name: group.shown_by for group in GROUPS for name in NAMES[GROUP_SLICES[group.name]]}
    return "; ".join(dict.fromkeys(shown_by[name] for name in names))


def value_of_fixed(name: str, sigma: Array, data: PreparedRecording, options: Options) -> str:
    """Clause on the value of a fixed parameter; ``sigma`` is that of :func:`fixed_sigma`."""
    if isinstance(options.start, SensorErrors):
        return "the value is that of the given start"
    if options.prior is not None:
        return "the value is that of the prior"
    i = INDEX[name]
    if options.start == "auto" and determined_by_fixture(data)[i]:
        size = f"{sigma[i] * DISPLAY_FACTORS[i]:.4g} {DISPLAY_UNITS[i]}"
        return f"the value is that of the fixture's nominal angles, 1-sigma {size}"
    return "taken as zero"


def reason_on_request(name: str, sigma: Array, data: PreparedRecording) -> str:
    """Reason text of a parameter that the user fixed, or that defines the axes."""
    if name in POSE_FRAME and data.posed.all() and data.nominal is None:
        return "zero by definition of the axes: x along accelerometer x, y in the plane of accelerometers x and y"
    return "fixed on request" + (", taken as exact" if sigma[INDEX[name]] == 0.0 else "")
