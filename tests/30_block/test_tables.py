"""The tests check which texts the CSV reader accepts, and its numbers digit by digit."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fg_orient.formats.faults import MAX_FAULTS, Faults
from fg_orient.formats.tables import Row, number, read_table


def read(tmp_path: Path, data: bytes | str, columns=(("id", "x_m"),)):
    path = tmp_path / "t.csv"
    path.write_bytes(data.encode("utf-8") if isinstance(data, str) else data)
    faults = Faults("t.csv")
    return read_table(path, columns, faults), faults


def rows_of(table):
    return [table.row(k) for k in range(len(table))]


@pytest.mark.behaviour
def test_byte_order_mark_crlf_comments_and_blank_lines(tmp_path):
    table, faults = read(tmp_path, b"\xef\xbb\xbf# made by hand\r\nid,x_m\r\n\r\n 01 , 2.5\r\n#7,8\r\n,,\r\n1,3\r\n")
    assert not faults and table is not None
    assert [(row.line, row.cells) for row in rows_of(table)] == [
        (4, {"id": "01", "x_m": "2.5"}),
        (7, {"id": "1", "x_m": "3"}),
    ]


@pytest.mark.behaviour
def test_columns_in_any_order_quotes_and_empty_trailing_cells(tmp_path):
    table, faults = read(tmp_path, 'x_m,id,\n1,"a,b",\n2,"say ""x""",,\n')
    assert not faults and table is not None
    assert [row.cells["id"] for row in rows_of(table)] == ["a,b", 'say "x"']


@pytest.mark.behaviour
def test_faults_are_counted_beyond_the_first_twenty(tmp_path):
    table, faults = read(tmp_path, "id,x_m\n" + "a,oops\n" * 50)
    assert table is not None
    for row in rows_of(table):
        number(row, "x_m", faults)
    assert len(faults.problems) == MAX_FAULTS + 1
    assert faults.problems[-1].code == "table.more_faults" and faults.problems[-1].value == "30 more"


@pytest.mark.oracle
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_double_is_read_back(value):
    faults = Faults("t.csv")
    assert number(Row(2, {"x": repr(value)}), "x", faults) == value and not faults


@pytest.mark.behaviour
@given(st.text(max_size=12) | st.text("0123456789+-.eE_, ٣xinfa", max_size=5))
@example("1_0")
@example("٣")
@example(" 1")
@example("nan")
@example("infinity")
@example("0x1F")
@example("+.5E-3")
@example("5.")
@example("1e999")
def test_only_plain_decimal_numbers_are_numbers(text):
    """A text is a number only if it has ASCII digits, with sign, point and exponent at their places, and is finite."""
    faults = Faults("t.csv")
    value = number(Row(2, {"x": text}), "x", faults)
    plain = re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text)
    if plain and math.isfinite(float(text)):
        assert value == float(text) and not faults
    else:
        assert math.isnan(value) and faults


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "text",
    ["", "nan", "NaN", "inf", "-Infinity", "1e400", "1,5", "1_000", "0x10", "1e", "--1", "٣", "1 2", "1d3", "1.5m"],
)
def test_anything_else_is_refused(text):
    faults = Faults("t.csv")
    assert math.isnan(number(Row(3, {"x_m": text}), "x_m", faults))
    (found,) = faults.problems
    assert found.place == "line 3, column x_m" and found.value == repr(text) and found.remedy


@pytest.mark.behaviour
@given(st.binary(max_size=200))
def test_no_bytes_whatever_break_the_reader(tmp_path_factory, data):
    table, faults = read(tmp_path_factory.mktemp("t"), data)
    assert (table is not None and len(table)) or faults
    assert all("\n" not in str(p) and p.remedy for p in faults.problems)
