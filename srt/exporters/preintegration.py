"""Parameters of gtsam's IMU preintegration, from the noise and the biases of a calibration.

gtsam knows biases and noise and no scale factor, misalignment or asymmetry: ``corrected = measured − bias``. So there
are two ways to feed it. Readings "corrected" by :meth:`srt.Calibration.apply` have no bias left (what is left is in the
covariance, for the prior of the bias), and their noise is that of the raw channels turned by the correction. "Raw"
readings have the identified bias, and all other errors stay in.

Factors: take ``PreintegratedImuMeasurementsManifold`` or ``PreintegratedCombinedMeasurementsManifold``. gtsam's default
(tangent) integration goes wrong by tens of degrees within full turns.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from srt.exceptions import InputError, optional
from srt.exporters.export_model import known_figures, statement
from srt.exporters.file_format import Exporter, each_sensor, field, from_json, heading, to_json
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.noise.stated_figures import white_density
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from srt.exporters.export_model import ExportModel
    from srt.exporters.file_format import Fields, Texts
    from srt.result.calibration import Calibration
    from srt.types import Array


INTEGRATION_COVARIANCE: Final = 1e-10
"""Covariance of the integrated position, m²/s: 10 µm/√s, so that the covariance of a single step has an inverse.

gtsam's own default is 1 m²/s.
"""

_GROUPS: Final = ("accel_bias", "gyro_bias")
_SHAPES: Final = {
    "bias_accel": (3,), "bias_gyro": (3,), "bias_covariance": (6, 6), "n_gravity": (3,),
    "accelerometer_covariance": (3, 3), "gyroscope_covariance": (3, 3), "integration_covariance": (3, 3),
}  # fmt: skip
_WALK_SHAPES: Final = {"bias_acc_covariance": (3, 3), "bias_omega_covariance": (3, 3)}


def gtsam_preintegration(
    calibration: Calibration,
    *,
    readings: Literal["corrected", "raw"],
    up: bool = True,
    gravity_m_s2: float | None = None,
    gyro_random_walk: float | None = None,
    accel_random_walk: float | None = None,
) -> tuple[Any, Any]:
    """Make gtsam's preintegration parameters and bias.

    Parameters
    ----------
    readings : "corrected" or "raw"
        Input of the factors: the result of :meth:`srt.Calibration.apply` in MARS axes, or the readings as they are.
    up : bool
        True: z of the navigation frame points up; False: down.
    gravity_m_s2 : float, optional
        Where the data are from; default: the calibration's site.
    gyro_random_walk, accel_random_walk : float, optional
        Random walks of the biases, rad/s²/√Hz and m/s³/√Hz; both or none.

    Returns
    -------
    params : gtsam.PreintegrationParams, or gtsam.PreintegrationCombinedParams where the random walks are given
        For the Manifold variants, see the head of this module.
    bias : gtsam.imuBias.ConstantBias

    Raises
    ------
    InputError
        A calibration without noise, gravity that is not known, figures that are not positive, one random walk without
        the other.
    MissingExtraError
        Without gtsam.
    """
    with optional("gtsam", "graph", "Preintegration"):
        import gtsam
    walks = (gyro_random_walk, accel_random_walk)
    if (gyro_random_walk is None) != (accel_random_walk is None):
        raise InputError("Give the random walks of gyros and accelerometers, or neither.")
    figures = preintegration_figures(calibration, readings, up=up, gravity_m_s2=gravity_m_s2, random_walks=walks)
    kind = gtsam.PreintegrationParams if None in walks else gtsam.PreintegrationCombinedParams
    params: Any = kind(figures["n_gravity"])
    # Each of these is one unit of variance unless it is set.
    params.setGyroscopeCovariance(figures["gyroscope_covariance"])
    params.setAccelerometerCovariance(figures["accelerometer_covariance"])
    params.setIntegrationCovariance(figures["integration_covariance"])
    if None not in walks:
        params.setBiasAccCovariance(figures["bias_acc_covariance"])
        params.setBiasOmegaCovariance(figures["bias_omega_covariance"])
    return params, gtsam.imuBias.ConstantBias(figures["bias_accel"], figures["bias_gyro"])


def preintegration_figures(
    calibration: Calibration,
    readings: str,
    *,
    up: bool = True,
    gravity_m_s2: float | None = None,
    random_walks: tuple[float | None, float | None] = (None, None),
) -> dict[str, Array]:
    """Work out the numbers that gtsam takes.

    Parameters
    ----------
    readings : "corrected" or "raw"
    random_walks : (float or None, float or None)
        Of gyro and accelerometer biases.

    Returns
    -------
    dict of str to ndarray
        Biases (3,); ``bias_covariance`` (6, 6) for a prior, accelerometers first as in gtsam; continuous covariances
        (3, 3), squares of rad/s/√Hz and m/s²/√Hz; ``n_gravity`` (3,); covariances of the random walks where given.

    Raises InputError as :func:`gtsam_preintegration`.
    """
    if readings not in ("corrected", "raw"):
        raise InputError(f"readings is {readings!r}; it must be 'corrected' or 'raw'.")
    gravity = calibration.site.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2
    if gravity is None or not (math.isfinite(gravity) and gravity > 0.0):
        raise InputError(f"Gravity is {gravity}: give gravity_m_s2, in m/s² and positive, of the place of the data.")
    triads = {"accel": accel_triad(calibration.errors), "gyro": gyro_triad(calibration.errors)}
    index = np.concatenate([np.arange(N_PARAMETERS)[GROUP_SLICES[group]] for group in _GROUPS])
    bias_covariance = calibration.covariance[np.ix_(index, index)]
    corrections, noise = [], {}
    for sensor, triad in triads.items():
        D = np.asarray(np.eye(3) if readings == "raw" else np.linalg.inv(triad.matrix))
        corrections.append(D)
        noise[sensor] = white_density(calibration.noise, sensor, D)
    both = np.block([[corrections[0], np.zeros((3, 3))], [np.zeros((3, 3)), corrections[1]]])
    figures = {
        "bias_accel": triads["accel"].bias * (readings == "raw"),
        "bias_gyro": triads["gyro"].bias * (readings == "raw"),
        "bias_covariance": both @ bias_covariance @ both.T,
        "n_gravity": np.array([0.0, 0.0, -gravity if up else gravity]),
        "accelerometer_covariance": noise["accel"],
        "gyroscope_covariance": noise["gyro"],
        "integration_covariance": INTEGRATION_COVARIANCE * np.eye(3),
    }
    names = ("bias_omega_covariance", "bias_acc_covariance")
    for name, walk in zip(names, random_walks, strict=True):
        if walk is None:
            continue
        if not (math.isfinite(walk) and walk > 0.0):
            raise InputError(f"The random walk of a bias is {walk:g}: give a positive number, or leave it out.")
        figures[name] = walk**2 * np.eye(3)
    return figures


def _write(model: ExportModel) -> dict[str, str]:
    known = known_figures(model)
    walks = (known.get("gyro_random_walk"), known.get("accel_random_walk"))
    figures = preintegration_figures(model.calibration, "raw", random_walks=walks)
    for name in ("accelerometer_covariance", "gyroscope_covariance"):
        # The random walks are inflated already.
        figures[name] = figures[name] * (model.settings.inflate or 1.0) ** 2
    # A fit of the asymmetry moves the biases.
    figures["bias_accel"], figures["bias_gyro"] = model.accel.bias, model.gyro.bias
    head = [*heading(GTSAM, model), *statement(model)]
    return {"": to_json({"comment": head, **{name: value.tolist() for name, value in figures.items()}})}


def _read(texts: Texts) -> Fields:
    document = from_json(texts[""])
    fields = {name: field(document, name, shape) for name, shape in _SHAPES.items()}
    walks = {name: shape for name, shape in _WALK_SHAPES.items() if name in document}
    return fields | {name: field(document, name, shape) for name, shape in walks.items()}


GTSAM: Final = Exporter(
    name="gtsam",
    title="gtsam preintegration parameters for raw readings",
    suffixes=(".json",),
    formula="corrected = measured - bias",
    losses=("scale factors and misalignment of gyros and accelerometers: gtsam knows biases alone",),
    advice=(
        "Better: feed corrected readings; srt.exporters.gtsam_preintegration(calibration, readings='corrected') makes "
        "the parameters in memory.",
        "Take the Manifold variants of the factors; gtsam's default goes wrong within full turns.",
    ),
    frames=("mars",),
    write=_write,
    read=_read,
    apply=each_sensor(lambda fields, sensor, y: y - fields[f"bias_{sensor}"]),
    within=None,
    options=frozenset({"gyro_random_walk", "accel_random_walk", "inflate"}),
)
