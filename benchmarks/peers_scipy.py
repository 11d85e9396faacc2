"""scipy.optimize.least_squares solves the same residuals in two ways."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.entries import LIMIT_S, MAX_EVALUATIONS, Outcome
from benchmarks.flat import FlatProblem
from benchmarks.own import repeated


class _TimeUp(Exception):
    """The residuals raise this exception after the limit of time."""


def trf(flat: FlatProblem, *, analytic: bool) -> Callable[[], Outcome]:
    """Return the trust-region-reflective solver.

    Without ``analytic`` it is called as sat-bundleadjust calls it: two-point differences with
    the sparsity of the Jacobian, ``x_scale="jac"``, linear loss, ftol 1e-4, xtol 1e-10, 300
    evaluations. With ``analytic`` it gets the CSR Jacobian of fg_orient and ftol 1e-8.
    """

    def once() -> Outcome:
        start = time.perf_counter()
        how: dict[str, Any] = {"jac": flat.jacobian, "ftol": 1e-8}
        if not analytic:
            how = {"jac": "2-point", "jac_sparsity": flat.sparsity(), "ftol": 1e-4}
        made = time.perf_counter()
        last = np.inf

        def residuals(x: np.ndarray) -> np.ndarray:
            nonlocal last
            if time.perf_counter() - made > LIMIT_S:
                raise _TimeUp
            value = flat.residuals(x)
            last = min(last, 0.5 * float(value @ value))
            return value

        try:
            found = least_squares(
                residuals, flat.start, method="trf", loss="linear", x_scale="jac", xtol=1e-10,
                max_nfev=MAX_EVALUATIONS, **how,
            )  # fmt: skip
        except _TimeUp:
            return Outcome(time.perf_counter() - made, made - start, 0, 0, last, f"{LIMIT_S:.0f} s are over")
        seconds = time.perf_counter() - made
        return Outcome(seconds, made - start, int(found.njev), int(found.nfev), float(found.cost), found.message)

    return repeated(once)
