"""An observation equation of parameters serves the tests of extra observations."""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Argument, Array, compiled, register_condition
from tests.support.equation_examples import Example


@compiled
def residual(record: Any, setup: Any, x: Any) -> Any:
    """Return ``(x - x_0) / sigma`` (k,).

    The record is 0 and unused; setup has the rows x_0 and sigma.
    """
    return (x - setup[0]) / setup[1]


def jacobian(record: Array, setup: Array, value: Array, x: Array) -> Array:
    """Return the Jacobian (k, k) of observed parameters."""
    return np.asarray(np.diag(1.0 / setup[1]))


def observed_parameters(rng: np.random.Generator) -> Example:
    """Return the equation of five parameters."""
    setup = np.stack([rng.normal(size=5), rng.uniform(0.1, 2.0, 5)])
    return Example(np.zeros(0), setup, (rng.normal(size=5),))


OBSERVED_PARAMETERS = register_condition(
    "test_observed_parameters", residual, jacobian, (Argument("x", "prior sigma"),), "test"
)
