"""Types of NumPy arrays, named by what they hold."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Numbers, in the units that its user states."""
Single = NDArray[np.float32]
"""Numbers in single precision, as the collision kernels compute."""
Index = NDArray[np.int32]
"""Indices as kernels use them."""
Indices = NDArray[np.int64]
"""Indices as NumPy gives them."""
Bits = NDArray[np.uint64]
"""Sets of up to 64, a bit for each."""
