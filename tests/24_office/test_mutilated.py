"""Mutilated tables and workbooks are refused in one line that names the file."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.command import in_process
from tests.support.office import Grid, number, pixel_rows, place, text, write_images, write_ods, write_xlsx

pytestmark = pytest.mark.behaviour

POINTS, MARKS = "noktalar.csv", "olcu.csv"
WORDS = ("--yes", "--first-pixel", "1", "--sigma-ground", "0.05", "0.05", "0.1", "--sigma-image", "0.5", "0.5")


def points() -> Grid:
    there = place("tr")
    rows: Grid = [["Nokta No", "Doğu", "Kuzey", "Elipsoidal yükseklik", "Tür"]]
    return rows + [[i, *(number(v, ",") for v in p), "kontrol"] for i, p in zip(there.ids, there.map(), strict=True)]


def cell(row: int, column: int, value: str) -> Callable[[Grid], Grid]:
    """Replace a cell of the points."""

    def change(rows: Grid) -> Grid:
        return [[value if (i, j) == (row, column) else c for j, c in enumerate(r)] for i, r in enumerate(rows)]

    return change


def mark(row: int, column: int, value: str) -> Callable[[Path], None]:
    """Replace a cell of the image points."""

    def change(folder: Path) -> None:
        rows: Grid = [["Görüntü", "Nokta No", "Satır", "Sütun"], *pixel_rows(place("tr"), ",", 1.0)]
        rows[row][column] = value
        (folder / MARKS).write_text(text(rows), "utf-8")

    return change


#: Changes of the rows of the points, and words that the error must contain.
ROWS: dict[str, tuple[Callable[[Grid], Grid], str]] = {
    "a word for a coordinate": (cell(5, 1, "?"), "line 6, column Doğu"),
    "a blank coordinate": (cell(5, 2, ""), "line 6, column Kuzey"),
    "a point for a comma": (cell(5, 1, "401234.5678"), "line 6, column Doğu"),
    "two commas": (cell(5, 1, "401,234,56"), "line 6, column Doğu"),
    "nan": (cell(7, 3, "nan"), "line 8"),
    "infinity": (cell(7, 3, "inf"), "line 8"),
    "too large a number": (cell(7, 3, "1e400"), "line 8"),
    "a formula that failed": (cell(7, 3, "#REF!"), "line 8"),
    "a height with its unit": (cell(7, 3, "301,2 m"), "line 8"),
    "a repeated id": (cell(4, 0, "101"), "used twice"),
    "no id": (cell(4, 0, ""), "line 5"),
    "an unknown role": (cell(4, 4, "belirsiz"), "--role-column"),
    "a row too long": (lambda rows: [*rows[:4], [*rows[4], "1", "2"], *rows[5:]], "more cells"),
    "a row without numbers": (lambda rows: [*rows[:4], ["bölüm", "iki", "-", "-", "-"], *rows[4:]], "line 5"),
    "a repeated column": (lambda rows: [[*r[:2], r[1], *r[2:]] for r in rows], "--columns"),
    "no northing": (lambda rows: [[r[0], r[1], r[3]] for r in rows], "--columns"),
    "no numbers": (lambda rows: rows[:1], "no rows of numbers"),
    "a decimal comma beside commas": (lambda rows: [[",".join(r)] for r in rows], "more cells"),
    "another place": (lambda rows: [rows[0], *([r[0], r[1], "5" + r[2][1:], *r[3:]] for r in rows[1:])], "--crs"),
    "shuffled ids": (
        lambda rows: [rows[0], *([a[0], *b[1:]] for a, b in zip(rows[1:], rows[:0:-1], strict=True))], "fits"
    ),
    "other ids": (lambda rows: [rows[0], *(["P" + r[0], *r[1:]] for r in rows[1:])], "no id in common"),
}  # fmt: skip

#: Changes of the folder.
FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "an empty file": (lambda f: (f / POINTS).write_bytes(b""), "no points"),
    "bytes": (lambda f: (f / POINTS).write_bytes(bytes(range(256)) * 9), "not text"),
    "half of UTF-16": (lambda f: (f / POINTS).write_bytes(text(points()).encode("utf-16")[:1001]), "not text"),
    "no workbook": (lambda f: (f / "a.xlsx").write_bytes(b"no zip"), "damaged"),
    "an old workbook": (lambda f: (f / "a.xls").write_bytes(b"\xd0\xcf\x11\xe0"), "before 2007"),
    "no GeoPackage": (lambda f: (f / "a.gpkg").write_bytes(b"SQLite format 3\0"), "layers"),
    "an unknown image": (mark(1, 0, "centre"), "--image"),
    "a pixel outside": (mark(3, 2, "99999"), "outside"),
    "a word for a pixel": (mark(3, 3, "x"), "line 4, column Sütun"),
    "a point measured twice": (mark(4, 1, "101"), "line 5"),
    "no pixel": (mark(3, 3, ""), "line 4, column Sütun"),
    "no images": (lambda f: [p.unlink() for p in f.glob("*_RPC.TXT")], "no file contains"),
}


def refused(folder: Path, *words: object) -> str:
    """Return the only line of a refusal."""
    ended = in_process("new", folder, "--out", folder.parent / "project", *WORDS, *words)
    assert ended.code == 2, (ended.code, ended.stderr)
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert not (folder.parent / "project").exists()
    return ended.stderr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder that is read without errors."""
    folder = tmp_path / "in"
    write_images(folder, place("tr"))
    mark(1, 0, "left")(folder)
    (folder / POINTS).write_text(text(points()), "utf-8")
    return folder


