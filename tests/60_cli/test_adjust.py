"""``adjust`` has the right JSON keys, exit codes, options and tables, and prints one JSON object."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import fg_orient.result.record
from fg_orient.cli import adjust
from fg_orient.result.plain import read_table
from tests.support.page import structure
from tests.support.work import counted

TOP = {
    "status", "reason", "warnings", "backend", "optimizer", "eop_set", "eop_set_name", "iterations", "n_image_points",
    "n_observations", "n_unknowns", "redundancy", "sigma0", "sigma0_interval_99_9", "rank_defect", "unobservable",
    "accuracy", "seconds", "us_per_observation_iteration", "out",
}  # fmt: skip
AXES = ("east", "north", "up", "ecef_x", "ecef_y", "ecef_z")
FIGURES = {"n", "ce90_m", "le90_m"} | {f"{kind}_{axis}_m" for kind in ("rmse", "mean", "sd") for axis in AXES}


def absent(record: dict[str, Any], figure: str) -> str:
    """Return the code of the finding that explains why a figure is null."""
    (code,) = [found["code"] for found in record["findings"] if figure in found["data"].get("figures", [])]
    return str(code)


@pytest.mark.behaviour
def test_keys(adjusted: tuple[Path, Any]) -> None:
    out, ended = adjusted
    record = ended.json
    assert ended.code == 0
    assert set(record) >= TOP
    assert {"read", "structure", "jit", "solve", "total"} <= set(record["seconds"])
    assert record["status"] == "converged"
    assert record["out"] == str(out)
    assert set(record["accuracy"]["control"]) >= FIGURES
    assert set(record["accuracy"]["check"]) >= FIGURES | {"suspicious", "largest"}
    assert len(record["accuracy"]["check"]["largest"]) == 5
    assert record["rank_defect"] == {"left": 0, "right": 0}
    # 94 image points, 37 control points, 2 x 18 priors; unknowns 2 x 18 + 3 x 47
    assert (record["n_image_points"], record["n_observations"]) == (94, 2 * 94 + 3 * 37 + 36)
    assert (record["n_unknowns"], record["redundancy"]) == (36 + 141, 2 * 94 + 3 * 37 + 36 - 177)


@pytest.mark.behaviour
def test_seconds_cover_the_work(run: Any, twin: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The times of ``adjust`` cover the work from the end of the imports to the printed result, within 5 %.

    The phases add up. The clock counts the calls of functions in place of seconds, so that the same work is the same on
    each machine, however busy it is. The record as text is in no phase, for it holds the phases: an eighth of the
    calls.
    """
    seen: dict[str, list[tuple[int, int]]] = {"load": [], "answer": [], "dumps": []}
    with counted() as calls:

        def noting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            def noted(*arguments: Any, **more: Any) -> Any:
                begin = calls.count
                found = function(*arguments, **more)
                seen[name].append((begin, calls.count))
                return found

            return noted

        for module, name in ((adjust, "load"), (adjust, "answer"), (fg_orient.result.record, "dumps")):
            monkeypatch.setattr(module, name, noting(name, getattr(module, name)))
        monkeypatch.setattr(time, "perf_counter", lambda: float(calls.count))
        ended = run("adjust", twin, "--json")
    assert ended.code == 0, ended.stderr
    seconds = dict(ended.json["seconds"])
    total, work = seconds.pop("total"), seen["answer"][0][0] - seen["load"][0][1]
    assert {"read", "structure", "jit", "solve", "statistics", "record", "write", "report"} == set(seconds)
    assert min(seconds.values()) >= 0.0
    *before, last = (end - begin for begin, end in seen["dumps"])  # the last text holds the total
    assert 0.95 * (total - sum(before)) <= sum(seconds.values()) <= total
    assert 0.95 * (work - last) <= total <= work
    per = 1e6 * seconds["solve"] / ended.json["n_image_points"] / ended.json["iterations"]
    assert ended.json["us_per_observation_iteration"] == pytest.approx(per, rel=1e-12)


