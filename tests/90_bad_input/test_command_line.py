"""Bad inputs on the command line give one line each and exit code 2, and leave no files.

Every case is the twin with one fault. The error must name the file, the place, the value and
a remedy, on one line, as text and as JSON; the output folder must not exist afterwards.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fg_orient.cli import app
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak

pytestmark = pytest.mark.behaviour


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a sound project."""
    folder = tmp_path_factory.mktemp("sound") / "zonguldak"
    simulate_zonguldak(folder, ZonguldakOptions(seed=1))
    return folder


def substitute(name: str, pattern: str, text: str) -> Callable[[Path], None]:
    """Replace the first match of a pattern in a file."""

    def fault(folder: Path) -> None:
        path = folder / name
        changed, count = re.subn(pattern, text, path.read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
        assert count == 1, f"{pattern} not found in {name}"
        path.write_text(changed, encoding="utf-8")

    return fault


def cut(name: str) -> Callable[[Path], None]:
    """Leave the first half of a file."""

    def fault(folder: Path) -> None:
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(text[: len(text) // 2], encoding="utf-8")

    return fault


def without_control(folder: Path) -> None:
    """Leave out the image points of all control points."""
    rows = [line.split(",") for line in (folder / "points.csv").read_text(encoding="utf-8").splitlines()]
    ids = {cells[0] for cells in rows if cells[1:2] == ["control"]}
    columns("observations.csv", lambda row: None if row["id"] in ids else row, first_only=False)(folder)


def columns(name: str, change: Callable[[dict[str, str]], dict[str, str] | None], first_only: bool = True) -> Callable:
    """Change the rows of a CSV file; None drops a row."""

    def fault(folder: Path) -> None:
        lines = (folder / name).read_text(encoding="utf-8").splitlines()
        start = next(k for k, line in enumerate(lines) if not line.startswith("#"))
        header, out, done = lines[start].split(","), lines[: start + 1], False
        for line in lines[start + 1 :]:
            row = dict(zip(header, line.split(","), strict=True))
            changed = row if first_only and done else change(dict(row))
            done = done or changed != row
            if changed is not None:
                out.append(",".join(changed.values()))
        assert done, "the fault changed nothing"
        (folder / name).write_text("\n".join(out) + "\n", encoding="utf-8")

    return fault


def control(**values: str) -> Callable[[dict[str, str]], dict[str, str]]:
    """Set columns of control points."""
    return lambda row: row | values if row["role"] == "control" else row


def swapped(row: dict[str, str]) -> dict[str, str]:
    return row | {"lon_deg": row["lat_deg"], "lat_deg": row["lon_deg"]}


def late_ephemeris(folder: Path) -> None:
    """Move all state vectors by five minutes: the image lies before the first one."""
    path = folder / "left.DIM"
    head, points, tail = re.split(
        r"(<Points>.*?</Points>)", path.read_text(encoding="utf-8"), maxsplit=1, flags=re.DOTALL
    )

    def later(match: re.Match[str]) -> str:
        return f"{match[1]}{(int(match[2]) + 5) % 60:02d}{match[3]}"

    moved = re.sub(r"(<TIME>\S+?T\d\d:)(\d\d)(:\S+</TIME>)", later, points)
    assert moved != points
    path.write_text(head + moved + tail, encoding="utf-8")


def twice(folder: Path) -> None:
    path = folder / "points.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([*lines, lines[-1]]) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Case:
    """A case has one fault, the file in which it is found, and words of the message."""

    fault: Callable[[Path], None]
    file: str
    words: str


CASES = {
    "truncated XML": Case(cut("left.DIM"), "left.DIM", "XML"),
    "DOCTYPE": Case(
        substitute("left.DIM", r"<Dimap_Document", '<!DOCTYPE a [<!ENTITY b "c">]><Dimap_Document'),
        "left.DIM",
        "DOCTYPE",
    ),
    "missing element": Case(substitute("left.DIM", r"<LINE_PERIOD>.*</LINE_PERIOD>", ""), "left.DIM", "LINE_PERIOD"),
    "non-numeric text": Case(
        substitute("left.DIM", r"<LINE_PERIOD>.*</LINE_PERIOD>", "<LINE_PERIOD>soon</LINE_PERIOD>"), "left.DIM", "soon"
    ),
    "another mission": Case(substitute("left.DIM", r"<MISSION>SPOT", "<MISSION>LANDSAT"), "left.DIM", "LANDSAT"),
    "time outside the ephemeris": Case(late_ephemeris, "left.DIM", "ephemeris"),
    "pixel outside the image": Case(
        columns("observations.csv", lambda r: r | {"line": "12000.7"}), "observations.csv", "12000.7"
    ),
    "nan coordinate": Case(columns("points.csv", control(lon_deg="nan")), "points.csv", "nan"),
    "inf coordinate": Case(columns("points.csv", control(height_m="inf")), "points.csv", "inf"),
    "sigma zero": Case(columns("points.csv", control(sigma_up_m="0")), "points.csv", "sigma_up_m"),
    "negative sigma": Case(
        columns("observations.csv", lambda r: r | {"sigma_line_px": "-0.3"}), "observations.csv", "-0.3"
    ),
    "swapped latitude and longitude": Case(columns("points.csv", swapped, first_only=False), "points.csv", "swap"),
    "duplicate point id": Case(twice, "points.csv", "twice|duplicate|already|before"),
    "unknown EPSG": Case(
        substitute("project.toml", r'crs = "EPSG:4979"', 'crs = "EPSG:99999"'), "project.toml|points.csv", "99999"
    ),
    "point seen once": Case(
        columns("observations.csv", lambda r: None if r["id"] == "05" else r), "observations.csv|points.csv", "05"
    ),
    "no control": Case(without_control, "points.csv|project.toml", "control"),
}


def adjust(project: Path, *words: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["adjust", str(project), "--out", str(project.parent / "out"), *words])
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize("name", CASES)
def test_one_line_with_file_place_value_and_remedy(name: str, twin: Path, tmp_path: Path) -> None:
    case = CASES[name]
    folder = tmp_path / "project"
    shutil.copytree(twin, folder)
    if name == "point seen once":  # a check point, so that it cannot stand on its coordinates
        columns("points.csv", lambda r: r | {"role": "check"} if r["id"] == "05" else r, first_only=False)(folder)
    case.fault(folder)
    before = sorted(p.name for p in folder.iterdir())
    code, stdout, stderr = adjust(folder / "project.toml", "--json")
    assert code == 2, stderr
    errors = json.loads(stdout)["errors"]
    assert len(errors) == 1, errors
    error = errors[0]
    assert re.search(case.file, Path(error["file"]).name), error
    assert error["place"] and error["message"] and error["remedy"] and error["code"], error
    said = f"{error['place']} {error['value']} {error['message']} {error['remedy']}"
    assert re.search(case.words, said), said
    lines = [line for line in stderr.splitlines() if line.startswith("error")]
    assert len(lines) == 1
    assert "Traceback" not in stderr
    assert sorted(p.name for p in folder.iterdir()) == before  # no output folder, no temporary one
    text_code, text_out, text_err = adjust(folder / "project.toml")
    assert (text_code, text_out) == (2, "")
    assert text_err.splitlines()[-1] == lines[-1]


def test_existing_output_folder(twin: Path, tmp_path: Path) -> None:
    shutil.copytree(twin, tmp_path / "project")
    kept = tmp_path / "project" / "out"
    kept.mkdir()
    (kept / "mine.txt").write_text("keep me")
    code, stdout, stderr = adjust(tmp_path / "project" / "project.toml", "--json")
    assert code == 2
    error = json.loads(stdout)["errors"][0]
    assert error["code"] == "output.exists"
    assert "--overwrite" in error["remedy"]
    assert (kept / "mine.txt").read_text() == "keep me"
    assert len(stderr.strip().splitlines()) == 1


def test_pixel_outside_on_locate(twin: Path) -> None:
    result = CliRunner().invoke(
        app, ["locate", str(twin / "left.DIM"), "--line", "12001", "--sample", "5", "--height", "0", "--json"]
    )
    assert result.exit_code == 2
    error = json.loads(result.stdout)["errors"][0]
    assert "12001" in error["place"] and "11999.5" in error["remedy"]


def test_validate_lists_all_faults_at_once(twin: Path, tmp_path: Path) -> None:
    folder = tmp_path / "project"
    shutil.copytree(twin, folder)
    columns("points.csv", control(sigma_up_m="0"))(folder)
    columns("observations.csv", lambda r: r | {"sample": "nan"})(folder)
    result = CliRunner().invoke(app, ["validate", str(folder / "project.toml"), "--json"])
    assert result.exit_code == 2
    codes = {Path(e["file"]).name for e in json.loads(result.stdout)["errors"]}
    assert codes == {"points.csv", "observations.csv"}


def test_sound_project_has_no_errors(twin: Path) -> None:
    result = CliRunner().invoke(app, ["validate", str(twin / "project.toml"), "--json"])
    assert result.exit_code == 0, result.stdout
