"""Mount alignment (Savage 2020, §10) from a level and a pitched static pose, and its file.

Frames: B is MARS. M is the mount: z down when the mount is level, y along its lateral reference, x forward. ``C_bm``
takes M- to B-components; an attitude output ``C_nb`` becomes that of the mount by ``C_nm = C_nb C_bm``.

The mount sits on a fixture with one horizontal axis, nominally along y. At rest the sensed down ``b = -f/|f|`` is
``b = C_bm d``, with ``d = e_z`` in the level pose and ``d = (-sin θ, 0, cos θ)`` after a turn of θ about y. With
``m = Ĉᵀ b``, a correction ``Ĉ <- Ĉ exp(ν×)`` leaves to first order, and at its end exactly::

    level     m_x = ν_y,   m_y = -ν_x
    pitched   m_y = ν_z m_x - ν_x m_z

No equation contains the pitch θ: m gives it, it need not be 90°, and its error affects no angle. Effects of the fixture
on the result ``Ĉ = C exp(η×)``: levelling errors (ε_x, ε_y) give η_x = -ε_x, η_y = -ε_y and no η_z; an axis that is not
square to the mount's reference (by a about z) gives η_z = a; an axis tilted by h gives η_z = -h tan(θ/2), which is +h
nose down and -h nose up and cancels over such a pair.

In the paper's small angles, with roll φ, pitch θ, yaw ψ of the sensor axes in the mount: level ``f_x = g θ``,
``f_y = -g φ``; x down ``f_y = g ψ``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtri

from srt.conditioning import scaled_root
from srt.exceptions import DataError, InputError
from srt.model.rotations import rotation_matrix
from srt.ranking import rounded
from srt.result.json_file import load_json_file, require_format, save_json_file

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from numpy.typing import ArrayLike

    from srt.result.calibration import Calibration
    from srt.types import Array, Indices, Mask

ANGLES: Final = ("roll", "pitch", "yaw")
"""Angles of B in M, ``C_mb = R_z(yaw) R_y(pitch) R_x(roll)``."""
_UNLIKELY: Final = 1e-3
"""p-value of the residuals by noise and calibration, below which a warning is given."""
_IMPOSSIBLE: Final = 1e-6
"""p-value of the residuals with the levelling, below which the poses are refused."""
_ITERATIONS: Final = 12
"""Gauss-Newton iterations at most; four suffice for angles of 0.3 rad."""
_CONVERGED_RAD: Final = 1e-15
"""Correction, rad, at rounding."""
_KINDS: Final = {0.0: "level", 1.0: "nose_down", -1.0: "nose_up"}
"""Names of the poses in the result."""


@dataclass(frozen=True, slots=True, eq=False)
class MountAlignment:
    """Attitude of the sensor axes B in the mount M.

    Attributes
    ----------
    matrix : ndarray, shape (3, 3)
        C_bm, M- to B-components.
    covariance : ndarray, shape (3, 3), rad²
        Covariance of ``angles_rad``.
    sources : mapping of str to ndarray, shape (3,), rad
        Standard deviations of the angles by source of error; their squares add up to the diagonal of ``covariance``.
    method : str
        "stands" (static poses) or "play-back" (U of a calibration).
    poses : tuple of mappings
        Static poses used: ``pose`` ("level", "nose_down", "nose_up"), ``pitch_deg``, ``residual_rad`` and, from a
        recording, ``start_s`` and ``end_s``; JSON values.
    provenance : mapping
        JSON values.
    """

    matrix: Array
    covariance: Array
    sources: Mapping[str, Array] = field(default_factory=dict)
    method: str = "stands"
    poses: tuple[Mapping[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def angles_rad(self) -> Array:
        """Roll, pitch and yaw of B in M, shape (3,): ``C_mb = R_z(yaw) R_y(pitch) R_x(roll)``."""
        C = self.matrix.T
        return np.array(
            [
                math.atan2(C[2, 1], C[2, 2]),
                math.atan2(-C[2, 0], math.hypot(C[2, 1], C[2, 2])),
                math.atan2(C[1, 0], C[0, 0]),
            ]
        )

    @property
    def sigma_rad(self) -> Array:
        """Standard deviations of the angles, shape (3,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rotation_covariance(self) -> Array:
        """Covariance of the small rotation η about the mount's axes, ``Ĉ_bm = C_bm exp(η×)``, rad²."""
        E = np.linalg.inv(_to_angles(self.matrix))
        return np.asarray(E @ self.covariance @ E.T)

    def attitude(self, C_nb: ArrayLike) -> Array:
        """Attitude of the mount from that of the sensor axes.

        Parameters
        ----------
        C_nb : array_like, shape (..., 3, 3)
            B- to navigation components.

        Returns
        -------
        ndarray, shape (..., 3, 3)
            C_nm, M- to navigation components.

        Raises
        ------
        InputError
            If the last two dimensions are not 3 by 3.
        """
        C = np.asarray(C_nb, dtype=np.float64)
        if C.ndim < 2 or C.shape[-2:] != (3, 3):
            raise InputError(f"Attitudes are matrices of shape (..., 3, 3), not {C.shape}.")
        return np.asarray(C @ self.matrix)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON form, whole or not at all. Raises InputError if the path cannot be written."""
        save_json_file(path, to_dict(self))


def align_mount(
    force: ArrayLike,
    covariance: Mapping[str, Array],
    *,
    level_sigma_rad: float,
    axis_sigma_rad: float,
    titles: tuple[str, ...] | None = None,
) -> MountAlignment:
    """Estimate the mount angles from the static poses of one mounting, any number of each kind.

    The poses are weighted by their full covariance, including the calibration and the tilt of the axis: the weights
    make a pair pitched nose down and nose up free of the tilt and of the bias along y. The weights also give each pose
    its own error of the size of the levelling. Without it, the small differences of poses that repeat to their noise
    would determine the tilt, and poses that do not would dominate the residuals.

    Parameters
    ----------
    force : array_like, shape (s, 3), m/s²
        Compensated mean specific force of each pose, in B.
    covariance : mapping of str to ndarray, shape (3 s, 3 s), (m/s²)²
        Covariance by source of error, poses one after the other; the sum must be positive definite.
    level_sigma_rad : float
        Standard deviation of the levelling about x and about y, common to all poses.
    axis_sigma_rad : float
        Standard deviation of the tilt of the fixture's axis, and of its squareness to the mount's lateral reference.
    titles : tuple of str, optional
        Names of the poses in messages.

    Raises
    ------
    InputError
        Shapes that do not fit, values that are not finite, sigmas that are not positive.
    DataError
        No pose near level, none near 90°, one that is neither, or poses that contradict one another.
    """
    f, R = _valid_inputs(force, covariance, (level_sigma_rad, axis_sigma_rad))
    names = titles or tuple(f"static pose {i + 1}" for i in range(len(f)))
    kind = pose_kinds(f)
    require_both(kind)
    if np.isnan(kind).any():
        raise DataError(
            f"{_capital(names[int(np.argmax(np.isnan(kind)))])} is neither level nor pitched by about 90°: omit it."
        )
    solution = _solve(f, kind, R, level_sigma_rad=level_sigma_rad, axis_sigma_rad=axis_sigma_rad)
    warnings = _repeatability(solution, [names[i] for i in solution.pose])
    eta = {name: solution.gain @ S @ solution.gain.T for name, S in solution.errors.items()}
    eta["levelling"] = np.diag([level_sigma_rad**2, level_sigma_rad**2, 0.0])
    eta["squareness"] = np.diag([0.0, 0.0, axis_sigma_rad**2])
    return mount_from_rotation(
        solution.matrix,
        eta,
        poses=tuple(
            {
                "pose": _KINDS[float(k)],
                "pitch_deg": math.degrees(math.atan2(-v[0], v[2])),
                "residual_rad": float(np.abs(solution.residual[solution.pose == i]).max()),
            }
            for i, (k, v) in enumerate(zip(kind, solution.down, strict=True))
        ),
        warnings=warnings,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _PoseFit:
    """Weighted least-squares solution of the equations of all poses, one row per measured direction cosine."""

    matrix: Array  # shape (3, 3); C_bm
    down: Array  # shape (s, 3); measured vertical of each pose in M components
    pose: Indices  # shape (r,); pose of each row
    residual: Array  # shape (r,), rad
    gain: Array  # shape (3, r); derivative of the solution to the rows
    errors: dict[str, Array]  # shape (r, r), rad²; covariance of the rows by source
    whitener: Array  # shape (r, r); inverse square root of the weights, with an error of the levelling for each row


def _solve(f: Array, kind: Array, R: Mapping[str, Array], *, level_sigma_rad: float, axis_sigma_rad: float) -> _PoseFit:
    """Solve the equations of the poses by Gauss-Newton iteration."""
    size = np.linalg.norm(f, axis=1)
    b = -f / size[:, None]
    pitched = kind != 0.0
    pose = np.concatenate([np.flatnonzero(~pitched), np.flatnonzero(~pitched), np.flatnonzero(pitched)])
    axis = np.repeat([0, 1, 1], [len(f) - pitched.sum()] * 2 + [pitched.sum()])
    tangent = -(np.eye(3) - b[:, :, None] * b[:, None, :]) / size[:, None, None]
    C = _initial_matrix(b, kind)
    for _ in range(_ITERATIONS):
        m = b @ C
        H = _design(m, pose, axis, pitched)
        # Effect of the forces, and of the tilt of the axis, on the rows.
        by_pose = np.zeros((len(pose), len(f), 3))
        by_pose[np.arange(len(pose)), pose] = np.einsum("ra,rab->rb", C.T[axis], tangent[pose])
        A = by_pose.reshape(len(pose), -1)
        tilt = np.where(pitched[pose], 1.0 - m[pose, 2], 0.0) * axis_sigma_rad
        errors = {name: A @ S @ A.T for name, S in R.items()} | {"axis_tilt": np.outer(tilt, tilt)}
        whitener = _whitener(np.asarray(sum(errors.values())) + level_sigma_rad**2 * np.eye(len(pose)))
        gain = np.linalg.pinv(whitener @ H) @ whitener
        nu = gain @ m[pose, axis]
        C = C @ rotation_matrix(nu)
        if np.abs(nu).max() < _CONVERGED_RAD:
            break
    m = b @ C
    return _PoseFit(C, m, pose, m[pose, axis], gain, errors, whitener)


def mount_from_calibration(calibration: Calibration) -> MountAlignment:
    """Mount angles from the rotation U that a calibration on the two-axis fixture estimates.

    T is the frame of the unit's seat on the table: z along the inner axis, y along the outer one. The start attitudes
    with y along the outer axis, z down and x down, are the level and the pitched pose of §10, with the outer axis as
    that of the fixture. U, T- to MARS components, is fitted to the measured verticals of all start attitudes and to the
    axes of the rotations: it is C_bm for a mount seated on the table as T is. Its accuracy is the stated alignment of
    the fixture, which exceeds all other errors.

    Raises
    ------
    InputError
        A calibration that was made without a fixture.
    """
    U, sigma = calibration.U, calibration.U_sigma_rad
    if U is None or not sigma:
        raise InputError(
            "This calibration has no table frame (U), and so no mount angles: record a level pose and one pitched by "
            "90°, and align by that recording."
        )
    left, _, right = np.linalg.svd(U)
    rotation = left @ right  # U to rounding, as the file holds decimal digits
    if np.linalg.det(rotation) < 0.0 or np.abs(rotation - U).max() > 1e-6:
        raise InputError("U of this calibration is no rotation: the file was edited; calibrate again.")
    provenance = {"serial": calibration.provenance.serial, "estimator": calibration.estimator}
    return mount_from_rotation(rotation, {"fixture": sigma**2 * np.eye(3)}, method="play-back", provenance=provenance)


def mount_from_rotation(C: Array, eta: Mapping[str, Array], **rest: Any) -> MountAlignment:
    """Mount alignment from C_bm and its error.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        C_bm.
    eta : mapping of str to ndarray, shape (3, 3), rad²
        Covariance of the error as a rotation about the mount's axes, by source.
    **rest
        Other fields of :class:`MountAlignment`.
    """
    E = _to_angles(C)
    by_source = {name: E @ S @ E.T for name, S in eta.items()}
    total = np.asarray(sum(by_source.values()))
    sources = {name: np.sqrt(np.maximum(np.diag(S), 0.0)) for name, S in by_source.items()}
    return MountAlignment(C, 0.5 * (total + total.T), sources, **rest)


def _valid_inputs(
    force: ArrayLike, covariance: Mapping[str, Array], sigmas: tuple[float, float]
) -> tuple[Array, dict[str, Array]]:
    f = np.asarray(force, dtype=np.float64)
    if f.ndim != 2 or f.shape[1] != 3 or len(f) == 0:
        raise InputError(f"Forces of the static poses have the shape (s, 3), not {f.shape}.")
    if not np.all(np.isfinite(f)) or not np.all(np.linalg.norm(f, axis=1) > 0.0):
        raise InputError("Forces of the static poses must be finite and not zero.")
    R = {name: np.asarray(S, dtype=np.float64) for name, S in covariance.items()}
    wanted = (f.size, f.size)
    for name, S in R.items():
        if S.shape != wanted or not np.all(np.isfinite(S)):
            raise InputError(f"The covariance {name!r} must be finite and of shape {wanted}; it has {S.shape}.")
    if not all(math.isfinite(s) and s > 0.0 for s in sigmas):
        raise InputError(
            f"The sigmas of levelling and axis are {sigmas[0]:g} and {sigmas[1]:g} rad; both must be positive."
        )
    return f, R


def _initial_matrix(b: Array, kind: Array) -> Array:
    """C_bm from the mean of the level poses and one pitched pose: exact if the poses agree."""
    z = b[kind == 0.0].sum(axis=0)
    z /= np.linalg.norm(z)
    first = int(np.flatnonzero(kind)[0])
    y = kind[first] * np.cross(z, b[first])
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def _design(m: Array, pose: Indices, axis: Indices, pitched: Mask) -> Array:
    """Derivative of the rows to the correction, z = H ν, shape (r, 3)."""
    H = np.zeros((len(pose), 3))
    level = ~pitched[pose]
    H[level & (axis == 0), 1] = 1.0
    H[level & (axis == 1), 0] = -1.0
    H[~level, 0], H[~level, 2] = -m[pose[~level], 2], m[pose[~level], 0]
    return H


def _whitener(R: Array) -> Array:
    try:
        L, scale = scaled_root(R)
    except np.linalg.LinAlgError:
        raise InputError(
            "The covariance of the static poses is not positive definite: each pose needs noise."
        ) from None
    return np.asarray(np.linalg.solve(L, np.diag(scale)))


def _repeatability(solution: _PoseFit, names: list[str]) -> tuple[str, ...]:
    """Refuse poses that contradict each other beyond the levelling; warn beyond noise and calibration."""
    without_levelling = _whitener(np.asarray(sum(solution.errors.values())))
    residual = solution.residual
    freedom = len(residual) - 3
    if freedom <= 0:
        return ()
    worst = int(np.argmax(rounded(np.abs(residual))))  # of two poses, both are off alike
    size = float(np.abs(residual[worst]))
    if np.sum((solution.whitener @ residual) ** 2) > chdtri(freedom, _IMPOSSIBLE):
        raise DataError(
            f"The static poses contradict one another: {names[worst]} is {1e3 * size:.3g} mrad off their mean, more "
            "than the sigma of the levelling explains; the unit moved on its mount, or the mount."
        )
    if np.sum((without_levelling @ residual) ** 2) > chdtri(freedom, _UNLIKELY):
        return (f"The static poses repeat to {1e6 * size:.3g} µrad only, more than noise and calibration explain.",)
    return ()


def _to_angles(C: Array) -> Array:
    """Derivative of roll, pitch and yaw to η, ``Ĉ_bm = C_bm exp(η×)``, shape (3, 3)."""
    pitch, yaw = math.asin(-float(np.clip(C[0, 2], -1.0, 1.0))), math.atan2(C[0, 1], C[0, 0])
    cp, sp, cy, sy = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    # Rates of the angles rotate B in M about these axes; η rotates in the opposite sense, as the right factor of C_bm.
    rates = np.array([[cy * cp, -sy, 0.0], [sy * cp, cy, 0.0], [-sp, 0.0, 1.0]])
    return np.asarray(-np.linalg.inv(rates))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


FORMAT: Final = "srt-mount-alignment"
VERSION: Final = 1
"""Name and version of the file format."""
FORMULA: Final = (
    "C_nm = C_nb C_bm: attitude of the mount from that of the sensor axes (MARS), with C_bm = matrix, mount to sensor "
    "components. The angles are those of the sensor axes in the mount: transpose(C_bm) = Rz(yaw) Ry(pitch) Rx(roll)."
)
"""Meaning of the matrix and the angles, as written into the file."""
_ROUNDING: Final = 1e-9
"""Largest difference of figures in a file that follow from one another, relative or in rad: decimal digits."""


def to_dict(mount: MountAlignment) -> dict[str, Any]:
    """JSON form as a dictionary, without NaN."""
    angles = zip(ANGLES, mount.angles_rad.tolist(), mount.sigma_rad.tolist(), strict=True)
    return {
        "format": FORMAT,
        "version": VERSION,
        "method": mount.method,
        "angles": [{"name": name, "value": value, "sigma": sigma, "unit": "rad"} for name, value, sigma in angles],
        "matrix": mount.matrix.tolist(),
        "covariance": mount.covariance.tolist(),
        "sources": {name: sigma.tolist() for name, sigma in mount.sources.items()},
        "formula": FORMULA,
        "stands": [dict(pose) for pose in mount.poses],
        "warnings": list(mount.warnings),
        "provenance": dict(mount.provenance),
    }


def load_mount_alignment(path: str | PathLike[str], *, trust: bool = False) -> MountAlignment:
    """Read a mount alignment.

    Parameters
    ----------
    trust : bool
        Accept a file that was changed after it was written.

    Raises
    ------
    InputError
        If the file cannot be read, is no mount alignment, is of another version, is not consistent, or differs from its
        digest.
    """
    return load_json_file(path, "mount alignment", _from_dict, trust=trust)


def _from_dict(document: dict[str, Any]) -> MountAlignment:
    require_format(document, "mount alignment", FORMAT, VERSION)
    C, P = (np.array(document[name], dtype=np.float64) for name in ("matrix", "covariance"))
    if C.shape != (3, 3) or not np.allclose(C @ C.T, np.eye(3), rtol=0.0, atol=_ROUNDING) or np.linalg.det(C) < 0.0:
        raise InputError("its matrix is no rotation of 3 by 3.")
    if P.shape != (3, 3) or not np.all(np.isfinite(P)) or not np.array_equal(P, P.T) or not np.all(np.diag(P) >= 0.0):
        raise InputError("its covariance is no symmetric matrix of 3 by 3 finite numbers.")
    mount = MountAlignment(
        C,
        P,
        {name: np.array(sigma, dtype=np.float64) for name, sigma in document["sources"].items()},
        document["method"],
        tuple(document["stands"]),
        tuple(document["warnings"]),
        document["provenance"],
    )
    if [angle["name"] for angle in document["angles"]] != list(ANGLES):
        raise InputError(f"its angles are not {', '.join(ANGLES)}.")
    for angle, value, sigma in zip(document["angles"], mount.angles_rad, mount.sigma_rad, strict=True):
        if not math.isclose(angle["value"], value, rel_tol=0.0, abs_tol=_ROUNDING):
            raise InputError(f"its {angle['name']} does not agree with the matrix.")
        if not math.isclose(angle["sigma"], sigma, rel_tol=_ROUNDING, abs_tol=1e-300):
            raise InputError(f"the sigma of its {angle['name']} does not agree with the covariance.")
    return mount


WITHIN_RAD: Final = math.radians(30.0)
"""Largest angle from level, or from a right angle, of a pose, rad: the sensor axes are near those of the mount."""


def pose_kinds(force: Array) -> Array:
    """Kind of each pose by the direction of gravity, shape (s,): 0 level, 1 nose down, -1 nose up, NaN neither.

    Parameters
    ----------
    force : ndarray, shape (s, 3), m/s²
        Compensated, in B.
    """
    down = -force / np.linalg.norm(force, axis=1, keepdims=True)
    near = math.cos(WITHIN_RAD)
    return np.select([down[:, 2] > near, down[:, 0] > near, down[:, 0] < -near], [0.0, 1.0, -1.0], np.nan)


def require_both(kind: Array) -> None:
    """Refuse poses that do not determine three angles. Raises DataError."""
    for there, what, pose in (
        (kind == 0.0, "level (z down)", "record the unit stationary on the levelled mount"),
        (np.abs(kind) == 1.0, "pitched by about 90° (x down or up)", "record the mount pitched by 90°"),
    ):
        if not there.any():
            raise DataError(
                f"None of the {len(kind)} static poses is {what} within {math.degrees(WITHIN_RAD):.0f}° in sensor "
                f"axes: {pose}, or correct the axes' names."
            )
