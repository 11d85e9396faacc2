"""The command ``compare`` is tested: folder, record, report, figures, refusals."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from markupsafe import escape

from fg_orient.report import chart, paper
from fg_orient.report.page import script_hash
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from fg_orient.studies.comparison import folder as comparison_folder
from fg_orient.studies.comparison import plots
from fg_orient.studies.comparison import report as heat
from fg_orient.studies.comparison.model import COLUMNS, Comparison
from fg_orient.studies.comparison.report import ranges, render, three_digits, verdict
from tests.support.page import structure

FIGURES = {
    "heatmap_control.svg", "heatmap_check.svg", "conditions.svg", "spectra.svg", "l_curves.svg", "seconds.svg",
    "error_vectors_solvers.svg", "error_vectors_sets.svg",
}  # fmt: skip
TABLES = {
    "compare.csv", "sets.csv", "spectra.csv", "directions.csv", "l_curves.csv", "error_vectors.csv", "result.json",
    "report.html",
}  # fmt: skip
#: Keys that the documentation promises.
ROW_KEYS = {
    "eop_set", "solver", "backend", "control_rmse_m", "check_rmse_m", "cond_raw", "cond_scaled", "rank", "reached",
}  # fmt: skip


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def same(text: str, value: Any) -> bool:
    """Return whether a cell has a value to its last digit."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return text == ""
    if isinstance(value, bool):
        return text == str(value).lower()
    return float(text) == value if isinstance(value, (int, float)) else text == value


@pytest.mark.behaviour
def test_folder_and_exit_code(written: tuple[Path, Any]) -> None:
    out, ended = written
    assert ended.code == 0, ended.stderr
    assert {p.name for p in out.iterdir()} == TABLES | FIGURES
    assert not list(out.parent.glob(".*"))
    assert json.loads((out / "result.json").read_text("utf-8")) == ended.json | {"out": out.name}


@pytest.mark.behaviour
def test_json_keys(written: tuple[Path, Any]) -> None:
    record = written[1].json
    assert set(record["rows"][0]) == set(COLUMNS) >= ROW_KEYS
    assert {"seconds", "target_m", "verdict", "summary", "provenance", "out", "warnings"} <= set(record)
    assert record["provenance"]["inputs"] and record["warnings"] == []


@pytest.mark.consistency
def test_table_equals_the_rows_of_the_library(written: tuple[Path, Any], comparison: Comparison) -> None:
    """``compare`` writes the rows of its record to the table, with the check RMSE of the library."""
    found = rows_of(written[0] / "compare.csv")
    assert list(found[0]) == list(COLUMNS)
    assert len(found) == len(comparison.rows)
    for text, row, record in zip(found, comparison.rows, written[1].json["rows"], strict=True):
        assert all(same(text[name], record[name]) for name in COLUMNS), (text, record)
        assert (text["backend"], text["solver"], text["eop_set"]) == (row.backend, row.solver, str(row.eop_set))
        if row.backend != "faithful" and not row.failure:
            assert float(text["check_rmse_m"]) == pytest.approx(row.check_rmse_m, rel=1e-7)
        assert text["failure"] == "" or not text["check_rmse_m"]


@pytest.mark.consistency
def test_spectra_table(written: tuple[Path, Any]) -> None:
    found = rows_of(written[0] / "spectra.csv")
    graph = next(r for r in written[1].json["rows"] if (r["backend"], r["eop_set"]) == ("graph", 2))
    values = [float(r["singular_value"]) for r in found
              if (r["eop_set"], r["system"], r["scaling"]) == ("2", "adjustment", "raw")]  # fmt: skip
    assert len(values) == graph["order"]
    assert (values[0] / values[-1]) ** 2 == pytest.approx(graph["cond_raw"], rel=1e-12)


