"""Biases that vary within a recording, in the joint model: bias instability as specified, and drift that is selected.

*Bias instability* (flicker noise): Markov states from sequence to sequence. The windows and rotations of a recording
are a chain of steps in time, one for each sequence. In every step the drift has states x at the start and white
unknowns u of unit variance. Its effects on the measurements of the step are ``y = A x + L u``, and the states at the
start of the next step are ``x⁺ = Φ x + B u + Γ w``, see :mod:`srt.noise.markov_drift`. The number of states does not
depend on the number of sequences.

*Forms of drift, and gyro g-sensitivity*: their effects on forces, rates and rotations are linear in the coefficients.
Rotations are integrated with the mean drift of each, because a drift of hundreds of degrees per hour is not linear in
the attitude, and without Γ f in every sample (:mod:`srt.estimation.g_sensitivity`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.drift_model import (
    DriftEstimate,
    DriftTerm,
    change,
)
from srt.estimation.error_sources import by_drift
from srt.model.analytic_platform import equal_parts
from srt.noise.bias_instability import correlation_times, interval_times, regular_root
from srt.noise.drift_forms import LINEAR, WALK
from srt.noise.markov_drift import MarkovSteps, markov_steps

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.estimation.error_sources import Slopes
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class DriftChain:
    """Steps of the drift of one channel with an Allan floor of one, and the place of every interval in them.

    Attributes
    ----------
    window_step, rotation_step : ndarray of int, shape (W,) and (K,)
        Step of each window and of each rotation.
    window_slot : ndarray of int, shape (W,)
        Place of each window among the n windows of its step.
    slots : int
        Largest number of windows of a step, n.
    markov : MarkovSteps
        Steps of the means over the n windows, then over the P parts of the rotation.
    """

    window_step: Indices
    rotation_step: Indices
    window_slot: Indices
    slots: int
    markov: MarkovSteps


def drift_chain(data: PreparedRecording, window_step: Indices, rotation_step: Indices, parts: int) -> DriftChain:
    """Chain of steps of a recording.

    Parameters
    ----------
    data : PreparedRecording
    window_step, rotation_step : ndarray of int, shape (W,) and (K,)
        Rank in time of the sequence of each window and of each rotation.
    parts : int
        Number of parts of every rotation; the accelerometers, whose drift acts in the windows, need none.
    """
    K, W = data.K, len(window_step)
    edges = equal_parts(data.rotation, parts) if parts else np.empty((K, 1), dtype=np.intp)
    spans = np.stack([edges[:, :-1].ravel(), edges[:, 1:].ravel()], axis=1)
    start, end = interval_times(np.concatenate([data.windows.samples, spans]), data.recording.time)
    times = correlation_times(float(end.max() - start.min()))
    # Slots of a step: its windows, then the parts of its rotation. An empty slot repeats the first window.
    slots = int(np.bincount(window_step, minlength=K).max())
    slot = np.zeros(W, dtype=np.intp)
    interval = np.empty((K, slots + parts), dtype=np.intp)
    for k in range(K):
        i, own = int(rotation_step[k]), np.flatnonzero(window_step == rotation_step[k])
        slot[own] = np.arange(len(own))
        interval[i, :slots] = np.resize(own if own.size else [int(data.end[k])], slots)
        interval[i, : len(own)] = own
        interval[i, slots:] = W + parts * k + np.arange(parts)
    # A step that begins before the one before it has ended keeps the state of that end.
    latest = np.concatenate([[-np.inf], np.maximum.accumulate(end[interval].max(axis=1))])
    begins = np.maximum(start[interval].min(axis=1), latest[:-1])
    ends = np.append(begins[1:], latest[-1])
    steps = markov_steps(start[interval], end[interval], (begins, ends), times)
    return DriftChain(window_step, rotation_step, slot, slots, steps)


@dataclass(frozen=True, slots=True, eq=False)
class DriftStates:
    """Drift of one triad: effects on the measurements, and transitions, in K steps.

    Attributes
    ----------
    steps : dict of str to ndarray of int, shape (n,)
        Step of every member by kind of measurement: "rate", "turn" and "stated_rate" (gyros), or "force"
        (accelerometers).
    by_state, by_noise : dict of str to ndarray, shape (n, d, X) and (n, d, U)
        Effects of the X states and of the U white unknowns of the step on compensated means (rad/s, m/s²) and on
        attitude errors of rotations (rad).
    transition : ndarray, shape (K − 1, X, X + U + X)
        Γ⁻¹ [−Φ, −B, I] of every step but the last: coefficients of x, u and x⁺ in the white noise w.
    """

    steps: dict[str, Indices]
    by_state: dict[str, Array]
    by_noise: dict[str, Array]
    transition: Array

    @property
    def states(self) -> int:
        """Number of states of a step, X."""
        return int(next(iter(self.by_state.values())).shape[2])

    @property
    def unknowns(self) -> int:
        """Number of white unknowns of a step, U."""
        return int(next(iter(self.by_noise.values())).shape[2])

    def effect(self, kind: str, x: Array, u: Array) -> Array:
        """Effect on the measurements of a kind, shape (n, 3), of states (K, X) and unknowns (K, U)."""
        at = self.steps[kind]
        return np.asarray(
            np.einsum("nax,nx->na", self.by_state[kind], x[at]) + np.einsum("nau,nu->na", self.by_noise[kind], u[at])
        )


def drift_states(
    chain: DriftChain,
    floor: Array,
    window: tuple[str, Array],
    rotations: Mapping[str, tuple[Indices, Array]] | None = None,
) -> DriftStates:
    """Drift of a triad.

    Parameters
    ----------
    chain : DriftChain
    floor : ndarray, shape (3,)
        Bias instability (Allan floor) of the channels, rad/s or m/s².
    window : (str, ndarray of shape (W, 3, 3))
        Kind of the means of the windows, and their derivatives with respect to biases of the raw channels.
    rotations : mapping of str to (ndarray of int, shape (n,); ndarray, shape (n, P, d, 3)), optional
        Rotations that each kind of measurement belongs to, and its derivatives with respect to biases in their parts.
    """
    markov, (kind, slope) = chain.markov, window
    K, intervals, M = markov.by_state.shape
    rotations = rotations or {}
    n = intervals if rotations else chain.slots
    # Steps and rows of each kind, and the effects on the rows of a step by the biases of the channels in its intervals.
    places = {kind: (chain.window_step, 3 * chain.window_slot[:, None] + np.arange(3))}
    U = 3 * chain.slots
    for name, (members, parts) in rotations.items():
        places[name] = chain.rotation_step[members], np.tile(U + np.arange(parts.shape[2]), (len(members), 1))
        U += parts.shape[2]
    effects, X = np.zeros((K, U, n, 3)), 3 * M
    step, rows = places[kind]
    effects[step[:, None], rows, chain.window_slot[:, None]] = slope * floor
    for name, (_, parts) in rotations.items():
        step, rows = places[name]
        effects[step[:, None], rows, chain.slots :] = np.swapaxes(parts * floor, 1, 2)
    by_state = np.einsum("kdnb,knm->kdmb", effects, markov.by_state[:, :n]).reshape(K, U, X)
    noise = np.einsum("kdnb,knr->kdbr", effects, markov.root[:, :n]).reshape(K, U, -1)
    final = np.einsum("kmr,bc->kmbcr", markov.root[:, intervals:], np.eye(3)).reshape(K, X, -1)
    joint = np.concatenate([noise, final], axis=1)
    root = regular_root(joint @ np.swapaxes(joint, 1, 2))
    L, B, Gamma = root[:, :U, :U], root[:-1, U:, :U], root[:-1, U:, U:]
    decay = np.repeat(markov.decay[:-1], 3, axis=1)
    phi = decay[:, :, None] * np.eye(X)
    unit = np.broadcast_to(np.eye(X), phi.shape)
    transition = np.linalg.solve(Gamma, np.concatenate([-phi, -B, unit], axis=2))
    states, noises = ({name: a[at[0][:, None], at[1]] for name, at in places.items()} for a in (by_state, L))
    return DriftStates({name: at[0] for name, at in places.items()}, states, noises, transition)


WINDOW_ROWS: Final = {"force": slice(0, 3), "rate": slice(3, 6)}
"""Rows of force and rate in a measurement of both, of the kind "window"."""


def combined(drift: Mapping[str, DriftStates]) -> DriftStates:
    """Drift of both triads, or of the one that has any, as one process; force and rate of a window are one kind.

    States, white unknowns and transitions are those of the triads one after the other.
    """
    X, U = (sum(sizes) for sizes in ([of.states for of in drift.values()], [of.unknowns for of in drift.values()]))
    steps: dict[str, Indices] = {}
    by_state: dict[str, Array] = {}
    by_noise: dict[str, Array] = {}
    transition = np.zeros((max((len(of.transition) for of in drift.values()), default=0), X, X + U + X))
    x = u = 0
    for of in drift.values():
        states, unknowns = np.arange(x, x + of.states), np.arange(u, u + of.unknowns)
        for name, step in of.steps.items():
            kind, rows = ("window", WINDOW_ROWS[name]) if name in WINDOW_ROWS else (name, slice(None))
            steps[kind] = step
            d = 6 if kind == "window" else of.by_state[name].shape[1]
            by_state.setdefault(kind, np.zeros((len(step), d, X)))[:, rows, states] = of.by_state[name]
            by_noise.setdefault(kind, np.zeros((len(step), d, U)))[:, rows, unknowns] = of.by_noise[name]
        columns = np.concatenate([states, X + unknowns, X + U + states])
        transition[:, states[:, None], columns] = of.transition
        x, u = x + of.states, u + of.unknowns
    return DriftStates(steps, by_state, by_noise, transition)


_WIDE_G_SENSITIVITY: Final = 1e-2
"""Prior sigma of an element of Γ, rad/s per m/s²: 6 °/s/g, tens of times that of the worst consumer gyros."""


class DriftTerms:
    """Selected forms of drift, each with three coefficients for every function of the form, after those of Γ.

    Parameters
    ----------
    data : PreparedRecording
    terms : tuple of DriftTerm
    force_axes : ndarray, shape (n, 3), optional
        Unit vectors in B along which gyro g-sensitivity is estimated, three coefficients for each; default none.
    """

    def __init__(
        self, data: PreparedRecording, terms: tuple[DriftTerm, ...] = (), force_axes: Array | None = None
    ) -> None:
        self.data, self.terms, self.force_axes = data, terms, force_axes
        first = 0 if force_axes is None else 3 * len(force_axes)
        self.of_force = slice(0, first)
        """Coefficients of the g-sensitivity."""
        self._shapes = {term: data.drift_shape(term.sensor, term.form) for term in terms}
        sizes = [3 * self._shapes[term].windows.shape[1] for term in terms]
        stops = (first + np.cumsum(sizes, dtype=np.intp)).tolist()
        self.slices = [slice(stop - size, stop) for stop, size in zip(stops, sizes, strict=True)]
        self.size = first + sum(sizes)
        """Number of coefficients."""

    @property
    def sigma(self) -> Array:
        """Prior standard deviations of all coefficients, shape (size,)."""
        of_drift = np.repeat([term.sigma for term in self.terms], [s.stop - s.start for s in self.slices])
        return np.concatenate([np.full(self.of_force.stop, _WIDE_G_SENSITIVITY), of_drift])

    def of_forms(self, coefficients: Array) -> Array:
        """Coefficients of the forms of drift, with zeros in place of those of Γ."""
        out = coefficients.copy()
        out[self.of_force] = 0.0
        return out

    @property
    def freely_estimated(self) -> int:
        """Number of coefficients with a wide prior, which is no measurement; that of a random walk is one."""
        of_drift = sum(s.stop - s.start for t, s in zip(self.terms, self.slices, strict=True) if t.form != WALK)
        return int(self.of_force.stop + of_drift)

    @property
    def g_sensitivity_map(self) -> Array:
        """Elements of Γ by rows (gyros before compensation, axes of B) from its coefficients, shape (9, 3 n)."""
        assert self.force_axes is not None
        return np.asarray(np.einsum("bd,nc->bcnd", np.eye(3), self.force_axes).reshape(9, -1))

    def g_sensitivity(self, coefficients: Array) -> Array:
        """Γ, shape (3, 3), rad/s per m/s²; zero where it is not estimated."""
        if self.force_axes is None:
            return np.zeros((3, 3))
        return np.asarray((self.g_sensitivity_map @ coefficients[self.of_force]).reshape(3, 3))

    def of(self, sensor: str) -> list[tuple[DriftTerm, slice]]:
        """Terms of a sensor, with their coefficients."""
        return [(t, s) for t, s in zip(self.terms, self.slices, strict=True) if t.sensor == sensor]

    def raw(self, sensor: str, coefficients: Array, of: str) -> Array:
        """Drift of the raw channels in "windows" (W, 3), their "halves" (W, 2, 3) or "parts" of rotations (K, P, 3)."""
        shape = (*getattr(self.data.drift_shapes[LINEAR], of).shape[:-1], 3)
        parts = [getattr(self._shapes[t], of) @ coefficients[s].reshape(-1, 3) for t, s in self.of(sensor)]
        return np.asarray(sum(parts, np.zeros(shape)))

    def jacobian(self, sensor: str, of: str, slope: Array, members: Indices | slice = slice(None)) -> Array:
        """Effect of all coefficients on windows (n, d, size) or, by parts (n, P, d, 3), on rotations; default: all."""
        out = np.zeros((len(slope), slope.shape[-2], self.size))
        for term, at in self.of(sensor):
            shape = getattr(self._shapes[term], of)[members]
            out[:, :, at] = by_drift(slope, shape)
        return out

    def add_g_sensitivity(
        self, effect: dict[str, Array], by: Slopes, force: Array, stated: tuple[Array, Array]
    ) -> None:
        """Add the effect of Γ to that of the drift on the "rate" of windows with this specific force, and on rotations.

        ``stated`` are the derivatives of stated rates by the raw channels, and their specific forces, (R, 2, 3).
        """
        if self.force_axes is None:
            return
        assert by.integrals.velocity is not None
        effect["rate"][:, :, self.of_force] = by_drift(by.rate, force @ self.force_axes.T)
        turn = np.einsum("kabc,nc->kanb", by.integrals.velocity, self.force_axes)
        effect["turn"][:, :, self.of_force] = turn.reshape(len(turn), 3, -1)
        by_raw, along = stated[0], stated[1] @ self.force_axes.T
        effect["stated_rate"][:, :, self.of_force] = np.einsum("rhb,rhn->rhnb", by_raw, along).reshape(
            *by_raw.shape[:2], self.of_force.stop
        )

    def estimates(self, coefficients: Array) -> tuple[DriftEstimate, ...]:
        """Drift of every term over the recording."""
        return tuple(
            DriftEstimate(
                t.sensor,
                t.form,
                change(t.form, coefficients[s].reshape(-1, 3), self._shapes[t].windows),
                modelled=True,
            )
            for t, s in zip(self.terms, self.slices, strict=True)
        )
