"""Iterations of an estimator over all models that it fitted, in one count, and their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from srt.sensor_errors import by_parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.estimation.registry import Progress

PARAMETER_UNITS: Final = by_parameter("full")
"""SI value of the unit of each parameter in comparisons: accelerometer bias in g, all others in SI units."""
CONVERGED_CORRECTION: Final = 1e-9
"""Correction, in :data:`PARAMETER_UNITS`, that counts as negligible; noise-free data reach it."""
CONVERGED_SIGMAS: Final = 0.01
"""Correction, in sigma of the parameter, that counts as negligible: it changes an error by 1e-4 in quadrature."""
MAX_STEP: Final = 0.7
"""Largest correction of an iteration, in :data:`PARAMETER_UNITS`: of longer steps only the direction is reliable."""


class Iterations:
    """Corrections of all iterations, and where they jump because another model is fitted.

    Attributes
    ----------
    corrections : list of float
        Largest correction of each iteration.
    refits : list of int
        Numbers, from 1, of the first iterations with another model whose correction exceeds the one before.
    """

    def __init__(
        self, progress: Progress | None = None, corrections: Sequence[float] = (), refits: Sequence[int] = ()
    ) -> None:
        self._progress, self._begun = progress, True
        self.corrections, self.refits = [*corrections], [*refits]

    def begin(self) -> None:
        """State that the next iteration is the first with a model."""
        self._begun = True

    def __call__(self, number: int, correction: float) -> None:  # noqa: ARG002 - the number within one model
        """Count an iteration and report it."""
        if self._begun and self.corrections and correction > self.corrections[-1]:
            self.refits.append(len(self.corrections) + 1)
        self._begun = False
        self.corrections.append(correction)
        if self._progress is not None:
            self._progress(len(self.corrections), correction)

    @property
    def converged(self) -> str:
        """Message of a result that converged."""
        return f"Converged after {len(self.corrections)} iterations."
