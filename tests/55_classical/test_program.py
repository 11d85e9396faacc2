"""The authors' program runs on the twin; the tests measure the effect of each difference from the equations.

The expected numbers are those of the program itself, run on the same twin. Errors that follow from the geometry are
held to 1 %; ranks and condition numbers of singular systems to their order; where rounding decides, nothing is held.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from fg_orient.adjustment.linear import registry
from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem, diagnose
from fg_orient.studies.claims import AS_RUN_TWIN, Study
from fg_orient.studies.switches import NUMBERED, PROGRAM, TEXT, Switches, label, names, switches_of
from fg_orient.studies.tables_spot5 import norm_condition
from fg_orient.studies.two_stage import TwoStage
from fg_orient.studies.two_stage_results import AxisErrors, from_two_rays

SOLVER = "gauss_inverse"
#: The procedure before D1 to D8 were known: matrices, 0.1", repeats, metadata positions, complex roots.
WITHOUT_NUMBERED = PROGRAM.without(*NUMBERED)


@cache
def run_of(switches: Switches = PROGRAM, seed: int = 1) -> TwoStage:
    return Study(seed, switches, AS_RUN_TWIN).two_stage


@cache
def bundle(
    eop_set: int, switches: Switches = PROGRAM, seed: int = 1, kind: int = 2, solver: str = SOLVER
) -> AxisErrors:
    return run_of(switches, seed).bundle(eop_set, kind, solver).accuracy


def design(eop_set: int, switches: Switches = PROGRAM, image: int = 0) -> np.ndarray:
    return run_of(switches).pre_adjust(image, eop_set, "moore_penrose_inverse").system.require_design("A")[0]


def near(found: np.ndarray, expected: list[float], share: float = 0.01) -> bool:
    """Return whether values agree within a share plus half a unit of the last printed digit."""
    printed = [0.5 * 10.0 ** -len(repr(e).partition(".")[2]) if "." in repr(e) else 0.5 for e in expected]
    return bool(np.all(np.abs(found - expected) <= share * np.abs(expected) + printed))


# --- the program's numbers -------------------------------------------------------------------


@pytest.mark.truth
def test_uncorrected_and_step_one_are_the_programs() -> None:
    run = run_of()
    assert near(run.uncorrected().gcp_rmse, [44.14, 26.17, 20.60], 0.001)
    assert near(run.look_only().gcp_rmse, [0.664, 0.205, 0.418], 0.001)
    assert near(run.look_only().icp_rmse, [6.441, 7.959, 7.928], 0.001)


@pytest.mark.truth
@pytest.mark.parametrize(("eop_set", "expected"), [
    (1, [0.703, 0.204, 0.456]), (15, [94, 208, 166]), (16, [4.6, 72, 74]),
])  # fmt: skip
def test_type_2_bundles_are_the_programs(eop_set: int, expected: list[float]) -> None:
    assert near(bundle(eop_set).gcp_rmse, expected)
    assert near(bundle(eop_set).icp_rmse, list(bundle(eop_set, WITHOUT_NUMBERED).icp_rmse.round(2)))


@pytest.mark.truth
@pytest.mark.parametrize(("seed", "eop_set", "expected"), [
    (1, 14, [2.3e5]), (1, 18, [1.8e3]), (2, 14, [3130, 578, 2987]), (2, 18, [320, 65, 338]),
])  # fmt: skip
def test_sets_14_and_18_fail_as_the_programs(seed: int, eop_set: int, expected: list[float]) -> None:
    """Sets 14 and 18 have the large errors of the program within a factor of 1.5.

    Rounding moves weak directions by per cent.
    """
    found = bundle(eop_set, PROGRAM, seed).gcp_rmse
    values = found if len(expected) == 3 else found.max()
    assert np.all(np.abs(np.log10(values / np.array(expected))) < np.log10(1.5))


@pytest.mark.consistency
def test_moore_penrose_cures_all_but_13_and_14() -> None:
    for eop_set in (1, 5, 15, 17, 19, 20):
        for kind in (1, 2):
            assert bundle(eop_set, kind=kind, solver="moore_penrose_inverse").gcp_max < 1.0
    assert 1.0 < bundle(13, solver="moore_penrose_inverse").gcp_max < 50.0
    assert 1e3 < bundle(13, kind=1, solver="moore_penrose_inverse").gcp_max < 1e6
    assert 1e4 < bundle(14, solver="moore_penrose_inverse").gcp_max < 1e6


@pytest.mark.truth
def test_ranks_and_condition_numbers_are_the_programs() -> None:
    assert np.linalg.matrix_rank(design(5)) == 8
    assert np.linalg.matrix_rank(design(13)) == 17
    one, fifteen = (run_of().pre_adjust(0, k, SOLVER).system for k in (1, 15))
    assert diagnose(one).rank == 8
    assert 1.1e18 / 2.0 < norm_condition(one, SOLVER) < 1.1e18 * 2.0  # here 1.13e18; another machine rounds otherwise
    assert 1.7e33 / 3.0 < norm_condition(fifteen, SOLVER) < 1.7e33 * 3.0  # here 1.70e33


@pytest.mark.consistency
@pytest.mark.parametrize("name", ["cholesky_inverse", "cholesky_elimination"])
def test_cholesky_fails_for_the_sets_with_velocity_at_two_times(name: str) -> None:
    """Without complex roots Cholesky fails for sets with velocity at two times, and for no regular set.

    Sets whose least pivot is a rounding error may fail or not.
    """
    run = run_of(PROGRAM.without("complex_roots"))
    for eop_set in (5, 13, 17, 20):
        assert run.bundle(eop_set, 2, name).failure
    for eop_set in (1, 2, 3, 9, 10, 15, 16):
        assert not run.bundle(eop_set, 2, name).failure


@pytest.mark.consistency
def test_matrices_leave_the_constant_residual() -> None:
    """With one matrix not orthonormal the residual is 0.1 to 0.6 m; with both orthonormal 0.1 to 0.5 mm.

    The latter is what the single cycle of step 1 leaves.
    """
    both = run_of(PROGRAM.without("short_axis", "small_angles")).look_only().gcp_rmse
    assert np.all((both > 1e-4) & (both < 5e-4))
    for one in ("short_axis", "small_angles"):
        left = run_of(PROGRAM.without(one)).look_only().gcp_rmse
        assert np.all((left > 0.1) & (left < 0.6))


# --- each switch alone -----------------------------------------------------------------------


@pytest.mark.consistency
def test_without_the_numbered_switches_it_is_the_former_procedure() -> None:
    """Without the switches D1 to D8 the errors are those of the former procedure within 0.1 %."""
    run = run_of(WITHOUT_NUMBERED)
    assert near(run.uncorrected().gcp_rmse, [39.75, 25.35, 25.23], 0.001)
    assert near(run.look_only().gcp_rmse, [0.691, 0.200, 0.390], 0.001)
    assert near(run.look_only().icp_rmse, [7.359, 8.014, 7.815], 0.001)
    assert near(bundle(1, WITHOUT_NUMBERED).gcp_rmse, [0.8112, 0.1784, 0.3892], 0.001)
    assert near(bundle(15, WITHOUT_NUMBERED).gcp_rmse, [383, 217, 398], 0.001)
    assert near(bundle(16, WITHOUT_NUMBERED).gcp_rmse, [109, 92, 194], 0.001)
    assert bundle(14, WITHOUT_NUMBERED).gcp_max < 5.0
    assert bundle(18, WITHOUT_NUMBERED).gcp_max < 5.0
    assert np.linalg.matrix_rank(design(5, WITHOUT_NUMBERED)) == 5
    assert np.linalg.matrix_rank(design(13, WITHOUT_NUMBERED)) == 14


@pytest.mark.truth
def test_d1_lines_from_the_centre_change_ranks_and_conditions_only() -> None:
    centred, first = PROGRAM, PROGRAM.without("centred_lines")
    systems = {s: run_of(s).pre_adjust(0, 1, SOLVER).system for s in (centred, first)}
    assert (diagnose(systems[centred]).rank, diagnose(systems[first]).rank) == (8, 6)
    assert 50.0 < norm_condition(systems[first], SOLVER) / norm_condition(systems[centred], SOLVER) < 500.0
    assert near(bundle(15, first).gcp_rmse, list(bundle(15).gcp_rmse.round(2)), 1e-3)
    q = [np.linalg.inv(scaled.T @ scaled) for scaled in
         (design(1, s) / np.linalg.norm(design(1, s), axis=0) for s in (centred, first))]  # fmt: skip
    r = [abs(m[0, 1]) / np.sqrt(m[0, 0] * m[1, 1]) for m in q]  # X0 with X1: published 0.027
    assert r[0] < 0.2 < 0.85 < r[1]


#: Without some measures: RMSE at control or check points without bundle, with step 1 alone, and of bundles of a set.
CHANGED = [
    ("midpoint", "uncorrected", "gcp_rmse", [39.75, 25.35, 25.23], 0.001),  # D2: the foot on the first ray
    ("midpoint", "look_only", "gcp_rmse", [0.691, 0.200, 0.390], 0.001),
    ("midpoint", "look_only", "icp_rmse", [7.361, 8.014, 7.812], 0.001),
    ("midpoint line_exact", 1, "gcp_rmse", [0.8115, 0.1777, 0.3893], 0.001),
    ("midpoint line_exact", 15, "gcp_rmse", [387, 217, 395], None),
    ("midpoint line_exact", 16, "gcp_rmse", [109, 93, 193], None),
    # from corrected positions 94/208/166 m become this: not the units of set 15, the way it is judged
    ("metadata_positions", 15, "gcp_rmse", [0.44, 0.25, 0.33], 0.01),
]


@pytest.mark.consistency
@pytest.mark.parametrize(("without", "step", "figure", "expected", "within"), CHANGED)
def test_what_the_program_gives_without_a_measure(
    without: str, step: str | int, figure: str, expected: list[float], within: float | None
) -> None:
    changed = PROGRAM.without(*without.split())
    found = bundle(step, changed) if isinstance(step, int) else getattr(run_of(changed), step)()
    assert near(getattr(found, figure), expected, *([] if within is None else [within]))
    if without == "metadata_positions":
        assert bundle(16, changed).gcp_max < 1.0


@pytest.mark.consistency
def test_d3_lines_interpolated_leave_polynomial_misclosures() -> None:
    """With D3 the misclosures of polynomials are about 1e-8 rad, and without D3 both kinds are equal.

    The procedure without bundle uses them as its right-hand side.
    """

    def w(switches: Switches, polynomial: bool) -> float:
        step = run_of(switches).pre_adjust(0, 1, SOLVER, polynomial_misclosures=polynomial)
        return float(np.sqrt(np.mean(step.system.require_design("w")[1] ** 2)))

    assert 5e-9 < w(PROGRAM, True) < 2e-8
    assert w(PROGRAM, False) < 1e-9
    smooth = PROGRAM.without("line_exact")
    assert w(smooth, True) == w(smooth, False)


@pytest.mark.consistency
def test_d4_the_test_after_the_correction_saves_a_cycle() -> None:
    early, late = run_of(), run_of(PROGRAM.without("test_after"))
    assert (early.look.cycles, late.look.cycles) == (1, 2)
    rms = []
    for run in (early, late):
        step = run.pre_adjust(0, 1, SOLVER)
        rms.append(np.sqrt(np.mean(step.system.require_design("w")[1] ** 2)))
        assert (np.abs(step.dP).max() > 1e-5) == (run is early)
    assert rms[0] == pytest.approx(9e-11, rel=0.1)
    assert rms[1] < 1e-16


@pytest.mark.consistency
def test_d5_a_length_that_follows_gives_velocity_along_the_radius_an_effect() -> None:
    held = PROGRAM.without("length_follows")
    assert [np.linalg.matrix_rank(design(k, held)) for k in (5, 13)] == [5, 14]
    assert bundle(14, held).gcp_max < 5.0 < 1e4 < bundle(14).gcp_max
    assert bundle(18, held).gcp_max < 5.0 < 1e2 < bundle(18).gcp_max


@pytest.mark.consistency
def test_d6_misclosures_at_the_metadata_count_step_two_twice() -> None:
    """With D6 the bundle adds the corrections of step 2 again: dP differs by them, within 10 %.

    The misclosures at the EOPs of step 2 contain what step 2 explained; those at the metadata do not.
    """
    at_step_2 = run_of(PROGRAM.without("metadata_misclosures")).bundle(15, 2, SOLVER)
    at_metadata = run_of().bundle(15, 2, SOLVER)
    steps = np.array([run_of().pre_adjust(k, 15, SOLVER).dP for k in (0, 1)])
    twice = at_metadata.dP - at_step_2.dP
    assert np.allclose(twice[:, [0, 3, 6]], steps[:, [0, 3, 6]], rtol=0.1, atol=1e-3)
    assert near(bundle(15, PROGRAM.without("metadata_misclosures")).gcp_rmse, list(bundle(15).gcp_rmse.round(1)))


@pytest.mark.consistency
def test_d7_one_limit_for_all_unknowns_ends_or_prolongs_step_two() -> None:
    """With D7 step 2 of set 19 needs more than ten iterations, and without D7 it stops at ten.

    Its positions move by more than 10 m for misclosures of 1e-8 rad.
    """
    iterations = [
        run_of(switches).pre_adjust(0, 19, SOLVER, polynomial_misclosures=True).repeats
        for switches in (PROGRAM, PROGRAM.without("one_limit"))
    ]
    assert iterations[0] > 10 == iterations[1]


@pytest.mark.consistency
def test_d8_the_quotients_of_the_look_angles_are_needed_for_sets_15_and_16() -> None:
    """Without D8 the errors of sets 15 and 16 differ from the program's by more than 0.5 %."""
    without = PROGRAM.without("look_quotients")
    assert not near(bundle(15, without).gcp_rmse, [94, 208, 166], 0.005)
    assert not near(bundle(16, without).gcp_rmse, [4.6, 72, 74], 0.005)
    assert bundle(14, without, 2).gcp_max < 0.2 * 3130.0


