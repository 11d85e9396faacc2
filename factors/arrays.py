"""Array types for annotations: numbers, indices and masks."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# indices of elements of another array
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