@pytest.mark.behaviour
def test_report_is_one_safe_file(written: tuple[Path, Any]) -> None:
    text = (written[0] / "report.html").read_text("utf-8")
    found = structure(text)
    assert found.tags.count("svg") == len(FIGURES) - 2  # the heat maps are tables
    assert not {"link", "iframe", "object", "embed"} & set(found.tags)
    assert found.tags.count("script") == 1 and script_hash() in text.replace("&#39;", "'")
    assert not [name for name, _ in found.attributes if name.startswith("on")]
    links = [v for name, v in found.attributes if name in ("src", "href", "xlink:href")]
    assert all(v.startswith(("#", "data:image/png;base64,")) for v in links)
    ids = [v for name, v in found.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    assert {v[1:] for v in links if v.startswith("#")} <= set(ids)
    assert set(re.findall(r"url\(#([^)]+)\)", text)) <= set(ids)
    assert "prefers-color-scheme: dark" in text and chart.INK not in text.split("</style>", 1)[1]
    assert text.index('id="verdict"') < text.index('id="outcomes"') < text.index("<svg")


@pytest.mark.behaviour
def test_report_and_figures_escape_what_others_wrote(comparison: Comparison, written: tuple[Path, Any]) -> None:
    spoiled = replace(comparison, labels=comparison.labels | {"qr": "<script>$x_1$&"})
    figures = plots.figures(spoiled)
    for text in figures.values():
        ElementTree.fromstring(text)
    assert "&lt;script&gt;$x_1$&amp;" in figures["seconds.svg"]
    record = written[1].json | {"name": "<script>alert(1)</script>"}
    html = render(spoiled, record, figures)
    assert structure(html).tags.count("script") == 1 and "alert(1)</script>" not in html


@pytest.mark.behaviour
def test_figures_show_the_numbers(written: tuple[Path, Any], comparison: Comparison) -> None:
    text = (written[0] / "heatmap_check.svg").read_text("utf-8")
    graph = comparison.select(backend="graph", eop_set=17)[0]
    assert f">{graph.check_rmse_m:.2g}</text>" in text
    assert "graph · GTSAM" in text and "published 2 · Moore-Penrose" in text
    assert "dense · Cramer" not in text  # never tried


@pytest.mark.consistency
def test_heat_maps_and_outcomes_are_the_rows(comparison: Comparison, written: tuple[Path, Any]) -> None:
    """Each row of a comparison is in its field of the heat map, on the right side of the target, and is counted."""
    counted = heat.counts(comparison)
    assert sum(counted.values()) == len(comparison.rows) and counted["left_out"] == 9
    assert counted["reached"] == sum(r.reached for r in comparison.rows)
    shown = {name: dict(zip(comparison.eop_sets, cells, strict=True))
             for name, _, cells in heat.heat_map(comparison, "check")}  # fmt: skip
    for row in comparison.rows:
        name = row.key.name(comparison.labels)
        if row.left_out:
            assert name not in shown
            continue
        cell = shown[name][row.eop_set]
        if row.failure:
            assert (cell.kind, cell.text) == ("none", "–") and row.failure in cell.words
        else:
            assert (cell.kind[0] == "b") == (row.check_rmse_m <= comparison.target_m)
            assert cell.text == chart.short(row.check_rmse_m)
    assert [name for _, name in heat.STEPS] == [kind for kind, _ in heat.steps(5.0)]
    assert dict(heat.steps(5.0)) | {"b1": "≤ 5 m", "o3": "> 500 m"} == dict(heat.steps(5.0))
    page = (written[0] / "report.html").read_text("utf-8")
    for key, (sign, words, meaning) in heat.OUTCOMES.items():
        assert f"<b>{sign} {counted[key]}</b> {words}<span>{meaning}</span>" in page


@pytest.mark.behaviour
def test_rows_without_numbers_have_their_reason_in_the_page(comparison: Comparison, written: tuple[Path, Any]) -> None:
    page = (written[0] / "report.html").read_text("utf-8")
    parts = dict(re.findall(r'<section id="([\w-]+)">(.*?)</section>', page, re.DOTALL))
    untried = [row for row in comparison.rows if row.left_out]
    assert len(untried) == 9 and all(row.failure for row in untried)
    assert {
        (n, sets) for n, sets in re.findall(r'</td><td>(\d+)</td><td class="text">([^<]*)</td>', parts["left-out"])
    } == {("3", ranges(comparison.eop_sets))}
    for name in ("cramer_inverse", "tikhonov_od"):
        reason = next(row.failure for row in untried if row.solver == name)
        assert str(escape(reason)) in parts["left-out"] and str(escape(reason)) not in parts.get("failures", "")


@pytest.mark.behaviour
def test_condition_numbers_stand_by_set(comparison: Comparison, written: tuple[Path, Any]) -> None:
    page = (written[0] / "report.html").read_text("utf-8")
    part = page.partition('id="condition-table"')[2].partition("</section>")[0]
    heads = re.findall(r'<th scope="col">([^<]*)</th>', part)[1:]
    rows = {
        int(n): re.findall(r'data-v="([^"]*)"', cells) for n, cells in re.findall(r"<tr><td>(\d+)</td>(.*?)</tr>", part)
    }
    assert tuple(rows) == comparison.eop_sets
    for s in comparison.spectra:
        shown = rows[s.eop_set][heads.index(f"{s.system}, {s.scaling}")]
        assert float(shown) == pytest.approx(s.condition, rel=1e-8)


@pytest.mark.behaviour
def test_verdict_in_words(comparison: Comparison) -> None:
    found = verdict(comparison)
    text, details = " ".join(found["text"]), " ".join(found["details"])
    assert found["kind"] == "good"
    assert found["title"] == "Take EOP set 2 (PU0) with graph · GTSAM, Gauss-Newton"
    assert text.startswith("Set: 3-D RMSE 4.04 m at 10 check points. 2 sets left aside: only priors determine")
    assert re.search(r"Engine: 16 of 19 engines give the same solution \(within \de-\d+ prior sigmas", text)
    assert ", 3 were not tried. Processor time: the default " in text
    assert "predicted 2.34 m at the check points, at most 3.17 m in 95 % of cases; actual check 2.57 m" in text
    assert 'In the project file: eop_set = 2, backend = "graph", optimizer = "gauss-newton".' in text
    assert "The graph with eliminated points (GTSAM): 2 of 3 sets at the target, not 5 (worst: control" in details
    assert "with each of 3 solvers" in details
    assert "published procedure, type 1: none of 3 sets at the target" in details
    assert re.search(r"differ from the adjustment by at most \d\.\de-\d+ prior sigmas", details)
    left = "dense · Cramer inverse; dense · Tikhonov OD; arrays · band Cholesky, LAPACK."
    assert f"Not tried (9 rows; each says why): {left}" in details


@pytest.mark.behaviour
def test_words_for_numbers() -> None:
    assert ranges([20, 1, 5, 6, 7, 1]) == "1, 5-7, 20"
    assert ranges([]) == ""
    shown = [three_digits(v) for v in (0.0, 1.234, 0.001, 2e6, math.nan, None)]
    assert shown == ["0.00", "1.23", "1e−3", "2e6", "–", "–"]


@pytest.mark.behaviour
def test_tables_for_people(run: Any, project: Path, tmp_path: Path) -> None:
    ended = run("compare", project, "--eop-sets", "2", "--solvers", "qr", "--types", "1", "--out", tmp_path / "out")
    assert ended.code == 0, ended.stderr
    assert ended.stdout.startswith("Take EOP set 2 (PU0) with graph")
    assert re.search(r"2 PU0\s+6\s+4.04", ended.stdout)
    shown = ended.stdout.splitlines()
    assert len(shown) < 40  # one screen
    for engine in ("graph", "explicit graph", "arrays", "dense"):
        assert any(line.strip().startswith(engine) for line in shown)
    assert "report.html" in ended.stdout
    assert max(map(len, ended.stdout.splitlines())) < 200


@pytest.mark.behaviour
def test_without_matplotlib(run: Any, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "find_spec", lambda name: None)
    out = tmp_path / "out"
    ended = run("compare", project, "--eop-sets", "2", "--backends", "graph", "--out", out)
    assert ended.code == 0
    assert [line for line in ended.stdout.splitlines() if "matplotlib is not installed" in line]
    assert {p.name for p in out.iterdir()} == TABLES - {
        "l_curves.csv",
        "error_vectors.csv",
    }  # of the published procedure alone
    assert "svg" not in structure(out / "report.html").tags


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "place"),
    [
        (("--eop-sets", "1-21"), "--eop-sets"),
        (("--solvers", "gauss"), "--solvers"),
        (("--backends", "sparse"), "--backends"),
        (("--time-limit", "0"), "--time-limit"),
        (("--types", "0"), "--types"),
        (("--target", "-1"), "--target"),
        (("--look-polynomial", "9", "--backends", "graph"), "--look-polynomial"),
    ],
)
def test_bad_options_are_one_line(run: Any, project: Path, tmp_path: Path, words: tuple[str, ...], place: str) -> None:
    out = tmp_path / "out"
    ended = run("compare", project, *words, "--out", out)
    assert ended.code == 2
    assert ended.stderr.startswith(f"error: {place}: ")
    assert len(ended.stderr.splitlines()) == 1
    assert not out.exists()
    as_json = run("compare", project, *words, "--out", out, "--json")
    assert [e["place"] for e in as_json.json["errors"]] == [place]


