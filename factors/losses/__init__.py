"""Registry of robust losses. ``standard`` contains the built-in losses; further files of this package add others.

A loss depends on the whitened norm t of one observation (2 numbers of an image point, 3 of a control point) by
``u = t / c``. It is defined by its weight w(u). The cost is the integral of the weight: ``rho(t) = c^2 cost(t / c)``,
``cost(u) = int_0^u s w(s) ds``, which is half the square if the weight is 1. A file of this package that calls
:func:`register` adds a loss. For a loss given by its weight only, :mod:`factors.losses.construct` computes cost and
constants.

The constant c gives the estimate an efficiency of 95 % for normally distributed errors. For residuals of d independent
normal numbers the asymptotic efficiency is ``E[w t^2]^2 / (d E[w^2 t^2])`` (Huber 1981, ch. 6; the derivative of
``w r`` is replaced by Stein's identity), so c depends on d.
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
    """Registered loss.

    Parameters
    ----------
    name : str
    weight, cost : callables
        Functions that return w, and the cost, for an array of ``u >= 0``.
    constants : (float, float, float)
        c for 95 % efficiency in 1, 2 and 3 dimensions.
    source : str
        Author year.
    corners : tuple of float
        Values of u where w or its slope jumps.
    redescending : bool
        True if the influence u w(u) decreases for large u. There can then be several minima, so the loss needs a robust
        start.
    """

    name: str
    weight: Curve
    cost: Curve
    constants: tuple[float, float, float]
    source: str
    corners: tuple[float, ...] = ()
    redescending: bool = True

    def constant(self, dimension: int) -> float:
        """Return the constant c for a residual of 1, 2 or 3 numbers."""
        return self.constants[dimension - 1]


_REGISTRY: dict[str, Loss] = {}
#: Other names of losses. The weight of Chen in ISIS jigsaw equals Tukey's weight up to a factor.
ALIASES: dict[str, str] = {"beaton_tukey": "tukey", "biweight": "tukey", "chen": "tukey", "lorentz": "cauchy"}


def register(loss: Loss) -> Loss:
    """Add a loss to the registry.

    Raises
    ------
    ValueError
        Another loss has this name.
    """
    present = _REGISTRY.get(loss.name)
    if loss.name in ALIASES:
        raise ValueError(f"{loss.name!r} is another name of the loss {ALIASES[loss.name]!r}")
    if present is not None and present.weight.__module__ != loss.weight.__module__:
        raise ValueError(f"a loss named {loss.name!r} is registered already")
    _REGISTRY[loss.name] = loss
    return loss


def find(name: str) -> Loss | None:
    """Return the loss with this name or alias; None if it does not exist."""
    return losses().get(ALIASES.get(name, name))


def losses() -> dict[str, Loss]:
    """Return all losses by name."""
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return dict(sorted(_REGISTRY.items()))
