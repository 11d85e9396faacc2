"""numpy eliminates the ground points from the equations of a block, as a reference for regularisations."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.problem import Problem
from fg_orient.model.block import Block
from fg_orient.model.parameters import with_options
from fg_orient.quality.deficiency import compiled_problem
from fg_orient.quality.regularisation import with_regularisation
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

Array = npt.NDArray[np.float64]
#: Sets with unobservable directions of velocity.
DEFICIENT = (5, 13, 17, 19, 20)


class Dense(NamedTuple):
    """Rows A (n - 3p, z) and right-hand side of the image unknowns; all rows J (n, z + 3p) and residuals."""

    a: Array
    right: Array
    j: Array
    residual: Array


def twin() -> Block:
    """Return the Zonguldak pair: 37 control and 10 check points."""
    return zonguldak_block(ZonguldakOptions(seed=1))[0]


def dense_of(problem: Problem) -> Dense:
    """Project all rows at the start on the complement of the columns of the ground points."""
    residual, design = assemble(problem, problem.start)
    design = design if problem.ties is None else problem.ties.columns(design)
    z = problem.n_free_unknowns
    basis = np.linalg.qr(design[:, z:], mode="complete").Q[:, design.shape[1] - z :]
    return Dense(basis.T @ design[:, :z], -basis.T @ residual, design, residual)


def regularised(block: Block, eop_set: int, **options: Any) -> tuple[Problem, Problem]:
    """Return a problem of the set without priors: plain, and with the regularisation of the options."""
    plain = compiled_problem(with_options(block, "test", eop_set=eop_set, **{"priors": False, **options}))
    return plain, with_regularisation(plain)


def explicit_step(problem: Problem) -> Array:
    """Return the image unknowns after one step of GTSAM with a factor for each image point."""
    backend = ExplicitBackend(problem)
    values = backend.values(problem.start)
    return problem.image_vector(backend.state(backend.retract(values, backend.linearise(values).solve(0.0))))
