"""Array types shared by all parts; shapes and units stand in the docstrings."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "ComplexArray", "IndexArray"]

Array: TypeAlias = NDArray[np.float64]
"""Real numbers in double precision."""
ComplexArray: TypeAlias = NDArray[np.complex128]
"""Complex numbers in double precision."""
IndexArray: TypeAlias = NDArray[np.intp]
"""Indices and labels."""
