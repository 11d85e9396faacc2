"""Covariances agree with the scatter of whole adjustments of simulated observations.

For errors e of covariance C and rank d the sum of e^T C^+ e over n independent runs is chi-square of n d degrees of
freedom; it is judged by the 99.9 % interval of that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.solve import solve
from fg_orient.model.block import Block
from fg_orient.orientation.solution import Solution
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.covariance import cofactors_of
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.full_statistics import Full, options

pytestmark = pytest.mark.oracle

PARTS = ("images", "points", "residuals", "observations")


@pytest.fixture(scope="module")
def truth() -> Solution:
    """Return the solution of a pair with 14 points, some of them control; observations are simulated from it."""
    chosen = BlockOptions(rows=1, columns=2, points=14, control_share=0.4, check_share=0.0, seed=4)
    return fg.adjust(options(grid_block(chosen)[0], eop_set=10))


@dataclass(frozen=True)
class Run:
    """Simulated observations and the state from which they were made."""

    block: Block
    state: State


def simulated(truth: Solution, rng: np.random.Generator) -> Run:
    """Return the orientation drawn from its priors, control points and pixels with errors of their sigmas."""
    problem, block, o = truth.problem, truth.block, truth.problem.observations
    x = rng.normal(size=problem.n_image_unknowns)
    state = State(problem.image_matrix(x), truth.ground_m - problem.origin_m)
    pixels = np.empty((len(o), 2))
    for k, (image, correction) in enumerate(zip(block.images, problem.corrections(state), strict=True)):
        rows = o.image == k
        pixels[rows] = np.stack(image.sensor.project(truth.ground_m[o.point[rows]], correction), axis=1)
    pixels += rng.normal(size=pixels.shape) * np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    known, ecef = block.points.known, block.points.known.ecef_m.copy()
    rows = np.flatnonzero(problem.observed)
    noise = rng.normal(size=(len(rows), 3)) * known.sigma_enu_m[rows]
    ecef[rows] = truth.ground_m[rows] + np.einsum("nji,nj->ni", problem.axes(truth.ground_m[rows]), noise)
    points = replace(block.points, known=replace(known, ecef_m=ecef))
    observations = replace(o, line=pixels[:, 0], sample=pixels[:, 1])
    return Run(replace(block, observations=observations, points=points), state)


def with_sigmas(block: Block, factor: float) -> Block:
    """Return the same observations with other sigmas of the image points."""
    o = block.observations
    sigmas = {name: factor * getattr(o, name) for name in ("sigma_line_px", "sigma_sample_px")}
    return replace(block, observations=replace(o, **sigmas))


def squares(problem: Problem, state: State, cofactors: Cofactors, true: State) -> dict[str, float]:
    """Return e^T C^+ e of image unknowns, ground points, residuals and adjusted observations.

    Those of unknowns use the covariance of the backend; C of residuals and adjusted observations is a projector.
    """
    images, points = tuple(range(problem.n_images)), tuple(np.flatnonzero(problem.active).tolist())
    e_images = problem.image_vector(state) - problem.image_vector(true)
    e_points = (state.ground - true.ground)[problem.active].ravel()
    q_images, q_points = cofactors.joint(images, ()), cofactors.joint((), points)
    full = Full.of(problem, state)
    change = full.v - assemble(problem, true, jacobian=False)[0]
    return {
        "images": float(e_images @ np.linalg.solve(q_images, e_images)),
        "points": float(e_points @ np.linalg.solve(q_points, e_points)),
        "residuals": float(full.v @ full.residuals @ full.v),
        "observations": float(change @ (np.eye(len(full.v)) - full.residuals) @ change),
    }


@dataclass(frozen=True)
class Scatter:
    """Means of e^T C^+ e, their degrees of freedom, number of runs."""

    means: dict[str, float]
    freedom: dict[str, int]
    runs: int

    @property
    def ratios(self) -> dict[str, tuple[float, float, float]]:
        """Return the mean per degree of freedom and its 99.9 % interval."""
        out = {}
        for part in PARTS:
            total = self.runs * self.freedom[part]
            low, high = stats.chi2.interval(0.999, total)
            out[part] = (self.means[part] / self.freedom[part], float(low / total), float(high / total))
        return out

    @property
    def outside(self) -> list[str]:
        return [part for part, (mean, low, high) in self.ratios.items() if not low <= mean <= high]


def scatter(truth: Solution, runs: int, seed: int, sigma_factor: float = 1.0) -> Scatter:
    """Simulate with the right sigmas; adjust with these times ``sigma_factor``."""
    rng, problem = np.random.default_rng(seed), truth.problem
    u, all_unknowns = problem.n_image_unknowns, problem.n_unknowns
    freedom = dict(zip(PARTS, (u, all_unknowns - u, problem.redundancy, all_unknowns), strict=True))
    sums = dict.fromkeys(PARTS, 0.0)
    for _ in range(runs):
        run = simulated(truth, rng)
        compiled = compile_problem(with_sigmas(run.block, sigma_factor))
        estimate = solve(compiled)
        assert estimate.converged
        for part, value in squares(compiled, estimate.state, cofactors_of(compiled, estimate), run.state).items():
            sums[part] += value
    return Scatter({part: total / runs for part, total in sums.items()}, freedom, runs)


def test_covariance_in_twelve_runs(truth: Solution) -> None:
    assert scatter(truth, 12, seed=621).outside == []


def test_wrong_sigma_is_seen_in_twelve_runs(truth: Solution) -> None:
    """With sigmas 20 % too small, residuals and observations leave their intervals in twelve runs."""
    assert {"residuals", "observations"} <= set(scatter(truth, 12, seed=621, sigma_factor=0.8).outside)


def test_half_the_sigma_is_seen_in_every_part(truth: Solution) -> None:
    """With half the sigmas every part leaves its interval in twelve runs, also images and points."""
    assert scatter(truth, 12, seed=621, sigma_factor=0.5).outside == list(PARTS)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["schur", "graph", "dense"])
def test_covariance_in_five_hundred_runs(truth: Solution, backend: str) -> None:
    block = options(truth.block, backend=backend)
    found = scatter(replace(truth, problem=replace(truth.problem, block=block)), 500, 622)
    print(backend, found.ratios)
    assert found.outside == []


@pytest.mark.slow
def test_wrong_sigma_is_seen_in_five_hundred_runs(truth: Solution) -> None:
    found = scatter(truth, 500, seed=622, sigma_factor=1.2)
    print("sigma 20 % off", found.ratios)
    assert found.outside == list(PARTS)
