"""Graduated non-convexity finds gross errors and the result without them, on the graph and Schur backends."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.irls import find_loss
from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.robust import DOWN, FLOOR, scaled, weighted_problem
from fg_orient.adjustment.rows import residuals
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.adjustment.stages import EXACT, PLAIN, SCHEDULES, Graduated, stages_left
from fg_orient.model.errors import InputError
from fg_orient.orientation.run import run_project
from fg_orient.simulate.block import BlockOptions, simulate_block
from tests.support.full_statistics import Dense, step_of_numpy

from .conftest import clean_block, spoiled_block, with_options


def adjusted(block: fg.Block, **options: object) -> Estimate:
    return solve(compile_problem(with_options(block, **{"backend": "schur", "gnc": True, **options})))


@pytest.mark.oracle
@pytest.mark.parametrize("loss", SCHEDULES)
def test_a_quarter_of_gross_errors_is_found(loss: str) -> None:
    """With one ray in four wrong by 5 to 60 px all are down-weighted, and unknowns agree with the clean run.

    They agree within three sigmas.
    """
    block, bad = spoiled_block((5.0, 60.0))
    rays = np.bincount(block.observations.point)[block.observations.point]
    assert 0.2 <= len(bad) / np.count_nonzero(rays >= 4) <= 0.3
    found = adjusted(block, loss=loss)
    assert found.converged
    assert found.weights is not None
    down = found.weights.image < DOWN
    assert down[bad].all()
    good = np.ones(len(down), dtype=bool)
    good[bad] = False
    assert np.mean(down[good & (rays >= 3)]) <= 0.05  # 1 % expected of truncated least squares
    clean = fg.adjust(clean_block(2, 3, 90), backend="schur")
    assert clean.cofactors is not None
    for k in range(len(block.images)):
        sigma = np.sqrt(np.diag(clean.cofactors.image(k)))
        assert (np.abs(found.state.image[k] - clean.state.image[k]) <= 3.0 * sigma).all()
    plain = adjusted(block, loss="none", gnc=False)
    assert (
        np.abs(plain.state.image - clean.state.image).max() > 10.0 * np.abs(found.state.image - clean.state.image).max()
    )


@pytest.mark.oracle
@pytest.mark.parametrize("loss", SCHEDULES)
def test_graph_and_schur_alike(loss: str) -> None:
    block, _ = spoiled_block((3.0, 6.0), 2, 2, 40)
    a, b = (adjusted(block, loss=loss, backend=backend) for backend in ("schur", "graph"))
    stages = [list(dict.fromkeys(r.mu for r in found.log)) for found in (a, b)]
    assert stages[0] == pytest.approx(stages[1], rel=1e-5)  # the first is measured where a stage ends: 1e-3 sigma
    assert np.abs(a.state.image - b.state.image).max() <= 1e-9
    assert np.abs(a.state.ground - b.state.ground).max() <= 1e-8
    assert a.chi2 == pytest.approx(b.chi2, rel=1e-10)
    problem = compile_problem(with_options(block, loss=loss, gnc=True))
    assert step_of_numpy(problem, a.state, Graduated.of(problem.block.options).robust(EXACT))[0] <= 1e-6


@pytest.mark.oracle
def test_truncated_weights_are_all_or_nothing_and_limits_are_quantiles() -> None:
    block, _ = spoiled_block((5.0, 30.0))
    found = adjusted(block, loss="tls", inlier_probability=0.95)
    assert found.weights is not None
    assert set(np.unique(found.weights.image)) == {FLOOR, 1.0}
    residual = residuals(compile_problem(block), found.state)
    assert ((residual**2).sum(axis=1) <= chi2.ppf(0.95, 2))[found.weights.image == 1.0].all()
    plan = Graduated.of(with_options(block, loss="tls").options)
    assert plan.image_limit == pytest.approx(np.sqrt(chi2.ppf(0.99, 2)), rel=1e-12)
    assert plan.control_limit == pytest.approx(np.sqrt(chi2.ppf(0.99, 3)), rel=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("loss", SCHEDULES)
def test_without_gross_errors_it_stays_least_squares(loss: str) -> None:
    """Without gross errors graduated non-convexity ends at numpy's least squares, after one plain stage."""
    block = clean_block(2, 2, 40)
    found = adjusted(block, loss=loss, inlier_probability=1.0 - 1e-15)
    plain = Dense.of(compile_problem(block))
    assert list(dict.fromkeys(r.mu for r in found.log)) == [PLAIN, EXACT] or loss == "geman_mcclure"
    limit = 1e-8 if loss == "tls" else 0.3  # Geman-McClure gives every residual a weight above zero
    assert np.abs(found.state.image - plain.state.image).max() <= limit


