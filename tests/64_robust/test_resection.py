"""Starts by resection find clean subsets and leave errors out where a start with Huber's loss fails."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import fg_orient as fg
from fg_orient.adjustment.problem import State
from fg_orient.adjustment.resection import CERTAINTY, METHODS, SHARE, resection_start, subset_count
from fg_orient.adjustment.rows import residuals
from fg_orient.model.errors import InputError
from fg_orient.simulate.block import BlockOptions, grid_block

from .conftest import adjusted, control_rays, moved, problem_of, spoiled, twin


@pytest.mark.oracle
def test_number_of_subsets_by_counting() -> None:
    """The number of subsets is the least m with (1 - p)^m <= 0.001 for the probability p of a clean subset.

    p is that of draws without replacement within 15 %.
    """
    for size in (5, 9):
        m = subset_count(size)
        p = (1.0 - SHARE) ** size
        assert (1.0 - p) ** m <= 1.0 - CERTAINTY < (1.0 - p) ** (m - 1)
    # drawn without replacement: 20 of 50 wrong, the share of draws of 5 without any
    rng = np.random.default_rng(1)
    clean = np.mean([(np.argsort(rng.random(50))[:5] >= 20).all() for _ in range(4000)])
    assert clean == pytest.approx(math.comb(30, 5) / math.comb(50, 5), abs=0.012)
    assert math.comb(30, 5) / math.comb(50, 5) == pytest.approx((1.0 - SHARE) ** 5, rel=0.15)


@pytest.mark.oracle
@pytest.mark.parametrize("method", METHODS)
def test_clean_images_are_resected_by_all_their_points(method: str) -> None:
    """A resection of a clean image keeps 90 % of its points and has scipy's unknowns within 1e-4.

    Ground points are held, and sigmas are those of image points alone.
    """
    block = twin()
    points = replace(
        block.points, known=replace(block.points.known, fixed=np.isfinite(block.points.known.ecef_m[:, 0]))
    )
    problem = problem_of(replace(block, points=points))
    state, found = resection_start(problem, method)
    assert len(found) == 2
    for k, resection in enumerate(found):
        assert len(resection.rows) == 37
        assert resection.kept.mean() >= 0.9
        assert 0.5 <= resection.scale <= 2.0

        def residual(x: np.ndarray, k: int = k, rows: np.ndarray = resection.rows[resection.kept]) -> np.ndarray:
            image = problem.start.image.copy()
            image[k] = x
            return np.concatenate([residuals(problem, State(image, problem.start.ground))[rows].ravel(), x])

        expected = least_squares(residual, np.zeros(problem.start.image.shape[1]), xtol=1e-12, ftol=1e-12).x
        assert np.abs(resection.unknowns - expected).max() <= 1e-4
        assert np.array_equal(state.image[k], resection.unknowns)


@pytest.mark.oracle
@pytest.mark.parametrize("method", METHODS)
def test_a_third_of_wrong_points_is_left_out(method: str) -> None:
    block, bad = spoiled(twin(), 0.33, 4, (6.0, 30.0))
    _, found = resection_start(problem_of(block), method)
    for resection in found:
        wrong = np.isin(resection.rows, bad)
        assert not resection.kept[wrong].any()
        assert resection.kept[~wrong].mean() >= 0.8
        assert resection.scale <= 2.5


@pytest.mark.consistency
def test_the_same_seed_gives_the_same_start() -> None:
    problem = problem_of(spoiled(twin(), 0.3, 4)[0])
    a, b, c = (resection_start(problem, "lms", seed) for seed in (1, 1, 2))
    assert np.array_equal(a[0].image, b[0].image) and np.array_equal(a[0].ground, b[0].ground, equal_nan=True)
    assert a[1][0].scale == b[1][0].scale != c[1][0].scale


@pytest.mark.oracle
def test_equal_errors_at_one_end_that_huber_follows() -> None:
    """With 12 of 37 points at one end wrong by 100 px, resections keep check points within 5 m; Huber does not.

    Points at an end have leverage: Huber's loss turns the image, and check points are off by over 100 m. Priors are 100
    times as wide as usual.
    """
    block = twin()
    rows = control_rays(block, 0)
    rows = rows[np.argsort(block.observations.line[rows])][:12]
    wide = {"position_sigma_m": (1e3, 1e2, 10.0), "attitude_sigma_rad": (5e-3, 1e-3, 2e-4)}
    check = block.points.where(fg.Role.CHECK)
    clean = adjusted(block, **wide).state.ground[check]
    away = {}
    for start in ("huber", "lms", "lts"):
        end = adjusted(moved(block, rows, 100.0, 100.0), loss="tukey", robust_start=start, **wide)
        away[start] = float(np.sqrt(np.mean(np.sum((end.state.ground[check] - clean) ** 2, axis=1))))
        if start != "huber":
            assert end.weights is not None
            assert (end.weights.image[rows] < 0.01).all()
    assert max(away["lms"], away["lts"]) <= 5.0
    assert away["huber"] > 100.0


@pytest.mark.consistency
def test_images_with_little_control_follow_their_neighbours() -> None:
    block, _ = grid_block(BlockOptions(rows=2, columns=3, points=150, seed=3, control_share=0.12, check_share=0.2))
    problem = problem_of(block)
    o = problem.observations
    few = np.bincount(o.image[problem.observed[o.point]], minlength=6)
    assert few.min() < 7 <= few.max()
    state, found = resection_start(problem, "lts")
    assert all(len(r.rows) >= 7 for r in found)
    end = adjusted(block, loss="tukey", robust_start="lts")
    plain = adjusted(block)
    assert end.converged
    assert np.abs(end.state.image - plain.state.image).max() <= 0.5
    assert np.abs(state.image - plain.state.image).max() <= 3.0


@pytest.mark.behaviour
def test_too_few_control_points_are_named() -> None:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=40, seed=3, control_share=0.1))
    with pytest.raises(InputError) as raised:
        fg.adjust(block, loss="tukey", robust_start="lms")
    assert [p.place for p in raised.value.problems] == [f"image {image.id}" for image in block.images]
    assert "too few points for a robust start" in str(raised.value)
    with pytest.raises(InputError, match="needs a robust loss"):
        fg.adjust(block, robust_start="lms")
    with pytest.raises(InputError, match="needs a robust loss"):
        fg.adjust(block, robust_scale="mad")
    with pytest.raises(InputError, match="graduated non-convexity begins with"):
        fg.adjust(block, loss="tls", gnc=True, robust_start="lms")
