"""The tests run commands on tables of offices: questions on a terminal, ``convert``, ``validate``, options."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fg_orient.cli import main
from fg_orient.formats.rpc import write_rpc
from tests.support.command import in_process
from tests.support.office import (
    Grid,
    Place,
    differences,
    made,
    number,
    office_files,
    office_folder,
    pixel_rows,
    place,
    text,
    write_images,
    write_xlsx,
)  # fmt: skip

pytestmark = pytest.mark.behaviour

STATED = ("--sigma-ground", "0.05", "0.05", "0.1", "--sigma-image", "0.5", "0.5")


class Terminal(io.StringIO):
    """A text stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


def on_terminal(monkeypatch: pytest.MonkeyPatch, answers: str, *words: object) -> tuple[int, str]:
    """Run a command on a terminal with these answers; give its code and what it printed."""
    screen = Terminal()
    for name, stream in (("stdin", Terminal(answers)), ("stdout", screen), ("stderr", screen)):
        monkeypatch.setattr(sys, name, stream)
    monkeypatch.setattr(sys, "argv", ["fg-orient", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0), screen.getvalue()


def test_a_terminal_is_asked_what_nothing_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    office_folder(tmp_path)
    words = ("new", tmp_path / "office", "--out", tmp_path / "project")
    code, screen = on_terminal(monkeypatch, "1\n0.05 0.05 0.1\n0.5\ny\n", *words)
    assert code == 0, screen
    assert "--first-pixel" in screen
    assert "Write the project with these assumptions?" in screen
    assert differences(made(tmp_path / "project"), place("tr"))[1] in (pytest.approx(0.0, abs=1e-4), pytest.approx(1.0))
    assert "first pixel: 1 (answered)" in (tmp_path / "project" / "project.toml").read_text("utf-8")


def test_a_terminal_may_refuse_the_assumptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    office_folder(tmp_path)
    words = ("new", tmp_path / "office", "--out", tmp_path / "project", "--first-pixel", "1", *STATED)
    code, screen = on_terminal(monkeypatch, "n\n", *words)
    assert code == 2, screen
    assert not (tmp_path / "project").exists()


def test_convert_and_validate_read_the_same_tables(tmp_path: Path) -> None:
    office_files(tmp_path)
    table = tmp_path / "noktalar.xlsx"
    images = [word for name in ("left", "right") for word in ("--metadata", tmp_path / f"{name}_RPC.TXT")]
    asked = in_process("convert", table, "--to", "csv", "--out", tmp_path / "points.csv", *STATED)
    assert (asked.code, "--crs" in asked.stderr) == (2, True)
    ended = in_process("convert", table, *images, "--first-pixel", "1", *STATED, "--to", "csv", "--out",
                       tmp_path / "points.csv")  # fmt: skip
    assert ended.code == 0, ended.stderr
    assert "EPSG:32636" in ended.stderr  # found with the images, as a note
    checked = in_process("validate", table, "--format", "office", "--crs", "EPSG:32636", "--first-pixel", "1", "--json")
    assert checked.code == 0
    assert (checked.json["points"], checked.json["crs"]) == (20, "EPSG:32636")
    assert any("Nokta No" not in r["message"] and "kontrol = control" in r["message"] for r in checked.json["remarks"])


def test_a_project_file_does_not_read_tables_of_unknown_form(tmp_path: Path) -> None:
    office_files(tmp_path)
    table = 'file = "noktalar.xlsx"\nformat = "office"\n'
    images = "".join(f'[[images]]\nid = "{i}"\nmetadata = "{i}_RPC.TXT"\n' for i in ("left", "right"))
    project = f'schema = 1\nname = "a"\n{images}[points]\n{table}[observations]\n{table}'
    (tmp_path / "project.toml").write_text(project, "utf-8")
    ended = in_process("validate", tmp_path / "project.toml")
    assert ended.code == 2
    assert all("fg-orient new" in line for line in ended.stderr.splitlines())


def test_images_alone_become_a_project_without_tables(tmp_path: Path) -> None:
    write_images(tmp_path / "in", place("tr"))
    ended = in_process("new", tmp_path / "in", "--out", tmp_path / "project")
    assert ended.code == 0, ended.stderr
    text_ = (tmp_path / "project" / "project.toml").read_text("utf-8")
    assert 'metadata = "../in/left_RPC.TXT"' in text_
    assert "[points]" not in text_
    assert "next: measure tie points (fg-orient match " in ended.stdout
    project = tmp_path / "project" / "project.toml"
    seen = in_process("footprint", project, "--height", "0", "--json")
    assert [image["image"] for image in seen.json["images"]] == ["left", "right"]
    for command in (("validate", project), ("adjust", project, "--out", tmp_path / "result")):
        refused = in_process(*command)
        assert refused.code == 2
        assert "the project has no image points; measure tie points with fg-orient match" in refused.stderr


def test_an_existing_project_is_kept(tmp_path: Path) -> None:
    office_folder(tmp_path)
    words = ("new", tmp_path / "office", "--out", tmp_path / "project", "--first-pixel", "1", *STATED, "--yes")
    assert in_process(*words).code == 0
    assert "--overwrite" in in_process(*words).stderr
    assert in_process(*words, "--overwrite", "--json").json["crs"] == "EPSG:32636"


@pytest.mark.parametrize(("header", "columns"), [(True, "E=b,N=c,H=d,id=a"), (False, "E=#2,N=#3,H=#4,id=#1")])
def test_columns_that_nobody_can_guess(tmp_path: Path, header: bool, columns: str) -> None:
    there = place("tr")
    write_images(tmp_path / "in", there)
    rows: Grid = [["a", "b", "c", "d"]] * header
    rows += [[i, *map(number, p)] for i, p in zip(there.ids, there.map("EPSG:32636"), strict=True)]
    (tmp_path / "in" / "t.csv").write_text(text(rows, ","), "utf-8")
    marks: Grid = [["Image", "Point", "Row", "Col"], *pixel_rows(there)]
    (tmp_path / "in" / "m.csv").write_text(text(marks, ","), "utf-8")
    stated = ("--crs", "EPSG:32636", "--first-pixel", "0", *STATED, "--yes")
    ended = in_process("new", tmp_path / "in", "--out", tmp_path / "project", "--columns", columns, *stated)
    assert ended.code == 0, ended.stderr
    assert differences(made(tmp_path / "project"), there) < (1e-3, 1e-3)


def test_a_stated_crs_in_which_the_points_are_in_no_image(tmp_path: Path) -> None:
    """``new`` names the CRS that it finds without the statement."""
    office_folder(tmp_path)
    stated = ("--crs", "EPSG:32635", "--first-pixel", "1", *STATED, "--yes")
    ended = in_process("new", tmp_path / "office", "--out", tmp_path / "project", *stated)
    assert ended.code == 2
    assert "in the stated CRS" in ended.stderr
    assert "they are in EPSG:32636" in ended.stderr


def test_words_for_pixels_that_are_exchanged(tmp_path: Path) -> None:
    """``new`` finds by the images that line and sample are exchanged in a table, states it and corrects it."""
    there = place("tr")
    write_images(tmp_path / "in", there)
    rows: Grid = [["No", "East", "North", "Ellipsoidal height"]]
    rows += [[int(i), *map(float, p)] for i, p in zip(there.ids, there.map("EPSG:32636"), strict=True)]
    marks: Grid = [["Image", "No", "Col", "Row"]]
    marks += [[name, int(i), float(a), float(b)] for name, i, a, b in pixel_rows(there)]
    write_xlsx(tmp_path / "in" / "t.xlsx", A=rows, B=marks)
    ended = in_process("new", tmp_path / "in", "--out", tmp_path / "project", "--first-pixel", "0", *STATED, "--yes")
    assert ended.code == 0, ended.stderr
    assert "line and sample: exchanged" in ended.stderr
    assert differences(made(tmp_path / "project"), there) < (1e-3, 1e-3)


def marks_table(there: Place, names: tuple[str, str] = ("left", "right"), ids: str = "") -> str:
    return text(
        [["Image", "Point", "Row", "Col"], *([a, ids + b, *rest] for a, b, *rest in pixel_rows(there, names=names))]
    )


def test_images_of_tie_points_are_told_by_rays_that_meet(tmp_path: Path) -> None:
    """``new`` asks which image is which if rays of tie points meet both ways, and decides if they meet one way only.

    The two images are nearly alike, so that after an exchange the rays meet at mirrored heights.
    """
    there = place("fr")
    write_images(tmp_path / "in", there)
    (tmp_path / "in" / "ties.csv").write_text(marks_table(there, ("A", "B")), "utf-8")
    words = ("new", tmp_path / "in", "--out", tmp_path / "project", "--first-pixel", "0", *STATED, "--yes")
    asked = in_process(*words)
    assert (asked.code, "A=right,B=left (rays meet within" in asked.stderr) == (2, True)
    far = there.models[1].offsets + np.array([0.0, 3000.0, 0.0, 0.0, 0.0])
    write_rpc(tmp_path / "in" / "right_RPC.TXT", replace(there.models[1], offsets=far))
    moved = np.stack([there.pixels[0], there.pixels[1] + (0.0, 3000.0)])
    rows = text([["Image", "Point", "Row", "Col"], *pixel_rows(replace(there, pixels=moved), names=("A", "B"))])
    (tmp_path / "in" / "ties.csv").write_text(rows, "utf-8")
    ended = in_process(*words)
    assert ended.code == 0, ended.stderr
    assert "A=left,B=right, rays meet within" in ended.stderr
    survey = made(tmp_path / "project")
    assert (set(survey.roles), survey.images) == ({"tie"}, ("left", "right"))
    assert np.abs(np.stack([survey.observed.line, survey.observed.sample], 1) - moved.reshape(-1, 2)).max() < 1e-4


def test_ids_are_those_that_the_other_table_has(tmp_path: Path) -> None:
    there = place("fr")
    write_images(tmp_path / "in", there)
    rows: Grid = [["Point ID", "Name", "Easting", "Northing", "Ellipsoidal height"]]
    rows += [[k, i, *map(number, p)] for k, (i, p) in enumerate(zip(there.ids, there.map(), strict=True))]
    (tmp_path / "in" / "a.csv").write_text(text(rows), "utf-8")
    (tmp_path / "in" / "b.csv").write_text(marks_table(there), "utf-8")
    words = ("new", tmp_path / "in", "--out", tmp_path / "project", "--first-pixel", "0", *STATED, "--yes")
    ended = in_process(*words)
    assert ended.code == 0, ended.stderr
    assert "ids of a.csv: Name" in ended.stderr
    assert differences(made(tmp_path / "project"), there) < (1e-3, 1e-3)


@pytest.mark.parametrize(
    ("names", "said"), [(("left", "right"), "the same ids"), (("left", "left.tif"), "two names for the image")]
)  # fmt: skip
def test_two_tables_that_may_mean_other_points_or_the_same_image(
    tmp_path: Path, names: tuple[str, str], said: str
) -> None:
    there = place("fr")
    write_images(tmp_path / "in", there)
    (tmp_path / "in" / "a.csv").write_text(marks_table(there), "utf-8")
    (tmp_path / "in" / "b.csv").write_text(marks_table(there, names, "" if names[1] == "right" else "T"), "utf-8")
    ended = in_process("new", tmp_path / "in", "--out", tmp_path / "project", "--first-pixel", "0", *STATED, "--yes")
    assert (ended.code, len(ended.stderr.splitlines())) == (2, 1)
    assert said in ended.stderr
