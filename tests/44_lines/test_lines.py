"""Control by lines and splines reaches the bound of the information; the tests cover backends and errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import fg_orient as fg
from factors.conditions import curves
from fg_orient.quality.features import feature_records
from fg_orient.sensors.lines import LineFeature

from .conftest import Array, of_spline, scene


@pytest.mark.oracle
@pytest.mark.slow
def test_check_points_reach_the_bound() -> None:
    """With ten lines and no control point, check points are within 1.3 of the Cramer-Rao bound.

    Normalised misclosures of the image points on lines have the mean square 1.
    """
    seeds, squares, limits, total, of_w, n_w = range(30), 0.0, 0.0, 0.0, 0.0, 0.0
    for seed in seeds:
        one = scene(seed)
        solution = fg.adjust(one.block, backend="schur")
        assert solution.status == "converged"
        error, bound = (solution.ground_m[:20] - one.check).ravel(), one.bound()
        squares, limits = squares + float(error @ error), limits + float(np.trace(bound))
        total += float(error @ np.linalg.solve(bound, error))
        for record in feature_records(solution):
            of_w, n_w = of_w + record["n"] * record["rms_w"] ** 2, n_w + record["n"]
    assert np.sqrt(squares / limits) <= 1.3
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 60 * len(seeds))
    assert low <= total <= high
    assert abs(of_w / n_w - 1.0) <= 5.0 * np.sqrt(2.0 / n_w)


@pytest.mark.consistency
def test_backends_agree() -> None:
    block = scene(1).block
    graph, schur, dense = (fg.adjust(block, backend=name) for name in ("graph", "schur", "dense"))
    for other in (schur, dense):
        assert np.nanmax(np.abs(other.ground_m - graph.ground_m)) < 1e-6
        assert other.redundancy == graph.redundancy == 20 + 60  # a condition for each check point and point on a line


@pytest.mark.truth
@pytest.mark.parametrize("kind", ["line", "spline"])
def test_exact_images_of_features_give_exact_check_points(kind: str) -> None:
    """Exact image points on lines or splines give check points within a micrometre, without priors.

    The metadata are wrong by tens of metres.
    """
    one = scene(2, kind=kind, noise_px=0.0, across_m=0.0, eop_set=1, priors=False, n_features=20)
    solution = fg.adjust(one.block, backend="dense")
    assert np.abs(solution.ground_m[:20] - one.check).max() < 1e-6


@pytest.mark.behaviour
def test_parallel_lines_name_the_direction_that_they_leave_open() -> None:
    one = scene(0, direction=np.array([1.0, 0.5, 0.0]), eop_set=1)
    solution = fg.adjust(one.block)
    assert any("shifted together along the control features, which are parallel" in s for s in solution.unobservable)
    words = [str(found) for found in solution.findings]
    assert any("control features of other directions, or a control point" in text for text in words)
    open_ = fg.adjust(replace(one.block, options=replace(one.block.options, priors=False)))
    assert open_.status == "not_trustworthy"
    across = fg.adjust(scene(0, eop_set=1).block)
    assert not any("shifted together" in s for s in across.unobservable)
    assert not any("relative adjustment" in str(found) for found in across.findings)


@pytest.mark.oracle
def test_a_planted_error_is_found_and_left_out() -> None:
    """An error of 12 px across a line is the largest w and is found; without it chi2 is that of the clean block."""
    block = scene(0, eop_set=1).block
    o, line, sample = block.observations, block.observations.line.copy(), block.observations.sample.copy()
    line[40], sample[40] = line[40] + 12.0, sample[40] + 9.0
    wrong = replace(block, observations=replace(o, line=line, sample=sample))
    worst = max(feature_records(fg.adjust(wrong)), key=lambda record: record["largest_w"])
    assert (worst["feature"], worst["point"], worst["image"]) == ("L0", "L0/1", "left") and worst["largest_w"] > 10.0
    solution = fg.adjust(wrong, snoop=True)
    assert [one.test.point for one in solution.snooping.found] == ["L0/1"]
    assert solution.status == "converged"
    without = fg.adjust(replace(block, observations=o.take(np.arange(len(o)) != 40), extra=block.extra[1:]))
    assert solution.chi2 == pytest.approx(without.chi2, rel=1e-6)


@pytest.mark.oracle
def test_foot_points_of_a_spline_are_the_nearest(rng: np.random.Generator) -> None:
    """The foot point on a spline is the nearest of 20 001 places of scipy's spline within 1 cm."""
    x = np.linspace(0.0, 1000.0, 7)
    vertices = np.column_stack([x, 80.0 * np.sin(x / 200.0), 20.0 * np.cos(x / 150.0)])
    feature = LineFeature("S", "spline", vertices, np.ones(2))
    setup = feature.segments(np.zeros(3))
    places = of_spline(feature, np.linspace(0.0, 1.0, 20_001))
    for _ in range(30):
        point = places[rng.integers(100, 19_900)] + rng.normal(scale=15.0, size=3)
        k, t = curves.foot(setup, point)
        nearest = float(np.linalg.norm(places - point, axis=1).min())
        found = float(np.linalg.norm(curves.curve(setup[k], t)[0] - point))
        assert nearest - 0.01 <= found <= nearest + 1e-9
        record = curves.RECORD.pack(axis=[0.0, 0.0, 1.0], sigma=[1.0, 1.0])
        assert np.linalg.norm(curves.residual(record, setup, point)) == pytest.approx(found, rel=1e-9)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("kind", "vertices", "sigma", "message"),
    [
        ("line", np.eye(3), [1.0, 1.0], "straight line has two vertices"),
        ("spline", np.eye(3)[:2], [1.0, 1.0], "a spline three or more"),
        ("line", np.ones((2, 3)), [1.0, 1.0], "the same place"),
        ("line", np.eye(3)[:2], [1.0, 0.0], "above 0"),
    ],
)
def test_impossible_features_are_refused(kind: str, vertices: Array, sigma: list[float], message: str) -> None:
    with pytest.raises(fg.InputError, match=message):
        LineFeature("L", kind, vertices, np.array(sigma))
