"""Site: consistency of gravity, latitude and heading with one another and with the stationary gyro rates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, EARTH_RATE_RAD_S, normal_gravity_m_s2
from srt.diagnosis.evidence import SAMPLES
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

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

    The tests are likelihood-ratio tests. The stated latitude is wrong if the best latitude explains the vertical
    component and the horizontal magnitude significantly better. The stated heading is wrong if the direction of the
    horizontal component differs significantly. If an Earth rate of zero explains the readings significantly better than
    any latitude, the unit removes the Earth rate.

    Statistic: difference of the squared deviations of the components over their variances. Distribution: F, with one
    degree of freedom and those of the stationary rates.
    """
    site, fixture = evidence.recording.site, evidence.recording.fixture
    fit, earth = evidence.stationary_rate_fit, evidence.earth_rate
    if site.latitude_rad is None or fixture is None or fit is None or earth is None:
        return
    largest = float(limit("F", 1, fit.freedom))

    def misfit(latitude_rad: Array) -> Array:
        true = EARTH_RATE_RAD_S * np.stack([-np.sin(latitude_rad), np.cos(latitude_rad)], axis=-1)
        return np.asarray(np.sum(((earth.found - true) / earth.sigma) ** 2, axis=-1))

    by_latitude = misfit(_LATITUDES)
    best = int(np.argmin(by_latitude))
    if float(by_latitude[best] - np.sum((earth.found / earth.sigma) ** 2)) > largest:
        yield EARTH_RATE_ABSENT.found(
            found=float(np.hypot(*earth.found) / DEG_PER_H),
            sigma=float(np.hypot(*earth.sigma) / DEG_PER_H),
            expected=float(EARTH_RATE_RAD_S / DEG_PER_H),
        )
        return
    latitude = site.latitude_rad
    # A wrong sample rate is a factor on the Earth rate; a latitude keeps its magnitude.
    found, true = earth.found / earth.sigma, earth.true / earth.sigma
    by_factor = float(found @ found - (true @ found) ** 2 / (true @ true))
    if by_factor >= by_latitude[best] - largest and float(misfit(np.array(latitude)) - by_latitude[best]) > largest:
        near = np.flatnonzero(by_latitude <= by_latitude[best] + 1.0)
        step = float(_LATITUDES[1] - _LATITUDES[0])
        yield LATITUDE.found(
            found=float(_LATITUDES[best] / DEG),
            sigma=max(0.5 * float(np.ptp(near)), 1.0) * step / DEG,
            stated=float(latitude / DEG),
        )
        latitude = float(_LATITUDES[best])
    if fixture.heading_rad is None or fit.horizontal is None:
        return
    # In base axes, the azimuth of north is minus the heading.
    x, y = fit.horizontal.tolist()
    off = float(np.angle(np.exp(1j * (np.arctan2(-y, x) - fixture.heading_rad))))
    size, sigma = float(earth.found[1]), float(earth.sigma[1])
    level = EARTH_RATE_RAD_S * float(np.cos(latitude))
    if 2.0 * size * level * (1.0 - np.cos(off)) / sigma**2 > largest:
        yield NORTH.found(
            found=float((fixture.heading_rad + off) / DEG),
            sigma=float(min(sigma / size, np.pi) / DEG),
            stated=float(fixture.heading_rad / DEG),
        )


EARTH_RATE_ABSENT: Final = Fault(
    "earth_rate_absent",
    "The gyros do not sense the Earth rate",
    "vertical component and horizontal magnitude of the Earth rate, from the stationary windows: zero fits better than"
    " any latitude",
    "The gyros measure an Earth rate of {found:.3g} ± {sigma:.2g} °/h at rest, but {expected:.3g} °/h is expected at "
    "any latitude: the unit removes the Earth rate (auto-zero, or a dead band); record raw readings.",
    "warning",
    earth_rate,
)
LATITUDE: Final = Fault(
    "latitude",
    "The Earth rate is inconsistent with the latitude",
    "vertical component and horizontal magnitude of the Earth rate, from the stationary windows",
    "The gyros measure the Earth rate of {found:.3g}° ± {sigma:.2g}° latitude, but {stated:.4g}° is stated: correct "
    "latitude_deg (north is positive).",
    "warning",
    earth_rate,
)
NORTH: Final = Fault(
    "north",
    "The Earth rate is inconsistent with the heading",
    "direction of the horizontal component of the Earth rate, from the stationary windows",
    "According to the Earth rate, the heading of the table's x axis is {found:.4g}° ± {sigma:.2g}°, but {stated:.4g}° "
    "is stated: correct heading_deg (clockwise is positive).",
    "warning",
    earth_rate,
)
