"""Errors that no residual shows: time base, gravity, latitude and heading, with their effect on the result.

All measurements share them, so that they agree however large the error is. Each has a coefficient, and a stated sigma
where the recording gives one; the sigmas of the result include it then. A latitude without sigma counts as exact.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from srt.constants import DEG_PER_H, EARTH_RATE_RAD_S

if TYPE_CHECKING:
    from srt.sequences.preparation import PreparedRecording

_PPM = 1e6


def unseen_errors(data: PreparedRecording) -> list[dict[str, Any]]:
    """Errors that no residual shows, as JSON values.

    Returns
    -------
    list of dict
        ``source``; ``unit`` and stated 1-sigma ``sigma`` (None: not stated) of its error; ``coefficient``: effect of
        one unit on each parameter of ``group`` in ``group_unit``, or its largest size where ``largest`` is true;
        ``sentence``.
    """
    recording, site, fixture = data.recording, data.recording.site, data.recording.fixture
    clock = recording.clock_sigma
    by_time = ("gyro_scale", 1.0) if recording.kind == "rate" else ("accel_scale", -1.0)
    rows = [
        _row("time base", ("ppm", None if clock is None else clock * _PPM), (*by_time, "ppm")),
        _row(
            "gravity",
            ("ppm", site.gravity_sigma_m_s2 / site.gravity_m_s2 * _PPM),
            ("accel_scale", -1.0, "ppm"),
        ),
    ]
    if site.latitude_rad is not None:
        # |dω/dφ| is the Earth rate itself; the poses decide how much of it falls on an axis.
        per_degree = EARTH_RATE_RAD_S * math.radians(1.0) / DEG_PER_H
        sigma = site.latitude_sigma_rad
        stated = None if sigma is None else math.degrees(sigma)
        rows.append(_row("latitude", ("°", stated), ("gyro_bias", per_degree, "°/h"), largest=True))
        if fixture is not None and fixture.heading_rad is not None:
            per_mrad = EARTH_RATE_RAD_S * math.cos(site.latitude_rad) * 1e-3 / DEG_PER_H
            sigma = fixture.alignment_sigma_rad * 1e3
            rows.append(_row("heading", ("mrad", sigma), ("gyro_bias", per_mrad, "°/h"), largest=True))
    return rows


def _row(
    source: str, error: tuple[str, float | None], effect: tuple[str, float, str], *, largest: bool = False
) -> dict[str, Any]:
    (unit, sigma), (group, coefficient, group_unit) = error, effect
    size = f"{'up to ' if largest else ''}{coefficient:.3g} {group_unit}"
    stated = "not stated" if sigma is None else f"stated: {sigma:.3g} {unit}, 1-sigma"
    return {
        "source": source,
        "unit": unit,
        "sigma": sigma,
        "group": group,
        "coefficient": coefficient,
        "group_unit": group_unit,
        "largest": largest,
        "sentence": f"1 {unit} of {source} is {size} of every {group.replace('_', ' ')} ({stated}).",
    }
