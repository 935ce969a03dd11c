"""The first estimate: from the fixture, from gravity alone, from the recorded turns, or from given errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.fixture_start import start_from_fixture
from srt.gravity_start import start_from_gravity
from srt.model.analytic_platform import gyro_stream
from srt.playback import Player
from srt.sensor_errors import SensorErrors
from srt.staged_start import start_in_stages

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.options import Options
    from srt.sequences.preparation import PlaybackData


def first_estimate(data: PlaybackData, options: Options) -> tuple[SensorErrors, NDArray[np.float64]]:
    """Errors to begin with and the rotation from the table-mounted frame to MARS.

    Parameters
    ----------
    data : PlaybackData
    options : Options
        ``start``: "auto", "zero", or the errors themselves.
    """
    if options.start != "auto":
        errors = options.start if isinstance(options.start, SensorErrors) else start_in_stages(data, options)
        # How MARS lies on the table is as the data show it under these errors.
        return errors, Player(data, options).play(errors, nominal_vertical=True).U
    if data.nominal is None:
        return start_from_gravity(data), np.eye(3)
    stream = gyro_stream(
        data.recording.gyro,
        data.recording.interval_s,
        data.rotation,
        data.rotation,
        rates=data.recording.kind == "rate",
    )
    return start_from_fixture(data, stream)
