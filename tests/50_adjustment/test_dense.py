"""The dense backend has the rows, the solution and the cofactors of the graph, without GTSAM."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from factors.cameras.pushbroom import RECORD
from factors.conditions.control import CONTROL_POINT
from fg_orient.adjustment.dense import DenseBackend, assemble
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.linear.registry import solve as solve_linear
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.adjustment.loop import gauss_newton
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.names import Role
from fg_orient.quality.covariance import Indeterminate, dense_cofactors
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.full_statistics import damped_of_numpy, dogleg_of_numpy, step_of_numpy
from tests.support.observed_parameters import OBSERVED_PARAMETERS

#: Both loops go on to this scaled step, or until it stops shrinking.
TOLERANCE = 1e-9


def compiled(block: Block, **options: object) -> Problem:
    return compile_problem(replace(block, options=replace(block.options, **options)))


def with_fixed_control(block: Block, count: int) -> Block:
    """Make the first control points constants."""
    fixed = block.points.known.fixed.copy()
    fixed[block.points.where(Role.CONTROL)[:count]] = True
    return replace(block, points=replace(block.points, known=replace(block.points.known, fixed=fixed)))


def with_own_observations(block: Block) -> Block:
    """Observe a check point, and all coefficients of an image, once more."""
    record = np.concatenate([np.diag([2.0, 3.0, 4.0]).ravel(), [1.0, -2.0, 0.5]])
    k = len(compile_problem(block).parameters[1])
    setup = np.stack([np.linspace(-1.0, 1.0, k), np.linspace(0.5, 2.0, k)])
    check = block.points.ids[int(block.points.where(Role.CHECK)[0])]
    return replace(block, extra=(
        ExtraObservation(CONTROL_POINT, (f"point:{check}",), record, np.zeros((2, 0)), 3, "own point"),
        ExtraObservation(OBSERVED_PARAMETERS, ("image:right",), np.zeros(0), setup, k, "own parameters"),
    ))  # fmt: skip


def assert_no_step_left(problem: Problem, state: State) -> None:
    image, ground = step_of_numpy(problem, state)
    assert image <= 1e-9
    assert ground <= 1e-7


def largest_differences(problem: Problem) -> tuple[float, float, float]:
    """Return the largest differences of the dense backend and GTSAM, each iterated by itself.

    They are those of unknowns (sigmas), points (m) and normal matrices (relative). At the end of the dense one numpy's
    least squares must have no step left.
    """
    dense, graph = DenseBackend(problem), ExplicitBackend(problem)
    a = gauss_newton(dense, dense.initial(), 50, tolerance=TOLERANCE)
    b = gauss_newton(graph, graph.initial(), 50, tolerance=TOLERANCE)
    assert a.converged
    assert b.converged
    assert 2.0 * a.error == pytest.approx(2.0 * b.error, rel=1e-11)
    assert_no_step_left(problem, a.state)
    state = graph.state(b.state)
    active = problem.active
    _, design = assemble(problem, state)
    normal = design.T @ design
    hessian, _ = graph.linearise(b.state).linear.hessian()  # images before points, as in Columns
    scale = np.sqrt(np.outer(np.diag(normal), np.diag(normal)))
    return (
        float(np.abs(a.state.image - state.image).max()),
        float(np.abs(a.state.ground[active] - state.ground[active]).max()),
        float(np.abs((hessian - normal) / scale).max()),
    )


def assert_equal(problem: Problem) -> None:
    image, ground, normal = largest_differences(problem)
    assert image <= 1e-9
    assert ground <= 1e-7
    assert normal <= 1e-12


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", range(1, 21))
def test_all_sets_equal_the_graph(twin: Block, eop_set: int) -> None:
    """For each EOP set the dense backend has the solution and normal matrix of the graph.

    Limits are 1e-9 prior sigma, 1e-7 m, and 1e-12 of the matrix.
    """
    assert_equal(compiled(twin, eop_set=eop_set))


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", [1, 5, 16, 20])
def test_equal_with_look_angle_unknowns(twin: Block, eop_set: int) -> None:
    assert_equal(compiled(twin, eop_set=eop_set, look_polynomial=2))


@pytest.mark.oracle
@pytest.mark.parametrize("check_points", ["use", "exclude"])
def test_equal_with_fixed_control_and_excluded_check_points(twin: Block, check_points: str) -> None:
    assert_equal(compiled(with_fixed_control(twin, 20), check_points=check_points))


@pytest.mark.oracle
def test_equal_with_own_observations(twin: Block) -> None:
    """With extra observations the dense backend equals the graph, and the observations move the solution."""
    with_extra = with_own_observations(twin)
    assert_equal(compiled(with_extra))
    moved = fg.adjust(with_extra, backend="dense").state.image - fg.adjust(twin, backend="dense").state.image
    assert np.abs(moved).max() > 0.1


@pytest.mark.oracle
@pytest.mark.parametrize("optimizer", ["levenberg-marquardt", "dogleg"])
def test_damped_optimisers_give_the_same(twin: Block, optimizer: str) -> None:
    base = fg.adjust(twin, eop_set=15, optimizer=optimizer, backend="schur")
    dense = fg.adjust(twin, eop_set=15, optimizer=optimizer, backend="dense")
    assert_no_step_left(dense.problem, dense.state)
    assert np.abs(dense.state.image - base.state.image).max() <= 1e-9
    assert np.abs(dense.ground_m - base.ground_m).max() <= 1e-7
    assert [r.accepted for r in dense.log] == [r.accepted for r in base.log]


@pytest.mark.oracle
def test_damped_and_dogleg_steps_equal_the_graphs(twin: Block) -> None:
    """Damped and dogleg steps of the dense backend equal those of the graph and of numpy.

    The damping is 0.5; the radii lie in the steepest-descent, the blended and the Gauss-Newton part.
    """
    problem = compiled(twin, eop_set=9)
    dense, graph = DenseBackend(problem), ExplicitBackend(problem)
    a, b = dense.linearise(dense.initial()), graph.linearise(graph.initial())
    newton = float(np.linalg.norm(a.solve(0.0).data))
    steepest = b.linear.optimizeGradientSearch().norm()
    radii = [0.5 * steepest, 0.5 * (steepest + newton), 2.0 * newton]
    assert steepest < newton
    v, design = assemble(problem, dense.initial())
    steps = [
        (a.solve(0.5), b.solve(0.5), damped_of_numpy(problem, v, design, 0.5)),
        *((a.dogleg(r), b.dogleg(r), dogleg_of_numpy(problem, v, design, r)) for r in radii),
    ]
    for ours, theirs, numpys in steps:
        assert np.abs(ours.data - numpys).max() <= 1e-9 * ours.length
        assert ours.predicted_error == pytest.approx(0.5 * np.sum((v + design @ numpys) ** 2), rel=1e-9)
        expected = graph.state(graph.retract(graph.initial(), theirs))
        found = dense.retract(dense.initial(), ours)
        assert np.abs(found.image - expected.image).max() <= 1e-9 * ours.length
        assert np.abs(found.ground - expected.ground)[problem.active].max() <= 1e-9 * ours.length
        assert ours.predicted_error == pytest.approx(theirs.predicted_error, rel=1e-9)


@pytest.mark.oracle
def test_columns_and_jacobian_by_differences(twin: Block) -> None:
    """The assembled Jacobian equals differences of the residuals for every row kind, and constant points stay."""
    problem = compiled(with_own_observations(with_fixed_control(twin, 5)))
    assert problem.n_columns == problem.n_unknowns
    residual, design = assemble(problem, problem.start)
    assert design.shape == (problem.n_observations, problem.n_unknowns)
    assert np.array_equal(assemble(problem, problem.start, jacobian=False)[0], residual)
    rng = np.random.default_rng(5)
    for _ in range(5):
        step = 1e-2 * rng.normal(size=problem.n_columns)
        ahead, back = (
            assemble(problem, problem.moved(problem.start, s * step), jacobian=False)[0] for s in (1.0, -1.0)
        )
        # second-order terms cancel; what is left is of third order in 1e-2 sigma, and rounding
        assert np.abs(0.5 * (ahead - back) - design @ step).max() < 1e-6 * np.abs(design @ step).max()
    moved = problem.moved(problem.start, np.arange(float(problem.n_columns)))
    assert np.allclose(problem.vector(moved) - problem.vector(problem.start), np.arange(problem.n_columns), atol=1e-9)
    constant = ~problem.active
    assert np.array_equal(moved.ground[constant], problem.start.ground[constant], equal_nan=True)


@pytest.mark.oracle
@pytest.mark.parametrize(
    "choice", [{"eop_set": 15}, {"eop_set": 20, "look_polynomial": 2}, {"eop_set": 2, "priors": False}]
)
def test_cofactors_equal_gtsam_marginals(twin: Block, choice: dict[str, object]) -> None:
    """Cofactors of the dense backend equal GTSAM's marginals within 1e-9: images, points and joint blocks."""
    block = with_fixed_control(twin, 3)
    a, b = fg.adjust(block, backend="dense", **choice), fg.adjust(block, backend="graph", **choice)
    control, check = (block.points.where(role) for role in (Role.CONTROL, Role.CHECK))
    points = tuple(int(j) for j in (control[10], check[0], check[5]))
    pairs = [(a.cofactors.joint((1, 0), points), b.cofactors.joint((1, 0), points))]
    pairs += [(a.cofactors.image(k), b.cofactors.image(k)) for k in (0, 1)]
    pairs += [(a.cofactors.point(int(j)), b.cofactors.point(int(j))) for j in (*control[3:], *check)]
    for ours, theirs in pairs:
        scale = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
        assert np.abs((ours - theirs) / scale).max() <= 1e-9
    assert not a.cofactors.point(int(control[0])).any()
    assert np.allclose(
        a.accuracy.check.predicted_sigma_enu_m, b.accuracy.check.predicted_sigma_enu_m, rtol=1e-9, atol=0.0
    )
    named = "image:left", f"point:{block.points.ids[int(check[0])]}"
    assert a.covariance(*named).names == b.covariance(*named).names


