"""The Schur backend agrees with the graph and the dense backend: steps, solutions, cofactors, refusals."""

from __future__ import annotations

import gc
import itertools
import os
import weakref
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fg_orient as fg
from factors._contract import NotFiniteError
from factors.conditions.control import CONTROL_POINT
from fg_orient.adjustment import (
    iterative_reduced,
    reduced_choice,
    reduced_systems,
    runtime,
    schur,
    schur_reduced,
    schur_structure,
)
from fg_orient.adjustment.dense import DenseBackend, assemble
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.irls import find_loss
from fg_orient.adjustment.iterative_reduced import ImplicitProduct
from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.reduced_choice import Pattern
from fg_orient.adjustment.reduced_cofactors import ReducedCofactors
from fg_orient.adjustment.robust import scaled
from fg_orient.adjustment.runtime import Workers
from fg_orient.adjustment.schur import SchurBackend, SchurSystem
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.solve import solve, suitable_backend
from fg_orient.model.block import Block, ExtraObservation, Image, ImagePoints
from fg_orient.model.names import Role
from fg_orient.quality import conditioning
from fg_orient.quality.covariance import cofactors_of
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.full_statistics import Full, damped_of_numpy, dogleg_of_numpy, step_of_numpy, stepped
from tests.support.pinhole import pinhole_block
from tests.support.rpc_block import rpc_twin, twin_with_models
from tests.support.states import largest, moved

#: Both backends go on to this scaled step, or until it stops shrinking.
TOLERANCE = 1e-9


@lru_cache
def grid(rows: int, columns: int, points: int) -> Block:
    return grid_block(BlockOptions(rows=rows, columns=columns, points=points, seed=3))[0]


def with_options(block: Block, **options: object) -> Block:
    return replace(block, options=replace(block.options, **options))


def fixed_control(block: Block, count: int) -> Block:
    fixed = block.points.known.fixed.copy()
    fixed[block.points.where(Role.CONTROL)[:count]] = True
    return replace(block, points=replace(block.points, known=replace(block.points.known, fixed=fixed)))


def mixed(kind: str) -> Block:
    """Return a block of three images with different models.

    The left one has its rigorous model, the right one an RPC, and the third is the left one with its RPC.
    """
    rigorous, _, _ = twin_with_models()
    twin = rpc_twin(kind).block
    o, p = rigorous.observations, twin.observations
    left = o.image == 0
    parts = [(o, left, 0), (p, p.image == 1, 1), (p, p.image == 0, 2)]
    names = ("line", "sample", "sigma_line_px", "sigma_sample_px")
    columns = {n: np.concatenate([getattr(a, n)[rows] for a, rows, _ in parts]) for n in names}
    image = np.concatenate([np.full(int(rows.sum()), k, a.image.dtype) for a, rows, k in parts])
    point = np.concatenate([a.point[rows] for a, rows, _ in parts])
    images = (rigorous.images[0], twin.images[1], Image("third", twin.images[0].sensor))
    options = replace(rigorous.options, rpc_compensation=kind)
    return replace(rigorous, images=images, observations=ImagePoints(image, point, **columns), options=options)


def measured_twice(block: Block, count: int) -> Block:
    """Return the first rays a second time, moved by 0.1 px: a point then has two rays of one image."""
    o = block.observations
    again = o.take(np.arange(count))
    names = ("line", "sample", "sigma_line_px", "sigma_sample_px")
    columns = {n: np.concatenate([getattr(o, n), getattr(again, n)]) for n in names}
    columns["line"][-count:] += 0.1
    ids = (np.concatenate([o.image, again.image]), np.concatenate([o.point, again.point]))
    return replace(block, observations=ImagePoints(*ids, **columns))


def gapped(block: Block, seed: int) -> Block:
    """Leave out every fifth ray of points that keep two others."""
    o, rng = block.observations, np.random.default_rng(seed)
    keep = np.ones(len(o), dtype=bool)
    for row in rng.permutation(len(o))[: len(o) // 5]:
        keep[row] = np.count_nonzero(keep & (o.point == o.point[row])) <= 2
    return replace(block, observations=o.take(keep))


def assert_same_step(problem: Problem, state: State, damping: float) -> None:
    """Assert that one step equals that of the dense rows, within 100 eps of the normal equations' condition."""
    residual, design = assemble(problem, state)
    normal = design.T @ design + damping * np.eye(design.shape[1])
    condition = np.linalg.cond(normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal))))
    assert condition < 1e10, "ill-conditioned: not compared"
    dense = DenseBackend(problem)
    expected = dense.linearise(state).solve(damping)
    reference = dense.retract(state, expected)
    for reduced in ("dense", "banded", "graph"):
        backend = SchurBackend(problem, reduced=reduced)
        system = backend.linearise(state)
        assert 2.0 * system.error == pytest.approx(residual @ residual, rel=1e-13)
        step = system.solve(damping)
        size = max(1.0, step.length)
        image, ground = largest(problem, backend.retract(state, step), reference)
        assert max(image, ground) <= size * max(1e-12, 100.0 * np.finfo(float).eps * condition), (reduced, condition)
        assert step.predicted_error == pytest.approx(expected.predicted_error, rel=1e-8)
        assert step.length == pytest.approx(expected.length, rel=1e-6)


