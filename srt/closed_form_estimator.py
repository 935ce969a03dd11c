"""The primary estimator: closed-form SRT, iterated by play-back."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from srt import closed_form
from srt.catalogue import AXES
from srt.exceptions import DataError
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES, N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from srt.options import Options
    from srt.playback import Playback
    from srt.playback_data import PlaybackData

    Array = NDArray[np.float64]

_BIAS = GROUP_SLICES["gyro_bias"]


class ClosedFormSolver:
    """Solves the components that the closed form reads, one per parameter, and the pooled rest rate.

    Parameters
    ----------
    data : PlaybackData
        Sequences of Table 1; those that occur more than once are averaged.
    options : Options

    Raises
    ------
    DataError
        If the sequences support no formula at all.
    """

    def __init__(self, data: PlaybackData, options: Options) -> None:
        self.data = data
        held = set(options.held_names)
        supported = closed_form.formulas(set(data.ids), asymmetry=not {*NAMES[GROUP_SLICES["gyro_asymmetry"]]} <= held)
        self.formulas = tuple(f for f in supported if f.parameter not in held)
        if not self.formulas:
            raise DataError(
                f"The sequences {', '.join(data.ids)} support none of the closed-form formulas; "
                "use the least-squares estimator, or record more of Table 1."
            )
        self.components = closed_form.components(self.formulas)
        self.missing = tuple(n for n in closed_form.missing_parameters(supported) if n not in held)
        self.kept = np.array([INDEX[f.parameter] for f in self.formulas] + list(range(*_BIAS.indices(N_PARAMETERS))))

    @cached_property
    def selection(self) -> Array:
        """S: what the formulas see of the measurements, shape (number of formulas + 3, n_z).

        One row per formula: its own combination of components, averaged over the occurrences of a sequence.
        """
        data = self.data
        n_z = 2 * data.K + len(data.windows.duration_s) + 3
        by_component = np.zeros((len(self.components), n_z))
        for row, component in enumerate(self.components):
            occurrences = [k for k, name in enumerate(data.ids) if name == component.sequence]
            for k in occurrences:
                by_component[row, self._column(k, component.kind)] += 1.0 / len(occurrences)
        own = np.zeros((len(self.formulas), len(self.components)))
        order = {c: j for j, c in enumerate(self.components)}
        for row, formula in enumerate(self.formulas):
            for coefficient, component in formula.components:
                own[row, order[component]] = coefficient
        S = np.zeros((len(self.formulas) + 3, n_z))
        S[:-3] = own @ by_component
        S[-3:, -3:] = np.eye(3)
        return S

    def _column(self, k: int, kind: str) -> int:
        data = self.data
        if kind == "start":
            return 2 * data.K + int(data.start[k])
        if kind == "end":
            return 2 * data.K + int(data.end[k])
        sequence = data.catalogue[k]
        assert sequence is not None
        horizontal = [axis for axis in AXES if axis != sequence.down]
        return 2 * k + horizontal.index(kind)

    def gain(self, playback: Playback, covariance: Callable[[], Array]) -> Array:  # noqa: ARG002 - one of two solvers
        """G of δ = G z: the full Jacobian of the selected components, inverted."""
        S = self.selection
        G = np.zeros((N_PARAMETERS, S.shape[1]))
        G[self.kept] = np.linalg.solve(S @ playback.H[:, self.kept], S)
        return G

    @cached_property
    def coefficients(self) -> Array:
        """Eq. 13 on the averaged components, and the rest rate as the gyro bias, shape (27, n_z)."""
        data = self.data
        n_z = self.selection.shape[1]
        by_component = np.zeros((len(self.components), n_z))
        for row, component in enumerate(self.components):
            occurrences = [k for k, name in enumerate(data.ids) if name == component.sequence]
            for k in occurrences:
                by_component[row, self._column(k, component.kind)] += 1.0 / len(occurrences)
        A = closed_form.inversion_matrix(self.formulas, data.gravity) @ by_component
        A[_BIAS, -3:] = np.eye(3)
        return A
