"""Free networks agree with the pseudo-inverse; the tests change datum and backend."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from fg_orient.quality.cofactors import MatrixCofactors
from fg_orient.quality.free_network import FreeNetwork, datum_step
from fg_orient.quality.residuals import ResidualCofactors
from tests.support.degenerate_blocks import options, pinhole, pushbroom, rpc, two_pinhole_blocks, with_control
from tests.support.full_statistics import Full, stepped
from tests.support.pinhole import pinhole_block


@cache
def solved(backend: str) -> Solution:
    return fg.adjust(pinhole(), datum="inner", backend=backend)


def everything(solution: Solution) -> list[str]:
    block = solution.block
    return [f"image:{i.id}" for i in block.images] + [f"point:{i}" for i in block.points.ids]


def jacobian(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals and Jacobian of the observations alone, without any datum."""
    problem = compile_problem(options(solution.block, priors=False))
    return assemble(replace(problem, block=replace(problem.block, extra=())), solution.state)


def scaled(difference: np.ndarray, q: np.ndarray) -> float:
    """Return the largest element in units of sqrt(q_ii q_jj)."""
    size = np.sqrt(np.diag(q))
    return float(np.abs(difference / np.outer(size, size)).max())


def pseudo_inverse(design: np.ndarray, rank: int) -> np.ndarray:
    """Return the Moore-Penrose inverse of the normal matrix by the SVD of J, which is not squared."""
    _, s, vt = np.linalg.svd(design, full_matrices=False)
    assert s[rank] < 1e-10 * s[0] < s[rank - 1]
    return (vt[:rank].T / s[:rank] ** 2) @ vt[:rank]