@pytest.mark.behaviour
def test_one_json_object_and_nothing_else_on_standard_output(fresh: Any, twin: Path) -> None:
    ended = fresh("adjust", "project.toml", "--json", cwd=twin.parent)
    assert ended.code == 0
    assert ended.json["out"] == "result"
    assert ended.stderr == ""
    assert (twin.parent / "result" / "report.html").is_file()  # the default folder, beside the project


@pytest.mark.behaviour
def test_not_trustworthy_is_exit_4_with_result(run: Any, twin: Path) -> None:
    """A set that does not fit the errors gives exit code 4, the reasons and a written result.

    Set 5 (velocity) cannot represent a constant offset of position and attitude.
    """
    ended = run("adjust", twin, "--eop-set", "V", "--json")
    record = ended.json
    assert (ended.code, record["status"], record["eop_set"]) == (4, "not_trustworthy", 5)
    assert "do not fit the model" in record["warnings"][0]
    assert record["rank_defect"] == {"left": 6, "right": 6}
    assert len(record["unobservable"]) == 12
    assert record["accuracy"]["check"]["suspicious"][0]["ratio"] > 3.0
    assert not record["accuracy"]["check"]["beyond_3_sigma"]["by_chance"]
    assert any(f["code"] == "verdict.check_beyond" for f in record["findings"])
    assert json.loads((twin.parent / "result" / "result.json").read_text("utf-8"))["status"] == "not_trustworthy"


@pytest.mark.behaviour
def test_rank_deficient_is_exit_3_with_a_report_and_no_coordinates(run: Any, twin: Path) -> None:
    ended = run("adjust", twin, "--eop-set", 20, "--no-priors", "--json")
    record, out = ended.json, twin.parent / "result"
    assert (ended.code, record["status"], record["out"]) == (3, "rank_deficient", str(out))
    assert record["rank_defect"] == {"left": 9, "right": 9}
    assert len(record["unobservable"]) == len(record["errors"]) == 18
    assert any("acts as yaw" in sentence for sentence in record["unobservable"])
    assert sorted(p.name for p in twin.parent.iterdir() if p.name.startswith((".", "result"))) == ["result"]
    assert sorted(p.name for p in out.iterdir()) == ["manifest.json", "report.html", "result.json", "start_points.csv"]
    kept = json.loads((out / "result.json").read_text("utf-8"))
    assert kept["seconds"] == record["seconds"] and kept["provenance"]["inputs"]
    assert [sum(s <= 1e-5 for s in o["singular_values"]) for o in kept["observability"]] == [9, 9]
    points = read_table(out / "start_points.csv", "id", "role", "lon_deg", "lat_deg")
    page = (out / "report.html").read_text("utf-8")
    assert page.count('<path class="check"') - 1 == points.words["role"].count("check") > 0
    assert page.count('<path class="control"') - 1 == points.words["role"].count("control") > 0
    values = re.findall(r'class="series-\d" d="([^"]*)"', page)
    assert page.count('<path class="foot"') == 2 and sum(path.count("M") for path in values) == 2 * 27
    remedy = "keep the priors, choose a smaller EOP set, or add option regularisation tikhonov"
    for words in ("Nothing was adjusted: 18 unknowns", f"What to do: {remedy}.",
                  *(f"<li>{sentence}</li>" for sentence in record["unobservable"])):  # fmt: skip
        assert words in page
    assert not [v for n, v in structure(out / "report.html").attributes if v.startswith("http")]


@pytest.mark.behaviour
def test_what_reads_results_refuses_one_where_nothing_was_adjusted(run: Any, twin: Path) -> None:
    out = twin.parent / "result"
    assert run("adjust", twin, "--eop-set", 20, "--no-priors", "--quiet").code == 3
    page = (out / "report.html").read_bytes()
    (out / "report.html").unlink()
    assert run("report", out).code == 0 and (out / "report.html").read_bytes() == page
    image = next(twin.parent.rglob("*.DIM"))
    for words in (("report", out, "--figures"), ("report", out, "--truth", twin.parent / "truth"),
                  ("report", out, "--export", twin.parent / "a.geojson"),
                  ("locate", image, "--line", 1, "--sample", 1, "--height", 0, "--result", out)):  # fmt: skip
        ended = run(*words)
        assert ended.code == 2, words
        assert ended.stderr.startswith(f"error: {out}, result.json: nothing was adjusted"), ended.stderr
    again = run("replay", out, "--json")
    assert again.code == 0 and again.json["equal"] and again.json["tables"] == {"start_points.csv": True}


