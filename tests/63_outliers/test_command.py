"""``adjust --snoop`` is tested from the project file to record, table and report."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import pytest

import fg_orient as fg
from fg_orient.cli.adjust import _reason
from fg_orient.formats.project import read_project
from fg_orient.model.errors import as_record, finding
from fg_orient.result.summary import summary
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process

pytestmark = pytest.mark.behaviour


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the twin's project; the line of point 05 is 8 px off in the left image."""
    folder = tmp_path_factory.mktemp("snoop") / "twin"
    simulate_zonguldak(folder, ZonguldakOptions())
    path = folder / "observations.csv"
    rows = list(csv.reader(path.read_text("utf-8").splitlines()))
    for row in rows:
        if row[:2] == ["left", "05"]:
            row[2] = repr(float(row[2]) + 8.0)
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", "utf-8")
    return folder / "project.toml"


def run(project: Path, out: Path, *words: object) -> Any:
    return in_process("adjust", project, "--out", out, "--json", *words)


def test_record_table_and_report(project: Path, tmp_path: Path) -> None:
    """``adjust --snoop`` rejects the error in the first round and names it in record, table and report.

    The other files are those of the last round.
    """
    out = tmp_path / "result"
    ended = run(project, out, "--snoop", "--backend", "schur")
    assert ended.code == 0
    record = ended.json
    found = record["snooping"]
    assert (found["n_left_out"], found["given_up"], len(found["rounds"])) == (1, None, 2)
    assert found["rounds"][0]["left_out"] == "point 05 in image left"
    assert found["rounds"][1]["left_out"] is None
    assert found["rounds"][1]["sigma0"] == record["sigma0"]
    assert found["found"][0]["error"] == pytest.approx([8.0, 0.0], abs=1.0)
    assert any("snooping left out 1 observation " in text for text in record["warnings"])
    assert not any("tie points now" in text for text in record["warnings"])
    assert (record["outlier_tests"]["test"], record["outlier_tests"]["multiple_testing"]) == ("t", "sidak")
    assert record["suspicious_observations"] == []
    assert record["global_test"]["accepted"]
    rows = list(csv.DictReader((out / "outliers.csv").read_text("utf-8").splitlines()))
    assert [(r["round"], r["part"], r["image"], r["id"], r["readmitted"]) for r in rows] == [
        ("1", "image", "left", "05", "")
    ]
    assert float(rows[0]["error_line_px"]) == found["found"][0]["error"][0]
    assert rows[0]["error_up_m"] == ""
    assert float(rows[0]["statistic_without"]) == pytest.approx(float(rows[0]["statistic"]), rel=0.01)
    residuals = (out / "residuals.csv").read_text("utf-8")
    assert "\nleft,05," not in residuals
    assert "\nright,05," in residuals
    assert "Search for gross errors" in (out / "report.html").read_text("utf-8")


def test_options_of_the_project_file_and_the_line(project: Path, tmp_path: Path) -> None:
    """Options of the search work in the project file and on the command line; without search there is no table.

    Suspicious observations are then in the record.
    """
    text = project.read_text("utf-8")
    chosen = project.with_name("chosen.toml")
    values = {"snoop": "true", "outlier_test": '"baarda"', "outlier_level": "0.001", "multiple_testing": '"none"'}
    for key, value in values.items():
        text, count = re.subn(f"(?m)^{key} = .*$", f"{key} = {value}", text)
        assert count == 1
    chosen.write_text(text, "utf-8")
    first = run(chosen, tmp_path / "a")
    assert first.code == 0, first.stdout
    record = first.json
    assert record["outlier_tests"]["level_each"] == 0.001
    assert record["outlier_tests"]["test"] == "baarda"
    assert record["snooping"]["n_left_out"] >= 1
    plain = run(
        project, tmp_path / "b", "--outlier-test", "pope", "--multiple-testing", "holm", "--outlier-level", 0.01
    )
    assert plain.json["snooping"] is None
    assert plain.json["suspicious_observations"][0]["id"] == "05"
    assert plain.json["suspicious_observations"][0]["symbol"] == "T/m0^2"
    assert not plain.json["global_test"]["accepted"]
    assert not (tmp_path / "b" / "outliers.csv").exists()


@pytest.mark.parametrize(
    ("words", "place"),
    [(("--outlier-test", "F"), "--outlier-test"), (("--outlier-level", "1.5"), "--outlier-level"),
     (("--multiple-testing", "fdr"), "--multiple-testing"), (("--snoop", "--loss", "tukey"), "--snoop")],
)  # fmt: skip
def test_impossible_choices(project: Path, tmp_path: Path, words: tuple[str, ...], place: str) -> None:
    ended = run(project, tmp_path / "result", *words)
    assert ended.code == 2
    assert ended.json["errors"][0]["place"] == place


@pytest.mark.parametrize(
    ("options", "none", "code"),
    [({"statistics": "basic"}, ["outlier_tests", "suspicious_observations"], "absent.basic"),
     ({"loss": "huber"}, ["global_test", "outlier_tests", "suspicious_observations"], "absent.loss")],
    ids=["basic statistics", "a loss"],
)  # fmt: skip
def test_where_nothing_is_tested_it_is_said_why(
    project: Path, options: dict[str, str], none: list[str], code: str
) -> None:
    record = summary(fg.adjust(read_project(project), **options))
    assert [record[name] for name in none] == [None] * len(none)
    assert none in [found["data"]["figures"] for found in record["findings"] if found["code"] == code]


def test_a_control_point_with_a_wrong_height_is_a_tie_point(project: Path, tmp_path: Path) -> None:
    """``adjust --snoop`` says that it leaves out all coordinates of the point."""
    points = project.parent / "points.csv"
    rows = list(csv.reader(points.read_text("utf-8").splitlines()))
    name, place = next((row[0], k) for k, row in enumerate(rows) if row[1:2] == ["control"])
    rows[place][4] = repr(float(rows[place][4]) + 60.0)
    points.with_name("high.csv").write_text("\n".join(",".join(row) for row in rows) + "\n", "utf-8")
    high = project.with_name("high.toml")
    high.write_text(project.read_text("utf-8").replace('"points.csv"', '"high.csv"'), "utf-8")
    warnings = run(high, tmp_path / "snooped", "--snoop").json["warnings"]
    (sentence,) = (text for text in warnings if "snooping left out" in text)
    assert f"height of point {name}" in sentence
    assert f"these control points are tie points now: {name}" in sentence


def test_the_last_line_of_a_command_names_flags() -> None:
    """The reason of the status in a record names "option accept", and the printed line the flag."""
    doubt = finding("verdict.check_far", points=["7"], size=6.25, n=9, limit=4.0)
    record = as_record([finding("search.conditional"), doubt]) | {"reason": str(doubt)}
    assert 'or accept the doubt with option accept "check_far<=6.25"' in record["reason"]
    assert _reason(record) == str(doubt).replace("option accept", "--accept")
    assert _reason({"findings": [], "reason": "not converged"}) == "not converged"