@pytest.mark.behaviour
def test_missing_project_and_missing_control(run: Any, project: Path, tmp_path: Path) -> None:
    assert run("compare", tmp_path / "no.toml").code == 2
    shutil.copytree(project.parent, tmp_path / "twin")
    points = tmp_path / "twin" / "points.csv"
    points.write_text(points.read_text("utf-8").replace(",control,", ",check,"), "utf-8")
    ended = run("compare", tmp_path / "twin" / "project.toml", "--out", tmp_path / "out")
    assert ended.code == 2
    assert len(ended.stderr.splitlines()) == 1 and "control" in ended.stderr


@pytest.mark.behaviour
def test_existing_folders(run: Any, project: Path, written: tuple[Path, Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(written[0], out)
    words = ("compare", project, "--eop-sets", "2", "--backends", "graph", "--out", out)
    assert run(*words).code == 2
    assert len(rows_of(out / "compare.csv")) == len(written[1].json["rows"])
    assert run(*words, "--overwrite").code == 0
    assert len(rows_of(out / "compare.csv")) == 3  # optimisers
    (out / "mine.txt").write_text("kept", "utf-8")
    assert run(*words, "--overwrite").code == 2
    assert (out / "mine.txt").read_text("utf-8") == "kept"


@pytest.mark.behaviour
def test_no_solution_at_all(run: Any, tmp_path: Path) -> None:
    """If no adjustment has a solution, ``compare`` ends with exit code 3 and the reason, and writes nothing.

    Two control points do not determine a look-angle polynomial.
    """
    project = simulate_zonguldak(tmp_path / "twin", ZonguldakOptions())
    points = project.parent / "points.csv"
    lines = points.read_text("utf-8").splitlines()
    control = [i for i, line in enumerate(lines) if ",control," in line]
    for i in control[2:]:
        lines[i] = lines[i].replace(",control,", ",check,")
    points.write_text("\n".join(lines) + "\n", "utf-8")
    out = tmp_path / "out"
    ended = run("compare", project, "--eop-sets", "2", "--backends", "faithful", "--out", out)
    assert ended.code == 3
    assert "different columns" in ended.stderr and not out.exists()


@pytest.mark.behaviour
def test_interrupted_run_leaves_nothing(
    run: Any, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison_folder, "write_folder", stop)
    out = tmp_path / "deep" / "out"
    ended = run("compare", project, "--eop-sets", "2", "--backends", "graph", "--out", out)
    assert ended.code == 130
    assert not out.parent.exists()


@pytest.mark.behaviour
def test_figures_repeat_to_the_last_byte(comparison: Comparison) -> None:
    few = replace(comparison, rows=(), curves=())
    assert set(plots.figures(few)) == {"conditions.svg", "spectra.svg"}
    assert plots.figures(few) == plots.figures(few)


@pytest.mark.behaviour
def test_figures_of_rows_without_any_solution(comparison: Comparison) -> None:
    rows = tuple(r for r in comparison.rows if r.failure)
    assert rows and all(not np.isfinite(r.check_rmse_m) for r in rows)
    drawn = plots.figures(replace(comparison, rows=rows, spectra=(), curves=()))
    assert set(drawn) == set()
