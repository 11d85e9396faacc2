"""Calling convention of all observation equations, and their registry.

An equation is one pure scalar kernel::

    value, jacobian_1, ..., jacobian_n = kernel(record, setup, x_1, ..., x_n, want)

``record`` (d,) contains the constants of one observation, named by ``factors.records``. ``setup`` (2, k)
contains constants that all observations of a group share.
``x_i`` (k_i,) are the unknowns. All are float64 in C order. ``value`` (m,) is the whitened residual, ``jacobian_i``
(m, k_i) its derivative. The Jacobians are (0, 0) arrays if
``want`` is False; the value never depends on ``want``. ``residual(record, setup, x_1, ...)`` returns only the
value and accepts complex unknowns, so that every Jacobian can be checked by complex step. Functions called
for each observation are compiled with numba:
``fill`` of an equation of image points, ``residual``, or the kernel itself (:func:`compiled`). Kernels that
process many records at once are plain numpy. Factors and batches call the same kernel. Observations run along
axis 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from factors._compile import compiled as compiled
from factors._compile import inlined as inlined
from factors.arrays import Array as Array


@dataclass(frozen=True)
class Argument:
    """Declaration of one unknown of an equation: its name, its unit, and whether GTSAM stores it as a Point3."""

    name: str
    unit: str
    is_point: bool = False


@dataclass(frozen=True)
class Equation:
    """A registered observation equation.

    Parameters
    ----------
    name : str
        Unique name, used in messages and in the registry.
    kernel, residual : callable
        See the module docstring.
    arguments : tuple of Argument
        The unknowns, in order.
    source : str
        Author year, equation number.
    fill : callable, optional
        ``fill(records, row, setup, x_1, ..., out, want) -> bool`` writes the value of one row of (N, d) records into
        column 0 of ``out``, and the Jacobians into the next columns. It returns False if sizes do not fit or a value is
        not finite. It gives the same numbers as the kernel without allocating memory; factors use it if it exists.
    arrays : bool, optional
        True if kernel and residual are plain numpy and also accept N records (N, d) at once; the results are then (N,
        m) and (N, m, k).
    n_constants : int
        Smallest size of a record. Compiled equations read these numbers without checking the size.
    """

    name: str
    kernel: Callable[..., tuple[Array, ...]]
    residual: Callable[..., npt.NDArray[Any]]
    arguments: tuple[Argument, ...]
    source: str
    fill: Callable[..., bool] | None = None
    arrays: bool = False
    n_constants: int = 0


@compiled
def is_finite(out: Array, columns: int) -> bool:
    """Return whether the first columns written by a ``fill`` are finite."""
    total = 0.0
    for j in range(columns):
        total += 0.0 * out[0, j] + 0.0 * out[1, j]
    return total == 0.0


def kernel_of(fill: Callable[..., bool]) -> Callable[..., tuple[Array, Array, Array]]:
    """Return a kernel that calls the ``fill`` of an image-point equation. Its arrays are nan if sizes do not fit.

    The kernel is plain Python, so that no further code is compiled for each equation.
    """

    def kernel(record: Array, setup: Array, x: Array, ground: Array, want: bool) -> tuple[Array, Array, Array]:
        k = setup.shape[1]
        out = np.full((2, k + 4), np.nan)
        fill(record.reshape((1, -1)), 0, setup, x, ground, out, want)
        if not want:
            return out[:, 0].copy(), np.empty((0, 0)), np.empty((0, 0))
        return out[:, 0].copy(), out[:, 1 : k + 1].copy(), out[:, k + 1 :].copy()

    return kernel


_REGISTRY: dict[str, Equation] = {}


def register(equation: Equation) -> Equation:
    """Add an equation to the registry.

    Raises
    ------
    ValueError
        Another equation has the same name.
    """
    present = _REGISTRY.get(equation.name)
    if present is not None and present.kernel is not equation.kernel:
        raise ValueError(f"an equation named {equation.name!r} is registered already")
    _REGISTRY[equation.name] = equation
    return equation


def register_condition(
    name: str, residual: Callable[..., Any], jacobians: Callable[..., Any], arguments: tuple[Argument, ...],
    source: str, n_constants: int = 0,
) -> Equation:  # fmt: skip
    """Register an equation by its residual and ``jacobians(record, setup, value, x_1, ...)``: one array or a tuple."""

    def kernel(record: Array, setup: Array, *unknowns_and_want: Any) -> tuple[Array, ...]:
        *x, want = unknowns_and_want
        value = residual(record, setup, *x)
        blocks = jacobians(record, setup, value, *x) if want else tuple(np.empty((0, 0)) for _ in x)
        return value, *(blocks if isinstance(blocks, tuple) else (blocks,))

    return register(Equation(name, kernel, residual, arguments, source, n_constants=n_constants))


def registered() -> dict[str, Equation]:
    """Return a copy of the registry: equations by name."""
    return dict(_REGISTRY)


def evaluate(
    equation: Equation, records: Array, setups: list[Array], *unknowns: list[Array] | Array, jacobian: bool = True
) -> tuple[Array, tuple[list[Array], ...]]:
    """Evaluate an equation for N observations with the scalar kernel.

    Parameters
    ----------
    records : (N, d) array
    setups : list of N (2, k) arrays
    unknowns : one list (or array) of N vectors per argument

    Returns
    -------
    values : (N, m) array
    jacobians : one list of N arrays (m, k_i) per argument
    """
    rows = [equation.kernel(records[i], setups[i], *(u[i] for u in unknowns), jacobian) for i in range(len(records))]
    values = np.array([row[0] for row in rows])
    return values, tuple([row[1 + k] for row in rows] for k in range(len(equation.arguments)))


class NotFiniteError(ValueError):
    """Error: a residual or Jacobian is nan or inf, so the equation has no value for these unknowns."""


def check_blocks(name: str, label: str, blocks: tuple[Any, ...], sizes: tuple[int, ...], n_residuals: int) -> None:
    """Refuse a kernel result that has a wrong shape or type, or values that are not finite.

    GTSAM 4.3.0 accepts all of these without an error (docs/equations.md 9).

    Raises
    ------
    ValueError
        The message names the equation, the observation and the error.
    """
    expected = [(n_residuals,)] + [(n_residuals, size) for size in sizes]
    if len(blocks) != len(expected):
        raise ValueError(f"equation {name!r}, {label}: {len(expected)} arrays expected, {len(blocks)} returned")
    for k, (block, shape) in enumerate(zip(blocks, expected, strict=True)):
        what = "residual" if k == 0 else f"Jacobian {k}"
        if not isinstance(block, np.ndarray) or block.dtype != np.float64:
            raise ValueError(f"equation {name!r}, {label}: {what} is not a float64 array")
        if block.shape != shape:
            raise ValueError(f"equation {name!r}, {label}: {what} has shape {block.shape}, expected {shape}")
        if not math.isfinite(float(block.sum())):
            raise NotFiniteError(f"equation {name!r}, {label}: {what} is not finite")
