"""The published tables are complete with digits and doubts; damaged ones are refused by file and line."""

from __future__ import annotations

import math
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import PublishedTables, load
from fg_orient.studies.tables_spot5 import PUBLISHED_SETS

Printed = dict[str, PublishedTables]
CONDITIONS = "table-4-03-to-09-ls-conditions-spot5.csv"


@pytest.mark.truth
def test_every_table_is_complete(printed: Printed) -> None:
    """Each published table has the number of cells of its source's description."""
    count = Counter(cell.key.table for cell in printed["terlemezoglu2019"].cells)
    series = {"4.3-4.9": (3, 9, 126), "4.10-4.16": (10, 16, 126), "4.17-4.23": (17, 23, 864), "4.24": (24, 24, 60),
              "4.25-4.27": (25, 27, 252), "4.28-4.34": (28, 34, 504)}  # fmt: skip
    for first, last, cells in series.values():
        assert sum(count[f"4.{k}"] for k in range(first, last + 1)) == cells
    assert (count["4.1"], count["4.2"], count["s4.2.2"]) == (9, len(PUBLISHED_SETS) + 162, 8)
    assert sum(count[f"eq4.{k}"] for k in range(1, 7)) == 22
    topan = Counter(cell.key.table for cell in printed["topan2010"].cells)
    assert (topan["1"], topan["2"]) == (63, 399)


@pytest.mark.truth
def test_printed_digits_and_doubts_are_kept(printed: Printed) -> None:
    cells = {cell.key: cell for cell in printed["terlemezoglu2019"].cells}
    doubtful = cells[CellKey("4.25", "13", "bundle", "2", "gcp", "rmse_x", "tikhonov_hkb")]
    assert (doubtful.value, doubtful.text, doubtful.printed) == (2139.383, "2139.383", "21.39.383")
    assert doubtful.note.startswith("doubt:")
    assert cells[CellKey("4.25", "5", "bundle", "1", "gcp", "rmse_x", "tikhonov_hkb")].text == "0.510"
    failed = cells[CellKey("4.31", "5", "bundle", "1", "gcp", "rmse_x", "cholesky_inverse")]
    assert math.isnan(failed.value)
    assert failed.text == "nan"


@pytest.mark.truth
def test_words_and_gaps_are_no_numbers(printed: Printed) -> None:
    words = [c for c in printed["topan2010"].cells if c.key.quantity == "accuracy_order"]
    gaps = [c for c in printed["topan2010"].cells if c.key.table == "1" and not c.text]
    assert [c.text for c in words] == [""]
    assert words[0].printed
    assert [c.printed for c in gaps] == ["-"] * 3


@pytest.mark.behaviour
def test_tables_come_in_the_order_of_the_publication(printed: Printed) -> None:
    titles = [name for name in printed["terlemezoglu2019"].titles if name.startswith("4.")]
    assert titles == [f"4.{k}" for k in range(1, 56)]
    order = list(printed["terlemezoglu2019"].titles)
    places = [order.index(cell.key.table) for cell in printed["terlemezoglu2019"].cells]
    assert places == sorted(places)


@pytest.mark.behaviour
def test_a_copy_of_the_folder_reads_alike(printed: Printed, copied: Callable[[str], Path]) -> None:
    folder = copied("topan2010")
    expected = repr(printed["topan2010"])  # nan is not equal to itself
    assert repr(load("topan2010", folder)) == expected
    assert repr(load("topan2010", folder.parent)) == expected, "the folder above is fine, too"


@pytest.mark.behaviour
def test_package_data_is_not_ignored(repository: Path) -> None:
    """git ignores no published table; the wheel would not contain an ignored file."""
    paths = [str(p) for p in (repository / "fg_orient" / "studies" / "published").rglob("*.csv")]
    assert len(paths) == 26 + 18 + 17
    if not (repository / ".git").exists():
        pytest.skip("not a git repository")
    words = ["git", "-c", "safe.directory=*", "check-ignore", *paths]
    done = subprocess.run(words, cwd=repository, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")  # 1: none is ignored; 128: git failed


def edit(path: Path, line: int, old: str, new: str) -> None:
    """Replace text in one line (1-based)."""
    lines = path.read_text("utf-8").splitlines()
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    path.write_text("\n".join(lines) + "\n", "utf-8")


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("line", "old", "new", "code", "place"),
    [
        (1, ",value,", ",worth,", "published.column", "line 1"),
        (3, ",9,,", ",nine,,", "published.not_a_number", "line 3, column value"),
        (4, "4.3,1,", "4.3,1,,", "published.row", "line 4"),
        (4, "4.3,1,", "4.33,1,", "published.table", "line 4"),
        (4, "pre-right", "pre-left", "published.twice", "line 4"),
        (4, "4.3,", "4.4,", "published.count", "table 4.3"),
        (4, "pre-right", "pre-rihgt", "published.unknown_cell", "line 4"),
        (4, "n_observations", "n_obs", "published.unknown_cell", "line 4"),
    ],
)
def test_damage_is_refused_with_file_and_line(
    copied: Callable[[str], Path], line: int, old: str, new: str, code: str, place: str
) -> None:
    folder = copied("terlemezoglu2019")
    edit(folder / CONDITIONS, line, old, new)
    with pytest.raises(InputError) as caught:
        load("terlemezoglu2019", folder)
    (found,) = caught.value.problems
    assert found.code == code
    assert found.file.endswith(CONDITIONS)
    assert found.place == place


@pytest.mark.behaviour
def test_missing_and_unreadable_files_are_refused(copied: Callable[[str], Path], tmp_path: Path) -> None:
    folder = copied("terlemezoglu2019")
    path = folder / CONDITIONS
    lines = path.read_bytes().splitlines(keepends=True)
    for data, code in ((b"".join(lines[:-1]), "published.count"), (b"\xff\xfe" + lines[0], "published.unreadable"),
                       (b"", "published.column"), (None, "published.unreadable")):  # fmt: skip
        path.unlink()
        if data is not None:
            path.write_bytes(data)
        with pytest.raises(InputError) as caught:
            load("terlemezoglu2019", folder)
        assert (caught.value.problems[0].code, Path(caught.value.problems[0].file).name) == (code, CONDITIONS)
    with pytest.raises(InputError, match="not a folder"):
        load("terlemezoglu2019", tmp_path / "nowhere")
    with pytest.raises(InputError, match="choose one of terlemezoglu2019, topan2010"):
        load("topan2011")
