"""Factors of GTSAM and user-defined factors in a block agree with dense least squares on every backend."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import product

import gtsam
import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.explicit import image_key, point_key
from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.rows import linearised
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.simulate.block import BlockOptions, grid_block


@lru_cache
def block() -> Block:
    return grid_block(BlockOptions(rows=2, columns=2, points=80, seed=3))[0]


def ties(count: int, of: Block | None = None) -> list[int]:
    """Return the ground points that no control equation holds, seen in two or more images."""
    of = of or block()
    rays = np.bincount(of.observations.point, minlength=len(of.points.ids))
    problem = compile_problem(of)
    return np.flatnonzero(problem.active & ~problem.observed & (rays >= 2))[:count].tolist()


def native_factors(of: Block | None = None) -> tuple[gtsam.NonlinearFactor, ...]:
    """Return a difference of two points, a distance, a full prior of an image and an own factor.

    All of them are a little wrong.
    """
    of = of or block()
    a, b, c, _ = ties(4, of)
    ground = fg.adjust(of, backend="schur").state.ground
    rng = np.random.default_rng(1)
    sigma = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.2, 0.3]))
    between = gtsam.BetweenFactorPoint3(point_key(a), point_key(b), ground[b] - ground[a] + 0.3, sigma)
    length = float(np.linalg.norm(ground[c] - ground[a]))
    distance = gtsam.RangeFactor3(point_key(a), point_key(c), length + 0.2, gtsam.noiseModel.Isotropic.Sigma(1, 0.05))
    size = compile_problem(of).parameters[1]
    root = rng.normal(size=(len(size), len(size)))
    prior = gtsam.PriorFactorVector(
        image_key(1),
        rng.normal(size=len(size)),
        gtsam.noiseModel.Gaussian.Covariance(root @ root.T + np.eye(len(size))),
    )

    def height(_this: object, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        if jacobians is not None:
            jacobians[0] = np.array([[0.0, 0.0, 1.0]])
        return np.array([values.atPoint3(point_key(b))[2] - ground[b, 2] - 0.5])

    own = gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, 0.2), [point_key(b)], height)
    return between, distance, prior, own


@pytest.mark.oracle
def test_every_backend_equals_independent_least_squares() -> None:
    """With GTSAM's factors in a block each backend has solution, chi2, redundancy and cofactors of least squares."""
    extended = replace(block(), extra=native_factors())
    dense = fg.adjust(extended, backend="dense")
    residual, design = assemble(dense.problem, dense.state)
    step = np.linalg.lstsq(design, -residual, rcond=None)[0]
    assert np.abs(step).max() <= 1e-7
    assert dense.chi2 == pytest.approx(residual @ residual, rel=1e-11)
    plain = fg.adjust(block(), backend="dense")
    size = len(compile_problem(block()).parameters[1])
    assert dense.redundancy == plain.redundancy + 3 + 1 + size + 1
    for backend, optimizer in product(("schur", "graph"), ("gauss-newton", "levenberg-marquardt", "dogleg")):
        found = fg.adjust(extended, backend=backend, optimizer=optimizer)
        assert found.status is dense.status
        assert found.chi2 == pytest.approx(dense.chi2, rel=1e-11)
        assert np.abs(found.state.image - dense.state.image).max() <= 1e-9
        assert np.nanmax(np.abs(found.ground_m - dense.ground_m)) <= 1e-7
        assert found.redundancy == dense.redundancy
    assert found.cofactors is not None
    assert dense.cofactors is not None
    for k in range(4):
        assert np.allclose(found.cofactors.image(k), dense.cofactors.image(k), rtol=1e-7, atol=1e-12)
    for j in ties(4):
        assert np.allclose(found.cofactors.point(j), dense.cofactors.point(j), rtol=1e-7, atol=1e-12)


