"""Start from no errors, without the fixture's angles: turns in the order of their length, the shortest first.

What is known of a turn is the specific force before and after it. A scale error of 50 % turns a full turn into half of
one or three halves, and next to them lie false answers that fit nearly as well; of a half turn it makes a quarter or
three, which still point to the truth. So the short turns are fitted first, and the longer ones from there.

The measurements are those of a play-back with all three components of the change of specific force: where angles are
large, its vertical part tells which way to go. They are weighted as if every turn were off by a hundredth of a radian,
against a prior of the size of the errors looked for; this is a first estimate, and its weights need be no better.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares

from srt.model import measurement_model as model
from srt.model.sensor_model import outside_model
from srt.playback import Player
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.options import Options
    from srt.sequences.preparation import PlaybackData

    Array = NDArray[np.float64]

_PRIOR: Final = np.ones(N_PARAMETERS)
"""Size of the errors looked for; accelerometer bias and gyro bias in SI."""
for _group, _size in {
    "gyro_scale": 0.5,
    "gyro_asymmetry": 0.01,
    "gyro_orthogonality": 0.3,
    "accel_bias": 1.0,
    "accel_scale": 0.5,
    "accel_asymmetry": 0.01,
    "accel_misalignment": 0.3,
    "gyro_bias": 0.02,
}.items():
    _PRIOR[GROUP_SLICES[_group]] = _size
_TURN_RAD: Final = 0.01
_REST_RAD_S: Final = 1e-5
_NEXT: Final = 1.5
"""Turns longer by this factor than those before wait for the next stage."""
_ENOUGH: Final = 1e-3
"""Gain of an evaluation over what is left, below which a stage is through."""
_FIRST_STEP: Final = 0.1
"""Largest first step, in units of the sizes: three of 150 units lost their way with 1, none of 650 with this."""
_EVALUATIONS: Final = 60


def start_in_stages(data: PlaybackData, options: Options) -> SensorErrors:
    """First estimate from the recorded stillness and turns alone.

    Parameters
    ----------
    data : PlaybackData
    options : Options

    Returns
    -------
    SensorErrors
        Near enough for a play-back to go on from; held parameters are zero.
    """
    sizes = _PRIOR.copy()
    sizes[[INDEX[name] for name in options.held_names]] = 0.0
    u = np.zeros(N_PARAMETERS)
    length = _turned(data)
    for limit in _limits(length):
        u = _Stage(data, options, np.flatnonzero(length <= limit), sizes).fit(u)
    return SensorErrors(u * sizes)


def _turned(data: PlaybackData) -> Array:
    """Angle of each turn, all its legs added up, rad: as it should be if that is known, else as the raw gyros read."""
    stream = data.stream(np.zeros(len(data.windows.duration_s), dtype=np.bool_))[0]
    out = np.empty(data.K)
    for k, sequence in enumerate(data.catalogue):
        if sequence is not None:
            out[k] = np.abs(sequence.angles_rad).sum()
        else:
            s, e = stream.rotation[k]
            rest = 0.5 * (data.windows.gyro_mean[data.start[k]] + data.windows.gyro_mean[data.end[k]])
            rate = stream.smooth[:, s:e] - rest[:, None] * stream.interval_s[s:e]
            out[k] = np.linalg.norm(rate, axis=0).sum()
    return out


def _limits(length: Array) -> list[float]:
    """Longest turn of every stage, ascending."""
    ordered = np.sort(length)
    limits = [_NEXT * float(ordered[0])]
    while ordered[-1] > limits[-1]:
        limits.append(_NEXT * float(ordered[ordered > limits[-1]][0]))
    return limits


class _Stage:
    """Fit of some of the turns.

    Parameters
    ----------
    data : PlaybackData
    options : Options
    chosen : ndarray of int
        Sequences that take part.
    sizes : ndarray, shape (27,)
        Units that the errors are fitted in; zero holds one.
    """

    def __init__(self, data: PlaybackData, options: Options, chosen: NDArray[np.intp], sizes: Array) -> None:
        self.data = replace(
            data,
            labels=tuple(data.labels[k] for k in chosen),
            catalogue=tuple(data.catalogue[k] for k in chosen),
            start=data.start[chosen],
            end=data.end[chosen],
        )
        self.player, self.sizes = Player(self.data, options), sizes
        self.windows = np.unique(np.concatenate([self.data.start, self.data.end]))
        self._at: Array | None = None

    def fit(self, u: Array) -> Array:
        """Errors in units of their sizes, from a first guess in the same."""
        found = least_squares(
            lambda v: self._played(v)[0],
            u,
            jac=lambda v: self._played(v)[1],
            x_scale=_FIRST_STEP,
            ftol=_ENOUGH,
            xtol=_ENOUGH,
            gtol=None,
            max_nfev=_EVALUATIONS,
        )
        return np.asarray(found.x)

    def _played(self, u: Array) -> tuple[Array, Array]:
        """Residuals and their derivative; not finite outside the model, where no step may go."""
        if self._at is None or not np.array_equal(u, self._at):
            self._at, self._last = u.copy(), self._play(u)
        return self._last

    def _play(self, u: Array) -> tuple[Array, Array]:
        errors = SensorErrors(u * self.sizes)
        data, g = self.data, self.data.gravity
        K = data.K
        if outside_model(errors) is not None:
            n = 3 * K + len(self.windows) + 3 + N_PARAMETERS
            return np.full(n, np.inf), np.zeros((n, N_PARAMETERS))
        played = self.player.play(errors)
        change = played.carried[:, 1] - played.carried[:, 0]
        force, axes = played.force, np.broadcast_to(np.eye(3), (K, 3, 3))
        H = model.horizontal_jacobian(played.integrals, axes, force[data.start], force[data.end], played.accel)
        rows = 2 * K + self.windows
        scale = np.concatenate(
            [np.full(3 * K, g * _TURN_RAD), np.full(len(rows), g * _TURN_RAD), np.full(3, _REST_RAD_S)]
        )
        z = np.concatenate([change.ravel(), played.z[rows], played.z[-3:]]) / scale
        H = np.concatenate([H.reshape(3 * K, -1), played.H[rows], played.H[-3:]]) * self.sizes / scale[:, None]
        # The derivative is that of what the errors still to be found leave, so its sign is the other one.
        return np.concatenate([z, u]), np.concatenate([-H, np.eye(N_PARAMETERS)])
