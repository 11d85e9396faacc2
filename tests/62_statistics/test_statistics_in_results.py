"""The result folder has redundancy, reliability and correlations, or the reason why one is absent."""

from __future__ import annotations

import csv
import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment import memory
from fg_orient.adjustment.cofactors import AUTO_LIMIT, full_statistics
from fg_orient.formats.project import read_project
from fg_orient.model.block import Block, Options
from fg_orient.model.names import Role
from fg_orient.orientation.run import run_project
from fg_orient.orientation.solution import Solution
from fg_orient.quality.stated_sigmas import stated_sigmas
from fg_orient.result import statistics
from fg_orient.simulate.block import BlockOptions, grid_block, simulate_block
from tests.support.full_statistics import Full, fixed, options

IMAGE = ("redundancy_line", "redundancy_sample", "redundancy_least", "w_line", "w_sample", "mdb_line_px",
         "mdb_sample_px", "external_m", "external_point", "external_image")  # fmt: skip


def table(path: Path) -> dict[str, list[str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {name: [row[name] for row in rows] for name in rows[0]}


def total(cells: list[str]) -> float:
    return sum(float(cell) for cell in cells if cell)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    chosen = BlockOptions(rows=2, columns=2, points=60, control_share=0.16, check_share=0.0)
    return simulate_block(tmp_path_factory.mktemp("block") / "block", chosen)


def run(project: Path, name: str, **given: object) -> tuple[dict[str, Any], Path]:
    out = project.parent / name
    record = run_project(project, out, overwrite=True, options={"eop_set": 16, **given})
    assert json.loads((out / "result.json").read_text("utf-8"))["reliability"] == record["reliability"]
    return record, out


@pytest.mark.oracle
def test_tables_sum_to_the_trace_of_the_full_matrix(project: Path) -> None:
    record, out = run(project, "full")
    found, rays, points = record["reliability"], table(out / "residuals.csv"), table(out / "points.csv")
    assert set(IMAGE) < set(rays)
    image = total(rays["redundancy_line"]) + total(rays["redundancy_sample"])
    control = sum(total(points[f"redundancy_{axis}"]) for axis in ("east", "north", "up"))
    solution = fg.adjust(read_project(project), eop_set=16)
    share, n = np.diag(Full.of(solution.problem, solution.state).residuals), 2 * len(rays["redundancy_line"])
    assert image == pytest.approx(share[:n].sum(), abs=1e-6)
    assert control == pytest.approx(share[n : n + 3 * int(solution.problem.observed.sum())].sum(), abs=1e-6)
    assert image == pytest.approx(found["redundancy"]["image_points"], rel=1e-12)
    assert control == pytest.approx(found["redundancy"]["control_points"], rel=1e-12)
    assert image + control + found["redundancy"]["priors"] == pytest.approx(record["redundancy"], abs=1e-7)
    assert found["redundancy_sum"] == pytest.approx(record["redundancy"], abs=1e-7)
    numbers = [float(v) for name in IMAGE[:2] for v in rays[name]]
    numbers += [float(v) for axis in ("east", "north", "up") for v in points[f"redundancy_{axis}"] if v]
    assert found["least"]["redundancy"] == min(numbers)


@pytest.mark.behaviour
def test_unbounded_effects_are_empty_cells(project: Path) -> None:
    """Points of two rays are stated as not checkable, and no cell of the tables is nan."""
    record, out = run(project, "full")
    points, rays = table(out / "points.csv"), table(out / "residuals.csv")
    two = [k for k, n in enumerate(points["n_rays"]) if n == "2" and points["role"][k] == "tie"]
    more = [k for k, n in enumerate(points["n_rays"]) if int(n) > 2]
    assert two and more
    least = dict.fromkeys(points["id"], 1.0)
    for name, value in zip(rays["id"], rays["redundancy_least"], strict=True):
        least[name] = min(least[name], float(value))
    assert all(abs(least[points["id"][k]]) < 1e-9 for k in two)
    assert all(points["external_m"][k] for k in more)
    assert "nan" not in (out / "points.csv").read_text() + (out / "residuals.csv").read_text()
    found = record["reliability"]
    assert found["n_of_these_with_two_rays"] >= 2 * len(two)
    sentences = [o["sentence"] for o in found["not_checkable"]]
    assert any("epipolar line of its two rays" in text and "any size stays unseen" in text for text in sentences)
    assert 'id="reliability"' in (out / "report.html").read_text("utf-8")


@pytest.mark.behaviour
def test_basic_leaves_them_out_and_says_so(project: Path) -> None:
    record, out = run(project, "basic", statistics="basic")
    assert record["reliability"] is None
    assert record["correlations"] is not None
    told = 'not given: redundancy numbers and minimal detectable biases; option statistics is "basic"'
    assert told in record["warnings"]
    assert not set(IMAGE) & set(table(out / "residuals.csv"))
    assert "w_east" not in table(out / "points.csv")


@pytest.mark.behaviour
def test_a_loss_leaves_the_redundancy_numbers(project: Path) -> None:
    record, out = run(project, "huber", loss="huber")
    assert record["reliability"] is None
    assert "absent.loss_but_redundancy" in [found["code"] for found in record["findings"]]
    rays = table(out / "residuals.csv")
    numbers = [float(cell) for cell in rays["redundancy_line"] if cell]
    assert len(numbers) > 50 and 0.0 <= min(numbers) < max(numbers) <= 1.0 and "mdb_line_px" not in rays


@pytest.mark.behaviour
def test_without_covariance_there_is_a_reason(grid: Block) -> None:
    solution = fg.adjust(grid, datum="free", priors=False, eop_set=2)
    assert statistics.reliability_record(solution) is None
    assert statistics.correlation_record(solution) is None
    (why,) = statistics.missing(solution)
    assert (why.code, why.data["figures"]) == ("absent.covariance", ["reliability", "correlations"])


@pytest.mark.behaviour
def test_large_blocks_are_asked_for() -> None:
    assert full_statistics(Options(), AUTO_LIMIT, 100)
    assert not full_statistics(Options(), AUTO_LIMIT + 1, 100)
    assert not full_statistics(Options(), 1000, 10_000)
    assert full_statistics(Options(statistics="full"), 10**7, 100)
    assert not full_statistics(Options(statistics="basic"), 10, 10)


@pytest.mark.behaviour
def test_limit_is_said(grid: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fg_orient.adjustment.cofactors.AUTO_LIMIT", 10)
    solution = fg.adjust(grid)
    assert statistics.image_columns(solution) == {}
    assert 'request them with option statistics "full"' in str(statistics.missing(solution)[0])


@pytest.mark.oracle
def test_correlations_are_those_of_the_covariance(grid: Block) -> None:
    """The record counts the correlations above the limit and states the largest, as the covariance has them."""
    solution = fg.adjust(options(grid, eop_set=16))
    found = statistics.correlation_record(solution)
    assert found is not None
    matrix = solution.covariance()
    sigma = np.sqrt(np.diag(matrix.values))
    r = np.abs(matrix.values / np.outer(sigma, sigma))
    pairs = np.argwhere(np.triu(r, 1) > found["limit"])
    assert found["n"] == len(pairs) > 0
    top = found["largest"][0]
    assert abs(top["correlation"]) == pytest.approx(np.triu(r, 1).max())
    i, j = (matrix.names.index(top[key]) for key in ("a", "b"))
    assert r[i, j] == pytest.approx(abs(top["correlation"]))


@pytest.mark.behaviour
def test_control_points_that_nothing_checks_are_named(grid: Block) -> None:
    """Control coordinates with sigmas of 1 cm are named as not checkable, those of fixed points are not.

    Pixels of metres do not check centimetres.
    """
    known = grid.points.known
    sigma = np.where(np.isfinite(known.sigma_enu_m), 0.01, known.sigma_enu_m)
    exact = replace(grid, points=replace(grid.points, known=replace(known, sigma_enu_m=sigma)))
    found = statistics.reliability_record(fg.adjust(fixed(exact, 1)))
    assert found is not None
    control = [o for o in found["not_checkable"] if o["image"] is None]
    assert found["n_control_coordinates_not_checkable"] == 3 * (len(grid.points.where(Role.CONTROL)) - 1)
    assert control[0]["sentence"].startswith(("East of", "North of", "Up of"))
    assert "stay unseen" in control[0]["sentence"]
    first = grid.points.ids[int(grid.points.where(Role.CONTROL)[0])]
    assert first not in [o["id"] for o in control]


@pytest.mark.oracle
def test_memory_estimate_covers_the_statistics() -> None:
    block = grid_block(BlockOptions(points=800, check_share=0.0))[0]
    solution = fg.adjust(block)
    needs = [memory.need_of(options(block, statistics=choice)).needed for choice in ("full", "basic")]
    peak = allocated(solution)
    assert peak < needs[0] - needs[1] < 3 * peak


def allocated(solution: Solution) -> int:
    statistics.reliability_of(fg.adjust(solution.block, max_iterations=1))  # what is compiled once does not count
    tracemalloc.start()
    try:
        statistics.image_columns(solution)
        stated_sigmas(solution.residual_cofactors)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
