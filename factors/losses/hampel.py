"""Hampel's three-part loss: influence constant from a to b = 2a, falling to nothing at c = 5a; u counts in a."""

from __future__ import annotations

from typing import Final

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register

#: b and c in units of a: the proportions of 1.7, 3.4, 8.5 (Hampel 1974).
B: Final = 2.0
C: Final = 5.0


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    falling = np.maximum(C - u, 0.0) / ((C - B) * np.maximum(u, B))
    return np.asarray(np.where(u <= B, 1.0 / np.maximum(u, 1.0), falling))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    end = np.minimum(u, C)
    falling = B - 0.5 + (C * (end - B) - 0.5 * (end**2 - B**2)) / (C - B)
    return np.asarray(np.where(u <= 1.0, 0.5 * u**2, np.where(u <= B, u - 0.5, falling)))


HAMPEL = register(
    Loss("hampel", weight, cost, (1.370552811, 1.525228239, 1.652560022), "Hampel 1974", corners=(1.0, B, C))
)
