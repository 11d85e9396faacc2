"""Welsch's loss: bounded, the weight is a Gaussian."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.exp(-(u**2)))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(-0.5 * np.expm1(-(u**2)))


WELSCH = register(Loss("welsch", weight, cost, (2.984637176, 3.250966769, 3.469061801), "Holland & Welsch 1977"))
