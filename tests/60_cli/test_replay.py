"""A run repeated from its record is equal to the last bit, or refused, or each difference is named."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

import fg_orient as fg
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.cli.results import show_replay as show
from fg_orient.formats.recorded_run import require_repeatable
from fg_orient.model.errors import InputError, finding
from fg_orient.orientation.replay import OCCASION, Replay, changed_sources, compare_records, compare_tables
from fg_orient.orientation.run import run_project
from tests.support.results import sealed


@pytest.fixture(scope="module")
def robust(twin_source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the project with the result of a robust run, stopped and gone on with from its checkpoint.

    Not to be changed.
    """
    folder = tmp_path_factory.mktemp("robust") / "twin"
    shutil.copytree(twin_source, folder)
    given: dict[str, Any] = {"options": {"eop_set": "PUA", "loss": "huber"}, "checkpoint_every_s": 0.0}

    def stop(record: IterationRecord) -> None:
        if record.iteration == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_project(folder / "project.toml", folder / "result", callback=stop, command=["fg-orient"], **given)
    run_project(folder / "project.toml", folder / "result", resume=True, command=["fg-orient"], **given)
    return folder


@pytest.fixture
def spoiled(robust: Path, tmp_path: Path) -> Path:
    """Return the copy of the project and its result that a test may spoil."""
    return Path(shutil.copytree(robust, tmp_path / "twin"))


def record_of(folder: Path) -> Any:
    return json.loads((folder / "result.json").read_text("utf-8"))


@pytest.mark.consistency
def test_resumed_robust_run_comes_out_again(run: Any, robust: Path, tmp_path: Path) -> None:
    assert record_of(robust / "result")["resumed_at_iteration"]
    ended = run("replay", robust / "result", "--out", tmp_path / "again", "--json")
    found = ended.json
    assert (ended.code, found["equal"], found["differences"], found["versions"]) == (0, True, [], [])
    assert found["n_compared"] > 400 and found["n_inputs"] == 5
    assert found["tables"] == {name: True for name in ("accuracy.csv", "eop.csv", "points.csv", "residuals.csv")}
    then, now = record_of(robust / "result"), record_of(tmp_path / "again")
    assert (now["loss"], now["eop_set_name"], now["resumed_at_iteration"]) == ("huber", "PUA", None)
    assert now["provenance"]["repeat"] == then["provenance"]["repeat"]


@pytest.mark.behaviour
def test_changed_input_is_refused_by_name_or_its_effect_is_listed(run: Any, spoiled: Path) -> None:
    table = spoiled / "points.csv"
    lines = table.read_text("utf-8").splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("id,"))
    row = next(k for k, line in enumerate(lines) if ",control," in line)
    cells, height = lines[row].split(","), lines[head].split(",").index("height_m")
    cells[height] = repr(float(cells[height]) + 1e-6)
    table.write_text("\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :], ""]), encoding="utf-8")
    ended = run("replay", spoiled / "result")
    assert ended.code == 2 and ended.stderr.count("\n") == 1
    assert ended.stderr.startswith(f"error: {table}: the file has changed since the run: SHA-256 ")
    assert not (spoiled / "result-replay").exists()
    ended = run("replay", spoiled / "result", "--allow-changed", "--json")
    found = ended.json
    assert (ended.code, found["equal"]) == (4, False)
    assert [p["code"] for p in found["inputs"]] == ["replay.changed"]
    keys = {d["key"] for d in found["differences"]}
    assert {"chi2", "sigma0"} <= keys and "n_image_points" not in keys
    assert found["tables"]["points.csv"] is False
    assert record_of(spoiled / "result-replay")["chi2"] != record_of(spoiled / "result")["chi2"]
    table.write_text("no table", encoding="utf-8")
    ended = run("replay", spoiled / "result")
    assert ended.code == 2 and ended.stderr.startswith(f"error: {table}: the file has changed since"), "not its faults"


@pytest.mark.behaviour
def test_records_that_cannot_be_repeated(run: Any, spoiled: Path, tmp_path: Path) -> None:
    result, project = spoiled / "result", spoiled / "project.toml"
    assert "would replace the result" in run("replay", result, "--out", result, "--overwrite").stderr
    assert "contains no result" in run("replay", spoiled / "truth").stderr
    project.rename(tmp_path / "moved.toml")
    ended = run("replay", result)
    assert ended.code == 2 and f"{project}, --project: " in ended.stderr
    ended = run("replay", result, "--project", tmp_path / "moved.toml")
    assert ended.code == 2 and "left.DIM" in ended.stderr, "its images are not beside it"
    record = record_of(result)
    del record["provenance"]["repeat"]
    (result / "result.json").write_text(json.dumps(record), encoding="utf-8")
    ended = run("replay", sealed(result))
    assert ended.code == 2 and "does not contain the data to repeat its run" in ended.stderr


DIGEST = 64 * "0"
DEM = {"file": "dem.tif", "sha256": DIGEST, "sigma_m": 1.0, "vertical_crs": ""}
START = {"folder": "earlier", "prior": True, "files": {"eop.csv": DIGEST}}


def _changed(record: Any, place: str, value: object) -> Any:
    """Return a record with another value at a place such as ``provenance.inputs.1.file``."""
    name, _, rest = place.partition(".")
    key = int(name) - 1 if isinstance(record, list) else name
    changed = list(record) if isinstance(record, list) else dict(record)
    changed[key] = _changed(record[key], rest, value) if rest else value
    return changed


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("inputs", []), ("inputs", 1), ("inputs.1", "x"), ("inputs.1.file", None), ("inputs.1.file", 300 * "x"),
        ("inputs.1.file", "a\0b"), ("inputs.2.sha256", 1), ("inputs.2.sha256", "x"), ("versions", "x"),
        ("versions", {"numpy": 1}), ("command", 1), ("command", [1]), ("repeat", 1), ("repeat.options", []),
        ("repeat.options", {"bogus": 1}), ("repeat.options", {"plugin": "x.py"}),
        ("repeat.options", {"max_iterations": "x"}), ("repeat.parts", "x"), ("repeat.parts", 0),
        ("repeat.in_parts", 1), ("repeat.dem_control", {}), ("repeat.dem_control", {"file": 1}),
        ("repeat.dem_control", {**DEM, "sigma_m": "x"}), ("repeat.start", "x"), ("repeat.start", {**START, "files": 1}),
        ("repeat.start", {**START, "folder": "a\0b"}),
    ],
)  # fmt: skip
def test_a_record_with_another_provenance_is_refused_with_the_key(place: str, value: object, robust: Path) -> None:
    """``DEM``, ``START`` and the record of a run are allowed; with one change, each is refused."""
    record, file = record_of(robust / "result"), robust / "result" / "result.json"
    for name, allowed in (("repeat.dem_control", DEM), ("repeat.start", START)):
        record = _changed(record, f"provenance.{name}", allowed)
    require_repeatable(record, file)
    with pytest.raises(InputError) as caught:
        require_repeatable(_changed(record, f"provenance.{place}", value), file)
    for problem in caught.value.problems:
        assert problem.code == "replay.record" and problem.file == str(file)
        parts = [part for part in re.split(r"[.\[\]]+", problem.place) if part]
        assert parts[: 1 + place.count(".") + 1] == ["provenance", *place.split(".")]


