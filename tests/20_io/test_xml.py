"""The tests check typed access to elements: units, numbers, times and paths."""

from __future__ import annotations

import re
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fg_orient.formats.xml import (
    DEGREES,
    LARGEST,
    METRES,
    MILLISECONDS,
    PURE,
    RADIANS,
    SECONDS,
    Quantity,
    XmlNode,
    read_xml,
)
from fg_orient.model.errors import InputError


def node(tmp_path: Path, inner: str) -> XmlNode:
    path = tmp_path / "small.xml"
    path.write_text(f"<root>{inner}</root>", "utf-8")
    return read_xml(path)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("text", "quantity", "expected"),
    [
        ("<a>2</a>", SECONDS, 2.0),
        ("<a>2</a>", MILLISECONDS, 2e-3),
        ('<a unit="microsecond">2</a>', MILLISECONDS, 2e-6),
        ('<a unit=" MS ">2</a>', SECONDS, 2e-3),
        ('<a unit="\u00b5s">2</a>', SECONDS, 2e-6),
        ('<a unit="km">2</a>', METRES, 2e3),
        ('<a unit="deg">180</a>', RADIANS, np.pi),
        ('<a unit="deg">180</a>', DEGREES, 180.0),
        ("<a> \n+1.5E-3\t</a>", PURE, 1.5e-3),
        ("<a>-.5</a>", PURE, -0.5),
        ("<a>5.</a>", PURE, 5.0),
        ("<a>1e-400</a>", PURE, 0.0),
    ],
)
def test_numbers_follow_their_unit(tmp_path: Path, text: str, quantity: Quantity, expected: float) -> None:
    assert node(tmp_path, text).one("a").number(quantity) == pytest.approx(expected, rel=1e-15, abs=0.0)


@pytest.mark.oracle
@given(value=st.floats(-LARGEST, LARGEST))
def test_every_printed_float_is_read_exactly(tmp_path_factory: pytest.TempPathFactory, value: float) -> None:
    root = node(tmp_path_factory.mktemp("n"), f"<a>{value!r}</a>")
    assert root.one("a").number() == value


@pytest.mark.behaviour
@pytest.mark.parametrize("text", ["1.1e30", "-1e31", "1e154", "1e308", "1e400"])
def test_numbers_of_impossible_size_are_refused(tmp_path: Path, text: str) -> None:
    """A number of 1e30 or more is refused as too large, because its square would overflow in later checks."""
    with pytest.raises(InputError, match="not a finite number, or it is too large"):
        node(tmp_path, f"<a>{text}</a>").one("a").number()


@pytest.mark.behaviour
@given(
    text=st.text(st.characters(exclude_characters="<&\r", exclude_categories=("Cs", "Cc")), min_size=1, max_size=12)
    | st.text("0123456789+-.eE_, ٣xinfa", min_size=1, max_size=5)
)
@example(text="1_0")
@example(text="٣")
@example(text="infinity")
@example(text="0x1F")
def test_other_text_is_never_a_number(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    """A text is read as a number only if it has ASCII digits, with sign, point and exponent at their places.

    Python's float() accepts more, for example underscores and other digits.
    """
    one = node(tmp_path_factory.mktemp("t"), f"<a>{text}</a>").one("a")
    plain = re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text.strip())
    if plain and abs(float(text)) <= LARGEST:
        assert one.number() == float(text)
    else:
        with pytest.raises(InputError):
            one.number()


@pytest.mark.behaviour
def test_vectors_have_their_count(tmp_path: Path) -> None:
    root = node(tmp_path, '<a unit="km">1 2\n 3</a>')
    np.testing.assert_array_equal(root.one("a").vector(3, METRES), [1e3, 2e3, 3e3])
    with pytest.raises(InputError, match="needs 4 numbers"):
        root.one("a").vector(4, METRES)


@pytest.mark.behaviour
def test_times_are_exact_and_cross_midnight(tmp_path: Path) -> None:
    root = node(tmp_path, "<a>2004-02-29T23:59:59.1234567890123Z</a><b>2004-03-01T00:00:00.5</b>")
    day, seconds = root.one("a").time()
    assert (day, seconds) == (np.datetime64("2004-02-29"), Decimal("86399.1234567890123"))
    assert root.one("b").seconds_since(day) == 86400.5
    assert root.one("a").seconds_since(np.datetime64("2004-03-01")) == float(Decimal("-0.8765432109877"))


