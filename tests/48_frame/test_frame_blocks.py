"""Blocks of frame images are compared on three backends, with scipy and with the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.dense import DenseBackend, assemble
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.model.block import Block, Coordinates, GroundPoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role, Status
from fg_orient.sensors.frame import FrameSensor
from fg_orient.sensors.frame_unknowns import UNKNOWNS
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.frame_above import with_frame_above
from tests.support.full_statistics import step_of_numpy
from tests.support.pinhole import SIGMA, FrameTruth, pinhole_block


@lru_cache
def small() -> tuple[Block, FrameTruth]:
    return pinhole_block(4, 25, views=3, seed=2)


def with_options(block: Block, **options: object) -> Block:
    return replace(block, options=replace(block.options, **options))


def all_unknown(block: Block) -> Block:
    """Return the block with every unknown of a frame camera that there is."""
    more = {"principal_sample": 1.0, "principal_line": 1.0, "k3": 1e-3, "p1": 1e-4, "p2": 1e-4}
    images = tuple(
        replace(image, sensor=FrameSensor(
            replace(image.sensor.camera, sigma=SIGMA | more), image.sensor.n_lines, image.sensor.n_samples,
            first_line=image.sensor.first_line, first_sample=image.sensor.first_sample, georeferenced=False,
        ))
        for image in block.images
    )  # fmt: skip
    return replace(block, images=images)


def blocks() -> dict[str, Block]:
    beside = with_frame_above(zonguldak_block(ZonguldakOptions(seed=1))[0])
    return {"nine": small()[0], "fourteen": all_unknown(small()[0]), "beside pushbroom": beside}


def largest(problem: Problem, a: State, b: State) -> tuple[float, float]:
    ground = np.abs(a.ground - b.ground)[problem.active]
    return float(np.abs(a.image - b.image).max()), float(ground.max())


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["nine", "fourteen", "beside pushbroom"])
@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_three_backends_end_where_numpy_has_no_step_left(name: str, optimizer: str) -> None:
    """Each backend and optimiser ends where numpy has no step left, within 1e-9 prior sigma and 1e-7 m.

    chi2 agrees within 1e-11.
    """
    problem = compile_problem(blocks()[name])
    loop, graph = OPTIMIZERS[optimizer], ExplicitBackend(problem)
    a = loop(SchurBackend(problem), problem.start, 50, tolerance=1e-9)
    b = loop(graph, graph.initial(), 50, tolerance=1e-9)
    c = loop(DenseBackend(problem), problem.start, 50, tolerance=1e-9)
    assert a.converged
    image, ground = step_of_numpy(problem, a.state)
    assert image <= 1e-9
    assert ground <= 1e-7
    for error, state in ((b.error, graph.state(b.state)), (c.error, c.state)):
        assert a.error == pytest.approx(error, rel=1e-11)
        image, ground = largest(problem, a.state, state)
        assert image <= 1e-9
        assert ground <= 1e-7


def independent(block: Block) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function for the residuals of priors and pixels by numpy and scipy alone.

    Its argument holds the image unknowns, then the points.
    """
    o, n_images = block.observations, len(block.images)
    cameras = [image.sensor.camera for image in block.images]
    scale = np.array(list(SIGMA.values()))

    def residuals(v: np.ndarray) -> np.ndarray:
        x, ground = v[: 9 * n_images].reshape(-1, 9), v[9 * n_images :].reshape(-1, 3)
        out = [x.ravel()]
        for k, camera in enumerate(cameras):
            rows, d = o.image == k, x[k] * scale
            turned = Rotation.from_rotvec(d[:3]) * Rotation.from_matrix(camera.rotation)
            q = turned.apply(ground[o.point[rows]] - camera.centre_m - d[3:6])
            p = q[:, :2] / q[:, 2:]
            r = np.sum(p**2, axis=1)
            k1, k2 = camera.distortion[:2] + d[7:9]
            pixel = (camera.focal_px + d[6]) * (1.0 + k1 * r + k2 * r**2)[:, None] * p
            out += [(pixel[:, 1] - o.line[rows]) / o.sigma_line_px[rows]]
            out += [(pixel[:, 0] - o.sample[rows]) / o.sigma_sample_px[rows]]
        return np.concatenate(out)

    return residuals


@pytest.mark.oracle
def test_solution_is_the_minimum_of_an_independent_cost() -> None:
    """The solution has the chi2 of an independent cost, and a Gauss-Newton step from it is below 1e-7.

    Its derivatives are numeric, 1e-10 of their size.
    """
    block, _ = small()
    assert tuple(SIGMA) == tuple(name for name in UNKNOWNS if name in SIGMA)
    solution = fg.adjust(block, backend="schur")
    assert solution.status is Status.CONVERGED
    residuals = independent(block)
    found = np.concatenate([solution.state.image.ravel(), solution.ground_m.ravel()])
    value = residuals(found)
    assert value @ value == pytest.approx(solution.chi2, rel=1e-11)
    h = 1e-5
    design = np.stack(
        [(residuals(found + e) - residuals(found - e)) / (2.0 * h) for e in h * np.eye(len(found))], axis=1
    )
    step = np.linalg.lstsq(design, -value, rcond=None)[0]
    assert np.abs(step).max() < 1e-7


