"""The memory predicted before a run agrees with the arrays; a run above the limit is refused."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment import memory, reduced_choice, schur_reduced
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model import machine
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.orientation import orient
from fg_orient.orientation.orient import adjust
from fg_orient.simulate.block import BlockOptions, grid_block, simulate_block
from tests.support.command import in_process
from tests.support.pinhole import pinhole_block


@pytest.fixture(scope="module")
def block() -> Block:
    return grid_block(BlockOptions(points=250))[0]


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["schur", "graph", "dense"])
def test_estimate_covers_what_is_allocated_and_not_much_more(block: Block, backend: str) -> None:
    """The memory estimate of each backend is above the peak of its arrays and below four times the peak.

    tracemalloc counts arrays, but not GTSAM's own memory.
    """
    adjust(block, backend=backend, max_iterations=1)  # what is loaded or compiled once does not count
    tracemalloc.start()
    try:
        solution = adjust(block, backend=backend)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert solution.memory is not None and solution.memory.backend == backend
    assert peak < solution.memory.needed < 4.0 * peak


@pytest.mark.behaviour
def test_dense_needs_more_than_explicit_factors_and_these_more_than_eliminated_points(block: Block) -> None:
    """The estimate grows from eliminated points over explicit factors (twice as much) to dense.

    Without priors the graph has one factor for each image point.
    """
    kinds = ({"backend": "graph"}, {"backend": "graph", "priors": False, "eop_set": 1}, {"backend": "dense"})
    needed = [adjust(block, max_iterations=1, **kind).memory for kind in kinds]
    sizes = [need.needed for need in needed if need is not None]
    assert sizes == sorted(sizes) and 2.0 * sizes[0] < sizes[1] < sizes[2]


@pytest.mark.behaviour
def test_blocks_of_a_wide_network_count_only_where_they_are_formed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimate of a wide network contains the blocks of its matrix only if graph or full factor need them."""
    wide = pinhole_block(100, 500, mixed=True)[0]
    wide = replace(wide, options=replace(wide.options, statistics="basic"))
    for module in (memory, reduced_choice):
        monkeypatch.setattr(module, "ITERATIVE", 800)
    factor = memory.need_of(wide).needed
    monkeypatch.setattr(memory, "LARGEST_FULL", 800)
    monkeypatch.setattr(schur_reduced, "LARGEST_BAND", 0)
    neither = memory.need_of(wide).needed
    graph = memory.need_of(replace(wide, options=replace(wide.options, backend="graph"))).needed
    blocks = 8 * 9**2 * len(reduced_choice.pattern_of(compile_problem(wide)).block_row)
    assert neither + 2 * blocks < min(graph, factor)


