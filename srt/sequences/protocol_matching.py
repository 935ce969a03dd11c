"""Labels of an unlabelled recording from its protocol: the steps are matched with the rests and turns, in order.

Each step expects a rest with a certain IMU direction down, reached by a certain turn or by placing the unit. Dynamic
programming finds the rests and turns of the recording that agree with all steps. A rest before a step that places the
unit may be skipped. Raw readings are compared; the limits are therefore wide enough for uncalibrated sensors and for
turning by hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG
from srt.exceptions import DataError
from srt.recording.sequence_label import SequenceLabel
from srt.sequences.manoeuvres import angles_between, centred
from srt.sequences.stationary_windows import rests_between_turns, window_times

if TYPE_CHECKING:
    from srt.recording.protocol import Protocol, Step
    from srt.recording.recording import Recording
    from srt.types import Array

_ANGLE: Final = 30.0 * DEG
"""Largest angle between an expected and a measured direction or rotation. Hands and uncalibrated sensors need it."""
_SCALE: Final = 0.15
"""Share of a rotation's path that is added to the limit :data:`_ANGLE`, for the scale factors of the gyros."""
_PASSED_OVER: Final = 0.1
"""Cost of a rest that no step expects, in units of the largest mismatch of a step."""
_STEADY: Final = 0.98
"""Share of the plateau's rate from which a run counts as steady."""
_MARGIN: Final = 0.1
"""Share of the steady time that is left out at either end."""


@dataclass(frozen=True, slots=True, eq=False)
class _Expected:
    """Rest that a step expects: what is down, and the step that turns the unit to it (None: it is placed)."""

    step: Step
    down: Array
    turn: Step | None


@dataclass(frozen=True, eq=False)
class _Found:
    """Rests of a recording and the turns between them, from raw readings."""

    recording: Recording
    windows: list[tuple[int, int]]
    breaks: list[bool]

    @cached_property
    def down(self) -> Array:
        """Direction of gravity in each rest, shape (W, 3)."""
        means = np.array([self.recording.accel[a:b].mean(axis=0) for a, b in self.windows])
        f = centred(means * self.recording.rates_factor, self.recording.site.gravity_m_s2)
        return np.asarray(-f / np.linalg.norm(f, axis=1, keepdims=True))

    @cached_property
    def turns(self) -> list[tuple[Array, float]]:
        """Summed gyro angle (3,) and path, rad, between each rest and the next."""
        each = [angles_between(self.recording, *pair) for pair in pairwise(self.windows)]
        return [(angles.sum(axis=0), float(np.linalg.norm(angles, axis=1).sum())) for angles in each]

    def times(self, window: int) -> tuple[float, float]:
        """Limits of a rest, s."""
        return window_times(self.recording, self.windows[window])


def with_protocol(recording: Recording) -> Recording:
    """Label a recording by its protocol; the same recording if it names none, or has labels.

    Raises
    ------
    DataError
        If the motion contradicts a step: which, and why.
    InputError
        If the recording has a fixture that cannot run the protocol.
    """
    if recording.protocol is None or recording.sequences:
        return recording
    protocol = recording.protocol
    labels = recording.memo(("protocol", protocol.name), lambda: protocol_labels(recording, protocol))
    return recording.with_sequences(labels)


def protocol_labels(recording: Recording, protocol: Protocol) -> tuple[SequenceLabel, ...]:
    """Labels of the steps of a protocol, see :func:`with_protocol`."""
    expected = _expected_rests(protocol)
    executed = protocol.on_fixture() if recording.fixture is not None and protocol.states_attitudes else None
    found = _Found(recording, *rests_between_turns(recording))
    matched = _match(protocol, expected, found)
    labels = []
    place = -1
    for number, step in enumerate(protocol.steps):
        if step.down is not None:
            place += 1
        if step.pose:
            following = protocol.steps[number + 1 : number + 2]
            if not following or following[0].down is not None:  # otherwise the next turn starts from this rest
                stated = () if executed is None else (None, *executed[number][:2])
                labels.append(SequenceLabel.of_pose(found.times(matched[place]), *stated))
            continue
        pair = found.times(matched[place]), found.times(matched[place + 1])
        place += 1
        if step.stated_rate_rad_s is not None:
            labels.append(_rate_label(recording, protocol, step, pair))
        elif executed is None:
            labels.append(SequenceLabel(*pair))
        elif step.id is not None:
            labels.append(SequenceLabel(*pair, step.id))
        else:
            down, outer, rotations = executed[number]
            labels.append(SequenceLabel(*pair, f"step {step.number}", down, outer, rotations))
    return tuple(labels)


