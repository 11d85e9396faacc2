"""In the explicit graph, a row of a figure has one point and the change of the figure; the step is the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.native import with_observations
from fg_orient.model.block import Block
from fg_orient.quality.deficiency import compiled_problem

from .test_constraints import SHAPES, N, observed


def _block(kind: str, sigma: float | None) -> Block:
    """Return a figure through free points and a fixed one, with an observed radius."""
    block, ground = observed(kind, control=True)
    fixed = np.arange(len(ground)) == 0
    known = block.points.known
    roles = (fg.Role.CONTROL, *block.points.roles[1:])
    at, spread = known.ecef_m.copy(), known.sigma_enu_m.copy()
    at[0], spread[0] = ground[0], np.nan
    known = replace(known, ecef_m=at, sigma_enu_m=spread, fixed=known.fixed | fixed)
    radius = {"radius": (10.0, 0.01)} if kind in ("circle", "sphere") else {}
    one = fg.Constraint(kind, block.points.ids[:N], sigma=sigma, observed=radius)
    return replace(block, points=replace(block.points, roles=roles, known=known), extra=(one,))  # type: ignore[arg-type]


@pytest.mark.oracle
@pytest.mark.parametrize("sigma", [None, 0.05])
@pytest.mark.parametrize("kind", list(SHAPES))
def test_a_step_is_that_of_the_whole_rows(kind: str, sigma: float | None) -> None:
    """A step of the explicit graph with a figure equals numpy's step from the rows that join all its points."""
    problem = compiled_problem(with_observations(_block(kind, sigma)))
    backend = ExplicitBackend(problem)
    assert len(backend.figures) == 1
    values = backend.initial()
    step = backend.linearise(values).solve(0.0)
    moved = backend.state(backend.retract(values, step))
    rows, design = assemble(problem, problem.start)
    own = np.linalg.lstsq(design, -rows, rcond=None)[0]
    expected = problem.moved(problem.start, own)
    assert moved.image == pytest.approx(expected.image, rel=1e-7, abs=1e-7)
    active = problem.active
    assert moved.ground[active] == pytest.approx(expected.ground[active], rel=0, abs=1e-7)
    assert step.predicted_error == pytest.approx(0.5 * float(np.sum((rows + design @ own) ** 2)), rel=1e-8)
    assert backend.error(values) == pytest.approx(0.5 * float(rows @ rows), rel=1e-12)
