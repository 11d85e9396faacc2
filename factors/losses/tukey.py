"""Tukey's biweight: no influence beyond c."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.maximum(1.0 - u**2, 0.0) ** 2)


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray((1.0 - np.maximum(1.0 - u**2, 0.0) ** 3) / 6.0)


TUKEY = register(
    Loss("tukey", weight, cost, (4.685064949, 5.122986090, 5.490249208), "Beaton & Tukey 1974", corners=(1.0,))
)
