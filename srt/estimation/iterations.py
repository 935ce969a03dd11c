"""Iterations of an estimator over all models that it fitted, in one count."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.estimation.registry import Progress


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
