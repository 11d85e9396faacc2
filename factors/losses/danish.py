"""Danish method, continuous form: full weight up to c, then a falling Gaussian.

The original form, whose exponent depends on the cycle, is no loss: it is an iteration (``fg_orient.adjustment.irls``).
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.exp(np.minimum(1.0 - u**2, 0.0)))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.where(u <= 1.0, 0.5 * u**2, 0.5 - 0.5 * np.expm1(np.minimum(1.0 - u**2, 0.0))))


DANISH = register(
    Loss("danish", weight, cost, (1.993002202, 2.212605440, 2.404339807), "Krarup, Juhl & Kubik 1980", corners=(1.0,))
)
