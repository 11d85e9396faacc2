"""Factors of GTSAM, and own ones, in a block: every backend against independent dense least squares."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import gtsam
import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.explicit import image_key, point_key
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.simulate.block import BlockOptions, grid_block


@lru_cache
def block() -> Block:
    return grid_block(BlockOptions(rows=2, columns=2, points=80, seed=3))[0]


def ties(count: int) -> list[int]:
    """Ground points that no control equation holds, seen in two or more images."""
    o = block().observations
    rays = np.bincount(o.point, minlength=len(block().points.ids))
    problem = compile_problem(block())
    return np.flatnonzero(problem.active & ~problem.observed & (rays >= 2))[:count].tolist()


def native_factors() -> tuple[gtsam.NonlinearFactor, ...]:
    """A difference of two points, a distance, a full prior of an image, and an own factor: all a little wrong."""
    a, b, c, _ = ties(4)
    ground = fg.adjust(block(), backend="schur").state.ground
    rng = np.random.default_rng(1)
    sigma = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.2, 0.3]))
    between = gtsam.BetweenFactorPoint3(point_key(a), point_key(b), ground[b] - ground[a] + 0.3, sigma)
    length = float(np.linalg.norm(ground[c] - ground[a]))
    distance = gtsam.RangeFactor3(point_key(a), point_key(c), length + 0.2, gtsam.noiseModel.Isotropic.Sigma(1, 0.05))
    size = compile_problem(block()).parameters[1]
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
    """Solution, chi2, redundancy and cofactors against numpy on all rows; the Schur backend refuses in words."""
    extended = replace(block(), extra=native_factors())
    dense = fg.adjust(extended, backend="dense")
    residual, design = assemble(dense.problem, dense.state)
    step = np.linalg.lstsq(design, -residual, rcond=None)[0]
    assert np.abs(step).max() <= 1e-7
    assert dense.chi2 == pytest.approx(residual @ residual, rel=1e-11)
    plain = fg.adjust(block(), backend="dense")
    size = len(compile_problem(block()).parameters[1])
    assert dense.redundancy == plain.redundancy + 3 + 1 + size + 1
    for optimizer in ("gauss-newton", "levenberg-marquardt", "dogleg"):
        found = fg.adjust(extended, backend="graph", optimizer=optimizer)
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
    with pytest.raises(InputError, match="Schur backend cannot take this block"):
        fg.adjust(extended, backend="schur")


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
        (gtsam.PriorFactorPoint3(gtsam.symbol("q", 1), np.zeros(3), unit), "no variable of the block"),
        (gtsam.PriorFactorPoint3(point_key(100_000), np.zeros(3), unit), "no variable of the block"),
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
