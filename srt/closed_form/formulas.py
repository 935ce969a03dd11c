"""Formulas of the closed form that a recording supports, and their solution at the current sensor errors.

Eq. 13 of Savage 2020 [P] reads one combination of measured components per parameter. This choice, S, is kept, and
their full Jacobian is inverted: ``δ = (S H)⁻¹ S z``; at zero error that equals the coefficients of the paper.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.conditioning import has_inverse
from srt.exceptions import DataError
from srt.model import srt_formulas
from srt.model.table1 import AXES, SEQUENCES
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Collection

    from srt.estimation.options import Options
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.model.srt_formulas import Component, Formula
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_BIAS: Final = GROUP_SLICES["gyro_bias"]
_COMPONENTS: Final = tuple(srt_formulas.Component(s, kind) for s in SEQUENCES for kind in (*AXES, "start", "end"))
_PLACE: Final = {component: i for i, component in enumerate(_COMPONENTS)}


@lru_cache(maxsize=256)
def _supported(
    ids: frozenset[str], fixed: tuple[str, ...]
) -> tuple[tuple[Formula, ...], tuple[Component, ...], tuple[str, ...]]:
    """Formulas that a set of sequences supports, their components, and the parameters without a formula."""
    asymmetry = not {*NAMES[GROUP_SLICES["gyro_asymmetry"]]} <= {*fixed}
    supported = srt_formulas.formulas(ids, asymmetry=asymmetry)
    chosen = tuple(f for f in supported if f.parameter not in fixed)
    missing = tuple(n for n in srt_formulas.missing_parameters(supported) if n not in fixed)
    return chosen, tuple(srt_formulas.components(chosen)), missing


def averaged_components(data: PreparedRecording, without: int = -1) -> Array:
    """Every component of Table 1 from the measurements, averaged over repetitions, shape (components, n_z).

    Sequence number ``without`` is left out.
    """
    out = np.zeros((len(_COMPONENTS), 2 * data.K + len(data.windows.duration_s) + 3))
    for k, sequence in enumerate(data.catalogue):
        if k == without or sequence is None:
            continue
        rows = {axis: 2 * k + i for i, axis in enumerate(sequence.horizontal)}
        rows |= {"start": 2 * data.K + int(data.start[k]), "end": 2 * data.K + int(data.end[k])}
        count = data.ids.count(data.ids[k]) - (without >= 0 and data.ids[k] == data.ids[without])
        for kind, row in rows.items():
            out[_PLACE[srt_formulas.Component(data.ids[k], kind)], row] += 1.0 / count
    return out


class SelectedFormulas:
    """Formulas of the closed form for a recording: a combination of components per parameter, and the rest rate.

    Parameters
    ----------
    data : PreparedRecording
        Sequences of Table 1; those that occur more than once are averaged.
    options : Options

    Raises
    ------
    DataError
        If the sequences support no formula at all.
    """

    def __init__(self, data: PreparedRecording, options: Options) -> None:
        self._without: dict[int, SelectedFormulas] = {}
        averaged = data.of_schedule("averaged components", lambda: averaged_components(data))
        self._select(data, options, data.ids, averaged)

    def _select(self, data: PreparedRecording, options: Options, ids: Collection[str], averaged: Array) -> None:
        fixed = options.fixed_names
        self.data, self.options, self._averaged = data, options, averaged
        self.formulas, self.components, self.missing = _supported(frozenset(ids), fixed)
        if not self.formulas:
            raise DataError(
                f"The sequences {', '.join(data.ids)} support none of the closed-form formulas; "
                "use the least-squares estimator, or record more of Table 1."
            )
        self._measured = averaged[[_PLACE[c] for c in self.components]]
        self.rest_axes = [i for i, name in enumerate(NAMES[_BIAS]) if name not in fixed]
        self.kept = np.array([INDEX[f.parameter] for f in self.formulas] + [_BIAS.start + i for i in self.rest_axes])

    def without(self, k: int) -> SelectedFormulas:
        """Formulas that the sequences support without that of number k.

        Raises
        ------
        DataError
            If they support no formula at all.
        """
        if k not in self._without:
            ids = (*self.data.ids[:k], *self.data.ids[k + 1 :])
            out = object.__new__(SelectedFormulas)
            averaged = averaged_components(self.data, k) if self.data.ids[k] in ids else self._averaged
            out._select(self.data, self.options, ids, averaged)
            self._without[k] = out  # for the other units of this schedule
        return self._without[k]

    @cached_property
    def fixed(self) -> Mask:
        """Parameters without a formula, and those fixed on request, shape (27,)."""
        out = np.ones(N_PARAMETERS, dtype=np.bool_)
        out[self.kept] = False
        return out

    @cached_property
    def selection(self) -> Array:
        """Selection matrix S from the measurements to the formulas, shape (number of kept parameters, n_z).

        A row per formula: its components, each averaged over the repetitions of the sequence; then a row per gyro bias.
        """
        own = np.zeros((len(self.formulas), len(self.components)))
        order = {c: j for j, c in enumerate(self.components)}
        for row, formula in zip(own, self.formulas, strict=True):
            for coefficient, component in formula.components:
                row[order[component]] = coefficient
        n_z = self._measured.shape[1]
        return np.concatenate([own @ self._measured, np.eye(n_z)[[n_z - 3 + i for i in self.rest_axes]]])

    def gain(self, measurements: SrtMeasurements) -> Array:
        """Gain G = (S H)⁻¹ S of δ = G z, shape (..., 27, n_z); NaN for a unit whose equations are singular."""
        H = measurements.H
        return self._solve(H, np.broadcast_to(self.selection, (*H.shape[:-2], *self.selection.shape)))

    def correction(self, measurements: SrtMeasurements) -> Array:
        """Correction δ = (S H)⁻¹ S z, shape (..., 27); NaN for a unit whose equations are singular."""
        return self._solve(measurements.H, self.selection @ measurements.z[..., None])[..., 0]

    def _solve(self, H: Array, right: Array) -> Array:
        out = np.zeros((*H.shape[:-2], N_PARAMETERS, right.shape[-1]))
        A = self.selection @ H[..., self.kept]
        soluble = has_inverse(A)
        out[..., self.kept, :] = np.linalg.solve(np.where(soluble[..., None, None], A, np.eye(len(self.kept))), right)
        out[~soluble] = np.nan
        return out

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients of [P] eq. 13 for the averaged components, and 1 for gyro bias by rest rate; shape (27, n_z)."""
        A = srt_formulas.inversion_matrix(self.formulas, self.data.gravity) @ self._measured
        for i in self.rest_axes:
            A[_BIAS.start + i, A.shape[1] - 3 + i] = 1.0
        return A
