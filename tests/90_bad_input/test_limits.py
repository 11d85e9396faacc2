"""Each loader refuses small files that imply large data within its time and memory; limits can be raised."""

from __future__ import annotations

import gzip
import io
import sqlite3
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.formats.exchange.bal import read_bal_data
from fg_orient.formats.exchange.colmap_database import read_colmap_database
from fg_orient.formats.load import load_json, load_npz
from fg_orient.formats.rpc.fields import read_text
from fg_orient.formats.toml import parse_toml
from fg_orient.formats.xml import read_xml
from fg_orient.geodesy import known_crs
from fg_orient.model.errors import InputError, finding
from fg_orient.model.limits import LIMITS, VARIABLE, limit
from tests.fuzz.harness import outcome

pytestmark = pytest.mark.behaviour

COLMAP = "CREATE TABLE keypoints (image_id, rows, cols, data); CREATE TABLE matches (pair_id, rows, cols, data);"


def _database(*statements: str) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        with closing(sqlite3.connect(path)) as opened:
            opened.executescript(COLMAP + ";".join(statements))

    return write


def _npz(path: Path) -> None:
    """Write 240 MB of zeros, deflated to 240 kB."""
    with path.open("wb") as stream:
        np.savez_compressed(stream, a=np.zeros(30_000_000))


def _stated(path: Path) -> None:
    """Write a header that states 8 TB."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", header.getvalue())


def _packed(path: Path) -> None:
    path.write_bytes(gzip.compress(b" " * 60_000_000, 1))


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, "utf-8")


def _json(path: Path) -> object:
    return load_json(path, "interchange.json")


def _arrays(path: Path) -> object:
    return load_npz(path, "checkpoint.unreadable")


def _crs(path: Path) -> object:
    return known_crs(path.read_text("utf-8"))


#: Bomb: how the file is written, its reader, and the code of the refusal.
BOMBS: dict[str, tuple[Callable[[Path], object], Callable[[Path], object], str]] = {
    "JSON of small tables": (_text("[" + '{"":0},' * 4_000_000 + "0]"), _json, "limits.memory"),
    "JSON of deep lists": (_text("[" * 900 + "]" * 900), _json, "limits.exceeded"),
    "JSON of very deep lists": (_text("[" * 200_000), _json, "limits.memory interchange.json"),
    "JSON number of 5000 digits": (_text("1" * 5000), _json, "interchange.json"),
    "JSON with a lone surrogate": (_text('"\\ud800"'), _json, "interchange.json"),
    "TOML key of 50 000 parts": (_text("a." * 50_000 + "b = 1"), parse_toml, "limits.exceeded"),
    "TOML tables of many parts": (_text("[" + ".".join("a" * 70) + "]"), parse_toml, "limits.exceeded"),
    "TOML of deep lists": (_text("a = " + "[" * 50_000), parse_toml, "limits.exceeded"),
    "TOML of deep tables": (_text("a = " + "{a = " * 50_000), parse_toml, "limits.exceeded"),
    "TOML number of 5000 digits": (_text("a = " + "1" * 5000), parse_toml, "project.syntax"),
    "TOML word of 1 MB": (_text("a" * 1_000_000), parse_toml, "project.syntax"),
    "XML of small elements": (_text("<a>" + "<b/>" * 2_500_000 + "</a>"), read_xml, "limits.memory"),
    "XML of deep elements": (_text("<a>" * 200_000), read_xml, "xml.malformed limits.memory"),
    "RPC of 17 MB": (_text("LINE_OFF: 1\n" * 1_450_000), read_text, "limits.exceeded"),
    "CRS of 200 kB": (_text("PROJCS[" * 30_000), _crs, "limits.exceeded"),
    "NPZ of zeros": (_npz, _arrays, "limits.memory"),
    "NPZ that states 8 TB": (_stated, _arrays, "checkpoint.unreadable"),
    "gzip of blanks": (_packed, read_bal_data, "limits.memory"),
    "SQLite view without end": (
        _database("CREATE VIEW images AS WITH RECURSIVE n(k) AS (VALUES (1) UNION ALL SELECT k + 1 FROM n) "
                  "SELECT k AS image_id, 'a' AS name FROM n"), read_colmap_database, "colmap.database",
    ),
    "SQLite column of 90 MB": (
        _database("CREATE TABLE images (image_id INTEGER, name TEXT AS (hex(zeroblob(45000000))))",
                  "INSERT INTO images (image_id) VALUES (1)"), read_colmap_database, "colmap.database",
    ),
    "SQLite virtual table": (
        _database("CREATE VIRTUAL TABLE images USING rtree(image_id, a, b)"), read_colmap_database, "colmap.database",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_bomb_is_refused_within_time_and_memory(tmp_path: Path, name: str) -> None:
    write, read, codes = BOMBS[name]
    path = tmp_path / "file"
    write(path)
    found = outcome(lambda: read(path), path.stat().st_size)
    assert found in (codes.split() or [""]), found


@pytest.mark.parametrize(("name", "text", "read"), [
    ("json_depth", "[[[]]]", _json), ("toml_depth", "a.a.a.a = 1", parse_toml), ("xml_bytes", "<a></a>", read_xml),
    ("crs_characters", "EPSG:4326", _crs), ("json_bytes", "[1, 2]", _json), ("rpc_bytes", "LINE: 1", read_text),
    ("toml_bytes", "a = 1", parse_toml),
])  # fmt: skip
def test_limit_is_named_and_can_be_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, text: str, read: Callable[[Path], Any]
) -> None:
    path = tmp_path / "file"
    path.write_text(text, "utf-8")
    read(path)
    known_crs.cache_clear()
    monkeypatch.setenv(VARIABLE, f"{name}=2")
    with pytest.raises(InputError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert problem.code == "limits.exceeded" and f'{VARIABLE}="{name}=NUMBER"' in problem.remedy
    monkeypatch.setenv(VARIABLE, f"memory_factor=30, {name}={len(text)}")
    read(path)


def test_variable_with_an_unknown_name_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("xml_byte=5", "xml_bytes=-1", "xml_bytes", "xml_bytes=nan", "xml_bytes=a"):
        monkeypatch.setenv(VARIABLE, text)
        with pytest.raises(InputError, match="known names: memory_factor"):
            limit("xml_bytes")
    monkeypatch.setenv(VARIABLE, " \t")
    assert all(limit(name) == value for name, value in LIMITS.items())


def test_messages_show_no_control_characters() -> None:
    """Messages escape control characters and lone surrogates.

    A terminal would execute the former; the latter cannot be printed.
    """
    one = finding("table.missing_file", file="a\x1b[2J\udcff.csv", value="\u202ea\0", place="line\n1")
    assert str(one).startswith(r"a\x1b[2J\udcff.csv, line 1: ") and r"\u202ea\x00" in str(one)
    assert str(one).encode("utf-8")
