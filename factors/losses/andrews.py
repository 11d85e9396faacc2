"""Andrews' sine: influence is an arch of the sine, nothing beyond pi."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register


def weight(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(np.where(u < np.pi, np.sinc(u / np.pi), 0.0))


def cost(u: Array) -> Array:
    """See :class:`factors.losses.Loss`."""
    return np.asarray(2.0 * np.sin(0.5 * np.minimum(u, np.pi)) ** 2)  # 1 - cos u without cancellation


ANDREWS = register(
    Loss("andrews", weight, cost, (1.338710859, 1.462984352, 1.567162970), "Andrews 1974", corners=(np.pi,))
)
