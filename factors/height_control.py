"""A ground point's height observed from an elevation model: the model is a plane about the point's last place.

    residual = n . (G - G_0) / sigma,   n = up - slope_east east - slope_north north

G_0 is the model's point above or below the place at which it was read, so that the residual is the height of G
above the plane. Adjusted on planes that are read anew until the points rest, the height is that above the model.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register

#: Record: n / sigma (3), G_0 (3) m.
RECORD_SIZE = 6


@compiled
def residual(record: Any, setup: Any, ground: Any) -> Any:
    """``n . (G - G_0) / sigma``: (1,)."""
    d0, d1, d2 = ground[0] - record[3], ground[1] - record[4], ground[2] - record[5]
    return np.array([record[0] * d0 + record[1] * d1 + record[2] * d2])


@compiled
def kernel(record: Array, setup: Array, ground: Array, want: bool) -> tuple[Array, Array]:
    """Residual (1,) and Jacobian (1, 3)."""
    value = residual(record, setup, ground)
    if not want:
        return value, np.empty((0, 0))
    return value, record[0:3].copy().reshape((1, 3))


def _example(rng: np.random.Generator) -> Example:
    return Example(rng.normal(size=RECORD_SIZE), np.zeros((2, 0)), (rng.normal(size=3),))


HEIGHT_CONTROL = register(Equation(
    "height_control", kernel, residual, (Argument("ground", "m", is_point=True),), _example,
    "docs/equations.md 7, stochastic weights",
))  # fmt: skip
