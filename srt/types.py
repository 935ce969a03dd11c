"""Types that all modules share: arrays by element (docstrings state the shapes), and the two sensors of an IMU."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Real numbers: samples (n, 3), states (27,), covariances (27, 27)."""

Mask: TypeAlias = NDArray[np.bool_]
"""Truth value per element."""

Indices: TypeAlias = NDArray[np.intp]
"""Positions in another array."""

Counts: TypeAlias = NDArray[np.int64]
"""Integers that are counted or stored, of the same size on all platforms."""

Sensor: TypeAlias = Literal["gyro", "accel"]
"""Triad of an IMU."""