@pytest.mark.oracle
def test_solutions_carry_the_same_statistics(twin: Block) -> None:
    dense, graph = (fg.adjust(twin, eop_set=16, backend=backend) for backend in ("dense", "graph"))
    assert (dense.backend, dense.solver) == ("dense", "qr")
    assert (graph.backend, graph.solver) == ("graph", "")
    assert dense.status is graph.status
    assert dense.warnings == graph.warnings
    assert dense.redundancy == graph.redundancy
    residual, design = assemble(dense.problem, dense.state)
    assert dense.redundancy == len(residual) - design.shape[1]
    assert dense.sigma0 == pytest.approx(np.sqrt(residual @ residual / dense.redundancy), rel=1e-10)
    assert dense.sigma0 == pytest.approx(graph.sigma0, rel=1e-10)
    for role in ("control", "check"):
        ours, theirs = (getattr(s.accuracy, role).statistics() for s in (dense, graph))
        assert ours == pytest.approx(theirs, rel=1e-7)
    assert dense.unobservable == graph.unobservable


@pytest.mark.oracle
@pytest.mark.parametrize(
    "solver", ["cholesky_elimination", "gauss_partial_pivot_elimination", "pivot_inverse", "svd_scaled", "lapack_lu"]
)
def test_any_solver_of_the_registry(twin: Block, solver: str) -> None:
    """With any of the published solvers the dense backend ends where no step is left.

    The iteration corrects the errors of their steps.
    """
    found = fg.adjust(twin, eop_set=16, backend="dense", solver=solver)
    assert found.solver == solver
    assert_no_step_left(found.problem, found.state)