@pytest.mark.truth
@pytest.mark.parametrize("name", SCHEDULES)
def test_surrogates_start_where_all_count_and_end_at_the_loss(name: str) -> None:
    """At the first stage all residuals have weight, and the last stage is the bounded loss of Yang et al. 2020.

    The losses are eq. 3, and eq. 9 with mu = 1.
    """
    u, schedule = np.linspace(1e-3, 50.0, 4001), SCHEDULES[name]
    weight, _ = schedule.curves(schedule.first(50.0**2))
    assert weight(u).min() > 0.0
    _, last = schedule.curves(1e9 if name == "tls" else 1.0)
    bounded = 0.5 * (np.minimum(u**2, 1.0) if name == "tls" else u**2 / (1.0 + u**2))
    assert np.abs(last(u) - bounded).max() <= 1e-6
    # the loss of the last stage keeps a little of least squares
    exact = Graduated(name, 1.0, 1.0).robust(EXACT).image
    assert np.abs(exact.costs(u) - (1.0 - FLOOR) * bounded - 0.5 * FLOOR * u**2).max() <= 1e-6
    assert schedule.first(0.4) == EXACT


@pytest.mark.behaviour
def test_stages_left() -> None:
    rising, falling = [PLAIN, 1.0, 1.4], [PLAIN, 8.0, 8.0 / 1.4]
    assert stages_left(rising[:2]) is None
    assert stages_left([*rising, EXACT]) is None
    assert stages_left(rising) == np.ceil(np.log(1e4 / 1.4) / np.log(1.4))
    assert stages_left(falling) == np.ceil(np.log(8.0 / 1.4) / np.log(1.4))


@pytest.mark.behaviour
def test_refusals() -> None:
    block = clean_block(2, 2, 40)
    for options, words in (
        ({"loss": "huber"}, "needs a bounded loss"),
        ({"loss": "none"}, "choose one of tls, geman_mcclure"),
        ({"loss": "hubre", "gnc": False}, "unknown robust loss"),
    ):
        with pytest.raises(InputError, match=words):
            adjusted(block, **options)
    with pytest.raises(InputError, match="inlier_probability"):
        with_options(block, inlier_probability=1.0)


@pytest.mark.oracle
@pytest.mark.parametrize("loss", ["geman_mcclure", "welsch", "tukey", "tls"])
def test_bounded_losses_start_from_least_squares(loss: str) -> None:
    """A bounded loss ends at its minimum near numpy's least squares, although most residuals begin beyond c.

    Without a plain stage they would have no weight.
    """
    block = clean_block(2, 2, 40)
    found, plain = adjusted(block, loss=loss, gnc=False), Dense.of(compile_problem(block))
    assert found.weights is not None
    assert np.count_nonzero(found.weights.image < DOWN) <= 0.05 * len(block.observations)
    assert np.abs(found.state.image - plain.state.image).max() <= 0.5
    problem = compile_problem(block)
    assert step_of_numpy(problem, found.state, scaled(find_loss(loss)))[0] <= 1e-6
    residual = residuals(problem, problem.start)
    assert np.median(np.linalg.norm(residual, axis=1)) > 10.0


@pytest.mark.behaviour
def test_solution_says_what_its_figures_are() -> None:
    block, bad = spoiled_block((5.0, 30.0))
    solution = fg.adjust(block, loss="tls", gnc=True)
    assert solution.status is fg.Status.CONVERGED
    assert solution.weights is not None
    assert np.isnan(solution.sigma0_interval).all()
    (text,) = (w for w in solution.warnings if w.startswith("robust loss tls"))
    down = int(np.count_nonzero(solution.weights.image < DOWN))
    assert f"{down} of {len(block.observations)} image points" in text
    assert down >= len(bad)
    name = f"image:{block.images[0].id}"
    assert np.array_equal(solution.covariance(name).values, solution.cofactor_matrix(name).values)
    with pytest.raises(fg.NoSolutionError, match="not tested for gross errors under a robust loss"):
        solution.outlier_tests()


