"""The command ``graph`` draws and counts the factor graph."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import gtsam
import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.explicit import point_key
from fg_orient.adjustment.graph_structure import ORDERINGS, Structure, explicit_structure, reduced_structure
from fg_orient.adjustment.native import with_observations
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.report.graph import IMAGES, POINTS, write_graph
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak, zonguldak_block
from tests.support.command import in_process


@lru_cache
def twin() -> Block:
    return zonguldak_block(ZonguldakOptions(seed=1))[0]


@lru_cache
def grid() -> Block:
    return grid_block(BlockOptions(rows=3, columns=3, points=150, seed=3))[0]


@lru_cache
def structure() -> Structure:
    return explicit_structure(compile_problem(grid()))


@pytest.mark.oracle
@pytest.mark.parametrize("name", ORDERINGS)
def test_fill_equals_elimination_by_hand(name: str) -> None:
    """Fill and largest clique equal an elimination of a full boolean matrix, one variable after the other."""
    own = structure()
    order = own.ordering(name)
    assert sorted(order) == list(range(len(own.names)))
    joined = np.zeros((len(own.names),) * 2, bool)
    for factor in own.factors:
        joined[np.ix_(factor, factor)] = True
    before, largest = joined.copy(), 0
    left = np.ones(len(own.names), bool)
    for v in order:
        left[v] = False
        rest = np.flatnonzero(joined[v] & left)
        joined[np.ix_(rest, rest)] = True
        largest = max(largest, int(own.sizes[v] + own.sizes[rest].sum()))
    weight = np.outer(own.sizes, own.sizes)
    counts = own.eliminated(order).counts
    assert counts["fill"] == np.triu(weight * (joined & ~before), 1).sum() > 0
    triangle = np.repeat(np.repeat(before, own.sizes, axis=0), own.sizes, axis=1)
    assert counts["nonzeros_normal_matrix"] == np.triu(triangle).sum()
    assert counts["largest_clique_unknowns"] == largest


@pytest.mark.oracle
@pytest.mark.parametrize("name", ORDERINGS)
def test_cliques_are_those_of_gtsam(name: str) -> None:
    own = structure()
    order, graph = gtsam.Ordering(), gtsam.SymbolicFactorGraph()
    for v in own.ordering(name):
        order.push_back(v)
    for factor in own.factors:
        graph.push_factor(*factor)
    tree = own.eliminated(own.ordering(name))
    assert len(tree.cliques) == graph.eliminateMultifrontal(order).size()
    assert sorted(v for frontals, _, _ in tree.cliques for v in frontals) == list(range(len(own.names)))
    for frontals, separator, parent in tree.cliques:
        above = set() if parent < 0 else {*tree.cliques[parent][0], *tree.cliques[parent][1]}
        assert set(separator) <= above
        assert not set(frontals) & above


@pytest.mark.consistency
def test_counts_are_those_of_the_graphs() -> None:
    """The structures have the factors, variables and points of the graphs, explicit and eliminated.

    Points of a GTSAM factor are variables, all others are inside the groups.
    """
    ties = np.flatnonzero(compile_problem(twin()).active)[:2].tolist()
    between = gtsam.BetweenFactorPoint3(*map(point_key, ties), np.zeros(3), gtsam.noiseModel.Unit.Create(3))
    for block in (grid(), replace(twin(), extra=(between,))):
        problem = compile_problem(with_observations(block))
        for points, own in (("explicit", explicit_structure(problem)), ("eliminated", reduced_structure(problem))):
            graph = fg.factor_graph(block, points=points)  # type: ignore[arg-type]
            assert len(own.factors) == graph.graph.size()
            assert set(own.names) == {graph.name(key) for key in graph.values.keys()}
            expected = sorted(sorted(map(graph.name, graph.graph.at(k).keys())) for k in range(graph.graph.size()))
            assert sorted(sorted(own.names[v] for v in factor) for factor in own.factors) == expected
            held = len(problem.block.points.ids) - own.counts["points"] - int((~problem.active).sum())  # type: ignore[operator]
            assert sum(own.points) == (held if points == "eliminated" else 0)


@pytest.mark.behaviour
def test_command_draws_and_counts(tmp_path: Path) -> None:
    project = simulate_zonguldak(tmp_path / "twin", ZonguldakOptions(seed=1))
    ended = in_process("graph", project, "--out", tmp_path / "graph", "--json")
    assert ended.code == 0
    record = json.loads(ended.stdout)
    assert record["explicit"]["factors_by_kind"] == {"image point": 94, "control point": 37, "image prior": 2}
    assert record["eliminated"]["variables"] == 2
    folder = tmp_path / "graph"
    names = {f"{name}.{kind}" for name in ("graph", "reduced", "tree", "matrix") for kind in ("svg", "pdf")}
    assert {path.name for path in folder.iterdir()} == names | {"captions.md", "graph.json"} == set(record["files"])
    kept = json.loads((folder / "graph.json").read_text("utf-8"))
    assert kept | {"out": str(folder), "files": record["files"]} == record
    svg = (folder / "reduced.svg").read_text("utf-8")
    assert "47 points" in svg
    assert ">left<" in svg
    again = in_process("graph", project, "--out", folder)
    assert again.code == 2
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    ended = in_process("graph", project, "--out", folder, "--overwrite")
    assert ended.code == 0
    assert "points first" in ended.stdout
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    ended = in_process("graph", project, "--out", tmp_path / "bare", "--no-priors", "--eop-set", "2")
    assert ended.code == 0
    assert "does not eliminate" in (tmp_path / "bare" / "captions.md").read_text("utf-8")
    assert not (tmp_path / "bare" / "reduced.svg").exists()


@pytest.mark.behaviour
def test_command_refuses_what_adjust_refuses(tmp_path: Path) -> None:
    refused, adjust = (in_process(name, tmp_path / "none.toml", "--json") for name in ("graph", "adjust"))
    assert refused.code == adjust.code == 2
    assert refused.json["errors"] == adjust.json["errors"] != []
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "letter.txt").write_text("mine")
    with pytest.raises(InputError):
        write_graph(twin(), tmp_path / "own", overwrite=True)
    assert (tmp_path / "own" / "letter.txt").read_text() == "mine"


@pytest.mark.behaviour
def test_large_blocks_are_thinned_in_drawings_only(tmp_path: Path) -> None:
    record = write_graph(grid(), tmp_path / "graph")
    assert record["explicit"]["image_vectors"] == 9
    assert record["explicit_is_whole"]
    assert record["drawn"]["image_vectors"] == IMAGES < 9
    assert record["drawn"]["points"] == POINTS
    text = (tmp_path / "graph" / "captions.md").read_text("utf-8")
    assert f"Only {IMAGES} image vectors and {POINTS} ground points are drawn." in text


@pytest.mark.behaviour
def test_without_an_explicit_graph_only_the_drawn_part_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fg_orient.report.graph.EXPLICIT_LIMIT", 10)
    record = write_graph(grid(), tmp_path / "graph")
    assert not record["explicit_is_whole"]
    assert record["explicit"] == record["drawn"]
    assert record["eliminated"]["image_vectors"] == 9