@pytest.mark.oracle
def test_a_regularised_solver_gives_the_step(twin: Block) -> None:
    """With Tikhonov's solver each step is that of the solver, and one iteration does not count as converged."""
    problem = compiled(twin, eop_set=16)
    backend = DenseBackend(problem, "tikhonov_hkb")
    residual, design = assemble(problem, problem.start)
    expected = solve_linear("tikhonov_hkb", LinearSystem.from_design(design, -residual))
    assert expected.kappa is not None
    assert expected.kappa > 0.0
    step = backend.linearise(problem.start).solve(0.0).data
    assert np.array_equal(step, expected.x)
    stacked = np.vstack([design, np.sqrt(expected.kappa) * np.eye(design.shape[1])])
    ridge = np.linalg.lstsq(stacked, -np.concatenate([residual, np.zeros(design.shape[1])]), rcond=None)[0]
    assert np.linalg.norm(step - ridge) <= 1e-6 * np.linalg.norm(ridge)
    short = fg.adjust(twin, eop_set=16, backend="dense", solver="tikhonov_hkb", max_iterations=1)
    assert short.status is fg.Status.NOT_CONVERGED
    assert short.chi2 < 2.0 * DenseBackend(problem).error(problem.start)


@pytest.mark.behaviour
def test_a_solver_that_breaks_down_is_one_line_and_exit_code_three(twin: Block) -> None:
    """For a singular N a solver that breaks down gives an error of one line, named and with exit code 3."""
    no_priors = compiled(twin, eop_set=20, priors=False)
    with pytest.raises(fg.NoSolutionError, match="lapack_cholesky") as caught:
        DenseBackend(no_priors, "lapack_cholesky").linearise(no_priors.start).solve(0.0)
    assert caught.value.exit_code == 3
    assert "\n" not in str(caught.value)