@pytest.mark.oracle
@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.data())
def test_random_blocks_step_as_the_dense_rows(data: st.DataObject) -> None:
    """For random blocks and options a Schur step equals that of the dense rows.

    Blocks vary in sets, look polynomials, roles, fixed points, gaps, points measured twice and two to six images.
    """
    block = grid(*data.draw(st.sampled_from([(1, 2, 24), (2, 2, 40), (2, 3, 50)]), label="grid"))
    block = fixed_control(block, data.draw(st.integers(0, 4), label="fixed"))
    if data.draw(st.booleans(), label="gaps"):
        block = gapped(block, 1)
    if data.draw(st.booleans(), label="twice"):
        block = measured_twice(block, 9)
    problem = compile_problem(with_options(
        block, eop_set=data.draw(st.integers(1, 20), label="set"),
        look_polynomial=data.draw(st.sampled_from([None, None, 0, 2]), label="look"),
        check_points=data.draw(st.sampled_from(["use", "exclude"]), label="check"),
        small_angle=data.draw(st.booleans(), label="small angle"),
    ))  # fmt: skip
    assert_same_step(problem, moved(problem, 1), data.draw(st.sampled_from([0.0, 1e-2, 10.0]), label="damping"))


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["shift", "shift_drift", "affine"])
def test_images_of_two_kinds_step_as_the_dense_rows(kind: str) -> None:
    problem = compile_problem(with_options(fixed_control(mixed(kind), 3), eop_set=20))
    assert len({m.equation.name for m in problem.models}) == 2
    assert_same_step(problem, problem.start, 0.0)
    assert_same_step(problem, moved(problem, 2), 0.1)


#: What is solved to the end by all backends.
BLOCKS: dict[str, Callable[[], Block]] = {
    "set 20": lambda: with_options(grid(2, 2, 60), eop_set=20),
    "look": lambda: with_options(measured_twice(grid(2, 2, 60), 5), eop_set=10, look_polynomial=2),
    "fixed": lambda: with_options(fixed_control(gapped(grid(2, 3, 60), 2), 6), eop_set=15),
    "RPC": lambda: rpc_twin("affine").block,
    "mixed": lambda: with_options(mixed("shift_drift"), eop_set=15),
}


@pytest.mark.oracle
@pytest.mark.parametrize("name", BLOCKS)
@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_solutions_equal_those_of_the_graph_and_the_dense_backend(name: str, optimizer: str) -> None:
    """Schur, graph and dense end at one solution for all optimisers, and numpy has no step left.

    Limits are 1e-9 prior sigma, 1e-7 m and 1e-11 of chi2.
    """
    problem = compile_problem(BLOCKS[name]())
    loop, graph = OPTIMIZERS[optimizer], ExplicitBackend(problem)
    a = loop(SchurBackend(problem), problem.start, 50, tolerance=TOLERANCE)
    b = loop(graph, graph.initial(), 50, tolerance=TOLERANCE)
    assert a.converged
    image, ground = step_of_numpy(problem, a.state)
    assert image <= 1e-9
    assert ground <= 1e-7
    assert a.error == pytest.approx(b.error, rel=1e-11)
    image, ground = largest(problem, a.state, graph.state(b.state))
    assert image <= 1e-9
    assert ground <= 1e-7
    c = loop(SchurBackend(problem, reduced="graph"), problem.start, 50, tolerance=TOLERANCE)
    d = loop(DenseBackend(problem), problem.start, 50, tolerance=TOLERANCE)
    for other in (c, d):
        image, ground = largest(problem, a.state, other.state)
        assert image <= 1e-9
        assert ground <= 1e-7


