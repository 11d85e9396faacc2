"""A ground point's height observed from an elevation model: the model is a plane about the point's last place.

    residual = n . (G - G_0) / sigma,   n = up - slope_east east - slope_north north

G_0 is the model's point above or below the place at which it was read, so that the residual is the height of G
above the plane. Adjusted on planes that are read anew until the points rest, the height is that above the model.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.records import Record

#: n / sigma, G_0 m.
RECORD: Final = Record(normal="n1 n2 n3", place="x y z")


@compiled
def residual(record: Any, setup: Any, ground: Any) -> Any:
    """``n . (G - G_0) / sigma``: (1,)."""
    d0, d1, d2 = ground[0] - record[RECORD.x], ground[1] - record[RECORD.y], ground[2] - record[RECORD.z]
    return np.array([record[RECORD.n1] * d0 + record[RECORD.n2] * d1 + record[RECORD.n3] * d2])


@compiled
def kernel(record: Array, setup: Array, ground: Array, want: bool) -> tuple[Array, Array]:
    """Residual (1,) and Jacobian (1, 3)."""
    value = residual(record, setup, ground)
    if not want:
        return value, np.empty((0, 0))
    return value, record[RECORD.normal].copy().reshape((1, 3))


def _example(rng: np.random.Generator) -> Example:
    return Example(rng.normal(size=RECORD.size), np.zeros((2, 0)), (rng.normal(size=3),))


HEIGHT_CONTROL = register(Equation(
    "height_control", kernel, residual, (Argument("ground", "m", is_point=True),), _example,
    "docs/equations.md 7, stochastic weights",
))  # fmt: skip
