"""Bias drift within a recording: selection of its form from the residuals, and its effect on the SRT measurements."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from srt.constants import DEG_PER_H, MICRO_G
from srt.estimation.error_sources import earth_rate_sigma, raw_rate_variance
from srt.estimation.white_residuals import WhiteResiduals
from srt.noise.bias_steps import LARGEST_SHARE, STEP, within_span
from srt.noise.drift_forms import (
    FALSE_ALARM,
    LINEAR,
    TEMPERATURE,
    WALK,
    WARM_UP,
    Statistics,
    drift_test,
    form_or_scatter,
    likelihood_gain,
    of_courses,
    residual_statistics,
    variance_component,
)
from srt.ranking import significant
from srt.result.diagnostics import Drift

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from srt.noise.drift_forms import DriftTest
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

    Sensor = Literal["gyro", "accel"]


_WIDE: Final = 100.0
"""Prior sigma of the coefficients of a form, in units of their estimate: the prior takes 1e-4 of the estimate."""
_SHOWN: Final = 1e-3
"""p-value of a form of drift below which steps are tested: one triad in a hundred without drift has one."""
_LEAST_P: Final = 1e-300
"""p-value below which the logarithm is taken of this limit."""
_POSSIBLE: Final = 0.05
"""p-value of a linear accelerometer drift below which the covariance includes it, although it is not selected."""
MOST_TERMS: Final = 4
"""Largest number of forms that are modelled: searching ends when as many, or more, have been selected."""
_COURSES: Final = {LINEAR: "linearly with time", TEMPERATURE: "with temperature", WALK: "as a random walk"} | (
    dict.fromkeys(WARM_UP, "as in a warm-up")
)
_UNITS: Final = {"gyro": (DEG_PER_H, "°/h"), "accel": (1e3 * MICRO_G, "mg")}
_NAMES: Final = {"gyro": "gyro", "accel": "accelerometer"}


class DriftTerm(NamedTuple):
    """One form of drift of one triad.

    Attributes
    ----------
    sensor : "gyro" or "accel"
    form : str
        Name of the form, see :mod:`srt.noise.drift_forms`.
    sigma : float, rad/s or m/s²
        Prior standard deviation of the coefficients: wide, or that of a random walk over the recording.
    """

    sensor: Sensor
    form: str
    sigma: float


class DriftSearch(NamedTuple):
    """Drift that the residuals of a solution show beyond what it models.

    Attributes
    ----------
    terms : tuple of DriftTerm
        Most likely form of each triad, where one is significant; that of the larger likelihood ratio first.
    gain : float
        Twice the logarithm of the first one's likelihood ratio, less a penalty, see
        :class:`srt.noise.drift_forms.DriftTest`.
    possible : float, m/s²
        Standard deviation, by restricted maximum likelihood, of the change of the accelerometer biases over the
        recording by a linear drift that is not significant. The covariance includes its effect. Zero if p > 0.05, or
        if an accelerometer drift is modelled or selected.
    """

    terms: tuple[DriftTerm, ...] = ()
    gain: float = 0.0
    possible: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DriftEstimate:
    """Estimated drift of one term.

    Attributes
    ----------
    sensor, form : str
    change : ndarray, shape (3,), rad/s or m/s²
        Change of the bias of each channel over the recording; for a random walk, its largest range.
    modelled : bool
        True if the estimate of the sensor errors allows for the drift.
    """

    sensor: str
    form: str
    change: Array
    modelled: bool

    @property
    def result(self) -> Drift:
        """Drift as the result states it."""
        change = {"change_rad_s" if self.sensor == "gyro" else "change_m_s2": self.change}
        return Drift(sensor=self.sensor, form=self.form, modelled=self.modelled, **change)

    @property
    def sentence(self) -> str:
        """Warning that names the drift and its size."""
        factor, unit = _UNITS[self.sensor]
        sizes = ", ".join(f"{value / factor:+.3g}" for value in self.change.tolist())
        form = f"by a {self.form}," if self.form.startswith(STEP) else _COURSES[self.form]
        end = (
            "the estimate includes this drift, and the sigmas allow for it."
            if self.modelled
            else "this estimator does not model it: use least-squares, or let the unit warm up."
        )
        return (
            f"The {_NAMES[self.sensor]} biases changed {form} by {sizes} {unit} (x, y, z) over the recording, more "
            f"than their noise allows; {end}"
        )


def candidates(data: PreparedRecording, present: Sequence[DriftTerm]) -> list[tuple[Sensor, str]]:
    """Sensors and forms that can be selected in addition to those present."""
    taken = {(term.sensor, term.form) for term in present}
    sensors: tuple[Sensor, ...] = ("accel", "gyro")
    return [(s, form) for s in sensors for form in data.drift_shapes if (s, form) not in taken]


def most_likely(
    data: PreparedRecording,
    found: Mapping[tuple[Sensor, str], Statistics],
    present: Sequence[DriftTerm],
    force: float,
    by_window: Callable[[Sensor], Statistics],
) -> DriftSearch:
    """Most likely form of drift of each triad among the significant ones, and a possible drift.

    The probability of selecting any form without drift is at most :data:`~srt.noise.drift_forms.FALSE_ALARM`
    (Bonferroni's inequality, half of it for the steps): later selections presuppose a first one. Steps are tested where
    another form of the triad has p < 1e-3: any significant step makes one so.

    Parameters
    ----------
    data : PreparedRecording
    found : mapping of (sensor, form) to Statistics
        Coefficients of the three channels, for each function in the test of a form in turn.
    present : sequence of DriftTerm
        Forms that are modelled.
    force : float, m/s²
        Standard deviation of independent errors of the windows that are modelled. They may be a drift that was not
        known.
    by_window : callable
        Statistics of independent errors of the windows of a sensor.
    """
    each, taken, possible, likely = cache(by_window), {(term.sensor, term.form) for term in present}, 1.0, []
    for sensor in dict.fromkeys(sensor for sensor, _ in found):
        tests = {key: test for key, own in found.items() if key[0] == sensor and (test := drift_test(own)) is not None}
        scatter = force if sensor == "accel" else 0.0
        if scatter > 0.0:
            tests = {key: _beside_scatter(data, key, test, scatter, each(sensor)) for key, test in tests.items()}
        if sensor == "accel" and (sensor, LINEAR) in tests:
            possible = tests[sensor, LINEAR].p_value
        shown = any(test.p_value < _SHOWN for test in tests.values())
        limit = 0.5 * FALSE_ALARM / len(found)
        tests = {key: test for key, test in tests.items() if test.p_value < limit}
        steps = [key for form in data.step_shapes if (key := (sensor, form)) not in taken] if shown else []
        if steps and (step := _best_step(data, steps, each(sensor))) is not None:
            key, test = step
            if scatter > 0.0:
                test = _beside_scatter(data, key, test, scatter, each(sensor))
            if test.p_value < 0.25 * FALSE_ALARM / len(steps):
                tests[key] = replace(test, gain=test.gain - 2.0 * math.log(len(steps)))
        if tests:
            key = max(tests, key=lambda key: significant(tests[key].gain))
            if key in steps and (sensor, WALK) in tests and scatter == 0.0:
                key = _step_or_walk(data, key, tests[key], each(sensor))
            likely.append((tests[key].gain, DriftTerm(*key, _prior_sigma(data, key, tests[key], each))))
    likely.sort(key=lambda item: -item[0])
    terms = tuple(term for _, term in likely)
    linear: tuple[Sensor, str] = ("accel", LINEAR)
    drifting = any(term.sensor == "accel" for term in (*present, *terms)) or linear not in found
    by_chance = 0.0 if drifting else possible_sigma(found[linear], possible)
    return DriftSearch(terms, likely[0][0] if likely else 0.0, by_chance)


def _beside_scatter(
    data: PreparedRecording, key: tuple[Sensor, str], test: DriftTest, scatter: float, each: Statistics
) -> DriftTest:
    """The test of a form beside independent errors of the windows, see :func:`form_or_scatter`."""
    p = form_or_scatter(each, data.drift_shape(*key).windows, scatter, walk=key[1] == WALK)
    return replace(test, p_value=p, gain=-2.0 * math.log(max(p, _LEAST_P)))


def _best_step(
    data: PreparedRecording, steps: Sequence[tuple[Sensor, str]], each: Statistics
) -> tuple[tuple[Sensor, str], DriftTest] | None:
    """Most likely step, and its test; None if the residuals show none.

    Both halves of a window explain its mean alike: the step is in the half that holds it.
    """
    best = None
    for key in steps:
        test = drift_test(of_courses(each, data.drift_shape(*key).windows))
        if test is not None and (share := within_span(test.amplitude)) <= LARGEST_SHARE:
            place = round(test.gain, 3), -share
            if best is None or place > best[0]:
                best = place, key, test
    return None if best is None else best[1:]


def _step_or_walk(
    data: PreparedRecording, step: tuple[Sensor, str], test: DriftTest, each: Statistics
) -> tuple[Sensor, str]:
    """The step, or the random walk if all its components together are more likely: its test uses three."""
    walk = (step[0], WALK)
    ratio = variance_component(of_courses(each, data.drift_shape(*walk).windows)).ratio
    return walk if likelihood_gain(ratio, 1, each.chi_square, each.freedom) > test.gain else step


def possible_sigma(linear: Statistics, p_value: float) -> float:
    """Standard deviation of a linear drift with a p-value that does not exclude it, m/s²; else zero."""
    return variance_component(linear).sigma if p_value < _POSSIBLE else 0.0


def _prior_sigma(
    data: PreparedRecording,
    key: tuple[Sensor, str],
    test: DriftTest,
    by_window: Callable[[Sensor], Statistics],
) -> float:
    """Prior sigma of the coefficients of a form: that of the walk, or a wide one."""
    if key[1] == WALK:
        return variance_component(of_courses(by_window(key[0]), data.drift_shape(*key).windows)).sigma
    return _WIDE * float(np.abs(test.amplitude).max())


def change(form: str, coefficients: Array, windows: Array) -> Array:
    """Change of the bias of each channel over the recording, shape (3,), from coefficients (n, 3) of a form."""
    course = windows @ coefficients
    return np.asarray(np.ptp(course, axis=0) * (1.0 if form == WALK else np.sign(course[-1] - course[0])))


def gyro_courses(data: PreparedRecording, keys: Sequence[tuple[Sensor, str]]) -> dict[str, Array]:
    """Functions in the tests of the forms of gyro drift among the keys, by form, shape (W, functions)."""
    return {form: data.drift_shapes[form].tested.windows for sensor, form in keys if sensor == "gyro"}


def gyro_statistics(
    data: PreparedRecording,
    slope: Array,
    rest: Array,
    integrated: Mask,
    present: Sequence[DriftTerm],
    courses: Mapping[str, Array],
) -> dict[str, Statistics]:
    """Test statistics of courses of the gyro bias in the rest rates, weighted by the specified noise.

    Parameters
    ----------
    data : PreparedRecording
    slope : ndarray, shape (3, 3)
        Derivative of compensated rates with respect to the raw ones.
    rest : ndarray, shape (W, 3), rad/s
        Compensated rates of the windows less the Earth's.
    integrated : ndarray of bool, shape (W,)
        Windows in which the unit moved; their rate is not used.
    present : sequence of DriftTerm
        Forms that are modelled.
    courses : mapping of str to ndarray, shape (W, functions)
        Courses to test, by name.
    """
    used = np.flatnonzero(~integrated)
    doubt = earth_rate_sigma(data.recording)
    variance = (raw_rate_variance(data.noise, data.windows.duration_s) @ (slope**2).T + doubt**2).ravel()
    noise: Array | None = None
    if data.noise.gyro_flicker is not None:
        own = data.noise.gyro_flicker * slope
        noise = np.asarray(np.kron(data.drift.window_covariance, own @ own.T))
    modelled = [(term, data.drift_shape(*term[:2]).windows) for term in present if term.sensor == "gyro"]
    for term, course in modelled:
        if term.form == WALK:
            own = term.sigma * slope
            walk = np.asarray(np.kron(course @ course.T, own @ own.T), dtype=np.float64)
            noise = walk if noise is None else np.asarray(noise + walk)
    rows = (3 * used[:, None] + np.arange(3)).ravel()
    taken = [course for term, course in modelled if term.form != WALK]
    parts = [np.concatenate([np.ones((len(rest), 1)), *taken], axis=1), *courses.values()]
    own = variance.reshape(-1, 3)
    if noise is None and not taken and len(used) == len(rest) and np.all(own == own[0]):
        return {name: _of_all_windows(data, rest, own[0], course) for name, course in courses.items()}
    z, (H, *effects) = rest[used].ravel(), (np.kron(part[used], np.eye(3)) for part in parts)
    if noise is None:
        scale = 1.0 / np.sqrt(variance[rows])
        found = residual_statistics(z * scale, *(part * scale[:, None] for part in (H, *effects)))
    else:
        white = WhiteResiduals.of(z, H, (noise + np.diag(variance))[np.ix_(rows, rows)])
        found = [white.statistics(part) for part in effects]
    return dict(zip(courses, found, strict=True))


def _of_all_windows(data: PreparedRecording, rest: Array, variance: Array, course: Array) -> Statistics:
    """Statistics where the rates of all windows have the same noise: the schedule determines the eigenvectors."""
    left, eigen = centred_course(data, course)
    return _common_course_statistics(rest, variance, left, eigen)


def centred_course(data: PreparedRecording, course: Array) -> tuple[Array, tuple[Array, Array]]:
    """Courses (W, n) less their means, and eigenvalues and eigenvectors of their products, (n,) and (n, n)."""

    def centred() -> tuple[Array, tuple[Array, Array]]:
        left = course - course.mean(axis=0)
        values, vectors = np.linalg.eigh(left.T @ left)
        return left, (values, vectors)

    return data.of_schedule(("course", course.tobytes()), centred)


def _common_course_statistics(z: Array, variance: Array, course: Array, eigen: tuple[Array, Array]) -> Statistics:
    """Statistics of courses of the biases of three channels, each of whose readings have one variance and a mean.

    Parameters
    ----------
    z : ndarray, shape (W, 3)
    variance : ndarray, shape (3,)
    course : ndarray, shape (W, n)
        Courses, with a mean of zero.
    eigen : (ndarray, ndarray), shape (n,) and (n, n)
        Eigenvalues of ``courseᵀ course``, ascending, and its eigenvectors.
    """
    r, n, channels = z - z.mean(axis=0), course.shape[1], np.arange(3)
    information, vectors = np.zeros((2, n, 3, n, 3))
    information[:, channels, :, channels] = (course.T @ course) / variance[:, None, None]
    vectors[:, channels, :, channels] = eigen[1]
    return Statistics(
        ((course.T @ r) / variance).ravel(),
        information.reshape(3 * n, 3 * n),
        float(np.sum(r**2 / variance)),
        r.size - 3,
        ((eigen[0][:, None] / variance).ravel(), vectors.reshape(3 * n, 3 * n)),
    )
