"""Cauchy's (Lorentz's) loss: grows with the logarithm."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(1.0 / (1.0 + u**2))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(0.5 * np.log1p(u**2))


CAUCHY = register(Loss("cauchy", weight, cost, (2.384947119, 2.548637624, 2.665568345), "Holland & Welsch 1977"))
