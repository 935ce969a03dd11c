"""Physical constants and the unit factors used at the borders (SI inside).

Sources: WGS 84 (NIMA TR8350.2) for the Earth's rotation rate and the normal-gravity formula of Somigliana;
the 9th SI brochure for the rest.
"""

import math
from typing import Final

EARTH_RATE_RAD_S: Final = 7.292115e-5
"""Rotation rate of the Earth relative to inertial space, ω_e."""

STANDARD_GRAVITY_M_S2: Final = 9.80665
"""The unit 'g' of data sheets."""

DEG: Final = math.pi / 180.0
ARCSEC: Final = DEG / 3600.0
HOUR_S: Final = 3600.0
DEG_PER_H: Final = DEG / HOUR_S
DEG_PER_SQRT_H: Final = DEG / math.sqrt(HOUR_S)
MICRO_G: Final = 1e-6 * STANDARD_GRAVITY_M_S2


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
        Gravity magnitude, m/s². Local anomalies of some 5e-4 m/s² are not in it.
    """
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    equator, k, e2 = 9.7803253359, 0.00193185265241, 0.00669437999013
    s2 = math.sin(latitude_rad) ** 2
    surface = equator * (1.0 + k * s2) / math.sqrt(1.0 - e2 * s2)
    return surface * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s2) * height_m + 3.0 / a**2 * height_m**2)
