"""Jacobians by complex step, from the equations as plain Python.

Compiling each equation for complex numbers takes ten times longer than all else in these tests: a process of its own,
in which nothing is compiled, evaluates them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from unittest.mock import patch

import numpy as np

from factors._contract import Equation, Example, registered

#: Example and the derivatives (m, k_i) of the residual with respect to each argument.
Derived = tuple[Example, tuple[np.ndarray, ...]]


def complex_step(equation: Equation, example: Example, which: int) -> np.ndarray:
    """Jacobian of the residual with respect to one argument, to rounding."""
    columns = []
    for c in range(len(example.unknowns[which])):
        z = [u.astype(complex) for u in example.unknowns]
        z[which][c] += 1e-30j
        columns.append(equation.residual(example.record, example.setup, *z).imag / 1e-30)
    return np.stack(columns, axis=1)


def derived(modules: Sequence[str], draws: int, seed: int) -> dict[str, list[Derived]]:
    """Draw examples of the equations that some modules register, and derive them."""
    for module in modules:
        import_module(module)
    out: dict[str, list[Derived]] = {}
    for name, equation in registered().items():
        rng = np.random.default_rng(seed)
        examples = [equation.example(rng) for _ in range(draws)]
        out[name] = [(e, tuple(complex_step(equation, e, k) for k in range(len(e.unknowns)))) for e in examples]
    return out


def derived_uncompiled(modules: Sequence[str], draws: int, seed: int) -> dict[str, list[Derived]]:
    """Do :func:`derived` in a process in which numba does not compile."""
    with (
        patch.dict(os.environ, {"NUMBA_DISABLE_JIT": "1"}),
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
    ):
        return pool.submit(derived, modules, draws, seed).result()