def with_datum(design: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Return the cofactors whose trace is the least at some unknowns (u,), by numpy.

    They are (J^T J)^+, moved along the null space.
    """
    rank = design.shape[1] - 7
    null = np.linalg.svd(design, full_matrices=True)[2][rank:].T
    part = null * held[:, None]
    move = np.eye(len(null)) - null @ np.linalg.solve(part.T @ null, part.T)
    return np.asarray(move @ pseudo_inverse(design, rank) @ move.T)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_cofactors_are_the_pseudo_inverse(backend: str) -> None:
    """With all unknowns in the datum the cofactors of a free network are numpy's pseudo-inverse.

    It has seven motions and the redundancy n - rank; one wrong weight changes it.
    """
    solution = solved(backend)
    assert solution.status is fg.Status.CONVERGED and solution.backend == backend
    _, design = jacobian(solution)
    u = design.shape[1]
    network = solution.in_datum(*everything(solution))
    assert network.datum_defect == 7
    expected = pseudo_inverse(design, u - 7)
    assert scaled(network.cofactors - expected, expected) < 1e-8
    wrong = design * np.where(np.arange(len(design)) < 2, 1.1, 1.0)[:, None]  # one image point's weight
    assert scaled(network.cofactors - pseudo_inverse(wrong, u - 7), expected) > 1e-3
    assert expected == pytest.approx(np.linalg.pinv(design.T @ design, rcond=1e-12, hermitian=True), rel=1e-3, abs=1e-6)
    assert solution.redundancy == len(design) - (u - 7)
    assert np.abs(design @ network.null_space).max() < 1e-10


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_state_fulfils_the_inner_constraints_and_is_a_minimum(backend: str) -> None:
    """A free network fulfils E^T (x - x_0) = 0 at the points and J^T r = 0, so that its points moved least."""
    solution = solved(backend)
    network = solution.in_datum()
    problem = solution.problem
    difference = problem.vector(solution.state) - problem.vector(
        compile_problem(options(pinhole(), datum="free")).start
    )
    carried = network.null_space[problem.n_image_unknowns :]
    assert np.abs(carried.T @ difference[problem.n_image_unknowns :]).max() < 1e-8
    r, design = jacobian(solution)
    assert np.abs(design.T @ r).max() < 1e-7 * np.abs(design).max() * np.linalg.norm(r)
    # the points' part of all solutions x - E t of the linearised problem: no other t is shorter
    t = np.linalg.lstsq(carried, difference[problem.n_image_unknowns :], rcond=None)[0]
    assert np.abs(t).max() < 1e-9
    assert solution.chi2 == pytest.approx(r @ r, rel=1e-12)


@pytest.mark.behaviour
def test_network_says_what_its_standard_deviations_are() -> None:
    (told,) = [text for text in solved("graph").warnings if "inner constraints" in text]
    assert told.startswith("images 1, 2, 3, 4, no control point: 7 motions are free (shifted together X")
    assert told.endswith("standard deviations are relative")


@pytest.mark.oracle
def test_both_backends_give_the_same_network() -> None:
    """Dense and graph backend give the same free network, with numpy's cofactors in the datum of all points."""
    a, b = solved("dense"), solved("graph")
    assert a.state.ground == pytest.approx(b.state.ground, abs=1e-9)
    assert a.state.image == pytest.approx(b.state.image, abs=1e-9)
    problem, (_, design) = a.problem, jacobian(a)
    q = with_datum(design, np.arange(design.shape[1]) >= problem.n_image_unknowns)
    some = np.r_[problem.image_slice(1), problem.image_slice(0), problem.point_slice(3)]
    expected = q[np.ix_(some, some)]
    for solution in (a, b):
        assert scaled(solution.in_datum().cofactors - q, q) < 1e-8
        assert solution.cofactors.joint((1, 0), (3,)) == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.oracle
def test_shape_is_that_of_the_damped_solution() -> None:
    """Networks with inner constraints and with free datum have the minimum and shape of numpy's shortest steps."""
    problem = compile_problem(options(pinhole(), priors=False, datum="free"))
    problem = replace(problem, block=replace(problem.block, extra=()))
    state = problem.start
    for _ in range(20):
        r, design = assemble(problem, state)
        step = np.linalg.lstsq(design, -r, rcond=1e-10)[0]
        state = stepped(problem, state, step)
        if np.abs(step).max() < 1e-9:
            break
    distances = np.linalg.norm(state.ground[:, None] - state.ground[None], axis=2)
    away = ~np.eye(len(distances), dtype=bool)
    for found in (solved("graph"), fg.adjust(pinhole(), datum="free", priors=False)):
        assert found.chi2 == pytest.approx(r @ r, rel=1e-9)
        own = np.linalg.norm(found.state.ground[:, None] - found.state.ground[None], axis=2)
        assert np.ptp(own[away] / distances[away]) < 1e-6, "a similarity"


def minimal(solution: Solution, held: np.ndarray) -> np.ndarray:
    """Return the cofactors with some unknowns held, which is an adjustment with that datum: their rows are zero."""
    _, design = jacobian(solution)
    keep = np.setdiff1d(np.arange(design.shape[1]), held)
    r = np.linalg.qr(design[:, keep], mode="r")
    half = np.linalg.inv(r)
    q = np.zeros((design.shape[1],) * 2)
    q[np.ix_(keep, keep)] = half @ half.T
    return q


def transformed(solution: Solution, q: np.ndarray, select: np.ndarray) -> np.ndarray:
    """Return the cofactors (n, n) in the datum of some unknowns, from those of any other datum."""
    problem, motions = solution.problem, solution.in_datum().null_space
    return FreeNetwork(problem, MatrixCofactors(problem, q), solution.state, motions, select).cofactors


@pytest.mark.oracle
def test_s_transformation_equals_adjusting_with_that_datum() -> None:
    """An S-transformation gives the cofactors of an adjustment with that datum, and leads back.

    numpy holds seven coordinates of three points exactly.
    """
    solution = solved("dense")
    network, first = solution.in_datum(), solution.problem.n_image_unknowns
    held = first + np.array([0, 1, 2, 3 * 9, 3 * 9 + 1, 3 * 9 + 2, 3 * 20 + 2])
    select = np.isin(np.arange(len(network.cofactors)), held)
    expected = minimal(solution, held)
    found = transformed(solution, network.cofactors, select)
    free = ~select
    assert scaled((found - expected)[np.ix_(free, free)], expected[np.ix_(free, free)]) < 1e-7
    assert np.abs(found[select]).max() < 1e-10 * np.abs(found).max(), "what carries it has no variance"
    # and back, from the one that was adjusted so
    again = transformed(solution, expected, network.datum)
    assert scaled(again - network.cofactors, network.cofactors) < 1e-7
    unit = np.eye(len(network.cofactors))
    s = unit + datum_step(unit, network.null_space, select)
    assert s @ s == pytest.approx(s, abs=1e-8), "a projection"
    assert np.abs(s @ network.null_space).max() < 1e-9


@pytest.mark.oracle
def test_trace_is_least_for_what_carries_the_datum() -> None:
    """No other minimal datum has a smaller trace at the points, and all unknowns in the datum have the least of all.

    The cofactors of each other datum are those of numpy.
    """
    solution = solved("dense")
    network, first = solution.in_datum(), solution.problem.n_image_unknowns
    every, (_, design) = solution.in_datum(*everything(solution)), jacobian(solution)
    rng = np.random.default_rng(3)
    for _ in range(10):
        some = rng.choice(25, 3, replace=False)
        other = solution.in_datum(*(f"point:{solution.block.points.ids[j]}" for j in some))
        of_numpy = with_datum(design, np.isin((np.arange(design.shape[1]) - first) // 3, some))
        assert scaled((other.cofactors - of_numpy)[:first, :first], of_numpy[:first, :first]) < 1e-6
        assert np.trace(other.cofactors) == pytest.approx(np.trace(of_numpy), rel=1e-6)
        part = np.diag(network.cofactors)[first:].sum()
        assert np.diag(other.cofactors)[first:].sum() > part
        assert np.trace(other.cofactors) > np.trace(every.cofactors)
    assert np.trace(every.cofactors) < np.trace(network.cofactors)
    # mutation: cofactors with a wrong weight are not those of this minimum
    wrong = np.diag(np.where(np.arange(len(network.cofactors)) == first, 1.1, 1.0))
    spoiled = wrong @ network.cofactors @ wrong
    clean, wrong = (
        np.abs(network.null_space[first:].T @ q[first:, first:]).max() for q in (network.cofactors, spoiled)
    )
    assert clean < 1e-10 < 1e-5 < wrong


def variances_of_shape(solution: Solution, q: np.ndarray) -> np.ndarray:
    """Return the variances of ratios of distances and of angles between points: free of shift, turn and scale."""
    ground, first = solution.state.ground, solution.problem.n_image_unknowns

    def functions(v: np.ndarray) -> np.ndarray:
        g = v.reshape(-1, 3)
        a, b, c = g[4] - g[1], g[11] - g[1], g[21] - g[1]
        lengths = [np.linalg.norm(d) for d in (a, b, c)]
        angle = np.arccos(a @ b / (lengths[0] * lengths[1]))
        return np.array([np.log(lengths[0] / lengths[1]), np.log(lengths[1] / lengths[2]), angle])

    h = 1e-4
    x = ground.ravel()
    f = np.stack([(functions(x + e) - functions(x - e)) / (2 * h) for e in h * np.eye(len(x))], axis=1)
    return np.diag(f @ q[first:, first:] @ f.T)


@pytest.mark.oracle
def test_invariants_have_the_same_variance_in_every_datum() -> None:
    """Invariants have the variance of numpy's pseudo-inverse in every datum, while coordinates have not."""
    solution = solved("dense")
    _, design = jacobian(solution)
    base = variances_of_shape(solution, pseudo_inverse(design, design.shape[1] - 7))
    others = [("point:1", "point:9", "point:22"), tuple(everything(solution)), ("image:1", "image:4")]
    assert variances_of_shape(solution, solution.in_datum().cofactors) == pytest.approx(base, rel=1e-6)
    for names in others:
        network = solution.in_datum(*names)
        assert variances_of_shape(solution, network.cofactors) == pytest.approx(base, rel=1e-6)
        sigma = np.sqrt(np.diag(network.cofactors))
        assert not np.allclose(sigma, np.sqrt(np.diag(solution.in_datum().cofactors)), rtol=0.05)
    coordinate = np.diag(solution.in_datum().cofactors)[-1]
    assert np.diag(solution.in_datum(*others[0]).cofactors)[-1] != pytest.approx(coordinate, rel=0.01)


@pytest.mark.oracle
def test_residual_statistics_do_not_depend_on_the_datum() -> None:
    """Redundancy numbers of a free network are those of the pseudo-inverse."""
    solution = solved("graph")
    _, design = jacobian(solution)
    q = pseudo_inverse(design, design.shape[1] - 7)
    n = len(solution.problem.observations)
    expected = 1.0 - np.einsum("ni,ij,nj->n", design, q, design)
    found = ResidualCofactors(solution.problem, solution.state, solution.cofactors)
    assert np.einsum("nii->ni", found.image).ravel() == pytest.approx(expected[: 2 * n], abs=1e-7)
    assert expected.sum() == pytest.approx(solution.redundancy, abs=1e-6)


@pytest.mark.consistency
def test_moved_start_values_move_the_result_and_nothing_else() -> None:
    """If the start values are moved, rotated and scaled, a free network follows them and chi2 does not change."""
    block = pinhole()
    solution = solved("dense")
    turn = Rotation.from_rotvec([0.0, 0.0, 1e-4]).as_matrix()
    known = block.points.known
    moved = 1.0002 * known.ecef_m @ turn.T + np.array([0.03, -0.02, 0.01])
    other = fg.adjust(
        replace(block, points=replace(block.points, known=replace(known, ecef_m=moved))), datum="inner", backend="dense"
    )
    assert other.chi2 == pytest.approx(solution.chi2, rel=1e-9)
    expected = 1.0002 * solution.ground_m @ turn.T + np.array([0.03, -0.02, 0.01])
    assert np.abs(other.ground_m - expected).max() < 1e-5


@pytest.mark.behaviour
def test_no_unknown_may_be_missing_from_a_datum() -> None:
    solution = solved("dense")
    with pytest.raises(fg.InputError) as caught:
        solution.in_datum("point:1", "point:2")
    assert caught.value.problems[0].code == "statistics.datum" and "7 motions" in caught.value.problems[0].message
    with pytest.raises(fg.InputError) as caught:
        solution.in_datum("point:nowhere")
    assert [(p.code, p.value) for p in caught.value.problems] == [("covariance.no_such", "point:nowhere")]
    with pytest.raises(fg.NoSolutionError) as refused:
        fg.adjust(pinhole()).in_datum()
    assert refused.value.problems[0].code == "statistics.no_free_network"
    named = solution.in_datum().cofactor_matrix()
    assert named.values.shape == (len(named.names),) * 2
    image = solution.cofactor_matrix("image:1")
    assert named.values[:9, :9] == pytest.approx(image.values, rel=1e-9)


@pytest.mark.truth
def test_two_networks_have_fourteen_motions() -> None:
    solution = fg.adjust(two_pinhole_blocks(()), datum="inner")
    network = solution.in_datum()
    assert network.datum_defect == 14
    assert solution.status is fg.Status.CONVERGED
    assert solution.block_view.n_free_motions == 14
    joint = network.cofactors[:36, 36:72]
    assert np.abs(joint).max() < 1e-9, "they know nothing of each other"


@pytest.mark.oracle
def test_control_points_leave_no_motion_and_inner_is_the_plain_adjustment() -> None:
    block = pinhole((0, 7, 12, 20))
    inner, plain = fg.adjust(block, datum="inner"), fg.adjust(block, priors=False)
    assert inner.in_datum().datum_defect == 0
    assert inner.state.ground == pytest.approx(plain.state.ground, abs=1e-9)
    full = Full.of(plain.problem, plain.state)
    columns = np.r_[full.problem.image_slice(0), full.problem.image_slice(2), full.problem.point_slice(4)]
    expected = full.unknowns[np.ix_(columns, columns)]
    for solution in (inner, plain):
        assert scaled(solution.cofactors.joint((0, 2), (4,)) - expected, expected) < 1e-7


@pytest.mark.behaviour
@pytest.mark.parametrize(("make", "changes"), [(rpc, {"rpc_compensation": "shift"}), (pushbroom, {"eop_set": 10})])
def test_sensors_that_know_where_they_are_have_no_exact_defect(make, changes: dict[str, object]) -> None:
    """For RPC and orbits ``inner`` is ``vendor``, and without priors the near motions are refused with a remedy.

    These sensors depend a little on a motion.
    """
    block = with_control(make(), ())
    inner, vendor = (fg.adjust(block, datum=name, **changes) for name in ("inner", "vendor"))
    assert np.array_equal(inner.state.image, vendor.state.image)
    with pytest.raises(fg.RankDeficientError) as caught:
        fg.adjust(block, datum="inner", priors=False, **changes)
    (near,) = [p for p in caught.value.problems if p.code == "statistics.datum_near"]
    assert "3 motions are free (shifted together East, shifted together North, shifted together Up)" in near.place
    assert 'datum = "vendor"' in near.remedy


@pytest.mark.oracle
def test_simulated_errors_have_these_cofactors() -> None:
    """The errors of 2000 linear adjustments fit the cofactors of a free network at 99.9 %; doubled errors do not."""
    solution = solved("dense")
    network, runs = solution.in_datum(), 2000
    _, design = jacobian(solution)
    noise = np.random.default_rng(1).standard_normal((runs, len(design)))
    unit = np.eye(len(network.cofactors))
    to_datum = unit + datum_step(unit, network.null_space, network.datum)
    errors = -(to_datum @ np.linalg.pinv(design) @ noise.T).T
    inverse = np.linalg.pinv(network.cofactors, rcond=1e-10, hermitian=True)
    rank = len(network.cofactors) - network.datum_defect
    low, high = chi2.ppf([0.0005, 0.9995], rank * runs) / runs
    assert low < np.einsum("ni,ij,nj->n", errors, inverse, errors).mean() < high
    assert np.einsum("ni,ij,nj->n", 2.0 * errors, inverse, 2.0 * errors).mean() > high


@pytest.mark.oracle
def test_minimal_datum_holds_as_many_unknowns_as_there_are_motions() -> None:
    """A minimal datum holds as many unknowns as the rank defect of the Jacobian, and makes it regular."""
    held = solved("graph").problem
    free = assemble(replace(held, block=replace(held.block, extra=())), held.start)[1]
    s = np.linalg.svd(free / np.linalg.norm(free, axis=0), compute_uv=False)
    assert sum(e.n_residuals for e in held.block.extra) == np.count_nonzero(s < 1e-12 * s[0]) == 7
    design = assemble(held, held.start)[1]
    assert np.linalg.cond(design / np.linalg.norm(design, axis=0)) < 1e6
    assert Role.CONTROL not in held.block.points.roles


@pytest.mark.behaviour
@pytest.mark.parametrize("priors", [True, False])
def test_control_that_holds_the_datum_is_said(priors: bool) -> None:
    """If control determines the datum, a warning states that inner constraints, and priors if any, have no effect."""
    block = pinhole((0, 7, 12, 20))
    solution = fg.adjust(block, datum="inner", priors=priors)
    told = [w for w in solution.warnings if "inner constraints have no effect" in w]
    assert told == [solution.warnings[0]]
    assert ("switched off" in told[0]) is priors
    free = solved("dense")
    assert not [w for w in free.warnings if "no effect" in w]


@pytest.mark.oracle
def test_network_with_many_images_has_the_cofactors_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A free network of twelve images has the unobservable directions, cofactors and redundancy numbers of numpy."""
    monkeypatch.setattr("fg_orient.quality.observability.WORK_LIMIT", 0.0)
    block, _ = pinhole_block(12, 200, views=5, seed=4)
    solution = fg.adjust(block, datum="inner")
    assert solution.status is fg.Status.CONVERGED and solution.block_view.n_free_motions == 7
    assert solution.block_view.counts is None and solution.block_view.null.shape == (108, 7)
    _, design = jacobian(solution)
    assert np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), 1e-10) == design.shape[1] - 7
    q = with_datum(design, np.arange(design.shape[1]) >= 108)
    assert scaled(solution.in_datum().cofactors - q, q) < 1e-8
    points = np.array([q[k : k + 3, k : k + 3] for k in range(108, len(q), 3)])
    found = solution.cofactors.points(np.arange(200))
    assert np.abs(found - points).max() < 1e-8 * np.abs(points).max()
    expected = 1.0 - np.einsum("ni,ij,nj->n", design, q, design)
    redundancy = ResidualCofactors(solution.problem, solution.state, solution.cofactors)
    assert np.einsum("nii->ni", redundancy.image).ravel() == pytest.approx(expected, abs=1e-7)