@pytest.mark.behaviour
def test_a_loss_that_turns_most_points_down_is_not_trusted() -> None:
    """If a loss down-weights most points, the result is not trustworthy. Sigmas are fifty times too small here."""
    block = clean_block(2, 2, 40)
    o = block.observations
    tiny = fg.ImagePoints(o.image, o.point, o.line, o.sample, o.sigma_line_px / 50.0, o.sigma_sample_px / 50.0)
    from dataclasses import replace

    solution = fg.adjust(replace(block, observations=tiny), loss="welsch", max_iterations=500, backend="schur")
    assert solution.status is fg.Status.NOT_TRUSTWORTHY
    assert "have a weight below 0.5: the model is wrong" in solution.reason


@pytest.mark.oracle
def test_cofactors_are_those_of_least_squares_with_the_weights() -> None:
    """Cofactors under a loss equal the inverse of the weighted normal equations, on Schur and graph."""
    block, _ = spoiled_block((3.0, 6.0), 2, 2, 40)
    solutions = [fg.adjust(block, loss="tls", gnc=True, backend=backend) for backend in ("schur", "graph")]
    problem, state, weights = solutions[0].problem, solutions[0].state, solutions[0].weights
    assert weights is not None
    _, design = assemble(weighted_problem(problem, weights), state)
    inverse = np.linalg.inv(design.T @ design)
    turned_down = int(problem.observations.point[np.argmin(weights.image)])
    for solution in solutions:
        assert solution.cofactors is not None
        for k in range(problem.n_images):
            expected = inverse[problem.image_slice(k), problem.image_slice(k)]
            assert np.abs(solution.cofactors.image(k) - expected).max() <= 1e-7 * np.abs(expected).max()
        expected = inverse[problem.point_slice(turned_down), problem.point_slice(turned_down)]
        assert np.abs(solution.cofactors.point(turned_down) - expected).max() <= 1e-7 * np.abs(expected).max()


@pytest.mark.oracle
def test_result_folder_under_a_loss(tmp_path: Path) -> None:
    """Under a loss the tables contain the weights, chi2 follows from them, and the report states no fit."""
    project = simulate_block(tmp_path / "project", BlockOptions(rows=1, columns=2, points=24))
    record = run_project(project, tmp_path / "out", options={"loss": "welsch", "max_iterations": 200})
    tables = {}
    for name in ("residuals", "points", "eop"):
        with (tmp_path / "out" / f"{name}.csv").open(encoding="utf-8") as stream:
            tables[name] = list(csv.DictReader(stream))
    squares = sum(
        float(row["weight"]) * (float(row[f"v_{axis}_px"]) / float(row[f"sigma_{axis}_px"])) ** 2
        for row in tables["residuals"] for axis in ("line", "sample")
    )  # fmt: skip
    squares += sum(
        float(row["weight"]) * (float(row[f"difference_{axis}_m"]) / float(row[f"own_sigma_{axis}_m"])) ** 2
        for row in tables["points"] if row["role"] == "control" for axis in ("east", "north", "up")
    )  # fmt: skip
    squares += sum((float(row["value_per_tau"]) / float(row["prior_sigma"])) ** 2 for row in tables["eop"])
    assert record["status"] == "converged", record["reason"]
    assert record["chi2"] == pytest.approx(squares, rel=1e-9)
    assert {row["sigma_scale"] for row in tables["points"]} == {"prior"}
    assert record["sigma0_interval_99_9"] == [None, None]
    assert record["suspicious_observations"] is None
    assert record["robust"]["n_image_points_below_half"] == sum(float(r["weight"]) < DOWN for r in tables["residuals"])
    assert len(record["robust"]["least"]) == record["robust"]["n_image_points_below_half"]
    text = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "The loss welsch has down-weighted" in text
    assert "not tested under a loss" in text
    assert "fit the model within their standard deviations" not in text