@pytest.mark.behaviour
def test_a_step_of_a_path_may_not_be_doubled(tmp_path: Path) -> None:
    root = node(tmp_path, "<a><b>1</b></a>\n<a><b>2</b></a><c/>")
    with pytest.raises(InputError) as caught:
        root.one("a/b")
    assert caught.value.problems[0].code == "xml.doubled"
    assert caught.value.problems[0].place == "line 2, a"
    assert root.maybe("d/b") is None
    assert [n.one("b").number() for n in root.every("a")] == [1.0, 2.0]
    assert root.every("d", 0) == []
    with pytest.raises(InputError, match="needs at least 1 d"):
        root.every("d")


@pytest.mark.behaviour
def test_places_name_line_and_path(tmp_path: Path) -> None:
    root = node(tmp_path, "\n<a>\n<b>\n<c>x</c></b></a>")
    assert root.one("a/b/c").place == "line 4, a/b/c"
    assert root.place == "line 1, root"


@pytest.mark.behaviour
def test_line_numbers_are_right_in_long_files(tmp_path: Path) -> None:
    """The line number of an element beyond line 65535 is right within one line.

    There libxml2 takes the number from the following text.
    """
    root = node(tmp_path, "\n" * 70_000 + "<a>\n<b>x</b>\n</a>")
    line = int(root.one("a/b").place.split(",")[0].removeprefix("line "))
    assert abs(line - 70_002) <= 1


PLAIN = "<R><A>1</A><B> -2.5e3\n</B></R>"
COLUMNS = {name: (RADIANS, -1e29, 1e29) for name in "AB"}


def outcome(read: Callable[[], object]) -> object:
    """Return the numbers, or the text of the refusal."""
    try:
        return np.array(read()).tobytes()
    except InputError as error:
        return str(error)


@pytest.mark.oracle
def test_numbers_of_a_table_are_those_read_one_by_one(tmp_path: Path) -> None:
    texts = ["0", "-.5", "5.", "+1.5E-3", "0.1000000000000000055511151231257827", "1e-400", "-0.350185030443419"]
    rows = [f"<R>\n <A>{a}</A> <B>\t{b} </B></R>" for a in texts for b in texts]
    root = node(tmp_path, "\n".join(rows))
    expected = [[float(a), float(b)] for a in texts for b in texts]
    assert [[row.one(name).number() for name in "AB"] for row in root.every("R")] == expected
    assert root.table("R", COLUMNS).tobytes() == np.array(expected).tobytes()


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "inner",
    [
        "", PLAIN + "<!-- c -->", PLAIN + "<X/>", f"<X>{PLAIN}</X>", f"<X/>{PLAIN}", "<R><B>1</B><A>1</A></R>",
        "<R><A>1</A><A>1</A><B>2</B></R>", "<R><A>1</A></R>", "<R><A>1</A><B>2</B><C>3</C></R>",
        "<R><A unit='deg'>1</A><B>2</B></R>", "<R><A>1<i/></A><B>1</B></R>", "<R><A>1</A><B></B></R>",
        "<R><A>1 2</A><B>2</B></R>", "<R><A>1_0</A><B>2</B></R>", "<R><A>1,5</A><B>1</B></R>",
        "<R><A>nan</A><B>1</B></R>", "<R><A>1e31</A><B>1</B></R>", "<R><A>1e999</A><B>1</B></R>",
        "<R><A>1-2</A><B>1</B></R>", "<R><A>\u0661</A><B>1</B></R>", "<R><A>1e30</A><B>1</B></R>",
    ],
)  # fmt: skip
def test_unusual_tables_are_read_one_by_one(tmp_path: Path, inner: str) -> None:
    root = node(tmp_path, inner)
    one_by_one = outcome(lambda: [[r.one(n).number(*COLUMNS[n]) for n in "AB"] for r in root.every("R")])
    assert outcome(lambda: root.table("R", COLUMNS)) == one_by_one
