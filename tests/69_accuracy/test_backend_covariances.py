"""All backends give the same covariance blocks of images and points on random blocks.

Compared with each other and with numpy's inverse of the full matrix, element by element in units of
``sqrt(c_ii c_jj)``: within 1e-8 wherever the condition of the normal matrix (unknowns in prior sigmas and metres) is at
most 1e6. Beyond it the difference stays below rounding times the condition.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.parts.execution import Execution
from fg_orient.adjustment.parts.solve import solve_in_parts
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.reduced_cofactors import ReducedCofactors
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.covariance import GraphCofactors, cofactors_of, dense_cofactors
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.full_statistics import Full
from tests.support.rpc_block import rpc_twin
from tests.support.states import moved

pytestmark = pytest.mark.oracle

LIMIT = 1e-8
CONDITION = 1e6
EPS = np.finfo(float).eps


class Inverse:
    """The blocks of the inverse are computed by numpy."""

    def __init__(self, problem: Problem, state: State) -> None:
        self.full = Full.of(problem, state)

    def image(self, k: int) -> np.ndarray:
        return self.joint((k,), ())

    def points(self, index: np.ndarray) -> np.ndarray:
        return np.array([self.joint((), (j,)) for j in index.tolist()])

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> np.ndarray:
        parts = [self.full.problem.image_slice(k) for k in images] + [self.full.problem.point_slice(j) for j in points]
        columns = np.r_[tuple(parts)]
        return self.full.unknowns[np.ix_(columns, columns)]


def all_cofactors(problem: Problem, state: State) -> dict[str, Cofactors | Inverse]:
    graph = ExplicitBackend(problem)
    linear = graph.linearise(graph.values(state)).linear
    return {
        "dense": dense_cofactors(problem, assemble(problem, state)[1]),
        "graph": GraphCofactors(problem, state, linear, graph.zero),
        "schur": ReducedCofactors(problem, SchurBackend(problem).linearise(state)),
        "numpy": Inverse(problem, state),
    }


def blocks_of(problem: Problem, found: Cofactors | Inverse, seed: int) -> list[np.ndarray]:
    """Return covariances of all images and points alone, of two images with three points, and of five points."""
    active = np.flatnonzero(problem.active)
    chosen = [int(j) for j in np.random.default_rng(seed).permutation(active)[:5]]
    single = [found.image(k) for k in range(problem.n_images)] + list(found.points(active))
    return [*single, found.joint((1, 0), tuple(chosen[:3])), found.joint((), tuple(chosen))]


def largest_difference(problem: Problem, cofactors: dict[str, Cofactors | Inverse], seed: int) -> float:
    """Return the largest difference of all pairs of backends, in units of sqrt(c_ii c_jj)."""
    every = [blocks_of(problem, found, seed) for found in cofactors.values()]
    worst = 0.0
    for a, b in itertools.combinations(every, 2):
        for one, other in zip(a, b, strict=True):
            root = np.sqrt(one.diagonal())
            worst = max(worst, float(np.abs((one - other) / np.outer(root, root)).max()))
    return worst


def condition(problem: Problem, state: State) -> float:
    return float(np.linalg.cond(assemble(problem, state)[1])) ** 2


def random_problem(data: st.DataObject) -> Problem:
    """Return a grid of images, or two RPC images, with any set of unknowns and sigmas."""
    if data.draw(st.integers(0, 3), label="kind") == 0:
        return compile_problem(rpc_twin(data.draw(st.sampled_from(["shift", "shift_drift", "affine"]))).block)
    block, _ = grid_block(BlockOptions(
        rows=data.draw(st.integers(1, 2)), columns=2, points=data.draw(st.integers(24, 48)),
        seed=data.draw(st.integers(0, 99)), roll_deg=data.draw(st.sampled_from([4.0, 12.0, 25.0])),
    ))  # fmt: skip
    size = data.draw(st.sampled_from([0.1, 1.0, 10.0]), label="pixel sigmas")
    o = replace(
        block.observations,
        sigma_line_px=block.observations.sigma_line_px * size,
        sigma_sample_px=block.observations.sigma_sample_px * size,
    )
    options = replace(block.options, eop_set=data.draw(st.integers(1, 20)))
    return compile_problem(replace(block, observations=o, options=options))


@settings(max_examples=8)
@given(data=st.data())
def test_three_backends_agree(data: st.DataObject) -> None:
    problem = random_problem(data)
    state = moved(problem, data.draw(st.integers(0, 9)))
    difference = largest_difference(problem, all_cofactors(problem, state), 1)
    found = condition(problem, state)
    assert difference < (LIMIT if found <= CONDITION else EPS * found)


def small() -> Problem:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=24, seed=7))
    return compile_problem(replace(block, options=replace(block.options, eop_set=2)))


def test_parts_agree() -> None:
    problem = small()
    estimate = solve_in_parts(problem, Execution(3, 1))
    assert condition(problem, estimate.state) <= CONDITION
    found = {"parts": cofactors_of(problem, estimate), **all_cofactors(problem, estimate.state)}
    assert largest_difference(problem, found, 2) < LIMIT


def test_a_wrong_weight_fails_the_check() -> None:
    """One pixel sigma that is wrong by a millionth in one backend exceeds the limit of the comparison."""
    problem = small()
    found = all_cofactors(problem, problem.start)
    _, design = assemble(problem, problem.start)
    design[0] *= 1.0 + 1e-6
    found["dense"] = dense_cofactors(problem, design)
    assert largest_difference(problem, found, 2) > LIMIT