# --- without bundle --------------------------------------------------------------------------


@pytest.mark.truth
@pytest.mark.parametrize(("eop_set", "control", "check"), [
    (15, [14, 7, 12], [19, 8, 14]), (19, [164, 167, 177], [167, 165, 180]),
])  # fmt: skip
def test_without_bundle_check_points_diverge_with_the_control_points(
    eop_set: int, control: list[float], check: list[float]
) -> None:
    """Without bundle, control and check points have the errors of the program; the bundle keeps below 10 m.

    Set 19 is nearly singular and depends on the machine: it has a tolerance of 50 %, set 15 of 1 %.
    """
    found = run_of().step_two_only(eop_set, "pivot_inverse")
    share = 0.01 if eop_set == 15 else 0.5
    assert near(found.gcp_rmse, control, share)
    assert near(found.icp_rmse, check, share)
    assert bundle(eop_set, kind=1).icp_max < 10.0  # those of the bundle stay


@pytest.mark.behaviour
def test_without_bundle_a_solver_that_breaks_down_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without bundle a solver that breaks down leaves nan at all control points.

    The test has its own solver, because rounding decides whether ours fail on a singular system.
    """
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))

    @registry.register_solver("breaks_down", "Breaks down", "modern", source="test")
    def breaks_down(system: LinearSystem, as_run: bool) -> LinearSolution:
        raise np.linalg.LinAlgError("singular")

    found = run_of(PROGRAM).step_two_only(17, "breaks_down")
    assert np.isnan(found.gcp_m).all()


# --- switches --------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_switches_are_named_and_have_a_label() -> None:
    assert [label(name) for name in NUMBERED] == [f"D{k}" for k in range(1, 9)]
    assert names(["D5", "D2"]) == ("midpoint", "length_follows")
    assert (
        switches_of(True) == PROGRAM
        and switches_of(False) == TEXT
        and switches_of(WITHOUT_NUMBERED) == WITHOUT_NUMBERED
    )
    assert TEXT.with_(*names()) == PROGRAM and PROGRAM.without(*names()) == TEXT


@pytest.mark.consistency
def test_the_text_has_no_switch_on(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, named = TwoStage(run_of().block), TwoStage(run_of().block, as_run=TEXT)
    for a, b in zip(plain.bundle(15, 2, SOLVER).dP.ravel(), named.bundle(15, 2, SOLVER).dP.ravel(), strict=True):
        assert a == b


@pytest.mark.truth
def test_two_rays_meet_in_the_middle_of_their_shortest_connection() -> None:
    centre = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, -3.0]])
    direction = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    image, point = np.array([0, 1]), np.array([0, 0])
    assert np.allclose(from_two_rays(centre, direction, image, point, 1), [[5.0, 0.0, 0.0]])
    assert np.allclose(from_two_rays(centre, direction, image, point, 1, midpoint=True), [[5.0, 0.5, 0.0]])
