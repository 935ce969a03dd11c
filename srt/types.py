"""Array types, by element; shapes are stated where they are used."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Real numbers: samples (n, 3), states (27,), covariances (27, 27)."""

Mask: TypeAlias = NDArray[np.bool_]
"""One truth value per element."""

Indices: TypeAlias = NDArray[np.intp]
"""Positions in another array."""

Counts: TypeAlias = NDArray[np.int64]
"""Whole numbers that are counted or stored, independent of the platform."""