@pytest.mark.behaviour
def test_refused_before_anything_is_compiled(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(_: Block) -> None:
        raise AssertionError("compiled in spite of the limit")

    monkeypatch.setattr(orient, "compiled_problem", never)
    with pytest.raises(InputError) as refused:
        adjust(block, memory_limit_gb=1e-4)
    (found,) = refused.value.problems
    assert found.code == "adjust.memory" and found.value.endswith(" GB") and "0.0001 GB" in found.message


@pytest.mark.behaviour
def test_statistics_are_left_out_where_only_they_exceed_the_limit(tmp_path: Path) -> None:
    """If only the statistics exceed the memory limit, they are omitted with a warning and sigma0 is unchanged."""
    project = simulate_block(tmp_path / "block", BlockOptions(points=900))
    full, basic = (
        in_process("adjust", project, "--statistics", kind, "--out", tmp_path / kind, "--json").json
        for kind in ("auto", "basic")
    )
    needed = [record["memory"]["needed_bytes"] for record in (full, basic)]
    limit = 0.5e-9 * sum(needed)
    assert needed[1] < 0.8 * needed[0] and full["reliability"] is not None
    less = in_process("adjust", project, "--memory-limit-gb", limit, "--out", tmp_path / "less", "--json").json
    assert less["reliability"] is None and less["memory"]["statistics_left_out"] and less["sigma0"] == full["sigma0"]
    assert [w for w in less["warnings"] if "memory limit" in w and "redundancy numbers" in w]
    assert "memory limit of" in (tmp_path / "less" / "report.html").read_text("utf-8")


@pytest.mark.behaviour
def test_a_block_above_the_limit_is_adjusted_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A block above the memory limit is adjusted in parts with the same result, and a note states the parts."""
    monkeypatch.setattr("fg_orient.adjustment.memory.PART_SIZE", 400)
    monkeypatch.setattr("fg_orient.quality.deficiency.affordable", lambda problem: False)  # as of a large block
    monkeypatch.setattr("fg_orient.quality.deficiency.ENOUGH", 1000)
    block = fg.read_project(simulate_block(tmp_path / "block", BlockOptions(points=1500)), statistics="basic")
    whole = adjust(block, backend="schur")
    least, most = (memory.need_of(block, open_share=share).needed for share in (0.1, 1.0))
    assert least < 0.9 * most
    some = adjust(block, memory_limit_gb=0.5e-9 * (least + most))
    assert some.memory.parts == memory.default_parts(len(block.observations)) > some.memory.kept >= 1
    assert some.memory.needed <= some.memory.allowed < some.memory.whole
    assert "records" not in vars(some.problem), "they were never computed as a whole"
    (note,) = [one for one in some.findings if one.code == "adjust.in_parts"]
    assert f"in {some.memory.parts} parts" in note.message
    assert some.chi2 == pytest.approx(whole.chi2, rel=1e-10)
    moved = np.abs(some.state.image - whole.state.image).max()
    assert moved < 1e-9 and np.nanmax(np.abs(some.ground_m - whole.ground_m)) < 1e-6
    for k in range(len(block.images)):
        np.testing.assert_allclose(some.cofactors.image(k), whole.cofactors.image(k), rtol=1e-6, atol=1e-12)


@pytest.mark.behaviour
def test_commands_tell_the_need_and_refuse(tmp_path: Path) -> None:
    project = simulate_block(tmp_path / "block", BlockOptions(points=60))
    told = in_process("validate", project, "--json").json["memory"]
    assert 0 < told["needed_bytes"] < told["allowed_bytes"]
    assert "memory: about " in in_process("validate", project).stdout
    ended = in_process("adjust", project, "--memory-limit-gb", "1e-4", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "adjust.memory")
    assert not (project.parent / "result").exists()
    text = project.read_text("utf-8")
    project.write_text(text.replace("[adjustment]", "[adjustment]\nmemory_limit_gb = 1e-4"), "utf-8")
    ended = in_process("validate", project, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "adjust.memory")


@pytest.mark.behaviour
def test_available_memory_is_that_of_system_and_control_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    information = tmp_path / "meminfo"
    information.write_text("MemTotal: 9000 kB\nMemAvailable:    4000 kB\n")
    monkeypatch.setattr(machine, "_MEMINFO", information)
    monkeypatch.setattr(machine, "_GROUPS", tmp_path)
    monkeypatch.setattr(machine, "_OWN_GROUPS", tmp_path / "groups")
    assert machine.available_bytes() == 4000 * 1024
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("500000\n")
    assert machine.available_bytes() == 4000 * 1024
    (tmp_path / "memory.max").write_text("2500000\n")
    assert machine.available_bytes() == 2_000_000
    (tmp_path / "memory.stat").write_text("anon 400000\ninactive_file 100000\n")
    assert machine.available_bytes() == 2_100_000, "memory of files can be given up"
    (tmp_path / "own" / "inner").mkdir(parents=True)
    (tmp_path / "groups").write_text("3:cpu:/else\n0::/own/inner\n")
    (tmp_path / "own" / "memory.max").write_text("1000000\n")
    (tmp_path / "own" / "memory.current").write_text("1\n")
    assert machine.available_bytes() == 999_999, "the group above the own one has the narrowest limit"
    (tmp_path / "own" / "memory.max").unlink()
    (tmp_path / "memory.stat").unlink()
    assert machine.allowed_bytes(None) == 1_600_000 and machine.allowed_bytes(3.0) == 3_000_000_000
    information.unlink()
    (tmp_path / "memory.max").unlink()
    found = machine.available_bytes()
    assert found is None or found > 0
