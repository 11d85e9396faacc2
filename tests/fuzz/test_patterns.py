"""Text that repeats a few characters is read or refused within the time of its size: no pattern is searched twice."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fg_orient.formats.pvl import read_pvl
from fg_orient.formats.registry import HEAD_BYTES, format_claiming, xml_root
from fg_orient.formats.rpc.fields import Reading
from fg_orient.formats.rpc.text import read_rpc_geom, read_rpc_rpb, read_rpc_text
from tests.fuzz.harness import Broken, outcome

pytestmark = pytest.mark.behaviour

#: Beginnings of comments, values, units and lines that never end.
UNITS = (
    "\n",
    " \n",
    "<?",
    "<!--",
    "<",
    "#",
    "#a\n",
    "/*",
    "a=(",
    "a={ ",
    'a="',
    "a=b <",
    "a=\t",
    "a:\n",
    "=",
    "(",
    '"',
)
READERS: dict[str, Callable[[Path], object]] = {
    "pvl": read_pvl, "geom": lambda path: read_rpc_geom(path, Reading()),
    "rpb": lambda path: read_rpc_rpb(path, Reading()), "rpc": lambda path: read_rpc_text(path, Reading()),
}  # fmt: skip


@pytest.mark.parametrize("unit", UNITS)
def test_repeated_text_is_recognised_in_time(tmp_path: Path, unit: str) -> None:
    """Image files of 64 kB of repeated text are recognised, or not, within 10 s (13 s before for ``<?``)."""
    for name in ("a.txt", "a.toml", "a.xml", "a.json"):
        path = tmp_path / name
        path.write_text((unit * HEAD_BYTES)[:HEAD_BYTES], "utf-8")
        for contents in ("rpc", "image"):
            found = outcome(lambda: format_claiming(path, contents), HEAD_BYTES)  # noqa: B023
            assert not isinstance(found, Broken), found.text


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("unit", UNITS)
def test_repeated_text_is_read_in_time(tmp_path: Path, name: str, unit: str) -> None:
    """Files of 300 kB are read or refused within their time; PVL with ``#`` or ``a=b <`` took minutes before."""
    path = tmp_path / "a.txt"
    path.write_text(unit * (300_000 // len(unit)), "utf-8")
    found = outcome(lambda: READERS[name](path), 300_000)
    assert not isinstance(found, Broken), found.text


@pytest.mark.parametrize(("head", "root"), [
    ('<?xml version="1.0"?>\n<!-- <a> -->\n<!DOCTYPE x>\n<Dimap_Document>', "Dimap_Document"),
    ("<!-- <a>", ""), ("<?xml <a>", ""), ("", ""), ("text <a>", ""), (" <a-b.c d='1'/>", "a-b.c"),
])  # fmt: skip
def test_root_of_xml(head: str, root: str) -> None:
    """The root element is the first one outside comments and instructions; text is not XML."""
    assert xml_root(head) == root
