"""Physical constants, and unit factors for input and output (SI inside).

Sources: WGS 84 (NIMA TR8350.2) for the Earth's rotation rate and the normal-gravity formula of Somigliana;
the 9th SI brochure for the rest.
"""

import math
from typing import Final

EARTH_RATE_RAD_S: Final = 7.292115e-5
"""Rotation rate of the Earth relative to inertial space, ω_e, rad/s."""

STANDARD_GRAVITY_M_S2: Final = 9.80665
"""Standard gravity, the unit g of data sheets, m/s²."""

DEG: Final = math.pi / 180.0
"""Degree, rad."""

ARCSEC: Final = DEG / 3600.0
"""Second of arc, rad."""

HOUR_S: Final = 3600.0
"""Hour, s."""

DEG_PER_H: Final = DEG / HOUR_S
"""Degree per hour, rad/s: unit of gyro bias."""

DEG_PER_SQRT_H: Final = DEG / math.sqrt(HOUR_S)
"""Degree per square root of hour, rad/√s: unit of angular random walk."""

MICRO_G: Final = 1e-6 * STANDARD_GRAVITY_M_S2
"""Micro-g, m/s²."""


def normal_gravity_m_s2(latitude_rad: float, height_m: float) -> float:
    """Plumb-bob gravity of the WGS 84 ellipsoid, with the second-order free-air term.

    Parameters
    ----------
    latitude_rad : float
        Geodetic latitude, rad.
    height_m : float
        Height above the ellipsoid, m.

    Returns
    -------
    float
        Gravity magnitude, m/s², without local anomalies of about 5e-4 m/s².
    """
    # Semi-major axis (m), flattening, and ω_e² a² b / GM; equatorial gravity (m/s²), Somigliana's k, eccentricity².
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    equator, k, e2 = 9.7803253359, 0.00193185265241, 0.00669437999013
    s2 = math.sin(latitude_rad) ** 2
    surface = equator * (1.0 + k * s2) / math.sqrt(1.0 - e2 * s2)
    return surface * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s2) * height_m + 3.0 / a**2 * height_m**2)
