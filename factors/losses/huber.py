"""Huber's loss: quadratic, then linear; the only convex one here."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.minimum(1.0, 1.0 / np.maximum(u, 1.0)))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.where(u <= 1.0, 0.5 * u**2, u - 0.5))


HUBER = register(
    Loss(
        "huber", weight, cost, (1.344997509, 1.501141084, 1.627987920), "Huber 1964", corners=(1.0,), redescending=False
    )
)
