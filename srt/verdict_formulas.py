"""The closed form without each sequence: the formulas that the others support, solved again."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model import closed_form
from srt.model.table1 import AXES, SEQUENCES
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES
from srt.verdict import LeftOut
from srt.verdict_playback import pools_left

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.iteration import Solution
    from srt.options import Options
    from srt.sequences.preparation import PlaybackData
    from srt.verdict_playback import Owned

    Array = NDArray[np.float64]

_BIAS = GROUP_SLICES["gyro_bias"]


def without_sequences(data: PlaybackData, options: Options, solution: Solution, owned: list[Owned]) -> list[LeftOut]:
    """Without a sequence, the formulas that the others support are solved."""
    playback, n = solution.playback, len(solution.playback.z)
    held = options.held_names
    axes = [i for i in range(3) if NAMES[_BIAS.start + i] not in held]
    rates = np.eye(n)[[n - 3 + i for i in axes]]
    # Of uncorrelated measurements, what a sequence has of the variance goes with it.
    weight = solution.gain**2 * np.diag(solution.measurement_covariance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    estimated = np.asarray(solution.gain.any(axis=1), dtype=np.bool_)
    pools = pools_left(data, solution, owned)
    shifts = (pools - playback.pool) @ playback.rest_rate
    measured = _measured(data)
    out = []
    for k, (rows, windows) in enumerate(owned):
        again = data.ids.count(data.ids[k]) > 1
        ids = frozenset(data.ids) if again else frozenset(data.ids) - {data.ids[k]}
        parameters, coefficients = _supported(ids, held)
        S = coefficients @ (_measured(data, without=k) if again else measured)
        kept = list(parameters)
        if pools[k].any():
            kept += [_BIAS.start + i for i in axes]
            S = np.concatenate([S, rates])
        z = playback.z.copy()
        z[n - 3 :] += shifts[k]
        lost = estimated.copy()
        lost[kept] = False
        change = np.zeros(N_PARAMETERS)
        if kept:
            change[kept] = np.linalg.solve(S @ playback.H[:, kept], S @ z)
        share = weight[:, rows].sum(axis=1) + weight[:, n - 3 :].sum(axis=1) * playback.pool[windows].sum()
        out.append(LeftOut(np.where(estimated, change, 0.0), lost, np.where(lost, 1.0, share)))
    return out


_COMPONENTS: Final = tuple(closed_form.Component(s, kind) for s in SEQUENCES for kind in (*AXES, "start", "end"))
_PLACE: Final = {component: i for i, component in enumerate(_COMPONENTS)}


@lru_cache(maxsize=256)
def _supported(ids: frozenset[str], held: tuple[str, ...]) -> tuple[tuple[int, ...], Array]:
    """Parameters that a set of sequences has formulas for, and the formulas' coefficients of :data:`_COMPONENTS`."""
    asymmetry = not {*NAMES[GROUP_SLICES["gyro_asymmetry"]]} <= {*held}
    formulas = [f for f in closed_form.formulas(ids, asymmetry=asymmetry) if f.parameter not in held]
    coefficients = np.zeros((len(formulas), len(_COMPONENTS)))
    for row, formula in zip(coefficients, formulas, strict=True):
        for coefficient, component in formula.components:
            row[_PLACE[component]] = coefficient
    return tuple(INDEX[f.parameter] for f in formulas), coefficients


def _measured(data: PlaybackData, without: int = -1) -> Array:
    """Components from the measurements, averaged over occurrences, shape (number of components, n_z)."""
    out = np.zeros((len(_COMPONENTS), 2 * data.K + len(data.windows.duration_s) + 3))
    for k, sequence in enumerate(data.catalogue):
        if k == without or sequence is None:
            continue
        rows = {axis: 2 * k + i for i, axis in enumerate(sequence.horizontal)}
        rows |= {"start": 2 * data.K + int(data.start[k]), "end": 2 * data.K + int(data.end[k])}
        count = data.ids.count(data.ids[k]) - (without >= 0 and data.ids[k] == data.ids[without])
        for kind, row in rows.items():
            out[_PLACE[closed_form.Component(data.ids[k], kind)], row] += 1.0 / count
    return out
