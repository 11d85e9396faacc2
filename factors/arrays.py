"""Array types for annotations: numbers, positions and masks."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# positions in another array
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