@pytest.mark.behaviour
def test_without_priors_rank_is_judged_before(twin: Block) -> None:
    with pytest.raises(fg.RankDeficientError):
        fg.adjust(twin, eop_set=20, priors=False, backend="dense")
    dense, graph = (fg.adjust(twin, eop_set=16, priors=False, backend=b) for b in ("dense", "graph"))
    assert dense.status is graph.status is fg.Status.CONVERGED
    assert np.abs(dense.state.image - graph.state.image).max() <= 1e-7  # no priors: 100 eps cond


@pytest.mark.oracle
def test_sigmas_where_gtsam_gives_none(twin: Block) -> None:
    """The dense backend gives the right cofactors, with a warning, where the graph gives none.

    One control and two check points without priors: cond(J) = 3e4, and GTSAM's Cholesky finds it indeterminate.
    """
    keep = [int(twin.points.where(Role.CONTROL)[0]), *(int(j) for j in twin.points.where(Role.CHECK)[:2])]
    small = replace(twin, observations=twin.observations.take(np.isin(twin.observations.point, keep)))
    dense, graph = (fg.adjust(small, eop_set=2, priors=False, backend=b) for b in ("dense", "graph"))
    assert graph.cofactors is None
    _, design = assemble(dense.problem, dense.state)
    expected = np.linalg.pinv(design) @ np.linalg.pinv(design).T
    found = dense.cofactors.joint((0, 1), tuple(int(j) for j in np.flatnonzero(dense.problem.active)))
    assert np.allclose(found, expected, rtol=1e-7, atol=0.0)
    assert np.sqrt(np.diag(found)).max() > 100.0  # m: the result is useless, and its sigma shows this
    assert any("not reliable" in text for text in dense.warnings)