@pytest.mark.behaviour
def test_rank_deficient_for_people(run: Any, twin: Path) -> None:
    ended = run("adjust", twin, "--eop-set", 20, "--no-priors")
    assert ended.code == 3
    assert ended.stdout == f"report of the undetermined unknowns: {twin.parent / 'result' / 'report.html'}\n"
    assert "velocity across track acts as yaw" in ended.stderr
    (line,) = ended.stderr.splitlines()
    assert line.startswith("error: image left: velocity along track (constant) acts on nothing | radial velocity")
    assert "| and 15 more (--json has all): not observable without priors; keep the priors, " in line


@pytest.mark.behaviour
def test_directions_without_control_points_are_one_line(run: Any, twin: Path) -> None:
    """Without control points one line names some free directions and suggests the datum; the JSON output has all."""
    points = twin.parent / "points.csv"
    points.write_text(points.read_text("utf-8").replace(",control,", ",check,"), "utf-8")
    ended = run("adjust", twin, "--datum", "inner", "--no-priors")
    assert (ended.code, ended.stdout.count("\n")) == (3, 1)
    (line,) = ended.stderr.splitlines()
    assert line.startswith("error: block: no control point fixes this combination (in prior sigmas): ")
    assert line.count(" | ") == 3 and line.count("this combination") == 1 and "the control points" not in line
    assert " more (--json has all): not observable without priors, and the block has no control point; " in line
    assert line.endswith(
        'keep the priors: datum = "priors"; or choose a smaller EOP set, or add --regularisation tikhonov'
    )
    record = run("adjust", twin, "--datum", "inner", "--no-priors", "--overwrite", "--json").json
    assert len(record["unobservable"]) == len(record["errors"]) > 5
    # each image alone is determined at fixed ground points: only the spectrum of the whole block shows what is missing
    assert {o["rank_defect"] for o in record["observability"]} == {0}
    block = record["block_observability"]
    assert sum(s <= block["limit"] for s in block["singular_values"]) == block["unobservable"] > 5
    assert '<td class="id">whole block</td>' in (twin.parent / "result" / "report.html").read_text("utf-8")


@pytest.mark.behaviour
def test_not_converged_is_exit_3(run: Any, twin: Path) -> None:
    ended = run("adjust", twin, "--max-iterations", 1, "--json")
    record = ended.json
    assert (ended.code, record["status"], record["iterations"]) == (3, "not_converged", 1)
    assert record["sigma0_interval_99_9"] == [None, None]
    assert absent(record, "sigma0_interval_99_9") == "absent.not_converged"
    assert "No solution" in (twin.parent / "result" / "report.html").read_text("utf-8")


