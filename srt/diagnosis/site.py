"""Place: gravity, latitude and heading as stated, against one another and against the Earth's rate at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import fdtri, ndtri, stdtrit

from srt.constants import DEG, EARTH_RATE_RAD_S, normal_gravity_m_s2
from srt.diagnosis.findings import Finding, check, found
from srt.diagnosis.rest_evidence import RestFit, rest_fit

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from srt.diagnosis.evidence import Evidence

    Array = NDArray[np.float64]

HEIGHTS_M: Final = (5000.0, -500.0)
"""Highest and lowest place where a unit is taken to be tested."""
ANOMALY_M_S2: Final = 1e-3
"""What local anomalies add: 100 mGal, more than nearly all of the land has."""
FALSE_ALARM: Final = 2e-5
"""Probability of naming a right latitude, or a right heading: a recording has some twenty such questions, and one of
a hundred sound recordings may raise any."""
_GRID_DEG: Final = 0.01


@check("gravity")
def gravity(evidence: Evidence) -> Iterator[Finding]:
    """Stated gravity against the normal one of all heights."""
    site = evidence.recording.site
    if site.latitude_rad is None:
        return
    low, high = (normal_gravity_m_s2(site.latitude_rad, height) for height in HEIGHTS_M)
    low, high = low - ANOMALY_M_S2, high + ANOMALY_M_S2
    if not low <= site.gravity_m_s2 <= high:
        yield found(
            "gravity", stated=site.gravity_m_s2, latitude=site.latitude_rad / DEG, low=float(low), high=float(high)
        )


@check("latitude", "north")
def earth_rate(evidence: Evidence) -> Iterator[Finding]:
    """The Earth's rate at rest against latitude and heading as stated.

    By likelihood: a latitude is named where the stated one explains vertical part and size of the horizontal part
    worse than the best one does by more than chance; the heading likewise from the direction of the horizontal part.
    """
    site, fixture = evidence.recording.site, evidence.recording.fixture
    if site.latitude_rad is None or fixture is None:
        return
    fit = rest_fit(evidence)
    if fit is None or fit.horizontal is None:
        return
    limit = float(fdtri(1, fit.freedom, 1.0 - FALSE_ALARM))
    align = EARTH_RATE_RAD_S * fixture.alignment_sigma_rad
    vertical_sigma = float(np.hypot(_vertical_sigma(fit), align))
    horizontal_sigma = float(np.hypot(fit.horizontal_sigma, align))
    x, y = fit.horizontal.tolist()
    size = float(np.hypot(x, y))

    def misfit(latitude_rad: Array) -> Array:
        down, level = -EARTH_RATE_RAD_S * np.sin(latitude_rad), EARTH_RATE_RAD_S * np.cos(latitude_rad)
        out: Array = ((fit.vertical - down) / vertical_sigma) ** 2 + ((size - level) / horizontal_sigma) ** 2
        return out

    latitudes = np.arange(-90.0, 90.0 + 0.5 * _GRID_DEG, _GRID_DEG) * DEG
    by_latitude = misfit(latitudes)
    best = int(np.argmin(by_latitude))
    latitude = site.latitude_rad
    if float(misfit(np.array([latitude]))[0] - by_latitude[best]) > limit:
        near = latitudes[by_latitude <= by_latitude[best] + 1.0]
        yield found(
            "latitude",
            found=float(latitudes[best] / DEG),
            sigma=float(max(0.5 * np.ptp(near) / DEG, _GRID_DEG)),
            stated=float(latitude / DEG),
        )
        latitude = float(latitudes[best])
    if fixture.heading_rad is None:
        return
    # North lies at minus the heading in base axes.
    seen = float(np.arctan2(-y, x))
    off = float(np.angle(np.exp(1j * (seen - fixture.heading_rad))))
    level = EARTH_RATE_RAD_S * float(np.cos(latitude))
    if 2.0 * size * level * (1.0 - np.cos(off)) / horizontal_sigma**2 > limit:
        yield found(
            "north",
            found=float((fixture.heading_rad + off) / DEG),
            sigma=float(min(horizontal_sigma / size, np.pi) / DEG),
            stated=float(fixture.heading_rad / DEG),
        )


def _vertical_sigma(fit: RestFit) -> float:
    """One sigma of the vertical part, with the share of a g-sensitivity that looks like it.

    Were the nine components of Γ alike in size, what the eight others show would tell that of the one that is hidden,
    with the tails of a t distribution of eight degrees of freedom. The factor makes them those of a normal one at the
    probability that is asked for.
    """
    hidden = np.mean(fit.g_sensitivity**2) / 3.0
    factor = stdtrit(8, 0.5 * FALSE_ALARM) / ndtri(0.5 * FALSE_ALARM)
    return float(np.sqrt(fit.vertical_sigma**2 + factor**2 * hidden))