def _expected_rests(protocol: Protocol) -> list[_Expected]:
    out: list[_Expected] = []
    for step in protocol.steps:
        if step.down is not None:
            out.append(_Expected(step, step.down, None))
        if not step.pose:
            out.append(_Expected(step, step.turned().T @ out[-1].down, step))
    return out


def _match(protocol: Protocol, expected: list[_Expected], found: _Found) -> list[int]:
    """Rest of the recording for each expected one; DataError names the step that nothing agrees with."""
    n, W = len(expected), len(found.windows)
    cost, came = np.full((n, W), np.inf), np.full((n, W), -1, dtype=np.intp)
    for i, rest in enumerate(expected):
        tilt = np.arccos(np.clip(found.down @ rest.down, -1.0, 1.0)) / _ANGLE
        for w in range(W):
            if tilt[w] > 1.0:
                continue
            if rest.turn is not None:
                before = w - 1
                reached = cost[i - 1, before] + _mismatch(rest.turn, found, before) if w else np.inf
            elif i == 0:
                before, reached = -1, _PASSED_OVER * w
            else:
                passed = cost[i - 1, :w] + _PASSED_OVER * np.arange(w - 1, -1, -1)
                before = int(np.argmin(passed)) if w else -1
                reached = float(passed[before]) if w else np.inf
            cost[i, w], came[i, w] = reached + tilt[w], before
        if not np.isfinite(cost[i]).any():
            raise DataError(_contradiction(protocol, rest, found, cost[i - 1] if i else None))
    last = int(np.argmin(cost[-1] + _PASSED_OVER * np.arange(W - 1, -1, -1)))
    out = [last]
    for i in range(n - 1, 0, -1):
        out.append(int(came[i, out[-1]]))
    return out[::-1]


def _mismatch(step: Step, found: _Found, window: int) -> float:
    """Difference between a step's turn and the measured turn after a rest, in units of the limit; infinite beyond."""
    if found.breaks[window]:
        return np.inf
    angle, path = found.turns[window]
    nominal = sum(abs(a) for _, a in step.rotations)
    limit = _ANGLE + _SCALE * nominal
    off = abs(path - nominal)
    if len(step.rotations) == 1:
        axis, turned = step.rotations[0]
        off = float(np.linalg.norm(angle - axis * turned))
    return off / limit if off <= limit else np.inf


def _contradiction(protocol: Protocol, rest: _Expected, found: _Found, cost: Array | None) -> str:
    """Sentence on the first step that no rest or turn of the recording agrees with."""
    step = rest.step
    head = f"The motion contradicts step {step.number} of protocol {protocol.name!r} ({step.described()}): "
    tail = "; correct the protocol, or label the sequences."
    at = -1 if cost is None else int(np.argmin(cost))
    if at + 1 >= len(found.windows):
        return f"{head}the recording ends after the rest at {found.times(at)[0]:.6g} s{tail}"
    if rest.turn is None:
        since = "" if cost is None else f" after {found.times(at)[1]:.6g} s"
        return f"{head}no rest{since} has that direction within {_ANGLE / DEG:.0f}° of the vertical{tail}"
    a, b = found.times(at)[1], found.times(at + 1)[0]
    if found.breaks[at]:
        return f"{head}after the rest that ends at {a:.6g} s, the recording is interrupted{tail}"
    if np.isfinite(_mismatch(rest.turn, found, at)):
        tilt = np.arccos(np.clip(found.down[at + 1] @ rest.down, -1.0, 1.0)) / DEG
        return f"{head}at {b:.6g} s, gravity is {tilt:.0f}° from where the turn leads{tail}"
    angle, path = found.turns[at]
    turned = ", ".join(f"{value / DEG:+.1f}" for value in angle)
    return f"{head}from {a:.6g} to {b:.6g} s the gyros turn by ({turned})°, {path / DEG:.0f}° in all{tail}"


def _rate_label(
    recording: Recording, protocol: Protocol, step: Step, pair: tuple[tuple[float, float], tuple[float, float]]
) -> SequenceLabel:
    """Label of a run at a stated rate, with the steady part of the turn."""
    axis, angle = step.rotations[0]
    i = int(np.argmax(np.abs(axis)))
    sense = float(np.sign(axis[i] * angle))
    samples = recording.window_indices(pair[0][1], pair[1][0])
    rate = recording.gyro[samples, i] * sense
    fast = rate > 0.5 * rate.max()
    steady = np.flatnonzero(rate > _STEADY * np.median(rate[fast]))
    first, last = int(steady[0]), int(steady[-1])
    inset = round(_MARGIN * (last - first))
    time = recording.time[samples]
    window = float(time[first + inset]), float(time[last - inset])
    stated = abs(step.stated_rate_rad_s or 0.0)
    return SequenceLabel(*pair, rate=("xyz"[i], sense * stated), rate_sigma=protocol.rate_sigma, steady_s=window)