@pytest.mark.behaviour
def test_without_redundancy_sigma0_is_null_with_a_reason(run: Any, twin: Path) -> None:
    """Without redundancy sigma0 is null with a reason, and sigmas are in prior scale.

    One control and two check points, two times roll, pitch, yaw: 12 + 3 equations, 6 + 9 unknowns.
    """
    folder = twin.parent
    rows = (folder / "points.csv").read_text("utf-8").splitlines()
    head = [row for row in rows if row.startswith(("#", "id"))]
    control = [row for row in rows if ",control," in row][:1]
    check = [row for row in rows if ",check," in row][:2]
    (folder / "points.csv").write_text("\n".join([*head, *control, *check]) + "\n", encoding="utf-8")
    ids = {row.split(",")[0] for row in control + check}
    rows = (folder / "observations.csv").read_text("utf-8").splitlines()
    kept = [row for row in rows if row.startswith(("#", "image")) or row.split(",")[1] in ids]
    (folder / "observations.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    record = run("adjust", twin, "--eop-set", "A0", "--no-priors", "--json").json
    assert (record["redundancy"], record["sigma0"]) == (0, None)
    assert absent(record, "sigma0") == "absent.no_redundancy"
    assert "prior" in (folder / "result" / "points.csv").read_text("utf-8").splitlines()[1].split(",")


@pytest.mark.behaviour
def test_options_replace_those_of_the_project(run: Any, twin: Path) -> None:
    words = ("--look-polynomial", 2, "--optimizer", "dogleg", "--check-points", "exclude", "--max-iterations", 30)
    record = run("adjust", twin, "--eop-set", 16, *words, "--backend", "graph", "--json").json
    assert (record["eop_set"], record["eop_set_name"], record["look_polynomial"]) == (16, "PUA0", 2)
    assert (record["optimizer"], record["check_points"], record["backend"]) == ("dogleg", "exclude", "graph")
    assert record["n_image_points"] == 94 - 20
    assert record["accuracy"]["check"]["n"] == 10
    written = json.loads((twin.parent / "result" / "result.json").read_text("utf-8"))
    assert written["provenance"]["options"]["max_iterations"] == 30


@pytest.mark.consistency
def test_dense_backend_and_its_solver(run: Any, twin: Path) -> None:
    """``--backend dense`` with a solver has the figures of the graph, and the project file can choose both."""
    graph = run("adjust", twin, "--eop-set", 16, "--backend", "graph", "--json").json
    dense = run("adjust", twin, "--eop-set", 16, "--backend", "dense", "--solver", "pivot_inverse", "--overwrite",
                "--json").json  # fmt: skip
    assert (graph["backend"], graph["solver"]) == ("graph", None)
    assert (dense["backend"], dense["solver"]) == ("dense", "pivot_inverse")
    assert dense["sigma0"] == pytest.approx(graph["sigma0"], rel=1e-9)
    assert dense["accuracy"]["check"]["rmse_up_m"] == pytest.approx(graph["accuracy"]["check"]["rmse_up_m"], rel=1e-7)
    text = twin.read_text("utf-8").replace("[adjustment]", '[adjustment]\nsolver = "svd"')
    assert 'backend = "auto"' in text
    twin.write_text(text.replace('backend = "auto"', 'backend = "dense"'), encoding="utf-8")
    again = run("adjust", twin, "--eop-set", 16, "--overwrite", "--json").json
    assert (again["backend"], again["solver"]) == ("dense", "svd")


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "seen"),
    [(("--eop-set", "21"), "21"), (("--optimizer", "newton"), "newton"), (("--check-points", "perhaps"), "perhaps"),
     (("--backend", "sparse"), "sparse"), (("--solver", "qr"), "qr"),
     (("--max-iterations", "0"), "0"), (("--look-polynomial", "9"), "9")],
)  # fmt: skip
def test_bad_option_is_one_line_and_exit_2(run: Any, twin: Path, words: tuple[str, str], seen: str) -> None:
    ended = run("adjust", twin, *words, "--json")
    assert ended.code == 2
    assert [set(e) for e in ended.json["errors"]] == [
        {"code", "severity", "message", "file", "place", "value", "remedy", "data"}
    ]
    assert len(ended.stderr.splitlines()) == 1
    assert seen in ended.stderr
    assert ended.json["errors"][0]["file"] == "", "the project file is not to blame"
    assert ended.json["errors"][0]["place"] == words[0]
    assert not (twin.parent / "result").exists()


@pytest.mark.behaviour
def test_missing_project(run: Any, tmp_path: Path) -> None:
    ended = run("adjust", tmp_path / "none.toml", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "project.missing_file")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.behaviour
def test_for_people_warnings_come_first_and_lines_fit(run: Any, twin: Path) -> None:
    ended = run("adjust", twin)
    lines = ended.stdout.splitlines()
    assert ended.code == 0
    assert sum("check points are given" in line for line in (ended.stdout + ended.stderr).splitlines()) == 1
    assert lines[0] == "warning: only 10 check points are given; ASPRS (2023) requires at least 30"
    assert max(map(len, lines[:-1])) <= 80  # the last line is the path of the report
    assert any("check RMSE (10)" in line for line in lines)
    assert lines[-1].startswith("report: ")
