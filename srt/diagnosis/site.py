"""Site: consistency of gravity, latitude and heading with one another and with the stationary gyro rates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, EARTH_RATE_RAD_S, normal_gravity_m_s2
from srt.diagnosis.cause_comparison import Cause, with_known_noise
from srt.diagnosis.evidence import SAMPLES
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault, Finding, with_runner_up
from srt.sequences.plausibility import LEGAL_RATIO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.evidence import Evidence
    from srt.types import Array

HEIGHTS_M: Final = (5000.0, -500.0)
"""Highest and lowest plausible height of a test site, m."""
ANOMALY_M_S2: Final = 1e-3
"""Largest plausible gravity anomaly, m/s²: 100 mGal, which is exceeded in few places on land."""
_LATITUDES: Final = np.radians(np.linspace(-90.0, 90.0, SAMPLES))
"""Latitudes that are tried: their steps are far below the resolution of gyros."""


def gravity(evidence: Evidence) -> Iterator[Finding]:
    """Test the stated gravity against normal gravity at the stated latitude, for all plausible heights.

    There is no finding if the gyros show another latitude, at which the stated gravity is plausible.
    """
    site = evidence.recording.site
    if site.latitude_rad is None:
        return
    low, high = _gravity_range(site.latitude_rad)
    doubt = limit("normal", both_sides=True) * site.gravity_sigma_m_s2
    if low - doubt <= site.gravity_m_s2 <= high + doubt:
        return
    wrong = next((found for found in earth_rate(evidence) if found.cause is LATITUDE), None)
    if wrong is not None:
        seen, sigma = wrong.details["found"] * DEG, limit("normal", both_sides=True) * wrong.details["sigma"] * DEG
        ranges = [_gravity_range(latitude) for latitude in np.linspace(seen - sigma, seen + sigma, 9).tolist()]
        if any(bottom <= site.gravity_m_s2 <= top for bottom, top in ranges):
            return
    yield GRAVITY.found(stated=site.gravity_m_s2, latitude=site.latitude_rad / DEG, low=low, high=high)


GRAVITY: Final = Fault(
    "gravity",
    "Gravity is inconsistent with the latitude",
    "stated gravity against normal gravity at the stated latitude, for heights from -500 m to 5000 m",
    "Gravity is stated as {stated:.6g} m/s², but at {latitude:.4g}° latitude it lies between {low:.6g} and {high:.6g} "
    "m/s²: correct gravity_m_s2 or latitude_deg.",
    "warning",
    gravity,
)


def _gravity_range(latitude_rad: float) -> tuple[float, float]:
    """Smallest and largest plausible gravity at a latitude, m/s²."""
    low, high = (float(normal_gravity_m_s2(latitude_rad, height)) for height in HEIGHTS_M)
    return low - ANOMALY_M_S2, high + ANOMALY_M_S2


def earth_rate(evidence: Evidence) -> Iterator[Finding]:
    """Test the stated latitude and heading against the Earth rate in the stationary windows.

    The Earth rate is referred to the vertical that the accelerometers show, so that a tilt of the table explains
    nothing else. The causes compete by likelihood: the rate as stated, none at all (a unit that removes it), another
    latitude, another heading, both if one alone leaves a significant deviation, or a factor on all readings, as by a
    wrong sample rate.

    Statistic: decrease of the squared deviations over their variances by the most likely cause. Distribution: F, with
    one degree of freedom and those of the stationary rates.
    """
    fit, causes = evidence.stationary_rate_fit, _causes(evidence)
    if fit is None or not causes:
        return
    largest = float(limit("F", 1, fit.freedom))
    single = [explanation for explanation in causes if len(explanation.cause.details) < 2]
    least = min(explanation.square for explanation in single) - largest
    causes = single + [both for both in causes if both not in single and both.square < least]
    ranked = sorted(causes, key=lambda explanation: -round(explanation.score, 6))
    best, faults = ranked[0], ranked[0].cause.details
    if causes[0].square - best.square <= largest:
        return
    for fault in (EARTH_RATE_ABSENT, LATITUDE, NORTH):
        if fault.name in faults:
            finding = fault.found(**faults[fault.name])
            yield with_runner_up(finding, ranked) if fault.name == best.cause.fault else finding


def _causes(evidence: Evidence) -> list[Explanation]:
    """Explanations of the Earth rate, the one as stated first; empty if it is not observable.

    Their details are those of the faults, by name.
    """
    site, fixture, earth = evidence.recording.site, evidence.recording.fixture, evidence.earth_rate
    if site.latitude_rad is None or fixture is None or earth is None:
        return []
    known, sigma, (x, y) = fixture.heading_rad is not None, earth.sigma[[0, 1, 1]], earth.horizontal.tolist()
    # In base axes, the azimuth of north is minus the heading.
    off = float(np.angle(np.exp(1j * (np.arctan2(-y, x) - (fixture.heading_rad or 0.0)))))

    def rate(latitude_rad: Array | float, off_rad: float) -> Array:
        """Downward component, and those of the horizontal one along and across the direction found."""
        level = EARTH_RATE_RAD_S * np.cos(latitude_rad)
        parts = [-EARTH_RATE_RAD_S * np.sin(latitude_rad), level * np.cos(off_rad), level * np.sin(off_rad)]
        return np.stack(parts, axis=-1) / sigma

    seen = np.append(earth.found, 0.0) / sigma
    turned = off if known else 0.0  # an unknown heading is that found
    true = rate(site.latitude_rad, turned)

    def explained(square: Array | float, parameters: int, **faults: dict[str, float]) -> Explanation:
        name = next(iter(faults), "")
        cause = Cause(name, np.zeros((3, 0)), faults)
        return with_known_noise(cause, float(square), parameters, 2 + known)

    def by_latitude(off_rad: float) -> tuple[float, dict[str, float]]:
        squares = np.sum((seen - rate(_LATITUDES, off_rad)) ** 2, axis=-1)
        best, step = int(np.argmin(squares)), float(_LATITUDES[1] - _LATITUDES[0])
        near = np.flatnonzero(squares <= squares[best] + 1.0)
        at = {"found": float(_LATITUDES[best] / DEG), "sigma": max(0.5 * float(np.ptp(near)), 1.0) * step / DEG}
        return float(squares[best]), at | {"stated": float(site.latitude_rad or 0.0) / DEG}

    absent = {
        "found": float(np.hypot(*earth.found) / DEG_PER_H),
        "sigma": float(np.hypot(*earth.sigma) / DEG_PER_H),
        "expected": float(EARTH_RATE_RAD_S / DEG_PER_H),
    }
    square, latitude = by_latitude(turned)
    factor = np.clip((true @ seen) / (true @ true), *LEGAL_RATIO["gyro"])
    out = [
        explained(np.sum((seen - true) ** 2), 0),
        explained(seen @ seen, 0, earth_rate_absent=absent),
        explained(np.sum((seen - factor * true) ** 2), 1),
        explained(square, 1, latitude=latitude),
    ]
    if known:
        stated = fixture.heading_rad or 0.0
        north = {
            "found": float((stated + off) / DEG),
            "sigma": float(min(sigma[1] / max(float(earth.found[1]), 1e-300), np.pi) / DEG),
            "stated": float(stated / DEG),
        }
        square, latitude = by_latitude(0.0)
        out.append(explained(np.sum((seen - rate(site.latitude_rad, 0.0)) ** 2), 1, north=north))
        out.append(explained(square, 2, latitude=latitude, north=north))
    return out


EARTH_RATE_ABSENT: Final = Fault(
    "earth_rate_absent",
    "The gyros do not sense the Earth rate",
    "Earth rate in the stationary windows: zero is more likely than any latitude and heading",
    "The gyros measure an Earth rate of {found:.3g} ± {sigma:.2g} °/h at rest, but {expected:.3g} °/h is expected at "
    "any latitude: the unit removes the Earth rate (auto-zero, or a dead band); record raw readings.",
    "warning",
    earth_rate,
)
LATITUDE: Final = Fault(
    "latitude",
    "The Earth rate is inconsistent with the latitude",
    "Earth rate in the stationary windows, about the vertical of the accelerometers: another latitude is more likely "
    "than the stated one, than none, and than another heading or a factor on all readings",
    "The gyros measure the Earth rate of {found:.3g}° ± {sigma:.2g}° latitude, but {stated:.4g}° is stated: correct "
    "latitude_deg (north is positive).",
    "warning",
    earth_rate,
)
NORTH: Final = Fault(
    "north",
    "The Earth rate is inconsistent with the heading",
    "Earth rate in the stationary windows, about the vertical of the accelerometers: another heading is more likely "
    "than the stated one, than none, and than another latitude or a factor on all readings",
    "According to the Earth rate, the heading of the table's x axis is {found:.4g}° ± {sigma:.2g}°, but {stated:.4g}° "
    "is stated: correct heading_deg (clockwise is positive).",
    "warning",
    earth_rate,
)
