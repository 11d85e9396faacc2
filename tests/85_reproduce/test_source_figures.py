"""Figures of the publications have the numbers of their tables; missing figures state the reason."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from fg_orient.model.names import Role
from fg_orient.report.chart import Chart, short
from fg_orient.studies.error_maps import places_km
from fg_orient.studies.reproduce.figures import figures
from fg_orient.studies.reproduce.folder import reproduce_to
from fg_orient.studies.reproduce.reproduction import Reproduction, reproduce
from fg_orient.studies.tables_twin import twin


def drawn(name: str, tables: str) -> dict[str, tuple[Chart, ...]]:
    return {one.name: one.charts for one in figures(found(name, tables))}


def found(name: str, tables: str) -> Reproduction:
    return reproduce(name, tables=tables, n_seeds=1, claims=False, permutations=1)


def labels(chart: Chart) -> dict[str, str]:
    return {mark.kind: mark.label for mark in chart.marks if mark.label}


@pytest.mark.consistency
def test_panels_state_the_rmse_of_their_table() -> None:
    """Each panel of P-Figs. 5 and 6 states the largest axis RMSE of the cells of its run."""
    of_paper = found("topan2010", "1")
    cells: dict[tuple[str, str, str], list[float]] = {
        (r.key.point_set, r.key.stage, r.key.point_role): [] for r in of_paper.rows
    }
    for row in of_paper.rows:
        cells[row.key.point_set, row.key.stage, row.key.point_role].append(row.reproduced)
    stages = {"5": "pre-adjusted", "6": "bundle"}
    panels = {one.name: one.charts for one in figures(of_paper)}
    checked = 0
    for name, stage in stages.items():
        for chart in panels[name]:
            for kind, role in (("control", "gcp"), ("check", "icp")):
                key = next((k for k in cells if k[0] == chart.title and k[1:] == (stage, role)), None)
                if key is not None:
                    assert labels(chart)[kind] == f"{kind}: {short(max(cells[key]))} m"
                    checked += 1
    assert checked >= 8


@pytest.mark.oracle
def test_vectors_are_errors_in_east_and_north() -> None:
    """Drawn vectors are adjusted minus measured places in East and North, by PROJ's topocentric conversion."""
    (chart,) = [c for c in drawn("topan2010", "1")["5"] if c.title == "H-20"]
    run = twin(1, "H-20")
    errors = run.look_only()
    known = run.block.points.known.ecef_m[run.block.points.where(Role.CONTROL)]
    lon, lat, _ = Transformer.from_crs(4978, 4979, always_xy=True).transform(*known.mean(axis=0))
    local = Transformer.from_pipeline(f"+proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0=0")
    mark = next(m for m in chart.marks if m.kind == "check")
    at = {n: p for n, p in zip(run.block.withheld.ids, run.block.withheld.open().ecef_m, strict=True)}
    measured = np.array([at[name] for name in errors.icp_ids])
    east, north, _ = np.array(local.transform(*(measured - errors.icp_m).T)) - np.array(local.transform(*measured.T))
    assert mark.vectors == pytest.approx(np.column_stack([east, north]), abs=1e-6)
    assert len(errors.icp_ids) == 20


@pytest.mark.behaviour
def test_layouts_show_each_point_once() -> None:
    for name, expected in (("terlemezoglu2019", {"H-10"}), ("topan2010", {"H-0", "H-20", "G-A", "G-B"})):
        layouts = drawn(name, "text" if name == "topan2010" else "4.1")[
            "4.2" if name[0] == "t" and "e" in name[:2] else "4"
        ]
        assert {chart.title for chart in layouts} == expected
        for chart in layouts:
            run = twin(1, chart.title)
            counted = {mark.kind: len(mark.x) for mark in chart.marks}
            assert counted["control"] == len(run.control_ids)
            assert sum(counted.values()) == len(places_km(run.block))


@pytest.mark.truth
def test_lines_of_ayhan_are_the_printed_numbers() -> None:
    """The lines of Ayhan's tables 5 and 13 are the printed numbers, and rings where print gives the number.

    Sums of squares are RMS in mm, differences are in cm.
    """
    panels = drawn("ayhan1996", "5,13")
    (accuracy,), (surfaces,) = panels["24-37, table 5"], panels["24-37, table 13"]
    depth = next(m for m in accuracy.marks if m.label == "Y")
    assert depth.y[0] == pytest.approx(10.0 * math.sqrt(2.01 / 49.0))
    assert [m.label for m in surfaces.marks if m.label] == ["a", "b", "X0", "Y0", "Z0"]
    case_i = [float(m.y[0]) for m in surfaces.marks if m.label]
    assert case_i == [-0.02, 0.03, -0.20, 0.10, 0.02]
    rings = [m for m in surfaces.marks if m.kind == "ring"]
    assert len(rings) == 5 and all(m.x.tolist() == [0.0] for m in rings)


@pytest.mark.behaviour
def test_the_folder_has_page_files_and_reasons(tmp_path: Path) -> None:
    reproduce_to("ayhan1996", tmp_path / "out", tables="5,ek1.points,ek2.control")
    record = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    missing = {one["name"]: one["missing"] for one in record["figures"]}
    assert missing["20"] == "" and "not in the text" in missing["21"]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert 'id="figures"' in page and re.search(r"Fig\. 21 .*not drawn", page)
    pytest.importorskip("matplotlib")
    files = sorted(path.name for path in (tmp_path / "out" / "figures").iterdir())
    assert files == ["captions.md", *sorted(f"fig-{n}.{k}" for n in ("20", "24-37-table-5") for k in ("pdf", "svg"))]
    assert "Not drawn" in (tmp_path / "out" / "figures" / "captions.md").read_text("utf-8")
