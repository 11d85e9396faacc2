"""Texts that a spreadsheet would read as a formula stay text in LibreOffice, and are read back unchanged."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_orient.formats.columns import regular
from fg_orient.formats.table_write import cell_text, own_cell, quoted, save_table
from fg_orient.formats.tables import MAX_LINE, require_table
from fg_orient.model.errors import InputError

SOFFICE = shutil.which("soffice")
#: Texts that a spreadsheet runs as formulas, texts that look like their escaped form, and other texts.
FORMULAS = ["=1+1", "=cmd|'/c calc'!A0", "+1+1", "-1+1", "@SUM(1)", '=HYPERLINK("http://x","y")', "-A1", "+A1"]
#: Texts with a formula after a mark at which the user may let a spreadsheet split.
INNER = ["a;=1+1;b", "a\t=1+1", 'a;"=1+1"', "a;'=1+1", "b;+1+1", "c;@SUM(1)", "d;-A1", "e;\t=1+1", "f; =1+1"]
#: Texts with a formula after a line break, which our CSV readers refuse.
BROKEN = ["a\n=1+1", "b\r=1+1", "c\r\n=1+1"]
OTHERS = ["'=1+1", "''=1", "'", "'-5", "O'Neil", "-1.5", "+2e3", "01", "a=b", "#1", 'a"b', "a,b"]


@pytest.mark.behaviour
def test_every_text_is_read_back(tmp_path: Path) -> None:
    file, ids = tmp_path / "t.csv", [*FORMULAS, *INNER, *OTHERS]
    save_table(file, {"id": ids, "x_m": -np.arange(float(len(ids)))})
    table = require_table(file, [("id", "x_m")])
    assert list(table.cells["id"]) == ids
    assert np.array_equal(table.numbers("x_m")[:, 0], -np.arange(float(len(ids))))


@pytest.mark.behaviour
@given(st.text(alphabet="'=+-@\t1.ea;\r\n \"", max_size=8))
def test_the_apostrophe_is_removed_exactly_where_it_was_added(text: str) -> None:
    """An escaped text is read back unchanged, also with own apostrophes, and no part of it begins as a formula does."""
    written = own_cell(text)
    plain = next(csv.reader(io.StringIO(written, newline=""), strict=True), [""])[0] if '"' in written else written
    assert cell_text(plain) == text
    parts = [part for whole in (plain, written) for part in re.split(r"[;\t\r\n]", whole)]
    assert not any(re.match(r"[ \"]*([=@]|[+-](?![0-9.]+(e[+-]?[0-9]+)?\"?\Z))", part) for part in parts)


@pytest.mark.behaviour
@pytest.mark.parametrize("text", ["\0=1+1", "a\0", "\0"])
def test_nul_is_refused(tmp_path: Path, text: str) -> None:
    """LibreOffice removes NUL; with NUL before it, ``=1`` would be a formula."""
    with pytest.raises(InputError, match="NUL"):
        save_table(tmp_path / "t.csv", {"id": ["a", text]})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.behaviour
def test_a_table_with_an_escaped_text_is_not_read_as_slices_of_bytes() -> None:
    """The fast reader leaves a table with an escaped text to the slow one, because it does not change bytes."""
    assert regular("id,x\na,1\n", MAX_LINE) is not None
    assert regular("id,x\n'=a,1\n", MAX_LINE) is None


@pytest.mark.oracle
@pytest.mark.skipif(SOFFICE is None, reason="LibreOffice is not installed")
@pytest.mark.parametrize(
    "separators", ["44", pytest.param("59", marks=pytest.mark.slow), pytest.param("59/44/9", marks=pytest.mark.slow)]
)
def test_libreoffice_takes_the_texts_as_text(tmp_path: Path, separators: str) -> None:
    """LibreOffice reads our texts as text with all separators, and the unescaped texts as formulas."""
    ids = [*FORMULAS, *INNER, *BROKEN]
    save_table(tmp_path / "ours.csv", {"id": ids, "role": ids})
    raw = "".join(f"{quoted(text)},{quoted(text)}\n" for text in ["id", *ids])
    (tmp_path / "raw.csv").write_text(raw, encoding="utf-8", newline="")
    form = f"Text - txt - csv (StarCalc):{separators},34,76,1,,0,false,true,false,false,false,0,true"
    for name in ("ours", "raw"):
        # the last token: formulas of the file are evaluated, as a user may choose on import
        subprocess.run(
            [str(SOFFICE), f"-env:UserInstallation={(tmp_path / 'profile').as_uri()}", "--headless", "--convert-to",
             "fods", f"--infilter={form}",
             "--outdir", str(tmp_path), str(tmp_path / f"{name}.csv")],
            check=True, capture_output=True, timeout=600,
        )  # fmt: skip
    cells = {name: _cells(tmp_path / f"{name}.fods") for name in ("ours", "raw")}
    if separators == "44":
        shown = [text.lstrip("'") for text, _ in cells["ours"]]  # equal neighbours are one element
        assert [text for text in shown if text in FORMULAS] == FORMULAS
    assert not any(is_formula for _, is_formula in cells["ours"])
    assert sum(is_formula for _, is_formula in cells["raw"]) >= 3


def _cells(file: Path) -> list[tuple[str, bool]]:
    """Return the shown text of each cell, and whether it is a formula."""
    table, found = "urn:oasis:names:tc:opendocument:xmlns:table:1.0", list[tuple[str, bool]]()
    for cell in ElementTree.parse(file).iterfind(".//t:table-row/t:table-cell", {"t": table}):
        text, is_formula = "".join(cell.itertext()).strip(), f"{{{table}}}formula" in cell.attrib
        found += [(text, is_formula)] if text or is_formula else []
    return found
