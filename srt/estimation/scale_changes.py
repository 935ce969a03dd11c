"""Changes of the scale factors of a triad within a recording, as a cause of residuals that no noise explains.

A change is a step between two sequences, or a ramp from one of them to the end. It is no part of the model: it competes
with a fault of one sequence, and is named. The test is that of a bias drift (:mod:`srt.noise.drift_forms`), with the
scale factors of each sequence in place of the biases of each window.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.noise.drift_forms import FALSE_ALARM, Statistics, drift_test, of_courses
from srt.ranking import rounded
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.types import Array, Indices

_TRIADS: Final = {"gyro": "gyros", "accel": "accelerometers"}
_LEAST_PLACES: Final = 3
"""Sequences from which a change can be told from a fault of one of them."""


_USUAL: Final = 1e-3
"""Prior sigma of a change: that of a consumer unit that warms up by tens of kelvins."""
_LARGEST: Final = 4.0 * _USUAL
"""Change beyond which another cause is likelier."""
_EXPLAINED: Final = 0.9
"""Share of chi-square beyond its degrees of freedom that a change must explain to be named."""


class ScaleChange(NamedTuple):
    """Most likely change of the scale factors of a triad.

    Attributes
    ----------
    sensor : str
    when : str
        Form and place in words.
    change : ndarray, shape (3,)
        Over the recording.
    p_value : float
        Probability of such residuals without a change, for all forms and places together.
    explained : float
        Share of chi-square beyond its degrees of freedom that it explains.
    gain : float
        As :func:`srt.noise.drift_forms.likelihood_gain`, less the penalty of the number of forms and places.
    """

    sensor: str
    when: str
    change: Array
    p_value: float
    explained: float
    gain: float

    @property
    def named(self) -> bool:
        """True if it explains most of the misfit: without a change this is as rare as a bias drift."""
        usual = bool(np.all(np.abs(self.change) < _LARGEST))
        return usual and self.p_value < FALSE_ALARM and self.explained > _EXPLAINED

    @property
    def sentence(self) -> str:
        """Sentence that names the change and its size."""
        sizes = ", ".join(f"{1e6 * value:+.3g}" for value in self.change.tolist())
        return (
            f"The scale factors of the {_TRIADS[self.sensor]} seem to change {self.when} by {sizes} ppm (x, y, z): let "
            "the unit warm up, and check its supply"
        )


def scale_effects(derivative: Array, owner: Indices, order: Indices) -> dict[str, Array]:
    """Effects (n, 3 K) of the scale factors of each triad in each sequence, in the order of time, on n measurements.

    Parameters
    ----------
    derivative : ndarray, shape (n, p)
        By the sensor errors, of which the first are those before the biases.
    owner : ndarray of int, shape (n,)
        Sequence of each measurement; −1 without one.
    order : ndarray of int, shape (K,)
        Sequences in the order of time.
    """
    member = (owner[:, None] == order).astype(np.float64)
    of_triads = ((sensor, derivative[:, GROUP_SLICES[f"{sensor}_scale"]]) for sensor in _TRIADS)
    return {sensor: (member[:, :, None] * own[:, None]).reshape(len(own), -1) for sensor, own in of_triads}


def most_likely_change(found: Mapping[str, Statistics], times: Array, titles: Sequence[str]) -> ScaleChange | None:
    """Most likely change among all triads, forms and places; None for too few sequences, or where nothing shows one.

    Parameters
    ----------
    found : mapping of str to Statistics
        By triad, of :func:`scale_effects`.
    times : ndarray, shape (K,)
        Middle of each sequence, ascending.
    titles : sequence of str
        Their names.
    """
    if len(times) < _LEAST_PLACES:
        return None
    courses = _courses(times, titles)
    forms = np.stack([course for _, course in courses])
    # The gain of a test rises with what it explains: the largest of all is that of the most likely change.
    explained = np.stack([_explained(each, forms) for each in found.values()])
    triad, form = np.unravel_index(int(np.argmax(rounded(explained, axis=None))), explained.shape)
    sensor, (when, course) = list(found)[triad], courses[form]
    own = of_courses(found[sensor], course[:, None])
    test = drift_test(replace(own, information=own.information + np.eye(3) / _USUAL**2))
    if test is None:
        return None
    decrease = float(test.amplitude @ own.gradient)
    share = decrease / max(own.chi_square - own.freedom, decrease)
    number = explained.size
    penalty = 2.0 * math.log(number)
    return ScaleChange(sensor, when, test.amplitude, min(number * test.p_value, 1.0), share, test.gain - penalty)


def _explained(found: Statistics, courses: Array) -> Array:
    """Decrease of chi-square by the change along each of n courses (n, K), with the prior of its size, shape (n,)."""
    K = courses.shape[1]
    gradient = courses @ found.gradient.reshape(K, 3)
    half = np.tensordot(courses, found.information.reshape(K, 3, K, 3), axes=1)
    information = np.einsum("cakb,ck->cab", half, courses) + np.eye(3) / _USUAL**2
    return np.asarray(np.einsum("ca,ca->c", gradient, np.linalg.solve(information, gradient[:, :, None])[:, :, 0]))


def _courses(times: Array, titles: Sequence[str]) -> list[tuple[str, Array]]:
    """Steps and ramps, (K,) each, with a range of one and, as the scale factors are estimated, any mean."""
    at = np.arange(len(times))
    steps = [(f"by a step before {titles[k]}", (at >= k).astype(np.float64)) for k in range(1, len(times))]
    ramps = [
        ("steadily" if k == 0 else f"steadily from {titles[k]} on", np.maximum(times - times[k], 0.0))
        for k in range(len(times) - 1)
    ]
    return steps + [(when, course / course[-1]) for when, course in ramps]
