"""Truncated least squares: an observation counts in full, or not at all."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.where(u <= 1.0, 1.0, 0.0))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(0.5 * np.minimum(u, 1.0) ** 2)


TLS = register(
    Loss(
        "tls",
        weight,
        cost,
        (2.795483483, 3.080215745, 3.327235744),
        "Yang et al. 2020, eq. 3",
        corners=(1.0,),
    )
)
