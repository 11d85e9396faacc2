"""Long sequences with few points eliminate the images first; the dense backend and numpy agree."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from benchmarks.frames import Size, network
from factors._contract import Argument, Equation
from fg_orient.adjustment import images_first
from fg_orient.adjustment.border import ImagesBorder
from fg_orient.adjustment.checkpoint import Checkpoint
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.images_first import Images, Places
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.native import with_observations
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.solve import solve
from fg_orient.model.block import Coordinates, ExtraObservation
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from fg_orient.quality.cofactors import StarCofactors
from fg_orient.quality.deficiency import compiled_problem
from fg_orient.quality.free_network import FreeNetwork
from fg_orient.sensors.frame import FrameSensor

PHOTOS, POINTS = 14, 9


def sequence(
    camera: int = 8, bars: int = 2, controls: int = 0, cameras: int = 1, held: int = 0, known: int = 0,
    *, gaps: bool = True,
) -> fg.Block:  # fmt: skip
    """Return the photos of a few points.

    Parameters
    ----------
    camera, bars, cameras : int
        Shared parameters of each camera, scale bars, cameras.
    controls : int
        Control points, the last of them constant; 0: a free network.
    held, known : int
        Photos with a known projection centre, and without any unknown.
    gaps : bool
        A fifth of the image points is missing.
    """
    block, ground = network(Size(PHOTOS, POINTS, 0, camera, bars, 0.0), seed=3)
    images = []
    for k, image in enumerate(block.images):
        s, own = image.sensor, image.sensor.camera
        sigma = {name: value for name, value in own.sigma.items() if k >= held or not name.startswith("centre_")}
        shared = dict.fromkeys(own.shared, f"camera {k % cameras}")
        own = replace(own, sigma=sigma if k >= known else {}, shared=shared if k >= known else {})
        images.append(replace(image, sensor=FrameSensor(own, s.n_lines, s.n_samples, georeferenced=False)))
    block = replace(block, images=tuple(images))
    if gaps:
        keep = np.random.default_rng(3).random(len(block.observations)) < 0.8
        block = replace(block, observations=block.observations.take(np.flatnonzero(keep)))
    if not controls:
        return block
    is_control = np.arange(POINTS) < controls
    coordinates = Coordinates(
        np.where(is_control[:, None], ground, block.points.known.ecef_m),
        np.where(is_control[:, None], 2e-3, np.full((POINTS, 3), np.nan)), np.arange(POINTS) == controls - 1,
    )  # fmt: skip
    roles = tuple(Role.CONTROL if c else Role.TIE for c in is_control.tolist())
    options = replace(block.options, datum="control")
    return replace(block, points=replace(block.points, roles=roles, known=coordinates), options=options)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eliminate images first in small networks, too."""
    monkeypatch.setattr(images_first, "GAIN", 0.0)
    monkeypatch.setattr(images_first, "SAVED", -np.inf)


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Solution, Solution]]:
    """Return a function that solves a block by the dense backend and by the elimination of images.

    The elimination is forced, although it is not yet worth it.
    """

    def solved(block: fg.Block, **options: object) -> tuple[Solution, Solution]:
        dense = fg.adjust(block, backend="dense", **options)
        with monkeypatch.context() as patch:
            patch.setattr(images_first, "GAIN", 0.0)
            patch.setattr(images_first, "SAVED", -np.inf)
            found = fg.adjust(block, **options)
        given = found.cofactors.given if isinstance(found.cofactors, FreeNetwork) else found.cofactors
        assert isinstance(given, StarCofactors) and found.backend == "graph"
        return dense, found

    return solved


def all_cofactors(solution: Solution) -> np.ndarray:
    problem = solution.problem
    points = tuple(np.flatnonzero(problem.active).tolist())
    return np.asarray(solution.cofactors.joint(tuple(range(problem.n_images)), points))