def independent_step(solution: fg.Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return the next Gauss-Newton step of images (u,) and points (N, 3) by numpy.

    Points are eliminated, but not those that factors name. Rows of these factors are GTSAM's own.
    """
    problem, state = solution.problem, solution.state
    rows, image, point = linearised(problem, state), problem.observations.image, problem.observations.point
    u, first = problem.n_image_unknowns, problem.first
    keys = [key for factor in problem.block.extra for key in factor.factor.keys()]
    named = sorted({gtsam.symbolIndex(key) for key in keys if chr(gtsam.symbolChr(key)) == "p"})
    column = {j: u + 3 * n for n, j in enumerate(named)}
    normal, right = np.zeros((u + 3 * len(named),) * 2), np.zeros(u + 3 * len(named))
    normal[:u, :u], right[:u] = np.eye(u), -problem.image_vector(state)
    values = gtsam.Values()
    for k in range(len(first) - 1):
        values.insert(image_key(k), problem.image_vector(state)[first[k] : first[k + 1]])
    for j in named:
        values.insertPoint3(point_key(j), state.ground[j])
    for factor in problem.block.extra:
        linear = factor.factor.linearize(values)
        places = []
        for key in linear.keys():
            n = gtsam.symbolIndex(key)
            is_point = chr(gtsam.symbolChr(key)) == "p"
            places += range(column[n], column[n] + 3) if is_point else range(first[n], first[n + 1])
        jacobian, b = linear.jacobian()
        normal[np.ix_(places, places)] += jacobian.T @ jacobian
        right[places] += jacobian.T @ b.ravel()
    kept = []
    for j in np.flatnonzero(problem.active).tolist():
        own = np.flatnonzero(point == j)
        parts = [np.arange(first[k], first[k + 1]) for k in image[own]]
        at = np.concatenate(parts)
        design, ground = np.zeros((2 * len(own), len(at))), rows.ground[own].reshape(-1, 3)
        for n, (ray, part) in enumerate(zip(own, parts, strict=True)):
            begin = sum(map(len, parts[:n]))
            design[2 * n : 2 * n + 2, begin : begin + len(part)] = rows.image[ray, :, : len(part)]
        residual = rows.residual[own].ravel()
        if problem.observed[j]:
            w = problem.control_weights(j)
            ground = np.vstack([ground, w])
            residual = np.concatenate([residual, problem.control_residuals(state, j)])
            design = np.vstack([design, np.zeros((3, len(at)))])
        if j in column:
            at = np.concatenate([at, np.arange(column[j], column[j] + 3)])
            design = np.hstack([design, ground])
        else:
            q, r = np.linalg.qr(ground)
            kept.append((j, at, q.T @ design, q.T @ residual, r))
            design, residual = design - q @ (q.T @ design), residual - q @ (q.T @ residual)
        normal[np.ix_(at, at)] += design.T @ design
        right[at] -= design.T @ residual
    step, moved = np.linalg.solve(normal, right), np.zeros_like(state.ground)
    for j, at, design, residual, r in kept:
        moved[j] = np.linalg.solve(r, -residual - design @ step[at])
    for j in named:
        moved[j] = step[column[j] : column[j] + 3]
    return step[:u], moved


@pytest.mark.oracle
def test_native_factors_in_a_block_of_ten_thousand_image_points() -> None:
    """With GTSAM's factors in 10 000 image points no step is left, and the redundancy counts them.

    The factors are a difference, a distance and a full prior.
    """
    large = grid_block(BlockOptions(rows=4, columns=4, points=3290, check_share=0.0, seed=3))[0]
    assert len(large.observations) > 10_000
    factors = native_factors(large)[:3]
    solution = fg.adjust(replace(large, extra=factors))
    assert (solution.backend, solution.status) == ("graph", Status.CONVERGED)
    image, ground = independent_step(solution)
    assert np.abs(image).max() <= 1e-9
    assert np.abs(ground).max() <= 1e-7
    plain = compile_problem(large)
    assert solution.redundancy == plain.redundancy + 3 + 1 + len(plain.parameters[1])
    assert solution.residual_cofactors.redundancy_sum == pytest.approx(solution.redundancy, abs=1e-5)


@pytest.mark.behaviour
def test_only_points_that_factors_name_are_variables() -> None:
    graph = fg.factor_graph(replace(block(), extra=native_factors()))
    names = {graph.name(key) for key in graph.values.keys()}
    ids = block().points.ids
    named = {f"point:{ids[j]}" for j in ties(3)}
    assert names == {f"image:{image.id}" for image in block().images} | named


@pytest.mark.behaviour
def test_wrong_factors_are_named_by_their_number() -> None:
    unit = gtsam.noiseModel.Unit.Create(3)
    cases = (
        (gtsam.PriorFactorPoint3(gtsam.symbol("q", 1), np.zeros(3), unit), "not a variable of the block"),
        (gtsam.PriorFactorPoint3(point_key(100_000), np.zeros(3), unit), "not a variable of the block"),
        (gtsam.PriorFactorVector(image_key(0), np.zeros(2), gtsam.noiseModel.Unit.Create(2)), "cannot be evaluated"),
        (gtsam.PriorFactorPoint3(image_key(0), np.zeros(3), unit), "cannot be evaluated"),
        (gtsam.PriorFactorPoint3(point_key(ties(1)[0]), np.full(3, np.nan), unit), "cannot be evaluated"),
        (object(), "neither an ExtraObservation nor a factor"),
    )
    good = native_factors()[0]
    for factor, words in cases:
        with pytest.raises(InputError, match=words) as caught:
            fg.adjust(replace(block(), extra=(good, factor)), backend="graph")
        assert "extra observation 1" in str(caught.value)


@pytest.mark.behaviour
def test_a_factor_of_a_point_without_rays_is_refused() -> None:
    points = block().points
    o = block().observations
    j = ties(1)[0]
    without = replace(block(), observations=o.take(o.point != j), points=points)
    factor = gtsam.PriorFactorPoint3(point_key(j), np.zeros(3), gtsam.noiseModel.Unit.Create(3))
    with pytest.raises(InputError, match="extra observation 0"):
        fg.adjust(replace(without, extra=(factor,)))
    assert fg.adjust(block()).status is Status.CONVERGED