@pytest.mark.oracle
def test_dogleg_inside_a_small_region_equals_the_one_by_numpy() -> None:
    """Dogleg steps equal numpy's: steepest descent alone, the blend, and the whole Gauss-Newton step."""
    problem = compile_problem(with_options(fixed_control(grid(2, 2, 40), 2), eop_set=15))
    state = moved(problem, 4)
    v, design = assemble(problem, state)
    backend = SchurBackend(problem)
    system = backend.linearise(state)
    newton = system.solve(0.0).norm
    image, ground = system.steepest()
    shortest = float(np.sqrt(np.sum(image**2) + np.sum(ground**2)))
    assert shortest < 0.5 * newton
    for radius in (0.5 * shortest, 0.5 * (shortest + newton), 2.0 * newton):
        found, expected = system.dogleg(radius), dogleg_of_numpy(problem, v, design, radius)
        assert min(radius, newton) == pytest.approx(found.norm, rel=1e-9)
        after = stepped(problem, state, expected)
        assert max(largest(problem, backend.retract(state, found), after)) < 1e-8 * newton
        assert found.predicted_error == pytest.approx(0.5 * np.sum((v + design @ expected) ** 2), rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("reduced", ["dense", "banded", "graph", "iterative", "implicit"])
@pytest.mark.parametrize("name", BLOCKS)
def test_cofactors_equal_the_dense_inverse(name: str, reduced: str) -> None:
    """Cofactors of images, points and joint blocks in any order equal numpy's inverse of J^T J."""
    problem = compile_problem(BLOCKS[name]())
    backend = SchurBackend(problem, reduced=reduced)
    state = OPTIMIZERS["gauss-newton"](backend, problem.start, 50).state
    found = ReducedCofactors(problem, backend.linearise(state))
    backend.linearise(problem.start)  # takes the arrays away: they must be made again
    _, design = assemble(problem, state)
    q = np.linalg.inv(design.T @ design)
    scale = np.sqrt(np.diag(q))

    def assert_block(block: np.ndarray, slices: list[slice]) -> None:
        index = np.concatenate([np.arange(s.start, s.stop) for s in slices])
        assert block.shape == (len(index), len(index))
        error = (block - q[np.ix_(index, index)]) / np.outer(scale[index], scale[index])
        assert np.abs(error).max() < 1e-7

    for k in range(problem.n_images):
        assert_block(found.image(k), [problem.image_slice(k)])
    active = [int(j) for j in np.flatnonzero(problem.active)]
    for j in active:
        assert_block(found.point(j), [problem.point_slice(j)])
    some = (active[3], active[-1], active[0])
    assert_block(
        found.joint((1, 0), some),
        [problem.image_slice(1), problem.image_slice(0), *(problem.point_slice(j) for j in some)],
    )
    assert_block(found.joint((), some), [problem.point_slice(j) for j in some])
    for j in np.flatnonzero(~problem.active)[:1]:
        assert not found.point(int(j)).any()


@pytest.mark.oracle
@pytest.mark.parametrize("reduced", ["dense", "banded", "graph", "iterative"])
@pytest.mark.parametrize("strip", [False, True])
def test_selected_blocks_equal_the_dense_inverse(strip: bool, reduced: str) -> None:
    """Blocks of the inverse for all image pairs with common points equal numpy's inverse.

    Blocks are a strip of 30 images, and images of different sizes.
    """
    block = pinhole_block(30, 300, columns=30)[0] if strip else with_options(mixed_size(), eop_set=15)
    problem = compile_problem(block)
    blocks, _ = SchurBackend(problem, reduced="blocks").linearise(problem.start).partial(0.0)
    pattern, first = pattern_with_blocks(problem), problem.first
    q = np.linalg.inv(schur_reduced.full_matrix(pattern, first, blocks, None) + np.eye(first[-1]))
    scale = np.sqrt(np.diag(q))
    system = reduced_systems.ReducedSystems(pattern, first, reduced)(blocks, 1.0)
    rng = np.random.default_rng(0)
    pairs = rng.permutation(np.column_stack(pattern.blocks))
    found = system.selected(pairs)
    assert system.selects
    for (i, j), one in zip(pairs.tolist(), found, strict=True):
        rows, columns = slice(first[i], first[i + 1]), slice(first[j], first[j + 1])
        expected, n, m = q[rows, columns], pattern.size[i], pattern.size[j]
        assert np.abs((one[:n, :m] - expected) / np.outer(scale[rows], scale[columns])).max() < 1e-9
        assert not one[n:].any() and not one[:, m:].any()


@pytest.fixture
def tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set tiles of a few chunks, some of which are kept and some computed again."""
    for name, value in (("TILE", 1200), ("ALL_KEPT", 0), ("KEPT_SHARE", 0.4)):
        monkeypatch.setattr(schur_structure, name, value)


@pytest.mark.consistency
@pytest.mark.parametrize("divided", [False, True])
def test_same_bits_for_one_and_two_threads(divided: bool, request: pytest.FixtureRequest) -> None:
    """Adjustments with one, two and three threads have the same bits for each reduced solver."""
    if divided:
        request.getfixturevalue("tiles")
    problem = compile_problem(with_options(mixed_size(), eop_set=20))
    structure = SchurBackend(problem).structure
    assert np.diff(structure.block_begin).max() > 4
    assert {tile.kept for tile in structure.tiles} == ({True, False} if divided else {True})
    for reduced in ("dense", "banded", "graph", "iterative", "implicit"):
        ends = []
        for threads in (1, 2, 3):
            backend = SchurBackend(problem, threads=threads, reduced=reduced)
            assert backend.workers.threads == threads
            result = OPTIMIZERS["levenberg-marquardt"](backend, problem.start, 50)
            ends.append((result.error, result.state.image.tobytes(), result.state.ground.tobytes()))
        assert ends[0] == ends[1] == ends[2]


@pytest.mark.consistency
@pytest.mark.parametrize("divided", [False, True])
def test_elimination_at_once_changes_no_bits(divided: bool, request: pytest.FixtureRequest) -> None:
    """Elimination during linearisation gives the same bits of rows, system and step as elimination after it."""
    if divided:
        request.getfixturevalue("tiles")
    problem = compile_problem(with_options(mixed_size(), eop_set=20))
    ends, rows = [], []
    for threads, expected in itertools.product((1, 2), (None, 0.0)):
        backend = SchurBackend(problem, threads=threads)
        backend.last_damping = expected
        system = backend.linearise(problem.start)
        assert (system._eliminated_at == 0.0) == (expected == 0.0)
        rows.append(backend.buffers.value.tobytes())
        step = system.solve(0.0)
        ends.append((system.error, step.predicted_error, step.image.tobytes(), step.ground.tobytes()))
    assert len(set(ends)) == len(set(rows)) == 1


@pytest.mark.consistency
def test_rows_computed_again_change_no_bits(request: pytest.FixtureRequest) -> None:
    """With tiles, whose rows are computed again, states, steps, gradients and cofactors have the same bits."""
    problem = compile_problem(with_options(mixed_size(), eop_set=15))
    loss = scaled(find_loss("huber"))
    place = int(np.flatnonzero(problem.active)[7])

    def results() -> list[bytes]:
        backend = SchurBackend(problem)
        end = OPTIMIZERS["gauss-newton"](backend, problem.start, 50).state
        cofactors = ReducedCofactors(problem, backend.linearise(end))
        found = [end.image, end.ground, cofactors.point(place), *backend.linearise(moved(problem, 3)).gradient()]
        backend.robust = loss
        system = backend.linearise(moved(problem, 3))
        step = system.solve(0.3)
        found += [step.image, step.ground, *backend.squares(end)]
        tiles.append(len(backend.structure.tiles))
        return [array.tobytes() for array in found]

    tiles: list[int] = []
    whole = results()
    request.getfixturevalue("tiles")
    assert results() == whole
    assert tiles[0] == 1
    assert tiles[1] > 3


@pytest.mark.behaviour
def test_points_that_only_damping_determines(request: pytest.FixtureRequest) -> None:
    """A tie point on one ray makes a Gauss-Newton step singular, but not a damped step."""
    request.getfixturevalue("tiles")
    problem = compile_problem(with_options(grid(1, 2, 900), eop_set=2))
    o = problem.observations
    tie = next(int(j) for j in np.flatnonzero(problem.active & ~problem.observed))
    keep = (o.point != tie) | (np.arange(len(o)) == int(np.flatnonzero(o.point == tie)[0]))
    lonely = replace(problem, observations=o.take(keep), records=problem.records[keep])
    system = SchurBackend(lonely).linearise(lonely.start)
    assert system.error > 0.0
    with pytest.raises(Singular):
        system.solve(0.0)
    assert np.isfinite(system.solve(1.0).length)


def mixed_size() -> Block:
    return grid(1, 2, 2500)


@pytest.mark.consistency
def test_order_of_the_observations_does_not_matter() -> None:
    """A permuted order of the observations gives the same bits."""
    block = with_options(grid(2, 2, 60), eop_set=15)
    order = np.random.default_rng(0).permutation(len(block.observations))
    a, b = (compile_problem(x) for x in (block, replace(block, observations=block.observations.take(order))))
    start = State(b.start.image, a.start.ground)
    records = a.records[order]
    found = [SchurBackend(p).linearise(start).solve(0.0) for p in (a, replace(b, records=records, start=start))]
    assert np.array_equal(found[0].image, found[1].image)
    assert np.array_equal(found[0].ground, found[1].ground)


@pytest.mark.oracle
def test_a_system_whose_arrays_were_taken_is_made_again() -> None:
    """A system whose arrays another system used gives the same bits again, and numpy's damped step."""
    problem = compile_problem(with_options(grid(2, 2, 60), eop_set=15))
    backend = SchurBackend(problem)
    first = backend.linearise(problem.start)
    expected = backend.linearise(problem.start).solve(0.5)
    backend.linearise(moved(problem, 1)).solve(0.5)
    found = first.solve(0.5)
    assert np.array_equal(found.image, expected.image)
    numpys = damped_of_numpy(problem, *assemble(problem, problem.start), 0.5)
    after = stepped(problem, problem.start, numpys)
    assert max(largest(problem, backend.retract(problem.start, found), after)) < 1e-8 * np.linalg.norm(numpys)


@pytest.mark.behaviour
@pytest.mark.parametrize("backend", [SchurBackend, ExplicitBackend])
def test_memory_of_a_backend_goes_with_it(backend: Callable[[Problem], SchurBackend | ExplicitBackend]) -> None:
    problem = compile_problem(grid(2, 2, 30))
    made = backend(problem)
    gone = weakref.ref(made)
    gc.collect()
    gc.disable()  # as while an adjustment runs
    try:
        OPTIMIZERS["gauss-newton"](made, made.initial(), 20, None)
        del made
        assert gone() is None
    finally:
        gc.enable()


@pytest.mark.behaviour
def test_workers_cover_the_range_once() -> None:
    for threads in (1, 2, 5):
        parts = Workers(threads).run(lambda lo, hi, shift: (lo + shift, hi + shift), 7, 1)
        assert [lo for lo, _ in parts] == [1, *(hi for _, hi in parts[:-1])]
        assert parts[-1][1] == 8
        costly = Workers(threads).run(lambda lo, hi: (lo, hi), np.array([0, 100, 101, 101]))
        assert [lo for lo, _ in costly] == [0, *(hi for _, hi in costly[:-1])]
        assert costly[-1][1] == 3


def pattern_of(images: int, pairs: list[tuple[int, int]], unknowns: int = 9) -> Pattern:
    """Return the pattern of images with so many unknowns, linked in pairs."""
    row, column = np.array([*((k, k) for k in range(images)), *sorted(pairs)]).T
    return Pattern(np.full(images, unknowns), row, column)


def choice(pattern: Pattern) -> str:
    first = np.concatenate([[0], np.cumsum(pattern.size)])
    return reduced_choice.choose(pattern, reduced_choice.narrowest(pattern, first).band).kind


@pytest.mark.behaviour
def test_reduced_systems_are_solved_by_what_suits_them() -> None:
    """A strip is solved by its band, a full system by a full factor, a wide one by conjugate gradients.

    A star of images is solved by the graph.
    """
    every = [(i, j) for i in range(200) for j in range(i + 1, 200)]
    assert choice(pattern_of(200, every)) == "dense"
    assert choice(pattern_of(2000, [(k, k + 1) for k in range(1999)])) == "banded"
    rng = np.random.default_rng(0)
    mixed = {tuple(sorted(pair)) for pair in rng.integers(0, 700, (200_000, 2)).tolist() if pair[0] != pair[1]}
    assert choice(pattern_of(700, list(mixed), 12)) == "iterative"
    star = [(0, k) for k in range(1, 300)]  # each image shares points with one: no narrow band, no fill
    assert choice(pattern_of(300, star)) == "graph"


@pytest.mark.oracle
@pytest.mark.parametrize(("images", "share"), [(1, 0.0), (9, 0.3), (70, 0.05), (130, 0.02), (65, 1.0), (40, 0.0)])
def test_degrees_of_the_elimination_are_those_of_sets(images: int, share: float) -> None:
    """The degrees of the elimination equal those of an elimination with sets of neighbours, for random links."""
    rng = np.random.default_rng(images)
    pairs = [(i, j) for i in range(images) for j in range(i + 1, images) if rng.random() < share]
    near = {k: {j for pair in pairs for j in pair if k in pair and j != k} for k in range(images)}
    expected = []
    while near:
        k = min(near, key=lambda k: (len(near[k]), k))
        expected.append(len(near[k]))
        own = near.pop(k)
        for j in own:
            near[j] = (near[j] | own) - {j, k}
    assert reduced_choice.elimination_degrees(pattern_of(images, pairs)).tolist() == expected


@pytest.mark.oracle
def test_conjugate_gradients_step_as_a_factor_does() -> None:
    """Conjugate gradients give the step and solution of a full factor, and too few steps are refused.

    The error of a step is measured in the norm of the matrix. The loop ends at a tolerance at which the last step of
    the full factor has no effect either.
    """
    problem = compile_problem(with_options(mixed_size(), eop_set=15))
    state, first = problem.start, problem.first
    for damping in (0.0, 0.3):
        system = SchurBackend(problem, reduced="dense").linearise(state)
        (blocks, gradient), pattern = system.partial(damping), system.structure.pattern
        matrix = schur_reduced.full_matrix(pattern, first, blocks, None) + (1.0 + damping) * np.eye(first[-1])
        exact = -np.linalg.solve(matrix, gradient)
        found = iterative_reduced.IterativeReduced(pattern, first, blocks, 1.0 + damping).solve(gradient)
        assert np.abs(found - exact).max() < 1e-7 * np.abs(exact).max()
        for kind in ("iterative", "implicit"):
            step = SchurBackend(problem, reduced=kind).linearise(state).solve(damping)
            error = step.image - exact
            assert 0.0 < error @ matrix @ error < iterative_reduced.LARGEST_ERROR**2 * (exact @ matrix @ exact)
    ends = [OPTIMIZERS["gauss-newton"](SchurBackend(problem, reduced=kind), state, 50, tolerance=TOLERANCE)
            for kind in ("dense", "iterative", "implicit")]  # fmt: skip
    for end in ends[1:]:
        assert np.abs(end.state.image - ends[0].state.image).max() < 1e-9
        assert end.error == pytest.approx(ends[0].error, rel=1e-12)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Singular, match="do not converge in 3 steps"):
        patch.setattr(iterative_reduced, "MOST_STEPS", 3)
        SchurBackend(problem, reduced="iterative").linearise(state).solve(0.0)


