"""Text of a mount alignment: angles with their sigmas by source, and the static poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.mount.alignment import ANGLES
from srt.reports.tables import decimals_for, fixed, text_table

if TYPE_CHECKING:
    from srt.mount.alignment import MountAlignment

_SOURCE_LABELS: Final = {
    "accel_noise": "acc. noise",
    "calibration": "calibration",
    "levelling": "levelling",
    "axis_tilt": "axis tilt",
    "squareness": "axis square",
    "fixture": "fixture",
}
"""Column headings of the sources."""
_POSE_LABELS: Final = {"level": "level", "nose_down": "pitched, x down", "nose_up": "pitched, x up"}


def mount_alignment_text(mount: MountAlignment) -> str:
    """Tables of a mount alignment: angles with their sigmas by source, and the static poses."""
    rows = []
    by_source = np.array(list(mount.sources.values()))
    for i, name in enumerate(ANGLES):
        value, sigma = 1e3 * float(mount.angles_rad[i]), 1e3 * float(mount.sigma_rad[i])
        places = decimals_for(sigma)
        parts = [fixed(1e3 * float(s), max(places, 3)) for s in by_source[:, i]]
        rows.append([name, fixed(value, places), fixed(sigma, places), *parts])
    headers = ["mrad", "angle", "sigma", *(_SOURCE_LABELS.get(name, name).replace(" ", "\n") for name in mount.sources)]
    text = ["Sensor axes in the mount", text_table(headers, rows, "l" + "r" * (len(headers) - 1))]
    if mount.poses:
        stands = [
            [
                _POSE_LABELS[stand["pose"]],
                f"{stand['start_s']:.2f}",
                f"{stand['end_s']:.2f}",
                f"{stand['pitch_deg']:+.3f}",
                fixed(1e6 * stand["residual_rad"], 1),
            ]
            for stand in mount.poses
        ]
        text.append(text_table(["pose", "from s", "to s", "pitch °", "residual\nµrad"], stands, "lrrrr"))
    else:
        text.append("From the rotation U of the two-axis test: as accurate as the alignment of the fixture.")
    return "\n\n".join(text)
