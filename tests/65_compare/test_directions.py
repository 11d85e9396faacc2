"""Directions in a comparison have the names of ``adjust``; Tikhonov solvers have curves."""

from __future__ import annotations

import csv
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.studies.comparison import plots
from fg_orient.studies.comparison.compare import compare
from fg_orient.studies.comparison.model import Comparison, Curve, Direction
from fg_orient.studies.comparison.report import render
from fg_orient.studies.two_stage import TwoStage


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.consistency
@pytest.mark.parametrize("number", [2, 5, 17])
def test_directions_are_those_of_adjust(twin: Block, comparison: Comparison, number: int) -> None:
    solution = fg.adjust(twin, eop_set=number)
    mine = [d for d in comparison.directions if d.eop_set == number]
    silent = [f"image {d.image}: {d.words}" for d in mine if d.held_by == "nothing"]
    assert silent == [s for s in solution.unobservable if s.startswith("image")]
    assert len(silent) == sum(solution.rank_defect.values())
    held = [(d.image, d.words) for d in mine if d.held_by == "prior" and d.image]
    assert held == [(o.image, words) for o in solution.observability for words in o.held]


@pytest.mark.behaviour
def test_motions_of_the_block_are_named_too(twin: Block) -> None:
    """A comparison names the motions of the block that priors hold, as ``adjust`` does.

    One control point leaves rotations of the block to the priors.
    """
    roles = twin.points.roles
    first = next(k for k, role in enumerate(roles) if role == "control")
    o = twin.observations
    kept = np.isin(o.point, [first, *(k for k, role in enumerate(roles) if role != "control")])
    block = replace(twin, observations=o.take(np.flatnonzero(kept)))
    found = compare(block, eop_sets=16, backends="graph")
    of_block = [d for d in found.directions if not d.image]
    assert of_block and all(d.held_by == "prior" for d in of_block)
    said = [s for s in fg.adjust(block, eop_set=16).unobservable if s.startswith("block")]
    assert [f"block: {d.words}" for d in of_block] == said


@pytest.mark.behaviour
def test_page_and_table_name_them(written: tuple[Path, Any], comparison: Comparison) -> None:
    text = (written[0] / "report.html").read_text("utf-8")
    part = text.partition('<section id="directions"')[2].partition("</section>")[0]
    shown = re.findall(r"<tr><td[^>]*>(.*?)</td><td[^>]*>(.*?)</td><td[^>]*>(.*?)</td><td[^>]*>(.*?)</td></tr>", part)
    assert {(words, held == "nothing") for words, held, _, _ in shown} == {
        (d.words, d.held_by == "nothing") for d in comparison.directions
    }
    yaw = next(row for row in shown if row[0].startswith("velocity across track acts as yaw (constant)"))
    assert yaw[1:] == ("nothing", "left, right", "17")
    # "nothing" stands before "its prior"
    assert [row[1] for row in shown] == sorted((row[1] for row in shown), reverse=True)
    table = rows_of(written[0] / "directions.csv")
    assert [tuple(r.values()) for r in table] == [
        (str(d.eop_set), d.image, d.words, d.held_by) for d in comparison.directions
    ]
    assert written[1].json["directions"] == [asdict(d) for d in comparison.directions]


@pytest.mark.behaviour
def test_titles_of_the_spectra_count_unobservable_directions(comparison: Comparison) -> None:
    drawn = plots.figures(comparison)["spectra.svg"]
    assert "17 VA (18)" in drawn and "2 PU0<" in drawn


@pytest.mark.behaviour
def test_the_axis_of_run_times_is_not_cut_off(comparison: Comparison) -> None:
    figure = plots._seconds(comparison)
    assert figure is not None
    figure.draw_without_rendering()
    label = figure.axes[0].xaxis.label
    extent = label.get_window_extent()
    assert label.get_text().endswith(", s")
    assert figure.bbox.x0 <= extent.x0 and extent.x1 <= figure.bbox.x1


@pytest.mark.behaviour
def test_hostile_image_ids_are_escaped(comparison: Comparison, written: tuple[Path, Any]) -> None:
    hostile = (Direction(2, "<img src=x>", "<b>", "nothing"),)
    text = render(replace(comparison, directions=hostile), written[1].json, {})
    assert "<img src=x>" not in text and "&lt;img src=x&gt;" in text and "&lt;b&gt;" in text


@pytest.mark.consistency
def test_curves_are_those_of_the_published_bundle(
    twin: Block, comparison: Comparison, written: tuple[Path, Any]
) -> None:
    """The L-curve of a Tikhonov solver contains the kappa and norms of the published bundle."""
    assert [(c.eop_set, c.type) for c in comparison.curves] == [
        (n, kind) for n in comparison.eop_sets for kind in (1, 2)
    ]
    bundle = TwoStage(twin).bundle(2, 1, "tikhonov_od")
    assert bundle.system is not None
    design, observed = bundle.system.require_design("test")
    curve = next(c.curve for c in comparison.curves if (c.eop_set, c.type) == (2, 1))
    choice = next(c for c in curve.choices if c.rule == "od")
    (row,) = comparison.select(eop_set=2, type=1, solver="tikhonov_od")
    assert choice.kappa == row.kappa == bundle.solution.kappa
    assert choice.solution_norm == pytest.approx(float(np.linalg.norm(bundle.solution.x)), rel=1e-6)
    left = float(np.linalg.norm(design @ bundle.solution.x - observed))
    assert choice.residual_norm == pytest.approx(left, rel=1e-6)
    table = [r for r in rows_of(written[0] / "l_curves.csv") if (r["eop_set"], r["type"], r["rule"]) == ("2", "1", "")]
    assert [float(r["kappa"]) for r in table] == pytest.approx(curve.kappa.tolist(), rel=1e-6, abs=0.0)


@pytest.mark.consistency
def test_curves_survive_the_way_from_a_worker(comparison: Comparison) -> None:
    one = comparison.curves[0]
    again = Curve.from_dict(asdict(one))
    assert np.array_equal(again.curve.solution_norm, one.curve.solution_norm)
    assert repr(again.curve.choices) == repr(one.curve.choices)


@pytest.mark.behaviour
def test_without_a_tikhonov_solver_there_is_no_curve(twin: Block) -> None:
    found = compare(twin, eop_sets=2, solvers="qr", backends="faithful", types=1)
    assert found.curves == () == found.directions and "l_curves.svg" not in plots.figures(found)
