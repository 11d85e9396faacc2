"""Texts that a spreadsheet would read as a formula stay text in LibreOffice, and are read back unchanged."""

from __future__ import annotations

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
from fg_orient.formats.table_write import cell_text, own_cell, save_table
from fg_orient.formats.tables import MAX_LINE, require_table

SOFFICE = shutil.which("soffice")
#: Texts that a spreadsheet runs as formulas, texts that look like their escaped form, and other texts.
FORMULAS = ["=1+1", "=cmd|'/c calc'!A0", "+1+1", "-1+1", "@SUM(1)", '=HYPERLINK("http://x","y")', "-A1", "+A1"]
OTHERS = ["'=1+1", "''=1", "'", "'-5", "O'Neil", "-1.5", "+2e3", "01", "a=b", "#1", 'a"b', "a,b"]


@pytest.mark.behaviour
def test_every_text_is_read_back(tmp_path: Path) -> None:
    file, ids = tmp_path / "t.csv", [*FORMULAS, *OTHERS]
    save_table(file, {"id": ids, "x_m": -np.arange(float(len(ids)))})
    table = require_table(file, [("id", "x_m")])
    assert list(table.cells["id"]) == ids
    assert np.array_equal(table.numbers("x_m")[:, 0], -np.arange(float(len(ids))))


@pytest.mark.behaviour
@given(st.text(alphabet="'=+-@\t1.ea", max_size=6))
def test_the_apostrophe_is_removed_exactly_where_it_was_added(text: str) -> None:
    """An escaped text is read back unchanged, also with own apostrophes, and never begins as a formula does."""
    written = own_cell(text)
    assert cell_text(written) == text
    assert re.match(r"[=@\t]|[+-](?![0-9.]+(e[+-]?[0-9]+)?\Z)", written) is None


@pytest.mark.behaviour
def test_a_table_with_an_escaped_text_is_not_read_as_slices_of_bytes() -> None:
    """The fast reader leaves a table with an escaped text to the slow one, because it does not change bytes."""
    assert regular("id,x\na,1\n", MAX_LINE) is not None
    assert regular("id,x\n'=a,1\n", MAX_LINE) is None


@pytest.mark.oracle
@pytest.mark.skipif(SOFFICE is None, reason="LibreOffice is not installed")
def test_libreoffice_takes_the_texts_as_text(tmp_path: Path) -> None:
    """LibreOffice reads our texts as text, and the same texts in quotes only as formulas."""
    save_table(tmp_path / "ours.csv", {"id": FORMULAS})
    raw = "".join('"' + text.replace('"', '""') + '"\n' for text in ["id", *FORMULAS])
    (tmp_path / "raw.csv").write_text(raw, encoding="utf-8")
    for name in ("ours", "raw"):
        # the last token: formulas of the file are evaluated, as a user may choose on import
        subprocess.run(
            [str(SOFFICE), f"-env:UserInstallation={(tmp_path / 'profile').as_uri()}", "--headless", "--convert-to",
             "fods", "--infilter=Text - txt - csv (StarCalc):44,34,76,1,,0,false,true,false,false,false,0,true",
             "--outdir", str(tmp_path), str(tmp_path / f"{name}.csv")],
            check=True, capture_output=True, timeout=600,
        )  # fmt: skip
    cells = {name: _cells(tmp_path / f"{name}.fods") for name in ("ours", "raw")}
    assert [text for text, _ in cells["ours"]] == ["id", *(f"'{text}" for text in FORMULAS)]
    assert not any(is_formula for _, is_formula in cells["ours"])
    assert sum(is_formula for _, is_formula in cells["raw"]) >= 3


def _cells(file: Path) -> list[tuple[str, bool]]:
    """Return the shown text of each cell of the first column, and whether it is a formula."""
    table, found = "urn:oasis:names:tc:opendocument:xmlns:table:1.0", list[tuple[str, bool]]()
    for cell in ElementTree.parse(file).iterfind(".//t:table-row/t:table-cell[1]", {"t": table}):
        text, is_formula = "".join(cell.itertext()).strip(), f"{{{table}}}formula" in cell.attrib
        found += [(text, is_formula)] if text or is_formula else []
    return found
