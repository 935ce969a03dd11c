"""A test that is followed as its recording grows: what is new at each look, and the accuracy after each sequence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.planning.monitoring.accuracy import accuracy_after, best_repetition
from srt.planning.monitoring.progress_text import next_text, progress_text, sequence_line, unrecorded_text
from srt.planning.monitoring.run_monitor import run_state, sequence_order

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.planning.monitoring.accuracy import SequenceAccuracy
    from srt.planning.monitoring.run_monitor import OperatorError, RunState
    from srt.recording.recording import Recording


class FollowedTest:
    """Rotation test while it runs.

    Parameters
    ----------
    order : sequence of str
        Sequences in their order; empty: Table 1.
    targets : mapping of str to float, SI
        Wanted sigma by parameter.
    estimator : str
        As for :func:`srt.calibrate`.

    Attributes
    ----------
    state : RunState or None
        State at the last look; None before it.
    history : list of SequenceAccuracy
        After each sequence.

    Raises
    ------
    InputError
        An unknown sequence.
    """

    def __init__(
        self, order: Sequence[str] = (), targets: Mapping[str, float] | None = None, estimator: str = "auto"
    ) -> None:
        self.order = sequence_order(order)
        self.targets = dict(targets or {})
        self.estimator = estimator
        self.begin()

    def begin(self) -> None:
        """Begin anew, without the samples so far."""
        self.state: RunState | None = None
        self.history: list[SequenceAccuracy] = []
        self.advice = ""
        self._named: set[tuple[str, str, int]] = set()
        self._next: str | None = None
        self._moves_told = False

    @property
    def open_errors(self) -> tuple[OperatorError, ...]:
        """Errors that no repetition has repaired."""
        return () if self.state is None else self.state.errors

    def take(self, recording: Recording) -> list[tuple[str, bool]]:
        """Look at the samples so far.

        Parameters
        ----------
        recording : Recording
            From the start of the test.

        Returns
        -------
        list of (str, bool)
            New lines; True marks the operator's errors, which need action.
        """
        bare = recording.with_sequences(()) if recording.sequences else recording
        state = self.state = run_state(bare, self.order)
        news = []
        # The last window still grows, so a sequence may vanish again, and its entry with it; others keep theirs.
        del self.history[len(state.labels) :]
        for number in range(len(self.history), len(state.labels)):
            self.history.append(accuracy_after(bare, state.labels[: number + 1], self.estimator))
            news.append((sequence_line(state, number, self.history[-1]), False))
        if state.unrecorded_s is not None and not self._moves_told:
            self._moves_told = True
            news.append((unrecorded_text(state), False))
        for error in state.errors:
            key = (error.kind, error.sequence, round(error.time_s))
            if not any((error.kind, error.sequence, key[2] + d) in self._named for d in (-1, 0, 1)):
                self._named.add(key)
                news.append((error.sentence, True))
        if news or self._next != state.next:
            self._next = state.next
            self.advice = self._advice(bare, state)
            news.append((self.advice or next_text(state), False))
        return news

    def text(self) -> str:
        """Table so far, errors, and what is next."""
        if self.state is None:
            return "No samples yet."
        text = progress_text(self.state, self.history, self.targets)
        return f"{text}\n{self.advice}" if self.advice else text

    def _advice(self, recording: Recording, state: RunState) -> str:
        """Repetition that brings the test nearest to its targets, once all sequences are done."""
        if state.next is not None or not self.history:
            return ""
        short = self.history[-1].shortfall(self.targets)
        if short is None or short[1] <= 1.0:
            return ""
        best = best_repetition(recording, state.labels, self.history[-1], self.targets)
        if best is None:
            return ""
        return f"Repeat sequence {best[0]}: with it the largest sigma is {best[1]:.2g} times its target."