@pytest.mark.behaviour
def test_covariance_is_unavailable_with_a_reason(twin: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """An indeterminate covariance has a reason: the condition, or an unknown in no observation.

    The solution is not trustworthy and gives no covariance.
    """
    problem = compiled(twin, eop_set=20, priors=False)
    _, design = assemble(problem, problem.start)
    with pytest.raises(Indeterminate, match="condition of the scaled Jacobian is above 1e\\+12"):
        dense_cofactors(problem, design)
    design[:, 3] = 0.0
    with pytest.raises(Indeterminate, match="in no observation"):
        dense_cofactors(problem, design)
    monkeypatch.setattr("fg_orient.quality.covariance.CONDITION_LIMIT", 10.0)
    solution = fg.adjust(twin, eop_set=2, priors=False, backend="dense")
    assert solution.status is fg.Status.NOT_TRUSTWORTHY
    assert "no covariance: the condition of the scaled Jacobian is above 1e+01;" in str(solution.unavailable[0])
    with pytest.raises(fg.NoSolutionError, match="no covariance was computed"):
        solution.covariance("image:left")


@pytest.mark.behaviour
def test_values_that_are_not_finite_name_the_observation(twin: Block) -> None:
    problem = compiled(twin, eop_set=15)
    records = problem.records.copy()
    records[7, RECORD.a11] = np.nan
    with pytest.raises(fg.NoSolutionError, match=problem.label(7)):
        from fg_orient.adjustment.solve import solve

        options = replace(twin.options, backend="dense")
        solve(replace(problem, records=records, block=replace(twin, options=options)))


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("choice", "code"),
    [
        ({"solver": "qr"}, "adjust.solver_dense"),
        ({"solver": "qr", "backend": "graph"}, "adjust.solver_dense"),
        ({"solver": "none_such", "backend": "dense"}, "linear.solver"),
        ({"optimizer": "newton", "backend": "dense"}, "options.value"),
        ({"backend": "sparse"}, "options.value"),
        ({"optimizer": "native"}, "options.value"),
        ({"solver": "qr", "backend": "schur"}, "adjust.solver_dense"),
        ({"backend": "dense", "solver": ""}, "options.value"),
    ],
)
def test_choices_that_do_not_go_together(twin: Block, choice: dict[str, str], code: str) -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(twin, **choice)
    (found,) = caught.value.problems
    assert found.code == code
    assert found.option in choice


@pytest.mark.behaviour
def test_too_many_unknowns_are_refused_before_a_matrix_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dense backend refuses unknowns above its limit before it makes a matrix, and accepts the limit itself.

    The limit is lowered, so that the test does not depend on time or memory.
    """
    block, _ = grid_block(BlockOptions(points=60, seed=1))
    n = fg.adjust(block, backend="dense").problem.n_unknowns

    def made(*_: object, **__: object) -> None:
        raise AssertionError("a matrix was made")

    monkeypatch.setattr("fg_orient.adjustment.dense.MAX_UNKNOWNS", n - 1)
    monkeypatch.setattr("fg_orient.adjustment.dense.assemble", made)
    with pytest.raises(fg.InputError, match=f"more than {n - 1} unknowns .*graph backend") as caught:
        fg.adjust(block, backend="dense")
    assert (caught.value.problems[0].code, caught.value.problems[0].option) == ("linear.too_large", "backend")
    monkeypatch.setattr("fg_orient.adjustment.dense.MAX_UNKNOWNS", n)
    with pytest.raises(AssertionError, match="a matrix was made"):
        fg.adjust(block, backend="dense")


@pytest.mark.behaviour
def test_the_limit_is_2000() -> None:
    from fg_orient.adjustment import dense

    assert dense.MAX_UNKNOWNS == 2000


@pytest.mark.behaviour
def test_gtsam_is_not_imported_on_the_dense_path(repository: Path) -> None:
    code = (
        "import sys\n"
        "import fg_orient as fg\n"
        "from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block\n"
        "s = fg.adjust(zonguldak_block(ZonguldakOptions(seed=1))[0], backend='dense', eop_set=2)\n"
        "s.covariance('image:left')\n"
        "print(s.status, 'gtsam' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=repository, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["converged", "False"]
