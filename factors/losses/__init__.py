"""Robust losses: one file each, found by name.

A loss acts on the whitened norm t of one observation (2 numbers of an image point, 3 of a control point) through
``u = t / c``. It is given by its weight w(u); the cost is the integral of the weight, ``rho(t) = c^2 cost(t / c)``,
``cost(u) = int_0^u s w(s) ds``: half the square where the weight is 1. A file of this package that calls
:func:`register` adds a loss.

The constant c leaves the estimate the efficiency 95 % at the normal distribution. For residuals of d independent
normal numbers the asymptotic efficiency is ``E[w t^2]^2 / (d E[w^2 t^2])`` (Huber 1981, ch. 6; the derivative of
``w r`` is replaced through Stein's identity), so c depends on d.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules

from factors._contract import Array

Curve = Callable[[Array], Array]


@dataclass(frozen=True)
class Loss:
    """A registered loss.

    Parameters
    ----------
    name : str
    weight, cost : callables
        w and its integral over an array of ``u >= 0``.
    constants : (float, float, float)
        c for 95 % efficiency in 1, 2 and 3 dimensions.
    source : str
        Author year.
    """

    name: str
    weight: Curve
    cost: Curve
    constants: tuple[float, float, float]
    source: str

    def constant(self, dimension: int) -> float:
        """C of a residual of 1, 2 or 3 numbers."""
        return self.constants[dimension - 1]


_REGISTRY: dict[str, Loss] = {}


def register(loss: Loss) -> Loss:
    """Add a loss.

    Raises
    ------
    ValueError
        Another one has this name.
    """
    present = _REGISTRY.get(loss.name)
    if present is not None and present.weight.__module__ != loss.weight.__module__:
        raise ValueError(f"a loss named {loss.name!r} is registered already")
    _REGISTRY[loss.name] = loss
    return loss


def losses() -> dict[str, Loss]:
    """All losses by name."""
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return dict(sorted(_REGISTRY.items()))