@pytest.mark.oracle
@pytest.mark.parametrize("set_of_unknowns", [5, 20])
def test_products_without_the_matrix_are_those_of_the_matrix(set_of_unknowns: int, tiles: None) -> None:
    """Products without the reduced matrix equal those with it within 1e-12, damped and not.

    The block has images of different sizes, control and constant points, and more tiles than one.
    """
    problem = compile_problem(with_options(mixed_size(), eop_set=set_of_unknowns))
    rng = np.random.default_rng(0)
    for damping in (0.0, 0.3):
        system = SchurBackend(problem, reduced="implicit", threads=2).linearise(problem.start)
        blocks, _ = SchurBackend(problem, reduced="dense").linearise(problem.start).partial(damping)
        matrix = schur_reduced.full_matrix(pattern_with_blocks(problem), problem.first, blocks, None)
        x = rng.standard_normal(problem.n_image_unknowns)
        rows, out = problem.image_matrix(x), np.full((problem.n_images, problem.columns.shape[1]), np.nan)
        ImplicitProduct(system, damping).multiply(rows, out)
        expected = problem.image_matrix(matrix @ x)
        assert np.abs(out - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.consistency
def test_a_wide_network_is_adjusted_without_its_matrix_as_with_it() -> None:
    """A wide network solved without its matrix has the same bits for any threads, and the solution with it.

    Each point is in four of 100 images, drawn at random.
    """
    problem = compile_problem(pinhole_block(100, 1500, mixed=True)[0])
    ends = []
    for threads, reduced in ((1, "implicit"), (2, "implicit"), (3, "implicit"), (2, "dense")):
        backend = SchurBackend(problem, threads, reduced)
        ends.append(OPTIMIZERS["gauss-newton"](backend, problem.start, 50, tolerance=TOLERANCE).state)
    for end in ends[1:3]:
        assert (end.image.tobytes(), end.ground.tobytes()) == (ends[0].image.tobytes(), ends[0].ground.tobytes())
    assert np.abs(ends[3].image - ends[0].image).max() < 1e-9


@pytest.mark.behaviour
def test_a_wide_network_is_chosen_to_be_solved_without_its_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    """A network with many unknowns is solved without its matrix, unless the caller needs the blocks.

    The links are those of the image points.
    """
    monkeypatch.setattr(schur, "ITERATIVE", 800)
    monkeypatch.setattr(reduced_choice, "ITERATIVE", 800)
    problem = compile_problem(pinhole_block(100, 500, mixed=True)[0])
    chosen, forming = SchurBackend(problem), SchurBackend(problem, reduced="blocks")
    assert chosen.implicit
    assert (chosen.reduced.kind, chosen.reduced.choice) == ("implicit", reduced_choice.choice_of(problem))
    assert not forming.implicit
    assert forming.reduced.kind != "implicit"
    pattern, formed = reduced_choice.pattern_of(problem), forming.structure.pattern
    assert set(zip(*map(np.ndarray.tolist, pattern.blocks), strict=True)) == set(
        zip(*map(np.ndarray.tolist, formed.blocks), strict=True)
    )
    assert (pattern.rays, formed.rays) == (len(problem.observations), 0)


def pattern_with_blocks(problem: Problem) -> Pattern:
    """Return the blocks of the reduced system in the order of a backend that forms them."""
    return SchurBackend(problem, reduced="blocks").structure.pattern


@pytest.mark.oracle
def test_a_strip_of_images_has_a_narrow_band_in_any_order() -> None:
    """A strip in any order of images has a narrow band, with numpy's solution, covariance and condition."""
    rng = np.random.default_rng(0)
    size = np.array([9, 6, 12, 9, 3, 9, 9, 12])
    names = rng.permutation(len(size))
    row = np.concatenate([np.arange(len(size)), np.minimum(names[:-1], names[1:])])
    column = np.concatenate([np.arange(len(size)), np.maximum(names[:-1], names[1:])])
    first = np.concatenate([[0], np.cumsum(size)])
    root = np.zeros((len(row), 12, 12))
    full = np.zeros((first[-1], first[-1]))
    for b, (i, j) in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
        block = rng.normal(size=(size[i], size[j]))
        root[b, : size[i], : size[j]] = block if i != j else block + block.T + 60.0 * np.eye(size[i])
        full[first[i] : first[i + 1], first[j] : first[j + 1]] = root[b, : size[i], : size[j]]
        full[first[j] : first[j + 1], first[i] : first[i + 1]] = root[b, : size[i], : size[j]].T
    pattern = Pattern(size, row, column)
    systems = reduced_systems.ReducedSystems(pattern, first)
    assert systems.kind == "banded"
    assert reduced_choice.narrowest(pattern, first).band <= 23
    reduced, right = systems(root, 2.0), rng.normal(size=first[-1])
    full += 2.0 * np.eye(len(full))
    assert reduced.solve(right) == pytest.approx(-np.linalg.solve(full, right), rel=1e-10, abs=1e-12)
    index = np.concatenate([np.arange(first[k], first[k + 1]) for k in (5, 2)])
    assert reduced.covariance((5, 2)) == pytest.approx(np.linalg.inv(full)[np.ix_(index, index)], rel=1e-9, abs=1e-14)
    scaled = full / np.sqrt(np.outer(np.diag(full), np.diag(full)))
    assert isinstance(reduced, schur_reduced.LapackReduced)
    assert 0.3 * np.linalg.cond(scaled, 1) <= reduced.condition() <= 1.0001 * np.linalg.cond(scaled, 1)


@pytest.mark.behaviour
def test_sums_of_chunks_stay_small_where_neighbours_share_no_images() -> None:
    """Sums of chunks keep their memory limit if each chunk has nearly all blocks of images.

    10 of 60 images see a point, drawn at random.
    """
    rng, rays, images, numbers = np.random.default_rng(0), 10, 60, 27**2
    image = np.concatenate([np.sort(rng.choice(images, rays, replace=False)) for _ in range(4000)]).astype(np.int32)
    first, free = np.arange(4001, dtype=np.int32) * np.int32(rays), np.ones(4000, np.int8)
    pieces, chunks, _ = schur_structure._chunks(first, image, free, 0 * free, images, numbers, diagonal=False)
    cut = [set(image[pieces[lo, 0] : pieces[hi - 1, 0] + rays].tolist()) for lo, hi in itertools.pairwise(chunks)]
    assert all(len(seen) == images for seen in cut[:-1])
    many = len(cut) * images * (images + 1) / 2 * numbers * 8
    assert 0.9 * many <= max(schur_structure.SUMS * len(image), schur_structure.LEAST_SUMS) or len(cut) <= 4
    assert len(cut) < len(image) // schur_structure.LEAST_CHUNK, "as many as a block of strips would have"


@pytest.mark.behaviour
def test_threads_are_those_that_pay_of_the_processors_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    for image_points, available, threads in (
        (0, 8, 1), (1999, 8, 1), (2000, 8, 2), (2000, 1, 1), (11_999, 8, 3), (12_000, 8, 4), (12_000, 3, 3),
        (1_000_000, 64, 32),
    ):  # fmt: skip
        monkeypatch.setattr(runtime, "processors", lambda n=available: n)
        assert runtime.threads_for(image_points) == threads
    monkeypatch.undo()
    assert 1 <= runtime.processors() <= (os.cpu_count() or 1)


@pytest.mark.consistency
@pytest.mark.parametrize("reduced", ["dense", "banded"])
def test_large_factors_agree_for_any_number_of_threads(reduced: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Step and covariance of a large factor agree within 1e-9 for one, two and three threads of BLAS."""
    monkeypatch.setattr(schur_reduced, "THREADED", 100)
    problem, found = compile_problem(pinhole_block(30, 500)[0]), []
    system = SchurBackend(problem, reduced="blocks").linearise(problem.start)
    (blocks, gradient), pattern = system.partial(0.0), system.structure.pattern
    for threads in (1, 2, 3):
        one = reduced_systems.ReducedSystems(pattern, problem.first, reduced, threads=threads)(blocks, 1.0)
        found.append((one.solve(gradient), one.covariance(tuple(range(problem.n_images)))))
    for step, covariance in found[1:]:
        assert np.abs(step - found[0][0]).max() < 1e-9
        assert np.abs(covariance - found[0][1]).max() < 1e-9


@pytest.mark.behaviour
def test_an_interrupt_leaves_no_result_for_the_next_call() -> None:
    def stop(lo: int, hi: int) -> int:
        if lo == 0:
            raise KeyboardInterrupt
        return -1

    workers = Workers(3)
    with pytest.raises(KeyboardInterrupt):
        workers.run(stop, 9)
    assert workers.run(lambda lo, hi: lo, 9) == [0, 3, 6]


@pytest.mark.behaviour
def test_a_failure_in_any_thread_is_raised() -> None:
    def fail(lo: int, hi: int) -> int:
        if hi == 4:
            raise MemoryError("no room")
        return lo

    for threads in (1, 2):
        with pytest.raises(MemoryError, match="no room"):
            Workers(threads).run(fail, 4)


@pytest.mark.behaviour
def test_auto_falls_back_on_the_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the Schur complement fails, ``auto`` uses the graph, and a Schur backend asked for by name reports the error.

    QR may succeed there.
    """

    def give_up(*_: object) -> None:
        raise Singular("not positive definite")

    block = grid(2, 2, 60)
    monkeypatch.setattr(reduced_systems, "LapackReduced", give_up)
    estimate = solve(compile_problem(block))
    assert (estimate.backend, estimate.converged) == ("graph", True)
    with pytest.raises(fg.NoSolutionError) as caught:
        solve(compile_problem(with_options(block, backend="schur")))
    assert caught.value.problems[0].code == "adjust.broken_down"


@pytest.mark.oracle
def test_resection_on_fixed_points_alone() -> None:
    """With fixed points only, so that no ground point is unknown, the Schur step equals that of the dense rows."""
    block = grid(2, 2, 60)
    control = block.points.where(Role.CONTROL)
    rows = np.isin(block.observations.point, control)
    only = fixed_control(replace(block, observations=block.observations.take(rows)), len(control))
    problem = compile_problem(with_options(only, eop_set=2))
    assert not problem.active.any()
    assert_same_step(problem, moved(problem, 5), 0.0)


@pytest.mark.behaviour
def test_auto_takes_what_the_block_asks_for() -> None:
    block = grid(2, 2, 60)
    assert suitable_backend(block) == "graph"
    assert suitable_backend(with_options(block, priors=False, datum="free")) == "schur"
    assert suitable_backend(with_options(block, backend="dense")) == "dense"
    assert suitable_backend(with_own_observation(block)) == "graph"
    control = np.isin(block.observations.point, block.points.where(Role.CONTROL))
    points = block.points.where(Role.CONTROL)
    resections = fixed_control(replace(block, observations=block.observations.take(control)), len(points))
    assert suitable_backend(resections) == "graph"


def with_own_observation(block: Block) -> Block:
    record = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    name = f"point:{block.points.ids[int(block.points.where(Role.CONTROL)[0])]}"
    return replace(block, extra=(ExtraObservation(CONTROL_POINT, (name,), record, np.zeros((2, 0)), 3, "own"),))


@pytest.mark.behaviour
def test_blocks_for_other_backends_are_refused() -> None:
    with pytest.raises(fg.InputError) as caught:
        SchurBackend(compile_problem(with_own_observation(grid(2, 2, 60))))
    assert caught.value.problems[0].code == "adjust.schur"
    with pytest.raises(ValueError, match="reduced"):
        SchurBackend(compile_problem(grid(2, 2, 60)), reduced="sparse")


@pytest.mark.oracle
def test_whole_adjustment_equals_the_graph_and_the_full_matrix() -> None:
    """``adjust`` with Schur has status, statistics, residuals and covariance of the graph and the full matrix."""
    block = grid(2, 2, 60)
    a, b = (fg.adjust(block, eop_set=20, backend=name) for name in ("schur", "graph"))
    assert (a.backend, a.solver, a.status) == ("schur", "", b.status)
    assert a.chi2 == pytest.approx(b.chi2, rel=1e-10)
    assert a.residuals_px == pytest.approx(b.residuals_px, abs=1e-7)
    assert a.accuracy.check.predicted_sigma_enu_m == pytest.approx(b.accuracy.check.predicted_sigma_enu_m, rel=1e-7)
    image = block.images[2].id
    full = Full.of(a.problem, a.state)
    columns, sigma = full.problem.image_slice(2), a.sigma0 * a.problem.parameters[2].sigma
    expected = full.unknowns[columns, columns] * np.outer(sigma, sigma)
    scale = np.sqrt(np.diag(expected))  # metres and radians
    for solution in (a, b):
        values = solution.covariance(f"image:{image}").values
        assert np.abs((values - expected) / np.outer(scale, scale)).max() <= 1e-5
    assert (a.warnings, a.unobservable) == (b.warnings, b.unobservable)


@pytest.mark.oracle
def test_without_priors_a_well_posed_block_is_solved() -> None:
    block = with_options(grid(2, 2, 200), eop_set=2, priors=False)
    problem = compile_problem(block)
    a = OPTIMIZERS["gauss-newton"](SchurBackend(problem), problem.start, 50)
    assert a.converged
    image, ground = step_of_numpy(problem, a.state)
    assert image < 1e-6
    assert ground < 1e-4


@pytest.mark.behaviour
@pytest.mark.parametrize("reduced", ["dense", "banded", "graph"])
def test_singular_systems_are_refused(reduced: str) -> None:
    """A system that priors alone determine is refused without priors, for step and covariance.

    Velocity has no effect along the track.
    """
    problem = compile_problem(with_options(grid(2, 2, 60), eop_set=20, priors=False))
    backend = SchurBackend(problem, reduced=reduced)
    with pytest.raises(RuntimeError, match=r"not positive definite|singular|Indeterminate"):
        backend.linearise(problem.start).solve(0.0)
    with pytest.raises(RuntimeError, match=r"not positive definite|singular|Indeterminate"):
        ReducedCofactors(problem, backend.linearise(problem.start))


@pytest.mark.behaviour
def test_covariance_of_an_ill_conditioned_system_is_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    from fg_orient.quality.covariance import Indeterminate

    estimate = solve(compile_problem(with_options(grid(2, 2, 60), eop_set=15, backend="schur")))
    assert isinstance(estimate.linear, SchurSystem)
    problem = estimate.linear._backend.problem
    cofactors_of(problem, estimate)
    monkeypatch.setattr("fg_orient.adjustment.schur_reduced.CONDITION_LIMIT", 1.0)
    with pytest.raises(Indeterminate, match="condition"):
        cofactors_of(problem, estimate)


@pytest.mark.oracle
def test_an_ill_conditioned_system_is_reported_by_all_backends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each backend has the condition of numpy's reduced system, and warns above the limit with the same sentence."""
    block = grid(2, 2, 60)
    problem = compile_problem(with_options(block, eop_set=15))
    estimates = [
        solve(compile_problem(with_options(block, eop_set=15, backend=b))) for b in ("schur", "graph", "dense")
    ]
    _, design = assemble(problem, estimates[0].state)
    normal, u = design.T @ design, problem.n_image_unknowns
    reduced = normal[:u, :u] - normal[:u, u:] @ np.linalg.solve(normal[u:, u:], normal[u:, :u])
    expected = np.linalg.cond(reduced / np.sqrt(np.outer(np.diag(reduced), np.diag(reduced))), 1)
    for estimate in estimates:
        found = conditioning.condition(problem, estimate)
        assert found is not None
        assert 0.3 * expected <= found <= 1.001 * expected
        assert not conditioning.findings(problem, estimate)
    monkeypatch.setattr(conditioning, "ILL_CONDITIONED", 0.2 * expected)
    said = {fg.adjust(block, eop_set=15, backend=name).warnings[0] for name in ("schur", "graph", "dense")}
    assert len(said) == 1
    assert "ill-conditioned" in said.pop()
    hidden = compile_problem(with_options(block, eop_set=20, priors=False))
    assert (conditioning.condition(hidden, replace(estimates[2], state=hidden.start)) or 0.0) > 1e13


@pytest.mark.behaviour
def test_a_point_on_one_ray_is_named() -> None:
    """A tie point on one ray makes the system singular, and the error names the point."""
    problem = compile_problem(with_options(grid(1, 2, 24), eop_set=2))
    tie = next(int(j) for j in np.flatnonzero(problem.active & ~problem.observed))
    row = int(np.flatnonzero(problem.observations.point == tie)[0])
    keep = (problem.observations.point != tie) | (np.arange(len(problem.observations)) == row)
    lonely = replace(problem, observations=problem.observations.take(keep), records=problem.records[keep])
    with pytest.raises(Singular, match=f"point {problem.block.points.ids[tie]} "):
        SchurBackend(lonely).linearise(lonely.start).solve(0.0)


@pytest.mark.behaviour
def test_values_that_are_not_finite_name_the_image_point() -> None:
    problem = compile_problem(with_options(grid(1, 2, 24), eop_set=2))
    records = problem.records.copy()
    records[7, 0] = np.nan
    broken = replace(problem, records=records)
    label = broken.label(7)
    with pytest.raises(NotFiniteError, match=label):
        SchurBackend(broken).linearise(broken.start)
    with pytest.raises(fg.NoSolutionError) as caught:
        solve(replace(broken, block=with_options(broken.block, backend="schur")))
    assert caught.value.problems[0].code == "adjust.broken_down"
    assert label in str(caught.value)


@pytest.mark.oracle
def test_an_image_without_points_keeps_its_priors() -> None:
    """An image without image points has zero corrections and the cofactors of its priors."""
    block = with_options(grid(1, 2, 24), eop_set=2)
    problem = compile_problem(replace(block, images=(*block.images, Image("idle", block.images[0].sensor))))
    for reduced in ("dense", "banded", "graph"):
        backend = SchurBackend(problem, reduced=reduced)
        system = backend.linearise(problem.start)
        step = system.solve(0.0)
        assert not step.image[problem.first[2] :].any()
        assert np.allclose(ReducedCofactors(problem, system).image(2), np.eye(len(problem.parameters[2])))
