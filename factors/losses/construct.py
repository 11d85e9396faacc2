"""Losses defined by their weight: cost and constants by quadrature.

Gauss-Legendre rules with 12 nodes are used on panels that end at the corners of the weight, so that the cost is its
integral up to rounding. If the cost contradicted the weight, the loop could refuse good steps or stop early.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from factors._contract import Array
from factors.losses import Curve, Loss

EFFICIENCY: Final = 0.95
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
#: Panels of the integration: up to ``_EVEN`` they have equal width, then each is a twentieth wider than the
#: last. Beyond the last panel the weight is zero.
_EVEN: Final = 16.0
_WIDTH: Final = 0.05
_LAST: Final = 1e7
#: Upper limit of the integration over the normal distribution; the probability beyond it is 1e-30.
_FAR: Final = 12.0
_BISECTIONS: Final = 80


@dataclass(frozen=True, eq=False)
class Integral:
    """The function ``int_0^u s w(s) ds`` of u.

    Parameters
    ----------
    weight : callable
        Function w of arrays; it must belong to a module if it is sent to worker processes.
    knots, values : (k,) arrays
        Ends of the panels, and the integral up to each.
    """

    weight: Curve
    knots: Array
    values: Array

    @classmethod
    def of(cls, weight: Curve, corners: Sequence[float] = ()) -> Integral:
        """Integrate once over all panels; ``corners`` are the places where the weight or its slope jumps."""
        growing = _EVEN * 1.05 ** np.arange(1, math.ceil(math.log(_LAST / _EVEN) / math.log(1.05)))
        knots = np.unique(np.concatenate([np.arange(0.0, _EVEN + 0.5 * _WIDTH, _WIDTH), growing, corners]))
        return cls(weight, knots, np.concatenate([[0.0], np.cumsum(_moment(weight, knots[:-1], knots[1:]))]))

    def __call__(self, u: Array) -> Array:
        """Return the integral up to u, in the shape of u."""
        end = np.minimum(np.asarray(u, dtype=np.float64), self.knots[-1])
        panel = np.clip(np.searchsorted(self.knots, end, side="right") - 1, 0, len(self.knots) - 2)
        return np.asarray(self.values[panel] + _moment(self.weight, self.knots[panel], end))


def _moment(weight: Curve, low: Array, high: Array) -> Array:
    """Return the integral of ``s w(s)`` from low to high, for each element."""
    half = 0.5 * (np.asarray(high) - low)[..., None]
    s = np.asarray(low)[..., None] + half * (1.0 + _NODES)
    return np.asarray((half * _WEIGHTS * s * weight(s)).sum(axis=-1))


def efficiency(weight: Curve, constant: float, dimension: int, corners: Sequence[float] = ()) -> float:
    """Return the asymptotic efficiency for normally distributed residuals of 1, 2 or 3 numbers.

    The efficiency is ``E[w t^2]^2 / (d E[w^2 t^2])``, t the norm (Huber 1981, ch. 6). ``E[w t^2] / d`` is the mean
    derivative of the influence by Stein's identity, which is also valid if the weight jumps.
    """
    ends = [constant * c for c in corners if constant * c < _FAR]
    knots = np.unique(np.concatenate([np.linspace(0.0, _FAR, 121), ends]))
    half = 0.5 * np.diff(knots)[:, None]
    t = knots[:-1, None] + half * (1.0 + _NODES)
    # t^2 times the density of chi(d)
    factor = half * _WEIGHTS * t ** (dimension + 1) * np.exp(-0.5 * t**2)
    factor /= 2.0 ** (0.5 * dimension - 1.0) * math.gamma(0.5 * dimension)
    w = np.asarray(weight(t / constant))
    return float((factor * w).sum() ** 2 / (dimension * (factor * w**2).sum()))


def constant_for(weight: Curve, dimension: int, corners: Sequence[float] = (), goal: float = EFFICIENCY) -> float:
    """Return the largest constant c with an efficiency not above ``goal``.

    Raises
    ------
    ValueError
        No constant between 0.01 and 100 has this efficiency.
    """
    grid = np.geomspace(100.0, 0.01, 40)
    below = [k for k, c in enumerate(grid) if efficiency(weight, float(c), dimension, corners) < goal]
    if not below or below[0] == 0:
        raise ValueError(f"no constant of this weight leaves the efficiency {goal:g} in {dimension} dimension(s)")
    low, high = float(grid[below[0]]), float(grid[below[0] - 1])
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if efficiency(weight, middle, dimension, corners) < goal else (low, middle)
    return 0.5 * (low + high)


def loss_from_weight(
    name: str, weight: Curve, *, corners: Sequence[float] = (), source: str = "", redescending: bool = True
) -> Loss:
    """Return a loss made from its weight; :func:`factors.losses.register` registers it.

    Parameters
    ----------
    name : str
    weight : callable
        Function w(u) of arrays ``u >= 0``: 1 at 0, not increasing, not negative.
    corners : sequence of float
        Values of u where w or its slope jumps.
    source : str
        Author year.
    redescending : bool
        True if the loss can have several minima; its adjustment then starts from the minimum of Huber's loss.

    Raises
    ------
    ValueError
        The weight is invalid, or no constant gives 95 % efficiency.
    """
    grid = np.unique(np.concatenate([np.linspace(0.0, 50.0, 5001), np.geomspace(50.0, _LAST, 500)]))
    w = np.asarray(weight(grid), dtype=np.float64)
    if w.shape != grid.shape or not np.isfinite(w).all() or w[0] != 1.0 or w.min() < 0.0 or (np.diff(w) > 1e-12).any():
        raise ValueError(f"the weight of {name!r} is not 1 at 0, falling and not negative")
    constants = tuple(constant_for(weight, d, corners) for d in (1, 2, 3))
    first, second, third = constants
    return Loss(
        name, weight, Integral.of(weight, corners), (first, second, third), source, tuple(corners), redescending
    )
