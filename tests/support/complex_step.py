"""Jacobians by complex step, from the equations as plain Python.

Compiling each equation for complex numbers takes ten times longer than all else in these tests: a process of its own,
in which nothing is compiled, evaluates them.
"""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from unittest.mock import patch

import numpy as np

from factors._contract import Equation, registered
from tests.support.equation_examples import EXAMPLES, Example

#: Example and the derivatives (m, k_i) of the residual with respect to each argument.
Derived = tuple[Example, tuple[np.ndarray, ...]]


def complex_step(equation: Equation, example: Example, which: int) -> np.ndarray:
    """Return the Jacobian of the residual with respect to one argument, to rounding.

    The record ends after the equation's ``n_constants``: Python, unlike the compiled form, refuses to read behind them.
    """
    columns, record = [], example.record[: equation.n_constants or None]
    for c in range(len(example.unknowns[which])):
        z = [u.astype(complex) for u in example.unknowns]
        z[which][c] += 1e-30j
        columns.append(equation.residual(record, example.setup, *z).imag / 1e-30)
    return np.stack(columns, axis=1)


def derived(draws: int, seed: int) -> dict[str, list[Derived]]:
    """Draw examples of all equations, and derive them."""
    out: dict[str, list[Derived]] = {}
    for name, draw in EXAMPLES.items():
        rng, equation = np.random.default_rng(seed), registered()[name]
        examples = [draw(rng) for _ in range(draws)]
        out[name] = [(e, tuple(complex_step(equation, e, k) for k in range(len(e.unknowns)))) for e in examples]
    return out


def derived_uncompiled(draws: int, seed: int) -> dict[str, list[Derived]]:
    """Do :func:`derived` in a process in which numba does not compile."""
    with (
        patch.dict(os.environ, {"NUMBA_DISABLE_JIT": "1"}),
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
    ):
        return pool.submit(derived, draws, seed).result()
