"""The tests run the command and check its folder."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fg_orient.cli import app
from fg_orient.report.page import script_hash
from fg_orient.studies.reproduce.verdict import KINDS

pytestmark = pytest.mark.behaviour

QUICK = ("--tables", "eq4.1-4.2", "--seeds", "1", "--no-claims")


def run(*words: object) -> Any:
    """Run fg-orient in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return the folder and JSON of a run of a few tables and the claims; not to be changed."""
    out = tmp_path_factory.mktemp("reproduced") / "topan"
    done = run("reproduce", "topan2010", "--tables", "text,1", "--seeds", "1", "--out", out, "--json")
    assert done.exit_code == 0, done.output
    return out, json.loads(done.stdout)


def test_json_has_the_stable_keys(written: tuple[Path, dict[str, Any]]) -> None:
    out, record = written
    assert record["out"] == str(out)
    assert len(record["rows"]) == 35 + 63
    assert {"table", "cell", "published", "reproduced", "verdict", "low", "high", "reason"} <= set(record["rows"][0])
    assert {row["verdict"] for row in record["rows"]} <= set(KINDS)
    assert {"id", "passed", "of", "interval", "met", "text", "reason"} <= set(record["claims"][0])
    assert [claim["id"] for claim in record["claims"]][:3] == ["C1", "C2", "C3"]


def test_folder_holds_tables_record_and_report(written: tuple[Path, dict[str, Any]]) -> None:
    out, record = written
    names = {p.name for p in out.iterdir()} - {"figures"}  # drawn with matplotlib only
    assert names == {"cells.csv", "claims.csv", "report.html", "result.json"}
    with (out / "cells.csv").open(encoding="utf-8") as stream:
        cells = list(csv.DictReader(stream))
    assert [c["verdict"] for c in cells] == [r["verdict"] for r in record["rows"]]
    result = json.loads((out / "result.json").read_text("utf-8"))
    assert sum(result["verdicts"].values()) == len(cells)
    assert sum(sum(t["verdicts"].values()) for t in result["tables"].values()) == len(cells)
    first = result["tables"]["1"]
    assert sum(first["shuffled"].values()) == pytest.approx(60)
    assert not any(result["tables"]["text"]["shuffled"].values())  # nothing to exchange with
    assert 0 <= first["gained"] <= first["verdicts"]["order"]
    assert result["options"] == {"tables": ["text", "1"], "seeds": [1], "as_run": False}
    assert {"numpy", "fg_orient"} <= set(result["versions"])
    assert len(result["published_sha256"]) == 3
    with (out / "claims.csv").open(encoding="utf-8") as stream:
        assert [c["id"] for c in csv.DictReader(stream)] == [c["id"] for c in record["claims"]]


def test_report_is_one_static_file_with_every_cell(written: tuple[Path, dict[str, Any]]) -> None:
    out, record = written
    html = (out / "report.html").read_text("utf-8")
    assert html.count("<script") == 1 and script_hash() in html
    assert not re.search(r" (src|href|on[a-z]+)=\"(?!#)", html)
    assert html.count('data-label="published"') == len(record["rows"])
    for kind in KINDS:
        counted = sum(row["verdict"] == kind for row in record["rows"])
        assert html.count(f'<span class="badge {kind}">') >= counted
        assert f"<b>{counted}</b>" in html


def test_an_altered_cell_is_found_by_the_command_and_text_is_escaped(
    copied: Callable[[str], Path], tmp_path: Path
) -> None:
    folder, out = copied("terlemezoglu2019"), tmp_path / "out"
    path = folder / "eq-4-01-to-06-counts.csv"
    text = path.read_text("utf-8")
    path.write_text(text.replace("188,1,188,63,", "189,1,188,63,<b>&", 1), "utf-8")
    before = json.loads(run("reproduce", "terlemezoglu2019", *QUICK, "--out", out, "--json").stdout)["rows"]
    done = run("reproduce", "terlemezoglu2019", *QUICK, "--published", folder, "--out", out, "--overwrite", "--json")
    after = json.loads(done.stdout)["rows"]
    for row in (*before, *after):  # the chance of other cells of this role changes, too
        del row["chance"]
    changed = [(b["cell"], b["verdict"], a["verdict"]) for b, a in zip(before, after, strict=True) if b != a]
    assert changed == [("bundle, n_observations", "equal", "differs")]
    html = (out / "report.html").read_text("utf-8")
    assert "&lt;b&gt;&amp;" in html
    assert "<b>&" not in html


def test_people_see_counts_claims_and_the_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("reproduce", "terlemezoglu2019", *QUICK, "--out", out)
    assert done.exit_code == 0, done.output
    assert "published numbers" in done.stdout
    assert str(out / "report.html").replace("\n", "") in done.stdout.replace("\n", "")
    assert max(map(len, done.stdout.splitlines()[2:-1])) <= 80
    again = run("reproduce", "terlemezoglu2019", *QUICK, "--out", out)
    assert again.exit_code == 2
    assert "exists already" in again.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("terlemezoglu2018",), "unknown publication"),
        (("terlemezoglu2019", "--tables", "4.99"), "--tables: unknown table"),
        (("terlemezoglu2019", "--seeds", "0"), "--seeds"),
        (("terlemezoglu2019", "--published", "nowhere"), "not a folder"),
    ],
)
def test_bad_input_is_one_line(words: tuple[str, ...], text: str, tmp_path: Path) -> None:
    done = run("reproduce", *words, "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert text in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
