"""Types that all modules share: arrays by element (docstrings state the shapes), and the two sensors of an IMU."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np

# Not numpy's NDArray: from numpy 2.5 on, it hides the class of which the reader of calibration files finds the fields.
Shape: TypeAlias = tuple[Any, ...]

Array: TypeAlias = np.ndarray[Shape, np.dtype[np.float64]]
"""Real numbers: samples (n, 3), states (27,), covariances (27, 27)."""

Mask: TypeAlias = np.ndarray[Shape, np.dtype[np.bool_]]
"""Truth value per element."""

Indices: TypeAlias = np.ndarray[Shape, np.dtype[np.intp]]
"""Positions in another array."""

Counts: TypeAlias = np.ndarray[Shape, np.dtype[np.int64]]
"""Integers that are counted or stored, of the same size on all platforms."""

Sensor: TypeAlias = Literal["gyro", "accel"]
"""Triad of an IMU."""
