"""Rows of a comparison agree with direct calls of the engines and with numpy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.block import Block, GroundPoints
from fg_orient.model.names import Role
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from fg_orient.studies.comparison import engines
from fg_orient.studies.comparison.compare import compare, ground_sampling_m, reached
from fg_orient.studies.comparison.model import COLUMNS, LARGEST_CONDITION, Comparison, Row, Spectrum, groups
from fg_orient.studies.comparison.report import verdict
from fg_orient.studies.comparison.work import Limits
from fg_orient.studies.two_stage import TwoStage

AXES = ("x", "y", "z")


def one(comparison: Comparison, **wanted: object) -> Row:
    (row,) = comparison.select(**wanted)
    return row


@pytest.mark.behaviour
def test_public_name_is_the_function() -> None:
    assert fg.compare is compare


@pytest.mark.behaviour
def test_one_row_per_set_backend_type_and_solver(comparison: Comparison) -> None:
    per_set = 2 * 5 + 5 + 7 + 4 + 3
    assert len(comparison.rows) == 3 * per_set
    assert [len(rows) for rows in groups(comparison.rows).values()] == [3] * per_set
    backends = ["faithful"] * 10 + ["dense"] * 5 + ["schur"] * 7 + ["explicit"] * 4 + ["graph"] * 3
    assert [key.backend for key in groups(comparison.rows)] == backends
    found = comparison.select(backend="graph", optimizer="dogleg")
    assert [r.eop_set_name for r in found] == ["PU0", "V", "VA"]


@pytest.mark.consistency
@pytest.mark.parametrize("kind", [1, 2])
@pytest.mark.parametrize("solver", ["moore_penrose_inverse", "cholesky_inverse", "qr"])
def test_published_rows_are_those_of_the_procedure(
    twin: Block, comparison: Comparison, kind: engines.Kind, solver: str
) -> None:
    with one_blas_thread():
        stage = TwoStage(twin)
        for eop_set in comparison.eop_sets:
            row = one(comparison, eop_set=eop_set, backend="faithful", type=kind, solver=solver)
            bundle = stage.bundle(eop_set, kind, solver)
            assert row.failure == bundle.failure
            assert row.order == bundle.n_unknowns
            for role, rmse in (("control", bundle.accuracy.gcp_rmse), ("check", bundle.accuracy.icp_rmse)):
                found = [getattr(row, f"{role}_rmse_{axis}_m") for axis in AXES]
                assert np.array_equal(found, rmse, equal_nan=True)
                assert np.array_equal(getattr(row, f"{role}_rmse_m"), rmse.max(), equal_nan=True)
            if not bundle.failure:
                freedom = 188 - bundle.n_unknowns
                assert row.m0_rad == pytest.approx(math.sqrt((bundle.v**2).sum() / freedom), rel=1e-12, abs=0.0)


@pytest.mark.consistency
def test_adjustment_rows_are_those_of_adjust(twin: Block, comparison: Comparison) -> None:
    for eop_set in comparison.eop_sets:
        graph = fg.adjust(twin, eop_set=eop_set, backend="graph")
        for row in comparison.select(eop_set=eop_set):
            if row.backend == "faithful" or row.left_out:
                continue
            statistics = {"control": graph.accuracy.control, "check": graph.accuracy.check}
            for role, found in statistics.items():
                want = np.sqrt((found.ecef_m**2).mean(axis=0))
                assert [getattr(row, f"{role}_rmse_{axis}_m") for axis in AXES] == pytest.approx(want, abs=1e-7)
                assert getattr(row, f"{role}_rmse_m") == pytest.approx(want.max(), abs=1e-7)
            assert row.sigma0 == pytest.approx(graph.sigma0, rel=1e-9)
            assert row.order == graph.problem.n_unknowns
            if (row.backend, row.optimizer) == ("graph", "gauss-newton"):  # another factorisation may need one more
                assert row.iterations == graph.iterations
            assert row.processor_s > 0.0


@pytest.mark.consistency
def test_engines_have_the_same_solution_with_priors(comparison: Comparison) -> None:
    rows = [r for r in comparison.rows if r.backend != "faithful" and not r.left_out]
    assert len(rows) == 3 * (3 + 6 + 4 + 3)
    assert max(r.difference_sigmas for r in rows) < 1e-9
    assert max(r.difference_m for r in rows) < 1e-7
    assert all(math.isnan(r.difference_sigmas) for r in comparison.rows if r.backend == "faithful" or r.left_out)


@pytest.mark.truth
def test_difference_is_measured(twin: Block, comparison: Comparison) -> None:
    """A reference with a known error shows this error as difference of the row."""
    with one_blas_thread():
        of_set = engines.Adjustments(twin, 2, Limits(None, 60.0))
        assert of_set.solution is not None
        state = of_set.solution.state
        moved = replace(state, image=state.image + 0.25, ground=state.ground - 3.0)
        of_set.solution = replace(of_set.solution, state=moved)
        (engine,) = of_set.engines("dense", ("qr",))
        row = of_set.run(engine)
    assert row.difference_sigmas == pytest.approx(0.25, abs=1e-9)
    assert row.difference_m == pytest.approx(3.0, abs=1e-7)


@pytest.mark.behaviour
def test_what_is_not_tried_says_why(comparison: Comparison) -> None:
    left_out = [r for r in comparison.rows if r.left_out]
    assert {(r.backend, r.solver) for r in left_out} == {
        ("dense", "cramer_inverse"), ("dense", "tikhonov_od"), ("schur", "banded"),
    }  # fmt: skip
    assert all(r.failure and not r.reached and math.isnan(r.control_rmse_m) for r in left_out)


@pytest.mark.behaviour
def test_breakdowns_are_rows(comparison: Comparison) -> None:
    row = one(comparison, eop_set=17, backend="faithful", type=1, solver="cholesky_inverse")
    assert "radicand" in row.failure and not row.reached and math.isnan(row.check_rmse_m)


@pytest.mark.behaviour
def test_kappa_of_the_published_regularisation(comparison: Comparison) -> None:
    assert 0.0 < one(comparison, eop_set=5, backend="faithful", type=1, solver="tikhonov_od").kappa <= 1.0
    assert math.isnan(one(comparison, eop_set=5, backend="faithful", type=1, solver="qr").kappa)


@pytest.mark.oracle
def test_condition_numbers_against_numpy(twin: Block, comparison: Comparison) -> None:
    design, _ = TwoStage(twin).bundle(2, 1, "qr").system.require_design("test")  # type: ignore[union-attr]
    row = one(comparison, eop_set=2, backend="faithful", type=1, solver="qr")
    assert row.cond_raw == pytest.approx(np.linalg.cond(design) ** 2, rel=1e-6)
    scaled = design / np.sqrt((design**2).sum(axis=0))
    assert row.cond_scaled == pytest.approx(np.linalg.cond(scaled.T @ scaled), rel=1e-6)
    assert (row.rank, row.order) == (np.linalg.matrix_rank(design), 36)


@pytest.mark.behaviour
def test_singular_sets_lack_rank(comparison: Comparison) -> None:
    for eop_set in (5, 17):
        row = one(comparison, eop_set=eop_set, backend="faithful", type=1, solver="moore_penrose_inverse")
        assert row.rank is not None and row.order is not None
        assert row.rank < row.order
        assert row.cond_raw == LARGEST_CONDITION
    graph = one(comparison, eop_set=17, backend="graph", optimizer="gauss-newton")
    assert graph.rank == graph.order
    assert graph.cond_scaled < 1e6  # priors and scaling cure it


@pytest.mark.truth
def test_priors_add_one_to_the_squares_of_each_image_unknown(comparison: Comparison) -> None:
    """Each prior adds 1 to the sum of squared singular values, in prior units."""
    for eop_set, count in ((2, 3), (5, 9), (17, 18)):
        trace = {
            s.system: float((s.values**2).sum())
            for s in comparison.spectra
            if s.eop_set == eop_set and s.scaling == "priors"
        }
        assert trace["adjustment"] - trace["no priors"] == pytest.approx(2 * count, rel=1e-6)


@pytest.mark.behaviour
def test_spectra_are_complete(comparison: Comparison) -> None:
    found = {(s.eop_set, s.system, s.scaling) for s in comparison.spectra}
    assert len(found) == len(comparison.spectra) == 3 * (2 * 2 + 2 * 3)
    for s in comparison.spectra:
        assert (np.diff(s.values) <= 0.0).all()
        if s.scaling == "columns":  # the squares of unit columns sum to their number
            zero = 0 if s.system != "no priors" else len(s.values) - round(float((s.values**2).sum()))
            assert float((s.values**2).sum()) == pytest.approx(len(s.values) - zero, rel=1e-9)


@pytest.mark.behaviour
def test_condition_is_capped() -> None:
    assert Spectrum(1, "adjustment", "raw", np.array([1e6, 1.0])).condition == pytest.approx(1e12)
    assert Spectrum(1, "adjustment", "raw", np.array([1.0, 0.0])).condition == LARGEST_CONDITION
    assert Spectrum(1, "adjustment", "raw", np.array([1.0, 1e-40])).condition == LARGEST_CONDITION


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("control", "check", "failure", "expected"),
    [
        (1.0, 5.0, "", True),
        (5.1, 1.0, "", False),
        (1.0, 5.1, "", False),
        (1.0, math.nan, "", True),
        (math.nan, math.nan, "", False),
        (1.0, 1.0, "broken", False),
    ],
)
def test_reached(control: float, check: float, failure: str, expected: bool) -> None:
    row = Row(1, "PU", "qr", "dense", control_rmse_m=control, check_rmse_m=check, failure=failure)
    assert reached(row, 5.0) is expected


@pytest.mark.behaviour
def test_reached_follows_the_target(twin: Block, comparison: Comparison) -> None:
    row = compare(twin, eop_sets=[17], backends="graph").rows[0]
    assert row.check_rmse_m == one(comparison, eop_set=17, backend="graph", optimizer="gauss-newton").check_rmse_m
    limit = max(row.check_rmse_m, row.control_rmse_m)
    assert compare(twin, eop_sets=[17], backends="graph", target_m=1.0001 * limit).rows[0].reached
    assert not compare(twin, eop_sets=[17], backends="graph", target_m=0.9999 * limit).rows[0].reached


@pytest.mark.consistency
def test_target_is_one_pixel_without_check_points(twin: Block) -> None:
    """Without check points the target is the ground size of a pixel: it projects to 1 px within 1e-3."""
    target = ground_sampling_m(twin)
    o, control = twin.observations, twin.points.where(Role.CONTROL)
    alone = replace(twin, observations=o.take(np.isin(o.point, control)))
    found = compare(alone, eop_sets=[2], backends="graph")
    assert (found.target_m, found.target_from) == (target, "pixel")
    assert "no check points have a predicted accuracy" in " ".join(verdict(found)["text"])
    assert 4.5 < target < 5.5  # SPOT 5 HRG, 5 m
    largest = 0.0
    for image in twin.images:
        sensor = image.sensor
        centre = (sensor.n_lines - 1) / 2.0
        at = sensor.locate(np.array([centre]), np.array([centre]), height_m=0.0)[0]
        along = sensor.locate(np.array([centre + 10.0]), np.array([centre]), height_m=0.0)[0] - at
        across = sensor.locate(np.array([centre]), np.array([centre + 10.0]), height_m=0.0)[0] - at
        for direction in (along, across):
            line, sample = sensor.project((at + target * direction / np.linalg.norm(direction))[None])
            largest = max(largest, math.hypot(float(line[0]) - centre, float(sample[0]) - centre))
    assert largest == pytest.approx(1.0, abs=1e-3)


@pytest.mark.behaviour
def test_look_polynomial_goes_to_dense_and_graph(twin: Block) -> None:
    some = ("faithful", "dense", "graph")
    found = compare(twin, eop_sets=[2], solvers="qr", types=[1], backends=some, look_polynomial=2)
    plain = compare(twin, eop_sets=[2], solvers="qr", types=[1], backends=some)
    assert [r.order for r in found.rows] == [36, *[153 + 6] * 4]
    assert [r.order for r in plain.rows] == [36, *[147] * 4]
    assert found.block.options.look_polynomial == 2


@pytest.mark.behaviour
def test_as_run_reaches_the_published_procedure() -> None:
    """With ``as_run`` a radial velocity leaves over 0.1 m at control points; without it nothing."""
    block = zonguldak_block(ZonguldakOptions(radial_velocity_m_s=8.0))[0]
    options = {"eop_sets": [2], "solvers": "moore_penrose_inverse", "backends": "faithful", "types": [1]}
    (as_run,) = compare(block, as_run=True, **options).rows  # type: ignore[arg-type]
    (specified,) = compare(block, **options).rows  # type: ignore[arg-type]
    assert as_run.control_rmse_m > 0.1
    assert specified.control_rmse_m < 1e-6


@pytest.mark.slow
@pytest.mark.behaviour
def test_all_sets_reach_the_target_through_the_graph(twin: Block) -> None:
    found = compare(twin, backends="graph", look_polynomial=2, target_m=5.0)
    assert [s.eop_set for s in found.sets] == list(range(1, 21))
    assert all(r.reached for r in found.rows)


@pytest.mark.behaviour
@pytest.mark.slow
def test_all_sets_and_published_solvers(twin: Block) -> None:
    found = compare(twin, solvers="published", look_polynomial=2, target_m=5.0)
    assert len(found.rows) == 20 * (2 * 11 + 11 + 7 + 4 + 3)
    assert all(r.reached for r in found.rows if r.backend != "faithful" and not r.left_out)
    good = found.select(backend="faithful", solver="moore_penrose_inverse", reached=True)
    assert len(good) == 40
    assert len(found.select(backend="faithful", solver="cholesky_inverse", reached=True)) < 40


@pytest.mark.behaviour
@pytest.mark.parametrize("limit", ["memory", "time"])
def test_too_large_for_dense(monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    """If dense exceeds the limit of memory or time, its rows state the estimate and the graph is computed."""
    block = grid_block(BlockOptions(rows=1, columns=2, points=700))[0]
    monkeypatch.setattr(engines, "assemble", None)
    if limit == "memory":
        block, given = replace(block, options=replace(block.options, memory_limit_gb=0.05)), {}
    else:
        given = {"time_limit_s": 2.0}
    found = compare(block, eop_sets=[1], solvers="qr", backends="dense,graph", **given)
    dense, graph, *_ = found.rows
    words = {"memory": "needs an estimated", "time": "s of processor time, more than 2 s"}
    assert words[limit] in dense.failure and dense.left_out
    assert not graph.failure and graph.sigma0 > 0.0
    assert graph.order is not None and graph.order > 2000 and math.isnan(graph.cond_raw)
    assert found.spectra == ()


@pytest.mark.slow
@pytest.mark.consistency
def test_dense_matrices_beyond_two_thousand_unknowns(twin: Block) -> None:
    """A comparison computes dense rows above the limit of ``adjust``, 2000 unknowns."""
    block = grid_block(BlockOptions(rows=1, columns=2, points=700))[0]
    found = compare(block, eop_sets=[2], solvers="lapack_cholesky", backends="dense")
    (row,) = found.rows
    assert not row.failure and row.order is not None and row.order > 2000
    assert row.difference_sigmas < 1e-7 and row.difference_m < 1e-6


@pytest.mark.behaviour
def test_single_image_has_no_published_procedure(twin: Block) -> None:
    """For a single image the published procedure states its reason, and other rows are computed."""
    o = twin.observations
    control = np.isin(o.point, twin.points.where(Role.CONTROL))
    block = replace(twin, images=twin.images[:1], observations=o.take((o.image == 0) & control))
    found = compare(block, eop_sets=["A0"], solvers=["qr"])
    assert all(r.left_out and "two images" in r.failure for r in found.select(backend="faithful"))
    assert not any(r.failure for r in found.rows if r.backend in ("dense", "graph"))
    assert math.isnan(found.rows[-1].check_rmse_m)
    said = verdict(found)
    assert "each says why): published 1 · QR; published 2 · QR; " in " ".join(said["details"])
    assert "There are no check points" in " ".join(said["details"])


@pytest.mark.behaviour
def test_without_priors_deficient_sets_are_rows_with_a_reason(twin: Block) -> None:
    block = replace(twin, options=replace(twin.options, priors=False))
    found = compare(block, eop_sets=[2, 5], solvers="qr", backends="dense,explicit,graph")
    assert [bool(r.failure) for r in found.select(backend="dense")] == [False, True]
    assert all("not observable" in r.failure and not r.left_out for r in found.select(eop_set=5))
    assert all("does not eliminate points" in r.failure for r in found.select(eop_set=2, backend="graph"))
    assert all(not r.failure for r in found.select(eop_set=2, backend="explicit"))
    said = verdict(found)
    assert said["title"] == "Take EOP set 2 (PU0) with explicit graph · GTSAM elimination, our loop, Gauss-Newton"
    assert "1 of 2 sets at the target, not 5 (without solution: 5)" in " ".join(said["details"])
    assert {s.system for s in found.spectra} == {"adjustment"}


@pytest.mark.behaviour
def test_progress(twin: Block) -> None:
    calls: list[tuple[int, int, str]] = []
    compare(twin, eop_sets=[2], solvers="qr,svd", types="2", callback=lambda *call: calls.append(call))
    n = 2 + 2 + 7 + 4 + 3
    assert [(done, total) for done, total, _ in calls] == [(k, n) for k in range(1, n + 1)]
    assert "set 2 PU0" in calls[0][2] and "type 2" in calls[0][2]


@pytest.mark.behaviour
def test_table_with_and_without_pandas(comparison: Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = comparison.table
    assert tuple(frame.columns) == COLUMNS and len(frame) == len(comparison.rows)
    assert frame["check_rmse_m"].iloc[0] == comparison.rows[0].check_rmse_m
    monkeypatch.setattr("fg_orient.studies.comparison.model.find_spec", lambda name: None)
    records = comparison.table
    assert [tuple(r) for r in records] == [COLUMNS] * len(comparison.rows)


@pytest.mark.behaviour
def test_control_points_are_required(twin: Block) -> None:
    points = twin.points
    ties = tuple(Role.TIE if r is Role.CONTROL else r for r in points.roles)
    block = replace(twin, points=GroundPoints(points.ids, ties, points.known))
    for backends in ("faithful", "dense", "graph"):
        with pytest.raises(fg.InputError) as caught:
            compare(block, backends=backends)
        assert caught.value.problems[0].code == "block.no_control"
