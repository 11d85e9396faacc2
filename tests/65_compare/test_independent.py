"""Ten random rows of a comparison agree with computations that share no code with it."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import fg_orient as fg
from factors.arrays import Array
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.simulate.mixed import MixedOptions, mixed_block
from fg_orient.studies.comparison import reference
from fg_orient.studies.comparison.compare import compare
from fg_orient.studies.comparison.model import LARGEST_CONDITION, Comparison, Row
from fg_orient.studies.comparison.report import verdict
from fg_orient.studies.comparison.work import Limits, Sparsity, Work, dense_operations
from tests.support.pleiades_project import pleiades_project

SEED = 28


def random_rows(comparison: Comparison) -> list[Row]:
    """Return ten rows of adjustments with a solution."""
    rows = [r for r in comparison.rows if r.backend != "faithful" and not r.failure]
    chosen = np.random.default_rng(SEED).choice(len(rows), 10, replace=False)
    return [rows[k] for k in chosen]


def minimum(problem: Problem) -> tuple[Array, Array]:
    """Return the corrections of all images and points by scipy's trust region, and Jacobian (n, u) at the start.

    A shared unknown is one column, and its correction is that of all its images.
    """
    start = problem.start
    whole = np.eye(problem.n_columns) if problem.ties is None else joined(problem)

    def residual(x: Array) -> Array:
        return assemble(problem, problem.moved(start, whole @ x), jacobian=False)[0]

    def jacobian(x: Array) -> Array:
        return assemble(problem, problem.moved(start, whole @ x))[1] @ whole

    found = least_squares(residual, np.zeros(whole.shape[1]), jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return whole @ found.x, assemble(problem, start)[1] @ whole


def joined(problem: Problem) -> Array:
    """Return the matrix from the unknowns without repetitions (columns) to those of all images and points (rows)."""
    assert problem.ties is not None
    z, wide = problem.n_free_unknowns, problem.n_image_unknowns
    out = np.zeros((problem.n_columns, problem.n_unknowns))
    out[np.arange(wide), problem.ties.of] = 1.0
    out[wide:, z:] = np.eye(problem.n_columns - wide)
    return out


def rmse(problem: Problem, x: Array, block: Block, role: Role) -> Array:
    """Return the RMSE of a role along the ECEF axes, point by point."""
    ground = problem.moved(problem.start, x).ground + problem.origin_m
    opened = block.withheld.open()
    known = dict(zip(block.withheld.ids, opened.ecef_m, strict=True))
    differences = []
    for j, (name, own) in enumerate(zip(block.points.ids, block.points.roles, strict=True)):
        if own is role and (block.observations.point == j).any():
            measured = known[name] if role is Role.CHECK else block.points.known.ecef_m[j]
            differences.append(ground[j] - measured)
    return np.sqrt(np.mean(np.square(differences), axis=0))


def eliminated(pattern: Array, sizes: list[int]) -> tuple[float, float]:
    """Return the elements and operations of the Cholesky factor of a block pattern (n, n), block by block."""
    filled, elements, operations = pattern.copy(), 0.0, 0.0
    for k, size in enumerate(sizes):
        later = [m for m in range(k + 1, len(sizes)) if filled[k, m]]
        d = sum(sizes[m] for m in later)
        elements += size * (size + 1) / 2 + size * d
        operations += size**3 / 3 + size**2 * d + size * d**2
        for a in later:
            filled[a, later] = True
    return elements, operations


@pytest.mark.oracle
def test_ten_random_rows(twin: Block, comparison: Comparison) -> None:
    check_rows(twin, comparison)


@pytest.mark.slow
@pytest.mark.oracle
def test_ten_random_rows_of_the_mixed_block() -> None:
    """Ten random rows of the mixed block equal independent computations.

    Satellite, RPC and frame images share unknowns.
    """
    block = mixed_block(MixedOptions())[0]
    check_rows(block, compare(block, eop_sets=[2, 9], solvers="qr,lapack_cholesky"))


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.oracle
def test_ten_random_rows_of_the_pleiades_pair(real_data: Path, tmp_path: Path) -> None:
    """Ten random rows of the Pléiades pair equal independent computations, and the advice names set and reasons."""
    block = fg.read_project(pleiades_project(real_data, tmp_path)[0])
    found = compare(block, solvers="qr,svd")
    said = verdict(found)
    assert re.fullmatch(r"Take EOP set \d+ \(\w+\) with graph · GTSAM, Gauss-Newton", said["title"])
    text = " ".join(said["text"])
    assert "3-D RMSE" in text and "check points" in text and "engines give the same solution" in text
    assert found.target_from == "predicted" and "In the project file: eop_set = " in text
    check_rows(block, found)


def check_rows(block: Block, comparison: Comparison) -> None:
    """Check errors, sigma0, matrix, elements and operations of ten random rows."""
    given, known = block, dict[int, tuple[Array, Array]]()
    for row in random_rows(comparison):
        block = replace(given, options=replace(given.options, eop_set=row.eop_set))
        problem = compile_problem(block)
        if row.eop_set not in known:
            known[row.eop_set] = minimum(problem)
        x, design = known[row.eop_set]
        for role in (Role.CHECK, Role.CONTROL):
            values = rmse(problem, x, block, role)
            assert [getattr(row, f"{role}_rmse_{a}_m") for a in "xyz"] == pytest.approx(values, rel=1e-6)
            assert getattr(row, f"{role}_rmse_m") == pytest.approx(values.max(), rel=1e-6)
        v = assemble(problem, problem.moved(problem.start, x), jacobian=False)[0]
        assert row.sigma0 == pytest.approx(np.sqrt(v @ v / (len(design) - design.shape[1])), rel=1e-9)
        check_matrix(row, problem, design)
        if problem.ties is None:
            check_work(row, problem, design)
        assert row.reached == (max(row.check_rmse_m, row.control_rmse_m) <= comparison.target_m)
        assert row.difference_sigmas < 1e-9 and row.difference_m < 1e-7


def check_matrix(row: Row, problem: Problem, design: Array) -> None:
    """Check order, rank and condition numbers by numpy."""
    scale = np.concatenate([np.concatenate([p.sigma for p in problem.parameters]), np.ones(3 * problem.active.sum())])
    if problem.ties is not None:
        scale = np.array([scale[np.flatnonzero(column)[0]] for column in joined(problem).T])
    physical = design / scale
    unit = physical / np.sqrt((physical**2).sum(axis=0))
    assert (row.order, row.rank) == (design.shape[1], np.linalg.matrix_rank(physical))
    assert row.cond_scaled == pytest.approx(np.linalg.cond(unit.T @ unit), rel=1e-6)
    assert row.cond_raw == pytest.approx(min(np.linalg.cond(physical) ** 2, LARGEST_CONDITION), rel=1e-5)
    if row.backend in ("schur", "graph") and problem.ties is None:
        u = problem.n_image_unknowns
        n = design.T @ design
        s = n[:u, :u] - n[:u, u:] @ np.linalg.solve(n[u:, u:], n[u:, :u])
        assert row.cond_reduced == pytest.approx(np.linalg.cond(s), rel=0.05)  # it changes little in the iterations


def check_work(row: Row, problem: Problem, design: Array) -> None:
    """Check elements and operations from the pattern of the matrix, block by block."""
    u = problem.n_image_unknowns
    sizes = [*([3] * int(problem.active.sum())), *np.diff(problem.first).tolist()]
    ends = np.concatenate([[0], np.cumsum(sizes)])
    order = np.concatenate([np.arange(u, design.shape[1]), np.arange(u)])  # points first
    has = np.abs(design) > 0
    for k, (image, point) in enumerate(zip(problem.observations.image, problem.observations.point, strict=True)):
        has[2 * k, problem.image_slice(image)] = True  # also an unknown that this image does not depend on
        if problem.active[point]:
            has[2 * k, problem.point_slice(point)] = True
    own = has[:, order].astype(float)
    n = own.T @ own > 0
    blocks = np.array([[n[a:b, c:d].any() for c, d in pairwise(ends)] for a, b in pairwise(ends)])
    normal = sum(s * (s + 1) / 2 for s in sizes)
    normal += sum(sizes[i] * sizes[j] for i in range(len(sizes)) for j in range(i) if blocks[i, j])
    if row.backend == "dense":
        elements = design.shape[1] * (design.shape[1] + 1) / 2
        operations = dense_operations(row.solver, *design.shape)
    else:
        elements, operations = eliminated(blocks, sizes)
        k = np.diff(problem.first)[problem.observations.image]
        operations += sum(2.0 * (size + 3.0) ** 2 for size in k.tolist())
    if row.solver in ("iterative", "implicit"):  # no factor: the matrix, or none of it
        return
    assert row.factor_elements == pytest.approx(elements)
    assert row.fill == pytest.approx(elements - normal)
    assert row.operations == pytest.approx(operations, rel=1e-12)


@pytest.mark.oracle
def test_forward_errors_against_extended_precision(twin: Block, comparison: Comparison) -> None:
    """Forward errors refer to the exact step, which equals iterative refinement in long doubles.

    Direct solvers are below 1e-10; iterative ones stop earlier on purpose.
    """
    problem = compile_problem(replace(twin, options=replace(twin.options, eop_set=2)))
    residual, design = assemble(problem, problem.start)
    exact = reference.exact(design, -residual)
    assert exact is not None
    wide, right = design.astype(np.longdouble), -residual.astype(np.longdouble)
    q, r = np.linalg.qr(design)
    x = np.zeros(design.shape[1], np.longdouble)
    v = right.copy()
    for _ in range(6):  # augmented system (Björck 1967): residual v = l - A x and A^T v = 0
        f, g = right - v - wide @ x, -(wide.T @ v)
        h = np.linalg.solve(r.T, g.astype(float))
        d = q.T @ f.astype(float)
        x += np.linalg.solve(r, d - h)
        v += f - q @ d + q @ h
    assert np.abs(np.asarray(x - exact, float)).max() <= 1e-14 * np.abs(exact).max()
    rows = [r for r in comparison.select(eop_set=2) if np.isfinite(r.forward_error) and r.backend != "faithful"]
    exact_ones = [r for r in rows if r.solver not in ("iterative", "implicit")]
    assert len(exact_ones) == 8 and max(r.forward_error for r in exact_ones) < 1e-10
    assert all(1e-8 < r.forward_error < 1e-2 for r in rows if r not in exact_ones)  # inexact steps, on purpose


@pytest.mark.truth
def test_reference_of_a_known_solution() -> None:
    """The reference solution is exact for whole numbers in Vandermonde's matrix, and absent if not determined.

    Least squares of consistent equations is exact.
    """
    design = np.vander(np.arange(1.0, 13.0), 8)
    x = np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0, -8.0])
    found = reference.exact(design, design @ x)
    assert found is not None and (found == x).all()
    assert reference.forward_error(x * (1.0 + 1e-9), found) == pytest.approx(1e-9, rel=1e-6, abs=0.0)
    assert reference.exact(np.ones((4, 2)), np.ones(4)) is None
    assert reference.exact(design, design @ x, limit=7) is None
    assert np.isnan(reference.forward_error(x, None))


@pytest.mark.behaviour
def test_without_flint_there_are_no_forward_errors(twin: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "find_spec", lambda name: None)
    assert not reference.available()
    rows = compare(twin, eop_sets=[2], solvers="qr", backends="dense,graph").rows
    assert not any(r.failure for r in rows) and all(np.isnan(r.forward_error) for r in rows)


@pytest.mark.behaviour
def test_limits_name_the_estimate() -> None:
    limits = Limits(10**9, 5.0)
    assert limits.reason("dense qr", Work(memory=1e8, seconds=1.0)) == ""
    assert "an estimated 2 GB, and 1 GB are allowed" in limits.reason("dense qr", Work(memory=2e9, seconds=1.0))
    assert "an estimated 6 s of processor time, more than 5 s" in limits.reason("dense qr", Work(seconds=6.0))
    assert Limits(None, 5.0).reason("dense qr", Work(memory=1e15)) == ""


@pytest.mark.consistency
def test_formulas_of_large_blocks_equal_the_symbolic_elimination(twin: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = compile_problem(replace(twin, options=replace(twin.options, eop_set=2)))
    counted = Sparsity(problem)
    assert counted.structure is not None
    monkeypatch.setattr("fg_orient.studies.comparison.work.COUNTED", 10)
    formulas = Sparsity(problem)
    assert formulas.structure is None
    assert formulas.normal == counted.normal
    for kind in ("dense", "graph", "iterative"):
        assert formulas.schur(kind) == counted.schur(kind)
    assert formulas.explicit() == counted.explicit() and formulas.graph() == counted.graph()
    monkeypatch.setattr("fg_orient.studies.comparison.work.BLOCKS", 0)
    assert Sparsity(problem).graph() == counted.graph()