@pytest.mark.behaviour
def test_unread_and_new_inputs_are_named(robust: Path) -> None:
    block = fg.read_project(robust / "project.toml")
    recorded = {entry["file"]: entry["sha256"] for entry in record_of(robust / "result")["provenance"]["inputs"]}
    assert dict(changed_sources(block, robust, recorded)) == {}
    recorded["gone.csv"] = recorded.pop("points.csv")
    found = dict(changed_sources(block, robust, recorded))
    assert {name: p.code for name, p in found.items()} == {"points.csv": "replay.new", "gone.csv": "replay.missing"}


@pytest.mark.behaviour
def test_any_bit_counts_and_times_do_not() -> None:
    then: dict[str, Any] = {"a": [1.0, {"b": 0.1}], "c": 0.0, "d": None, "e": [], **dict.fromkeys(OCCASION, 1)}
    assert compare_records(then, {**then, **dict.fromkeys(OCCASION, 2)}) == (5, ())
    now = {"a": [1, {"b": math.nextafter(0.1, 1.0)}], "c": -0.0, "e": [1], "f": True}
    n, found = compare_records(then, now)
    assert n == 7
    assert [d["key"] for d in found] == ["a[0]", "a[1].b", "c", "d", "e", "e[0]", "f"]
    assert found[1] == {"key": "a[1].b", "then": 0.1, "now": math.nextafter(0.1, 1.0)}


@pytest.mark.behaviour
def test_tables_are_compared_byte_by_byte(tmp_path: Path) -> None:
    then, now = tmp_path / "then", tmp_path / "now"
    for folder in (then, now):
        (folder / "rpc").mkdir(parents=True)
        for name in ("eop.csv", "points.csv", "rpc/a_RPC.TXT"):
            (folder / name).write_text("1", encoding="utf-8")
    assert compare_tables(then, now) == {"eop.csv": True, "points.csv": True, "rpc/a_RPC.TXT": True}
    (now / "eop.csv").write_text("2", encoding="utf-8")
    (then / "points.csv").unlink()
    (now / "outliers.csv").write_text("", encoding="utf-8")
    assert compare_tables(then, now) == {
        "eop.csv": False, "outliers.csv": False, "points.csv": False, "rpc/a_RPC.TXT": True,
    }  # fmt: skip


@pytest.mark.behaviour
def test_what_people_read(capsys: pytest.CaptureFixture[str]) -> None:
    changed = finding("replay.changed", file="points.csv", then="1", now="2")
    differences = tuple({"key": f"a[{k}]", "then": 0.1, "now": None} for k in range(30))
    version = {"name": "numpy", "then": "2.0.0", "now": "2.1.0"}
    show(Replay("again", "converged", (changed,), 5, 100, differences, {"eop.csv": False}, (version,)))
    out, err = capsys.readouterr()
    assert err == "warning: points.csv: the file has changed since the run: SHA-256 2, recorded 1\n"
    for words in ("numpy: 2.0.0 then, 2.1.0 now", "values that differ: 30 of 100", "the first 20; --json gives all",
                  "eop.csv differs", "the repeated run differs", "written: again"):  # fmt: skip
        assert words in out


@pytest.mark.behaviour
def test_the_project_is_found_by_its_content(run: Any, spoiled: Path, tmp_path: Path) -> None:
    """``replay`` finds the project next to the result or in a folder above it by content, not by name."""
    work = tmp_path / "work"
    (work / "decoy").mkdir(parents=True)
    (work / "decoy" / "project.toml").write_text("schema = 1\n", "utf-8")
    shutil.move(spoiled / "result", work / "result")
    refused = run("replay", work / "result", "--out", tmp_path / "again")
    assert refused.code == 2 and "not in a folder above it or beside it" in refused.stderr
    shutil.move(spoiled, work / "scene")
    assert run("replay", work / "result", "--out", tmp_path / "again", "--json").json["equal"]
    deep = work / "scene" / "a" / "b" / "result"
    shutil.move(work / "result", deep)
    assert run("replay", deep, "--out", tmp_path / "more", "--json").json["equal"]