def test_the_folder_itself_is_read(folder: Path) -> None:
    assert in_process("new", folder, "--out", folder.parent / "project", *WORDS).code == 0


@pytest.mark.parametrize("case", ROWS)
def test_mutilated_rows(folder: Path, case: str) -> None:
    change, said = ROWS[case]
    (folder / POINTS).write_text(text(change(points())), "utf-8")
    assert said in refused(folder)


@pytest.mark.parametrize("case", FILES)
def test_mutilated_files(folder: Path, case: str) -> None:
    change, said = FILES[case]
    change(folder)
    assert said in refused(folder)


@pytest.mark.parametrize(
    "words", [("--columns", "E=Batı"), ("--columns", "Q=Doğu"), ("--columns", "Doğu"), ("--crs", "EPSG:1"),
              ("--first-pixel", "2"), ("--decimal", "dot"), ("--units", "E=inch"),
              ("--heights", "geoid"), ("--image", "a")]
)  # fmt: skip
def test_wrong_options(folder: Path, words: tuple[str, str]) -> None:
    assert words[0] in refused(folder, *words)


@pytest.mark.parametrize("end", ["xlsx", "ods"])
def test_damaged_workbooks(folder: Path, end: str) -> None:
    path = folder / f"a.{end}"
    (write_xlsx if end == "xlsx" else write_ods)(path, A=points())
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:200] + bytes(200) + whole[400:]):
        path.write_bytes(damaged)
        assert "damaged" in refused(folder)


def repacked(path: Path, change: Callable[[str, bytes], bytes]) -> None:
    """Change the parts of a workbook."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, change(name, data))


def test_bombs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A workbook that unpacks to too much data, states a huge sheet or has a DOCTYPE is refused in one line."""
    monkeypatch.setenv("FG_ORIENT_LIMITS", "workbook_bytes=4e6 workbook_cells=1e5")
    path = folder / "a.xlsx"
    write_xlsx(path, A=points())
    repacked(path, lambda name, data: data + b" " * (5_000_000 * name.endswith("sheet1.xml")))
    assert path.stat().st_size < 20_000
    assert "exceeds the limit of" in refused(folder)
    last = b'<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
    write_xlsx(path, A=points())
    repacked(path, lambda name, data: data.replace(b"</sheetData>", last))
    assert "exceeds the limit of" in refused(folder)
    path.unlink()
    path = folder / "a.ods"
    for times in (b"2000000000", b"200000"):
        write_ods(path, A=points())
        long = b'<table:table-cell table:number-columns-repeated="' + times + b'" office'
        repacked(path, lambda _, data, long=long: data.replace(b"<table:table-cell office", long, 1))  # type: ignore[misc]
        assert re.search("exceeds the limit|damaged", refused(folder))
    write_ods(path, A=points())
    repacked(path, lambda _, data: data.replace(b"?>", b'?><!DOCTYPE a [<!ENTITY b "c">]>', 1))
    assert "damaged" in refused(folder)