@pytest.mark.oracle
def test_truth_lies_within_its_standard_deviations() -> None:
    block, truth = pinhole_block(6, 60, seed=5)
    solution = fg.adjust(block)
    worst = []
    for k, image in enumerate(block.images):
        q = solution.covariance(f"image:{image.id}").values
        physical = np.array(list(SIGMA.values()))
        difference = (solution.state.image[k] - truth.image[k]) * physical
        worst.append(difference @ np.linalg.solve(q, difference))
    # sums of squares of 9 normal numbers each, correlated between images: none beyond the 1e-5 limit of chi2(9)
    assert max(worst) < 40.0
    assert np.mean(worst) > 1.0
    assert 0.8 < np.sqrt(solution.chi2 / solution.problem.redundancy) < 1.2


@pytest.mark.behaviour
def test_relative_block_names_the_seven_motions_of_its_datum() -> None:
    solution = fg.adjust(small()[0])
    datum = [text for text in solution.unobservable if text.startswith("block: the images may be")]
    words = [text.split("may be ")[1].split(":")[0] for text in datum]
    shifts, turns = ([f"{word} {axis}" for axis in "XYZ"] for word in ("shifted together", "turned together about"))
    assert words == [*shifts, *turns, "scaled together"]
    assert any("m X, Y, Z" in text for text in solution.warnings)


@pytest.mark.oracle
def test_free_datum_needs_no_prior_and_is_not_trusted() -> None:
    """A free datum without priors gives the same chi2 on all backends, is not trustworthy and names seven motions.

    The equations are singular.
    """
    block = with_options(pinhole_block(4, 60, seed=2)[0], datum="free", priors=False)
    costs = []
    for backend in ("schur", "graph", "dense"):
        solution = fg.adjust(block, backend=backend)
        assert solution.status is Status.NOT_TRUSTWORTHY
        assert solution.cofactors is None
        assert "datum is free" in solution.reason
        assert len(solution.block_view.sentences) == 7
        costs.append(solution.chi2)
        residual, design = assemble(solution.problem, solution.state)
        design = design / np.linalg.norm(design, axis=0)
        assert np.linalg.matrix_rank(design, rtol=1e-9) == design.shape[1] - 7
        assert np.abs(design.T @ residual).max() < 1e-6
    assert costs[1:] == pytest.approx([costs[0]] * 2, rel=1e-10)
    assert costs[0] < fg.adjust(with_options(block, priors=True)).chi2
    with pytest.raises(InputError) as caught:
        fg.adjust(block, datum="control")
    assert caught.value.problems[0].code == "block.no_control"


@pytest.mark.oracle
def test_control_points_of_a_local_system_fix_the_datum() -> None:
    """Control points in a local system fix the datum, and their sigmas and differences are along X, Y, Z."""
    block, truth = small()
    control = np.arange(0, 25, 3)
    sigma = np.full((25, 3), np.nan)
    sigma[control] = 0.01, 0.02, 0.03
    start = block.points.known.ecef_m.copy()
    start[control] = truth.ground_m[control]
    roles = tuple(Role.CONTROL if j in control else Role.TIE for j in range(25))
    points = GroundPoints(block.points.ids, roles, Coordinates(start, sigma, np.zeros(25, bool)))
    solution = fg.adjust(replace(with_options(block, datum="control"), points=points))
    assert solution.unobservable == ()
    assert np.abs(solution.accuracy.control.enu_m).max() < 0.05
    assert np.allclose(solution.accuracy.control.enu_m, solution.accuracy.control.ecef_m, atol=1e-12)
    records = solution.problem.control_records[control, POINT.whitening].reshape(-1, 3, 3)
    assert np.allclose(records, np.diag([100.0, 50.0, 100.0 / 3.0]))


@pytest.mark.behaviour
@pytest.mark.parametrize(("arguments", "place"), [((1, 5), "n_images"), ((3, 5, 4), "views"), ((3, 0, 2), "n_points")])
def test_impossible_simulations_are_refused(arguments: tuple[int, ...], place: str) -> None:
    with pytest.raises(InputError) as caught:
        pinhole_block(*arguments)
    assert caught.value.problems[0].option == place


@pytest.mark.consistency
def test_simulation_without_noise_fits_its_truth() -> None:
    block, truth = pinhole_block(5, 40, seed=9, noise_px=0.0)
    problem = compile_problem(block)
    state = State(truth.image, truth.ground_m - problem.origin_m)
    assert np.abs(problem.pixel_residuals(state)).max() < 1e-9
    again, _ = pinhole_block(5, 40, seed=9, noise_px=0.0)
    assert np.array_equal(again.observations.line, block.observations.line)
    assert np.abs(np.stack([block.observations.line, block.observations.sample])).max() < 4000.0
