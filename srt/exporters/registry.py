"""Registry of the export formats by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError, did_you_mean
from srt.exporters.c_header import C_HEADER
from srt.exporters.matrix_formats import BASALT, IMU_TK, IMUCAL, KALIBR, OPENVINS, PYINS
from srt.exporters.parameter_files import ARDUPILOT, KF_GINS, PX4, ROS2, VECTORNAV
from srt.exporters.preintegration import GTSAM

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.exporters.file_format import Exporter

_ALL: Final = (
    KALIBR,
    OPENVINS,
    BASALT,
    IMUCAL,
    IMU_TK,
    PYINS,
    VECTORNAV,
    PX4,
    ARDUPILOT,
    ROS2,
    GTSAM,
    KF_GINS,
    C_HEADER,
)
_BY_NAME: Final = {item.name: item for item in _ALL}


def exporters() -> Mapping[str, Exporter]:
    """All formats by name."""
    return dict(_BY_NAME)


def exporter(name: str) -> Exporter:
    """Find one format. Raises InputError if there is none of the name."""
    if name not in _BY_NAME:
        raise InputError(
            f"There is no format {name!r}{did_you_mean(name, _BY_NAME)}: use one of {', '.join(_BY_NAME)}."
        )
    return _BY_NAME[name]
