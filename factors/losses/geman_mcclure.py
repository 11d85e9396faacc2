"""Geman and McClure's loss: bounded, the weight falls with the fourth power."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(1.0 / (1.0 + u**2) ** 2)


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(0.5 * u**2 / (1.0 + u**2))


GEMAN_MCCLURE = register(
    Loss("geman_mcclure", weight, cost, (3.787418761, 4.095552337, 4.337289950), "Geman & McClure 1985")
)