def require_equal(dense: Solution, found: Solution) -> None:
    """Assert that state, cofactors and everything that follows from them are equal."""
    problem, q = dense.problem, all_cofactors(dense)
    size = np.sqrt(np.diag(q))
    assert found.status is dense.status and len(found.warnings) == len(dense.warnings)
    assert found.chi2 == pytest.approx(dense.chi2, rel=1e-11)
    assert np.abs(problem.vector(found.state) - problem.vector(dense.state)).max() < 1e-8
    assert (np.abs(problem.vector(found.state) - problem.vector(dense.state)) / size).max() < 1e-9
    assert np.abs((all_cofactors(found) - q) / np.outer(size, size)).max() < 1e-8
    at = np.arange(len(problem.active))
    assert found.cofactors.points(at) == pytest.approx(dense.cofactors.points(at), rel=1e-8, abs=1e-8 * size[-1] ** 2)
    image, pairs = found.cofactors.image(2), np.array([[1, 3], [2, 2]])
    assert image == pytest.approx(dense.cofactors.image(2), rel=1e-7, abs=1e-8 * np.abs(image).max())
    blocks = found.cofactors.blocks(pairs)
    assert blocks == pytest.approx(dense.cofactors.blocks(pairs), rel=1e-7, abs=1e-8 * np.abs(blocks).max())
    known, expected = found.residual_cofactors, dense.residual_cofactors
    assert np.abs(known.image - expected.image).max() < 1e-8
    for mine, other in zip(known.extra, expected.extra, strict=True):
        assert mine == pytest.approx(other, abs=1e-8)


@pytest.mark.consistency
@pytest.mark.parametrize(
    ("made", "options"),
    [
        ({}, {}),
        ({"bars": 0, "gaps": False}, {}),
        ({"camera": 0}, {}),
        ({"cameras": 2, "held": 3}, {}),
        ({"controls": 4}, {}),
        ({"controls": 4, "bars": 0}, {}),
        ({"controls": 4, "known": 2}, {}),
        ({"controls": 4, "cameras": 2, "held": 3}, {"priors": True}),
        ({"controls": 4}, {"optimizer": "levenberg-marquardt"}),
        ({}, {"optimizer": "dogleg"}),
        ({}, {"loss": "huber"}),
        ({"controls": 4}, {"loss": "huber"}),
        ({"controls": 4}, {"loss": "tls", "gnc": True}),
        ({}, {"loss": "danish"}),
    ],
)
def test_elimination_of_images_changes_nothing(
    both: Callable[..., tuple[Solution, Solution]], made: dict[str, int], options: dict[str, object]
) -> None:
    dense, found = both(sequence(**made), **options)
    require_equal(dense, found)


