"""The HTML report is one safe file with warnings first and the figures of the record."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest

from fg_orient.model.errors import finding
from fg_orient.report.chart import round_down
from fg_orient.report.words import number, scientific, verdict
from tests.support.page import structure
from tests.support.results import sealed

#: The script elements of the page itself are its data and its script.
SCRIPTS = 2
SECTIONS = ["verdict", "problems", "summary", "map", "figures", "accuracy", "residuals", "reliability", "orientation",
            "observability", "iterations", "provenance"]  # fmt: skip


@pytest.mark.behaviour
def test_structure_and_order(adjusted: tuple[Path, Any]) -> None:
    found = structure(adjusted[0] / "report.html")
    assert [name for name in found.ids if name in SECTIONS] == SECTIONS
    assert found.ids.count("report-data") == 1


@pytest.mark.behaviour
def test_nothing_from_elsewhere(adjusted: tuple[Path, Any]) -> None:
    path = adjusted[0] / "report.html"
    text = path.read_text("utf-8")
    found = structure(path)
    assert set(re.findall(r"https?://[^\s\"'<]+", text)) <= {"http://www.w3.org/2000/svg"}
    assert not {"link", "iframe", "img", "object", "embed"} & set(found.tags)
    assert not [name for name, _ in found.attributes if name.startswith("on") or name == "src"]
    assert {value[:1] for name, value in found.attributes if name == "href"} == {"#"}
    assert "@import" not in text and "url(" not in text
    assert path.stat().st_size < 2_000_000
    assert "prefers-color-scheme: dark" in text and "@media print" in text


@pytest.mark.behaviour
def test_figures_of_the_record(adjusted: tuple[Path, Any]) -> None:
    out, ended = adjusted
    text = " ".join(structure(out / "report.html").text)
    for role in ("control", "check"):
        for axis in ("east", "north", "up"):
            assert f"{ended.json['accuracy'][role][f'rmse_{axis}_m']:.3f}" in text
    assert f"{ended.json['sigma0']:.3f}" in text
    assert re.search(r"m horizontal error, enlarged [\d,]+ times", text)
    assert re.search(r"\d km on the ground", text)


@pytest.mark.consistency
def test_exaggeration_is_true(adjusted: tuple[Path, Any]) -> None:
    """The exaggeration stated on the map is the ratio of its two scale bars."""
    text = (adjusted[0] / "report.html").read_text("utf-8")
    bars = re.findall(r'd="M[\d.]+ [\d.]+v5h([\d.]+)v-5"/><text[^>]*>([\d.]+) (k?m) ([^<]*)</text>', text)
    ground, error = bars[0], bars[1]
    per_km, per_m = float(ground[0]) / float(ground[1]), float(error[0]) / float(error[1])
    stated = float(re.sub(r"\D", "", error[3].split("enlarged")[1]))
    assert (ground[2], error[2]) == ("km", "m")
    assert stated == pytest.approx(per_m / per_km * 1000.0, rel=0.06)  # stated with two digits, drawn to 0.1 unit


@pytest.mark.behaviour
def test_report_is_made_again_from_the_folder_alone(run: Any, result: Path) -> None:
    before = (result / "report.html").read_text("utf-8")
    (result / "report.html").unlink()
    ended = run("report", result, "--json")
    assert (ended.code, ended.json) == (0, {"report": str(result / "report.html"), "truth": None})
    after = (result / "report.html").read_text("utf-8")
    # only the time of the report itself, and so the total, became known after it was first written
    assert _without_times(before) == _without_times(after)


def _without_times(text: str) -> str:
    return re.sub(r"<div><b>[\d.]+ s</b>|Seconds: .*", "", text)


HOSTILE = ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "{{ 7 * 7 }}", "&amp;"]


@pytest.mark.behaviour
def test_hostile_names_are_escaped(run: Any, twin: Path) -> None:
    folder = twin.parent
    points = (folder / "points.csv").read_text("utf-8")
    observations = (folder / "observations.csv").read_text("utf-8")
    for k, name in enumerate(HOSTILE):
        cell = '"' + name.replace('"', '""') + '"'
        points = points.replace(f"\n{k + 1:02d},", f"\n{cell},")
        observations = observations.replace(f",{k + 1:02d},", f",{cell},")
    project = twin.read_text("utf-8").replace('id = "left"', "id = '<b>left</b>'")
    project = re.sub(r'name = ".*"', "name = '</title><script>x</script>'", project)
    (folder / "points.csv").write_text(points, encoding="utf-8")
    (folder / "observations.csv").write_text(observations.replace("\nleft,", "\n<b>left</b>,"), encoding="utf-8")
    twin.write_text(project, encoding="utf-8")
    ended = run("adjust", twin, "--json")
    assert ended.code == 0, ended.stderr
    found = structure(folder / "result" / "report.html")
    assert "img" not in found.tags and found.tags.count("script") == SCRIPTS
    assert "b" in found.tags  # our own; the image's name adds none:
    text = (folder / "result" / "report.html").read_text("utf-8")
    assert "<b>left" not in text
    assert not [name for name, _ in found.attributes if name.startswith("on")]
    shown = " ".join(found.text)
    for name in [*HOSTILE, "<b>left</b>", "</title><script>x</script>"]:
        assert name in shown
    assert "49" not in re.findall(r"(?:check|control) (\d+)(?=:)", shown)  # {{ 7 * 7 }} is not evaluated


@pytest.mark.behaviour
def test_bad_folders(run: Any, result: Path, twin: Path, tmp_path: Path) -> None:
    """``report`` refuses a folder without result or truth, with another truth or a missing table.

    The page does not change.
    """
    path = twin.parent / "truth" / "eop.csv"
    path.write_text(path.read_text("utf-8").replace("left,", "west,"), encoding="utf-8")
    for words, code in (
        ((tmp_path,), "report.no_result"), ((result, "--truth", tmp_path), "report.no_truth"),
        ((result, "--truth", twin.parent / "truth"), "report.other_truth"),
    ):  # fmt: skip
        ended = run("report", *words, "--json")
        assert (ended.code, ended.json["errors"][0]["code"]) == (2, code)
    (result / "points.csv").unlink()
    before = (result / "report.html").read_bytes()
    ended = run("report", result, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "manifest.incomplete")
    ended = run("report", sealed(result), "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "report.damaged")
    assert (result / "report.html").read_bytes() == before


@pytest.mark.oracle
def test_truth_is_compared_in_predicted_sigmas(run: Any, result: Path, twin_source: Path) -> None:
    ended = run("report", result, "--truth", twin_source / "truth", "--json")
    assert ended.code == 0
    found = ended.json["truth"]
    assert {e["image"] for e in found["eop"]} == {"left", "right"}
    assert len(found["eop"]) == 36
    with (twin_source / "truth" / "eop.csv").open(encoding="utf-8") as stream:
        true = {(r["image"], r["parameter"]): float(r["value_per_tau"]) for r in csv.DictReader(stream)}
    with (result / "eop.csv").open(encoding="utf-8") as stream:
        estimated = {(r["image"], r["parameter"]): r for r in csv.DictReader(stream)}
    sigma0 = json.loads((result / "result.json").read_text("utf-8"))["sigma0"]
    for e in found["eop"]:
        row = estimated[e["image"], e["parameter"]]
        difference = float(row["value_per_tau"]) - true[e["image"], e["parameter"]]
        assert e["difference"] == pytest.approx(difference, rel=1e-12)
        assert e["normalised"] == pytest.approx(difference * sigma0 / float(row["sigma"]), rel=1e-12)
    # 37 control points: RMS of normalised errors is 1 +- 0.12 (one sigma); four sigma are allowed
    east = next(g for g in found["groups"] if g["name"] == "control points, East")
    assert east["n"] == 37
    assert east["rms_normalised"] == pytest.approx(1.0, abs=4 * 0.12)
    assert "truth" in structure(result / "report.html").ids


@pytest.mark.behaviour
def test_fixed_control_and_the_end_of_the_iterations_are_told(run: Any, result: Path) -> None:
    def text(**control: Any) -> str:
        path = result / "result.json"
        record = json.loads(path.read_text("utf-8"))
        record["accuracy"]["control"] |= control
        record |= {"ended": "planted end", "reason": "planted verdict"}
        path.write_text(json.dumps(record), encoding="utf-8")
        assert run("report", sealed(result)).code == 0
        return (result / "report.html").read_text("utf-8")

    plain = text(n_fixed=0)
    assert "fixed" not in plain[plain.index('id="accuracy"') : plain.index('id="map"')]
    assert "Ended: planted end." in plain and "planted verdict" not in plain
    assert "; 3 fixed left out)" in text(n_fixed=3)
    assert "All 3 control points are fixed" in text(n=0)


@pytest.mark.behaviour
def test_verdict_in_words() -> None:
    base = {"status": "converged", "sigma0": 1.0, "sigma0_interval_99_9": [0.8, 1.2], "warnings": [], "reason": "why"}
    assert verdict(base)["kind"] == "good"
    assert verdict({**base, "warnings": ["x"]})["kind"] == "warn"
    low = verdict({**base, "sigma0": 0.5, "warnings": ["sigma0 = 0.50 lies below 0.80"]})
    assert (low["kind"], "0.80" in low["text"], "see the warnings" in low["text"]) == ("warn", False, True)
    assert verdict({**base, "sigma0": None})["title"] == "Converged, unchecked"
    searched = verdict({**base, "warnings": ["x"], "snooping": {"n_left_out": 2}})["text"]
    assert searched.startswith("The search for gross errors left out 2 observations. ")
    for status, title in (("not_converged", "No solution"), ("not_trustworthy", "Not trustworthy")):
        assert verdict({**base, "status": status}) == {"kind": "bad", "title": title, "text": "why"}


@pytest.mark.behaviour
def test_numbers_for_people() -> None:
    assert number(-0.0004) == "0.000"
    assert number(-1.5, 1) == "−1.5"
    assert number(None) == number(float("nan")) == scientific(None) == "–"
    assert scientific(1.234e-7) == "1.23e−07"
    assert [round_down(v) for v in (1.0, 4.9, 5.0, 0.03, 99.0)] == [1.0, 2.0, 5.0, 0.02, 50.0]


@pytest.mark.behaviour
def test_page_under_a_loss(twin_source: Path, tmp_path: Path, run: Any) -> None:
    """Under a loss the page states sigmas in prior scale and why figures are missing, without keys of the record."""
    out = tmp_path / "result"
    ended = run("adjust", twin_source / "project.toml", "--loss", "tukey", "--out", out, "--json")
    assert ended.code == 0
    text = " ".join(structure(out / "report.html").text)
    assert "standard deviations in prior scale, with the weights of the loss" in text
    assert "a posteriori" not in text
    assert "minimal detectable biases are not given: the weights of the loss change them" in text
    page = (out / "report.html").read_text("utf-8")
    warnings = page[page.index('id="problems"') : page.index('id="summary"')]
    assert " null" not in warnings
    assert not re.findall(r"[a-z0-9]+_[a-z0-9_]+", warnings)
    assert "not given: the interval of sigma0; the weights of the loss change them" in warnings
    assert '<p class="sub">1 pairs' not in page


@pytest.mark.behaviour
def test_reasons_in_words() -> None:
    found = finding("absent.covariance", figures=["global_test", "outlier_tests", "y_parallax"])
    assert str(found) == (
        "not given: the global test, tests of single observations, y parallax; they need the covariance"
    )
