"""Points eliminated inside factors are compared with the explicit graph, cost differences and LAPACK."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_orient.adjustment import point_groups, reduced_graph, schur_structure
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.eliminated import IMPOSSIBLE, Elimination
from fg_orient.adjustment.graph import GraphBackend
from fg_orient.adjustment.point_groups import GroupRows
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.reduced_graph import cover
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.model.block import Block
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.mixed import MixedOptions, mixed_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.pinhole import pinhole_block
from tests.support.rpc_block import rpc_twin


@lru_cache
def block_of(kind: str) -> Block:
    if kind == "twin":
        return zonguldak_block(ZonguldakOptions(seed=1))[0]
    if kind == "grid":
        return grid_block(BlockOptions(rows=3, columns=3, points=90, seed=3))[0]
    if kind == "rpc":
        return rpc_twin("affine").block
    if kind == "mixed":
        return mixed_block(MixedOptions(seed=3, points=40))[0]
    return pinhole_block(4, 25, views=3, seed=2)[0]


KINDS = ("twin", "grid", "rpc", "mixed", "frames")


@lru_cache
def problem_of(kind: str) -> Problem:
    return compile_problem(block_of(kind))


def away(problem: Problem, seed: int, size: float = 0.3) -> np.ndarray:
    """Return the image unknowns that are not those of the solution."""
    return np.random.default_rng(seed).normal(scale=size, size=problem.n_free_unknowns)


def values_at(backend: GraphBackend, free: np.ndarray) -> gtsam.Values:
    values = backend.values(backend.problem.start)
    for key, part in backend._vectors:
        values.update(key, free[part])
    return values


def reduced_of_dense(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the normal equations of images after elimination of the points, without priors, and the error.

    They are numpy's, from all rows.
    """
    without = replace(problem, block=replace(problem.block, options=replace(problem.block.options, priors=False)))
    residual, design = assemble(without, state)
    design, u = design if problem.ties is None else problem.ties.columns(design), problem.n_free_unknowns
    image, ground = design[:, :u], design[:, u:]
    q, _ = np.linalg.qr(ground / np.linalg.norm(ground, axis=0))
    image, rest = image - q @ (q.T @ image), residual - q @ (q.T @ residual)
    return image.T @ image, image.T @ rest, 0.5 * float(rest @ rest)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_factors_are_the_explicit_graph_with_its_points_eliminated(kind: str) -> None:
    """Factors with eliminated points have matrix, gradient and cost of numpy's reduced system within 1e-9."""
    problem = problem_of(kind)
    backend = GraphBackend(problem)
    values = values_at(backend, away(problem, 5))
    linear = gtsam.NonlinearFactorGraph()
    for g in range(backend.graph.size() - backend.others.size()):
        linear.push_back(backend.graph.at(g))
    error = linear.error(values)
    jacobian, right = linear.linearize(values).jacobian(backend_ordering(backend))
    matrix, gradient, cost = reduced_of_dense(problem, backend.state(values, complete=True))
    scale = np.sqrt(np.diag(matrix))
    assert np.abs((jacobian.T @ jacobian - matrix) / np.outer(scale, scale)).max() <= 1e-9
    assert np.abs((-jacobian.T @ right - gradient) / scale).max() <= 1e-9 * np.sqrt(2.0 * cost)
    assert error == pytest.approx(cost, rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("joined", [True, False])
@pytest.mark.parametrize("grouped", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_of_an_iteration_is_that_of_all_groups(
    kind: str, grouped: bool, joined: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The graph of an iteration has numpy's reduced matrix, gradient and cost, and the right cost elsewhere.

    Images are variables of their own, or joined to one.
    """
    problem = problem_of(kind)
    monkeypatch.setattr(reduced_graph, "JOINED_SIZE", 10_000 if joined else 0)
    backend = GraphBackend(problem, grouped=grouped)
    others, sums = backend.others, backend.sums
    assert sums.is_joined == (joined and not problem.block.extra)
    values = values_at(backend, away(problem, 5))
    linear = backend.linearised(values)
    matrix, gradient, cost = reduced_of_dense(problem, backend.state(values, complete=True))
    ordering = gtsam.Ordering()
    for key, _ in sums.variables:
        ordering.push_back(key)
    normal, right = linear.graph.linearize(linear.values).hessian(ordering)
    own, own_right = others.linearize(values).hessian(backend_ordering(backend))  # of a joined graph they are part
    scale = np.sqrt(np.diag(matrix))
    assert np.abs((normal - own - matrix) / np.outer(scale, scale)).max() <= 1e-9
    assert np.abs((own_right - right - gradient) / scale).max() <= 1e-9 * np.sqrt(2.0 * cost)
    assert linear.graph.error(linear.values) - others.error(values) == pytest.approx(cost, rel=1e-9)
    there = values_at(backend, away(problem, 6))
    free = backend.free(there)
    expected = reduced_of_dense(problem, backend_state(backend, there))[2]
    moved = gtsam.Values()
    for key, part in sums.variables:
        moved.insert(key, free[part])
    assert linear.graph.error(moved) - others.error(there) == pytest.approx(expected, rel=1e-9)
    assert np.array_equal(backend.free(linear.of_images(moved)), free)


@pytest.mark.oracle
def test_each_pair_is_in_one_factor_of_three() -> None:
    for n, share in ((1, 1.0), (7, 1.0), (12, 0.5), (20, 0.2)):
        rng = np.random.default_rng(n)
        pairs = [(a, b) for a in range(n) for b in range(a + 1, n) if rng.uniform() < share]
        sets = cover(pairs)
        held = [pair for own in sets for pair in combinations(own, 2) if pair in set(pairs)]
        assert sorted(held) == sorted(pairs)
        assert all(list(own) == sorted(set(own)) and len(own) in (2, 3) for own in sets)
    assert len(cover([(a, b) for a in range(7) for b in range(a + 1, 7)])) == 7  # the Fano plane


def backend_state(backend: GraphBackend, values: gtsam.Values) -> State:
    """Return the state of values with the points intersected there."""
    backend.graph.error(values)
    return backend.state(values, complete=True)


def backend_ordering(backend: GraphBackend) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key, _ in backend._vectors:
        ordering.push_back(key)
    return ordering


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_gradient_is_that_of_the_scalar_cost(kind: str) -> None:
    """The gradient ``J^T e`` of all groups equals central differences of the cost in random directions."""
    problem = problem_of(kind)
    backend, free = GraphBackend(problem), away(problem, 7, 0.05)
    rng = np.random.default_rng(1)
    values = values_at(backend, free)
    others = backend.others
    linear = backend.graph.linearize(values).gradientAtZero()
    gradient = np.concatenate([linear.at(key) for key, _ in backend._vectors])
    prior = others.linearize(values).gradientAtZero()
    gradient -= np.concatenate([prior.at(key) for key, _ in backend._vectors])
    for _ in range(3):
        direction = rng.normal(size=len(free))
        direction /= np.linalg.norm(direction)
        costs = []
        for step in (1e-4, -1e-4, 2e-4, -2e-4):
            at = values_at(backend, free + step * direction)
            costs.append(backend.graph.error(at) - others.error(at))
        central = (8.0 * (costs[0] - costs[1]) - (costs[2] - costs[3])) / 12e-4
        assert central == pytest.approx(gradient @ direction, rel=1e-8, abs=1e-8 * np.linalg.norm(gradient))


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_longest_step_of_one_unknown_is_that_of_numpy(kind: str) -> None:
    """The longest step of a single unknown equals numpy's from gradient and diagonal of the reduced system.

    It decides the end if an optimiser refuses every step.
    """
    problem = problem_of(kind)
    backend, free = GraphBackend(problem), away(problem, 9, 0.1)
    values = values_at(backend, free)
    found = backend.linearised(values).steepest()
    matrix, gradient, _ = reduced_of_dense(problem, backend.state(values, complete=True))
    assert found == pytest.approx((np.abs(gradient + free) / np.sqrt(np.diag(matrix))).max(), rel=1e-8)


@pytest.mark.consistency
@pytest.mark.parametrize("kind", KINDS)
def test_the_error_does_not_depend_on_jacobians_order_or_threads(kind: str) -> None:
    """The error has the same bits for one and two threads, and 1e-12 of it after any earlier calls."""
    problem = problem_of(kind)
    first, second = GraphBackend(problem, threads=1), GraphBackend(problem, threads=2)
    here, there = away(problem, 1, 0.1), away(problem, 2, 0.1)
    plain = [first.graph.error(values_at(first, here)), second.graph.error(values_at(second, here))]
    assert plain[0] == plain[1]
    values = values_at(first, there)
    first.graph.linearize(values)
    for key, part in first._vectors:
        values.update(key, here[part])
    after = first.graph.error(values)  # predicted from there
    linear = first.graph.linearize(values)
    zero = gtsam.VectorValues()
    for key, part in first._vectors:
        zero.insert(key, np.zeros(part.stop - part.start))
    assert linear.error(zero) == pytest.approx(after, rel=1e-14)
    assert after == pytest.approx(plain[0], rel=1e-12)


@pytest.mark.oracle
@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(0, 12), st.sampled_from([0.0, 1e-6, 1.0]), st.integers(0, 10_000))
def test_rows_of_any_semidefinite_matrix(n: int, rank: int, unchanged: float, seed: int) -> None:
    """Rows of a group return its matrix, gradient and cost for any rank and units, also of a perfect fit."""
    rng = np.random.default_rng(seed)
    units = 10.0 ** rng.uniform(-6, 6, n)
    rows = rng.normal(size=(min(rank, n), n)) * units
    residual = rng.normal(size=len(rows))
    matrix, gradient = rows.T @ rows, rows.T @ residual
    cost = float(residual @ residual) + unchanged
    own = GroupRows(np.zeros(n), matrix.copy(), gradient, cost)
    jacobian, error = own.jacobian, own.error
    assert np.abs((jacobian.T @ jacobian - matrix) / np.outer(units, units)).max(initial=0.0) <= 1e-11
    assert np.abs((jacobian.T @ error - gradient) / units).max(initial=0.0) <= 1e-12
    assert error @ error == pytest.approx(cost, rel=1e-12)


@pytest.mark.consistency
def test_rows_computed_tile_by_tile_are_those_of_one_tile(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows computed in tiles equal those of one tile within 1e-9, although only some tiles are kept."""
    monkeypatch.setattr(point_groups, "OVERHEAD", 0)
    problem = compile_problem(grid_block(BlockOptions(rows=12, columns=1, points=300, seed=3))[0])
    free = away(problem, 3, 1.0)

    def rows() -> tuple[GroupRows, ...]:
        elimination = Elimination(problem)
        kept = [tile.kept for tile in elimination.backend.structure.tiles]
        assert len(kept) == 1 or (kept.count(True) > 1 and kept.count(False) > 1)
        assert (len(kept) == 1) == (schur_structure.TILE > 1000)
        for g, group in enumerate(elimination.groups):
            elimination.rows(g, free[group.free], lambda: free, accepted=True)
        return elimination.last_rows()

    whole = rows()
    monkeypatch.setattr(schur_structure, "TILE", 40)
    monkeypatch.setattr(schur_structure, "ALL_KEPT", 80)
    monkeypatch.setattr(schur_structure, "KEPT_SHARE", 0.6)
    for own, other in zip(whole, rows(), strict=True):
        normal = own.jacobian.T @ own.jacobian
        scale = np.sqrt(np.diag(normal))
        assert np.abs((other.jacobian.T @ other.jacobian - normal) / np.outer(scale, scale)).max() <= 1e-9
        assert other.cost == pytest.approx(own.cost, rel=1e-11)


@pytest.mark.behaviour
def test_points_that_cannot_be_intersected_cost_much_and_are_named() -> None:
    """Points that cannot be intersected give a large finite cost and are listed, until a state is possible.

    GTSAM's optimisers retreat from a finite cost, but not from an exception, nan or infinity.
    """
    problem = problem_of("frames")
    elimination = Elimination(problem)
    free = away(problem, 3, 1e4)
    elimination.start_at(np.zeros_like(free), problem.start.ground)
    rows = elimination.rows(0, free[elimination.groups[0].free], lambda: free, accepted=False)
    assert rows.cost == pytest.approx(IMPOSSIBLE)
    (why,) = elimination.impossible.values()
    assert any(f"point {name} is not determined" in why for name in problem.block.points.ids), why
    good = elimination.rows(0, 0.0 * rows.at, lambda: 0.0 * free, accepted=False)
    assert good.cost < 1e9
    assert not elimination.impossible


@pytest.mark.behaviour
def test_graph_and_arrays_are_freed_with_the_backend() -> None:
    """Deleting the backend frees the elimination without garbage collection.

    A callback that refers to the graph would keep both.
    """
    backend = GraphBackend(problem_of("grid"))
    backend.graph.error(backend.values(backend.problem.start))
    watched = weakref.ref(backend.elimination)
    gc.disable()
    try:
        del backend
        assert watched() is None
    finally:
        gc.enable()


@pytest.mark.consistency
def test_only_groups_whose_images_moved_are_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_groups, "OVERHEAD", 0)
    problem = compile_problem(grid_block(BlockOptions(rows=6, columns=1, points=90, seed=3))[0])
    elimination = Elimination(problem)
    assert len(elimination.groups) > 1
    free = away(problem, 1, 0.1)
    elimination.start_at(0.0 * free, problem.start.ground)
    computed: list[int] = []
    monkeypatch.setattr(
        elimination,
        "_evaluate",
        lambda groups, *more, own=elimination._evaluate: (computed.extend(groups), own(groups, *more)),
    )
    for g, group in enumerate(elimination.groups):
        elimination.rows(g, free[group.free], lambda: free, accepted=True)
    assert sorted(computed) == list(range(len(elimination.groups)))
    computed.clear()
    changed = free.copy()
    changed[elimination.groups[-1].free[-1]] += 1e-3
    last = [g for g, group in enumerate(elimination.groups) if elimination.groups[-1].free[-1] in group.free]
    for g, group in enumerate(elimination.groups):
        elimination.rows(g, changed[group.free], lambda: changed, accepted=True)
    assert sorted(computed) == last


@pytest.mark.oracle
def test_gradient_equals_that_of_the_schur_backend() -> None:
    """The gradient of the factors equals that of the Schur backend within 1e-12."""
    problem = problem_of("twin")
    elimination, backend = Elimination(problem), SchurBackend(problem)
    free = away(problem, 4, 0.01)
    elimination.start_at(free, problem.start.ground)
    rows = [elimination.rows(g, free[k.free], lambda: free, accepted=True) for g, k in enumerate(elimination.groups)]
    total = np.zeros(problem.n_free_unknowns)
    for own, group in zip(rows, elimination.groups, strict=True):
        total[group.free] += own.jacobian.T @ own.error
    _, gradient = backend.linearise(elimination.state(free)).partial(0.0)
    assert np.abs(total + free - gradient).max() <= 1e-12 * np.abs(gradient).max()
