"""The tests check the arithmetic of the benchmarks and the page made from the results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from benchmarks import cases, snooping
from benchmarks.flat import FlatProblem
from benchmarks.goals import GRAPH, MUST, PINHOLE, WISHED, Goal
from benchmarks.hardware import Hardware, iteration_bound
from benchmarks.page import FIGURE, PAGE, RESULTS, digest, page
from benchmarks.summary import Summary, Value, whole_seconds
from benchmarks.table import all_tables
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.schur import SchurBackend

MACHINE = Hardware({1: 12.0e9, 2: 20.0e9}, {1: 50.0e9, 2: 60.0e9}, 22.0e9)


@pytest.fixture(scope="module")
def pair() -> Problem:
    return compile_problem(cases.spot_block("94"))


@pytest.mark.truth
def test_counts_of_the_smallest_block(pair: Problem) -> None:
    n = cases.counts(pair)
    # 43 points in both images: 3 pairs each; 6 control points; 27 priors per image
    assert (n.n_images, n.n_ground_points, n.n_image_points, n.n_pairs) == (2, 43, 86, 129)
    assert n.n_observations == 2 * 86 + 3 * 6 + 54
    assert n.n_unknowns == 54 + 3 * 43 and n.redundancy == n.n_observations - n.n_unknowns
    assert (n.image_unknowns, n.half_bandwidth) == (54, 53)


@pytest.mark.behaviour
def test_band_of_images_that_do_not_all_overlap() -> None:
    block = cases.grid_block(cases.BlockOptions(rows=1, columns=6, points=200, spacing_m=4e4, check_share=0.0))[0]
    problem = compile_problem(block)
    o, k = problem.observations, int(np.diff(problem.first).max())
    partners = [np.ptp(o.image[o.point == j]) for j in np.unique(o.point)]
    assert cases.counts(problem).half_bandwidth == (max(partners) + 1) * k - 1 < 6 * k - 1


@pytest.mark.oracle
def test_flat_problem_is_the_problem_of_our_backends(pair: Problem) -> None:
    flat, schur = FlatProblem(pair), SchurBackend(pair, threads=1)
    flat._rows = flat._rows.py_func  # not compiled: 86 image points
    assert flat.cost(flat.start) == pytest.approx(schur.error(schur.initial()), rel=1e-12)
    assert flat.n_residuals == pair.n_observations and len(flat.start) == pair.n_unknowns
    rng = np.random.default_rng(5)
    x, along = flat.start + 0.1 * rng.normal(size=len(flat.start)), rng.normal(size=len(flat.start))
    step = 1e-4
    numeric = (flat.residuals(x + step * along) - flat.residuals(x - step * along)) / (2.0 * step)
    np.testing.assert_allclose(flat.jacobian(x) @ along, numeric, rtol=0.0, atol=1e-7 * np.abs(numeric).max())
    assert (flat.sparsity() != 0).sum() == flat.jacobian(x).nnz
    # one Gauss-Newton step of the flat problem is that of the backend
    j, r = flat.jacobian(flat.start).toarray(), flat.residuals(flat.start)
    expected = -np.linalg.lstsq(j, r, rcond=None)[0]
    found = schur.linearise(schur.initial()).solve(0.0)
    np.testing.assert_allclose(found.image, expected[: flat.n_image_unknowns], rtol=0.0, atol=1e-8)


@pytest.mark.behaviour
def test_resection_has_one_image_and_constant_points() -> None:
    problem = cases.resection_problem()
    n = cases.counts(problem)
    assert (n.n_images, n.n_ground_points, n.n_image_points, n.n_unknowns, n.n_pairs) == (1, 0, 94, 27, 0)


@pytest.mark.truth
def test_bound_of_an_iteration_by_hand() -> None:
    # 1e6 image points: 450 + 192 B at 20 GB/s; 2.5e6 pairs of 1458 flop at 60 GFlop/s; 2700^3 / 3 at 50 GFlop/s
    expected = 1e6 * 642.0 / 20e9 + 2.5e6 * 1458.0 / 60e9 + 2700.0**3 / 3.0 / 50e9
    assert iteration_bound(MACHINE, 2, 10**6, 2_500_000, 2700) == pytest.approx(expected, rel=1e-12)
    banded = expected - (2700.0**3 / 3.0 - 2700.0 * 600.0**2) / 50e9
    assert iteration_bound(MACHINE, 2, 10**6, 2_500_000, 2700, 600) == pytest.approx(banded, rel=1e-12)
    assert iteration_bound(MACHINE, 2, 10**6, 2_500_000, 2700, 2699) == pytest.approx(expected, rel=1e-12)
    # where arithmetic is slow it decides: 330 flop in place of 450 B
    slow = Hardware({1: 1e12, 2: 1e12}, {1: 1e9, 2: 1e9}, 1e9)
    assert iteration_bound(slow, 1, 1000, 0, 0) == pytest.approx(1000 * (330e-9 + 192e-12), rel=1e-12)


def record(solver: str, size: str, solve: float, cost: float | None, **more: Any) -> dict[str, Any]:
    stages = {"linearise": 0.1 * solve, "solve": 0.1 * solve, "retract": 0.05 * solve, "kernel:pair_blocks": 0.01}
    points = int(float(size.removesuffix(" mixed")))
    base = {
        "problem": "spot", "size": size, "solver": solver, "repeat": 0, "repeats": 3, "n_images": 4,
        "n_ground_points": points // 3, "n_image_points": points, "n_observations": 2 * points, "n_unknowns": points,
        "redundancy": points, "n_pairs": 2 * points, "image_unknowns": 108, "half_bandwidth": 107, "solve": solve,
        "structure": 0.0, "iterations": 4, "evaluations": 4, "cost": cost, "ended": "", "stages": stages, "inner": 1,
    }  # fmt: skip
    return base | more


def summary(*records: dict[str, Any]) -> Summary:
    rates = {"triad_1": 1e10, "triad_2": 2e10, "product_1": 5e10, "product_2": 6e10, "cholesky_1": 2e10}
    return Summary({
        "hardware": [rates, {k: 0.5 * v for k, v in rates.items()}], "records": list(records), "jit_s": 1.0,
        "memory": [{"size": "1e4", "threads": 2, "n_image_points": 10_000, "working_set": 2_000_000, "records": 10**6,
                    "solve_only": 10**6, "input": 10**6}],
        "machine": {"processor": "p", "cores": 2, "vector_bits": 256, "python": "3", "versions": {}, "load": 0.0,
                    "date": "d", "full": False, "repeats": 3},
    })  # fmt: skip


@pytest.mark.behaviour
def test_ratio_is_that_of_the_rounds_and_a_bound_where_the_peer_did_not_arrive() -> None:
    ours = [record("schur", "1e3", seconds, 100.0) for seconds in (1.0, 2.0, 3.0)]
    arrived = [record("pyceres", "1e3", seconds, 100.0 + 0.9e-4) for seconds in (10.0, 60.0, 90.0)]
    short = [record("trf-2-point", "1e3", 100.0, 100.0 + 1.1e-4)]
    s = summary(*ours, *arrived, *short)
    found = s.ratio("spot", "1e3", "pyceres", "schur", whole_seconds)
    assert found is not None and (found.median, found.bound, found.repeats) == (30.0, False, 3)
    assert (found.low, found.high) == (20.0, 30.0)  # of 10, 30, 30
    lower = s.ratio("spot", "1e3", "trf-2-point", "schur", whole_seconds)
    assert lower is not None and lower.bound and lower.median == 100.0  # of the first round, in which it ran
    assert s.ratio("spot", "1e3", "graph", "schur", whole_seconds) is None
    # if ours did not arrive there is no ratio at all
    better = [record("graph", "1e3", 1.0, 99.0)]
    assert summary(*ours, *arrived, *better).ratio("spot", "1e3", "pyceres", "schur", whole_seconds) is None


@pytest.mark.behaviour
def test_hardware_counts_at_its_best_and_exponents_come_out() -> None:
    sizes = ("1e3", "1e4", "1e5", "1e6")
    s = summary(record("schur", "94", 5.0, 1.0), *(record("schur", n, 1e-6 * float(n) ** 1.1, 1.0) for n in sizes))
    assert s.hardware.triad == {1: 1e10, 2: 2e10}
    assert s.exponent("schur", 10**6) == pytest.approx(1.1, abs=1e-12)
    assert s.exponent("schur", 10**7) is None and s.exponent("graph", 10) is None
    assert s.working_set("1e4", 2) == 200.0 and s.working_set("1e4", 2, with_records=True) == 300.0


@pytest.mark.behaviour
def test_verdicts() -> None:
    wish = Goal("", lambda s: None, target=40.0, stretch=60.0, more=True)
    for value, expected in ((39.0, "missed"), (40.0, "target met"), (61.0, "stretch met")):
        assert wish.verdict(Value(value, value, value, 1)) == expected
    assert wish.verdict(Value(39.0, 39.0, 39.0, 1, bound=True)) == "open (lower bound)"
    assert wish.verdict(None) == "not measured"
    must = Goal("", lambda s: None, limit=2.5)
    assert [must.verdict(Value(v, v, v, 1)) for v in (2.4, 2.6)] == ["limit met", "missed"]


@pytest.mark.behaviour
def test_every_goal_can_be_measured_or_says_that_it_was_not() -> None:
    empty = all_tables(summary(record("schur", "1e3", 1.0, 1.0)).results)
    for heading, goals in (("Limits", MUST), ("Targets", WISHED)):
        assert [row[0] for row in empty[heading][1:]] == [goal.name for goal in goals]
        assert "not measured" in {row[-1] for row in empty[heading]}
    sizes = ("1e3", "1e4", "1e5", "1e6")
    solver = {"linear_solver": 1.0, "linear_solves": 2.0, "linearise": 1.0, "solve": 1.0, "retract": 1.0}
    solver |= {"kernel:pair_blocks": 1.0}
    names = ("schur", "schur-1", "schur-2", "graph", "pyceres", "trf-2-point", "trf-analytic", "gtsam-native-iterate")
    everything = [record(name, n, 1.0, 1.0, stages=solver) for n in sizes for name in names]
    everything += [record(n, "94", 1.0, 1.0, problem="resection") for n in ("adjust", *names, "gtsam-native")]
    everything += [record(n, "1e5", 1.0, 1.0, problem="pinhole", stages=solver) for n in ("schur", "ceres-2", "gtsam")]
    s = summary(*everything)
    s.results["memory"][0]["size"] = "1e6"
    assert [goal.name for goal in (*MUST, *WISHED) if goal.measure(s) is None] == []
    kinds = [f"graph-{name}" for name in ("gauss-newton", "levenberg-marquardt", "dogleg")]
    names = (*kinds, "schur", "schur-levenberg-marquardt", "ceres-2", "gtsam")
    everything = [record(name, n, 1.0, 1.0) for n in ("1e4", "1e5", "1e6") for name in names]
    everything += [record(name, n, 1.0, 1.0, problem="pinhole") for n in PINHOLE for name in names]
    s = summary(*everything)
    s.results["memory"][0] |= {"size": "1e6", "backend": "graph"}
    assert [goal.name for goal in GRAPH if goal.measure(s) is None] == []


@pytest.mark.repository
def test_page_and_figure_are_made_of_the_results_file() -> None:
    text = RESULTS.read_text("utf-8")
    results = json.loads(text)
    assert PAGE.read_text("utf-8") == page(results), "run: python -m benchmarks.page"
    assert f"results {digest(text)}" in Path(FIGURE).read_text("utf-8"), "run: python -m benchmarks.page"
    repeats = {(r["problem"], r["size"], r["solver"], r["repeat"]) for r in results["records"]}
    assert len(repeats) == len(results["records"]), "one record per repeat"
    assert {"n_image_points", "n_observations", "redundancy"} <= set(results["records"][0])


@pytest.mark.truth
def test_planted_gross_errors_and_the_power_to_find_them(tmp_path: Path) -> None:
    """Planted errors have the stated number and size, and the missed probability is 0 for large, 0.999 for no error."""
    table = tmp_path / "observations.csv"
    lines = ["# made here", "image,id,line,sample", *(f"a,{k},{k}.0,1.0" for k in range(20))]
    table.write_text("\n".join(lines) + "\n", "utf-8")
    errors = snooping.planted(table, 0.25)
    after = [line.split(",") for line in table.read_text("utf-8").splitlines()[2:]]
    moved = {(i, k): (float(line) - float(k), float(sample) - 1.0) for i, k, line, sample in after}
    changed = {key: error for key, error in moved.items() if any(error)}
    assert len(changed) == 5 and changed.keys() == errors.keys()
    for key, error in errors.items():
        assert changed[key] == pytest.approx(error, abs=1e-9)
        assert 5.0 <= np.hypot(*error) <= 50.0
    solution = fg.adjust(cases.spot_block("94"))
    o, many = solution.problem.observations, int(np.argmax(solution.problem.observed))
    key = solution.block.images[int(o.image[o.point == many][0])].id, solution.block.points.ids[many]
    for size, missed in ((1000.0, 0.0), (0.0, 0.999)):
        found = snooping.missed_probabilities(solution, {key: (size, size)}, 0.001)
        assert found[key] == pytest.approx(missed, abs=1e-6)


@pytest.mark.repository
def test_recorded_searches_are_those_of_one_by_one_and_miss_what_theory_predicts() -> None:
    results = json.loads(snooping.RESULTS.read_text("utf-8"))["cases"]
    assert results.keys() == snooping.CASES.keys()
    assert [found["same_as_one_by_one"] for found in results.values()] == [True, True, None]
    for found in results.values():
        assert abs(found["missed"] - found["predicted"]) <= found["half"]
        assert found["false"] == found["control"] == 0