@pytest.mark.consistency
def test_tests_of_unknowns_and_observations_are_those_of_full_matrices(
    both: Callable[..., tuple[Solution, Solution]],
) -> None:
    """F tests, coefficients, outlier tests and redundancy numbers equal those of the dense backend."""
    dense, found = both(sequence())
    for mine, other in zip(found.significance().groups, dense.significance().groups, strict=True):
        assert (mine.group, mine.dimension) == (other.group, other.dimension)
        assert mine.statistic == pytest.approx(other.statistic, rel=1e-8)
    for mine, other in zip(found.significance().coefficients, dense.significance().coefficients, strict=True):
        assert (mine.t, mine.sd) == pytest.approx((other.t, other.sd), rel=1e-7, abs=1e-8)
    mine, other = found.outlier_tests(), dense.outlier_tests()
    assert mine.quadratic == pytest.approx(other.quadratic, rel=1e-8, abs=1e-8)
    assert found.reliability().image.redundancy == pytest.approx(dense.reliability().image.redundancy, abs=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("controls", [0, 4])
def test_effects_of_image_points_are_those_of_their_cofactors(
    both: Callable[..., tuple[Solution, Solution]], controls: int
) -> None:
    """The effects of image points equal ``Q A^T`` from the full matrix of cofactors, on each backend."""
    block = sequence(controls=controls)
    solutions = (*both(block), fg.adjust(block))
    assert solutions[2].backend == "graph" and not isinstance(solutions[2].cofactors, StarCofactors)
    problem, q, o = solutions[0].problem, all_cofactors(solutions[0]), solutions[0].problem.observations
    rows = linearised(problem, solutions[0].state)
    for solution, a in product(solutions, range(0, len(o), 7)):
        rays = solution.residual_cofactors.rays
        image, j = problem.image_slice(int(o.image[a])), int(o.point[a])
        design = np.zeros((2, len(q)))
        design[:, image] = rows.image[a, :, : image.stop - image.start]
        if problem.active[j]:
            point = problem.point_slice(j)
            design[:, point] = rows.ground[a]
            assert rays.response[a] == pytest.approx(q[point] @ design.T, rel=1e-6, abs=1e-8 * np.sqrt(q[-1, -1]))
            assert rays.points[o.point[a]] == pytest.approx(q[point, point], rel=1e-6, abs=1e-8 * q[-1, -1])
        else:
            assert not rays.response[a].any()
        effect = q[image] @ design.T
        along = np.einsum("ir,ir->r", effect, np.linalg.solve(q[image, image], effect))
        assert rays.on_image[a] == pytest.approx(np.sqrt(along), rel=1e-7)


def compiled(block: fg.Block, **options: object) -> Problem:
    block = with_observations(block)
    return compiled_problem(replace(block, options=replace(block.options, **options)))


def moved(problem: Problem) -> State:
    rng = np.random.default_rng(4)
    ground = problem.start.ground + 0.01 * rng.normal(size=problem.start.ground.shape)
    return State(problem.image_matrix(rng.normal(size=problem.n_free_unknowns)), ground)


def held_unknown(problem: Problem) -> ExtraObservation:
    """Return the observation of one own and one shared unknown of the second photo."""

    def residual(record, setup, x):
        return x[[2, 7]] - record

    def kernel(record, setup, x, want):
        return residual(record, setup, x), np.eye(len(x))[[2, 7]] if want else np.empty((0, 0))

    equation = Equation("two_unknowns", kernel, residual, (Argument("x", "prior sigma"),), "test")
    name = f"image:{problem.block.images[1].id}"
    return ExtraObservation(equation, (name,), np.array([0.5, -0.5]), np.zeros((1, 1)), 2, "two unknowns")


@pytest.mark.oracle
@pytest.mark.parametrize("priors", [True, False])
def test_border_is_the_schur_complement_of_the_images(priors: bool) -> None:
    """Matrix, gradient, cost and steps of the border equal numpy's Schur complement of the images.

    The problem has weights and an observation of one image.
    """
    problem = compiled(sequence(controls=4, cameras=2, held=3), priors=priors)
    problem = replace(problem, block=replace(problem.block, extra=(*problem.block.extra, held_unknown(problem))))
    rng, state, places = np.random.default_rng(5), moved(problem), Places(problem)
    weight = rng.uniform(0.2, 1.0, len(problem.observations))
    control = rng.uniform(0.2, 1.0, len(problem.active))
    records = problem.control_records.copy()
    records[:, :9] *= np.sqrt(control)[:, None]
    images = Images(places, state, np.sqrt(weight)[places.order], records)
    r, design = assemble(problem, state)
    root = np.concatenate([np.repeat(np.sqrt(weight), 2), np.repeat(np.sqrt(control[problem.observed]), 3)])
    root = np.append(root, np.ones(len(r) - len(root)))
    assert problem.ties is not None
    r, design = root * r, root[:, None] * problem.ties.columns(design)
    n, g, z = design.T @ design, design.T @ r, len(problem.ties) - len(places.shared)
    by_border = np.linalg.solve(n[:z, :z], n[:z, z:])
    matrix = n[z:, z:] - n[z:, :z] @ by_border
    assert images.squares == pytest.approx(r @ r, rel=1e-13)
    assert images.matrix == pytest.approx(matrix, rel=1e-9, abs=1e-12 * np.abs(matrix).max())
    gradient = g[z:] - g[:z] @ by_border
    assert images.border_gradient == pytest.approx(gradient, rel=1e-7, abs=1e-12 * np.abs(g).max())
    moves = rng.normal(size=(len(places), 3))
    followed = images.followed(moves)[places.exists]
    assert followed == pytest.approx(-by_border @ moves, rel=1e-7, abs=1e-10)
    step = np.linalg.solve(n[:z, :z], -g[:z])
    assert images.own_step[places.exists] == pytest.approx(step, rel=1e-7, abs=1e-10)
    least = 0.5 * (r @ r + g[:z] @ step)
    assert 0.5 * (images.squares - np.sum(images.decrements**2)) == pytest.approx(least, rel=1e-9)
    assert places.state(places.own_of(state), places.border_of(state)).image == pytest.approx(state.image)


@pytest.mark.oracle
def test_movements_of_the_border_have_the_effect_of_all_rows() -> None:
    """Effect, gradient and step of the border equal those of the Jacobian of all observations."""
    problem = compiled(sequence(controls=4), priors=True)
    state = moved(problem)
    border = ImagesBorder(problem, state)
    r, design = assemble(problem, state)
    assert problem.ties is not None
    design = problem.ties.columns(design)
    moves = np.random.default_rng(6).normal(size=(len(border), 4))
    images, ground = border.movements(moves)
    effect = design @ np.vstack([images, ground[problem.active].reshape(-1, 4)])
    followed = border.follow(moves)
    singular = np.linalg.svd(effect, compute_uv=False)
    assert np.linalg.svd(followed.effect, compute_uv=False) == pytest.approx(singular, rel=1e-10)
    assert followed.gradient == pytest.approx((design.T @ effect)[-len(border) :], rel=1e-8, abs=1e-6)
    step = problem.vector(border.newton()) - problem.vector(state)
    expected = problem.ties.widened(np.linalg.lstsq(design, -r, rcond=None)[0])
    assert step == pytest.approx(expected, rel=1e-7, abs=1e-9)


@pytest.mark.consistency
@pytest.mark.parametrize("options", [{}, {"optimizer": "dogleg"}, {"loss": "huber"}, {"loss": "tls", "gnc": True}])
def test_resumed_run_has_the_same_bits(at_once: None, options: dict[str, object], tmp_path: Path) -> None:
    problem = compiled(sequence(controls=4), **options)

    def stop(record: IterationRecord) -> None:
        if record.iteration == 3:
            raise KeyboardInterrupt

    whole, path = solve(problem), tmp_path / "file"
    with pytest.raises(KeyboardInterrupt):
        solve(problem, stop, checkpoint=Checkpoint(path, every_s=0.0))
    resumed = solve(problem, checkpoint=Checkpoint(path, every_s=0.0, resume=True))
    assert resumed.resumed_at > 0 and isinstance(resumed.linear, ImagesBorder)
    assert np.array_equal(resumed.state.image, whole.state.image)
    assert np.array_equal(resumed.state.ground, whole.state.ground)
    assert (resumed.chi2, resumed.iterations) == (whole.chi2, whole.iterations)


@pytest.mark.behaviour
def test_points_are_eliminated_where_images_cannot_be(at_once: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """If no image can be eliminated first, points are, and the solution is the same within 1e-9 m."""
    problem = compiled(sequence(controls=4), priors=True)
    expected = solve(problem)
    monkeypatch.setattr(images_first, "PIVOT", 1.0)
    found = solve(problem)
    assert isinstance(expected.linear, ImagesBorder) and not isinstance(found.linear, ImagesBorder)
    assert found.chi2 == pytest.approx(expected.chi2, rel=1e-11)
    assert found.state.ground == pytest.approx(expected.state.ground, abs=1e-9)


@pytest.mark.behaviour
def test_images_are_eliminated_first_where_that_takes_less_work() -> None:
    many, few = network(Size(60, 12, 0, 8, 2, 0.0))[0], network(Size(8, 100, 4, 8, 2, 0.0))[0]
    assert images_first.images_first(compiled(many))
    assert not images_first.images_first(compiled(few))
    assert not images_first.images_first(compiled(many, datum="free"))
    base = fg.Constraint("base", (many.images[0].id, many.images[1].id), 1.0, 1e-3)
    assert not images_first.images_first(compiled(replace(many, extra=(base,))))


@pytest.mark.behaviour
def test_photo_that_its_points_do_not_determine_is_named() -> None:
    problem = compiled(sequence(gaps=False))
    o = problem.observations
    keep = np.flatnonzero((o.image != 5) | (o.point < 2))
    problem = replace(problem, observations=o.take(keep), records=problem.records[keep])
    with pytest.raises(Singular, match=r"image p5"):
        Images(Places(problem), problem.start)


@pytest.mark.oracle
@pytest.mark.parametrize(("photos", "points"), [(60, 20), (100, 37)])
def test_estimated_memory_covers_what_is_allocated(photos: int, points: int) -> None:
    """The estimated memory is above the peak that tracemalloc counts, and below four times the peak."""
    block, _ = network(Size(photos, points, 0, 8, 2, 0.0))
    fg.adjust(block)  # what is compiled or loaded once does not count
    tracemalloc.start()
    try:
        solution = fg.adjust(block)
        solution.reliability()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert solution.memory is not None
    assert peak < solution.memory.needed < 4.0 * peak
