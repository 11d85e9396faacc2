"""Short runs of the fuzzer and strategies of hypothesis test the loaders; long runs are slow tests."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_orient.formats.load import load_npz, parse_json
from fg_orient.formats.toml import parse_toml
from fg_orient.geodesy.crs import epsg_code
from fg_orient.model.errors import FgOrientError
from tests.fuzz.harness import Broken, Session, outcome
from tests.fuzz.mutate import NUMBERS, WORDS
from tests.fuzz.readers import READERS

pytestmark = pytest.mark.behaviour

#: Cases of each reader that loads no large library in the fast tests, and of each reader in the slow ones.
FEW, MANY = 5, 400
QUICK = (
    "bundler", "colmap-text", "geojson", "metashape-xml", "micmac", "odm", "rpc-txt", "rpb", "dimap1", "pushbroom",
    "frame", "closerange-toml", "tables", "ods", "office-text", "npz",
)  # fmt: skip


def _run(name: str, folder: Path, cases: int, seed: int, *, limits: bool) -> Session:
    session = Session(READERS[name], folder / name, seed)
    first = session.begin()
    assert first == "", first
    for _ in range(cases):
        session.case(limits=limits)
    session.close()
    return session


def test_some_mutated_files_of_each_quick_reader(tmp_path: Path) -> None:
    for name in QUICK:
        tally = _run(name, tmp_path, FEW, 1, limits=False).tally
        assert tally.cases == FEW and not tally.broken, {name: [one.text for one in tally.broken.values()]}


@pytest.mark.parametrize("name", READERS)
def test_files_that_fuzzing_begins_with_are_read(tmp_path: Path, name: str) -> None:
    """Each reader reads the files that its fuzzing begins with. Otherwise only its first check would be tested."""
    reader = READERS[name]
    reader.make(tmp_path)
    assert any(reader.changes(path.name) for path in tmp_path.rglob("*") if path.is_file())
    found = outcome(lambda: reader.read(tmp_path), 0, limits=False)
    assert found == "", found


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_mutated_files(tmp_path: Path, name: str) -> None:
    tally = _run(name, tmp_path, MANY, 7, limits=True).tally
    assert not tally.broken, [one.text for one in tally.broken.values()]


def test_a_case_is_repeated_by_its_seed(tmp_path: Path) -> None:
    """A fuzzing run with the same seed has the same outcomes."""
    a, b = (_run("geojson", tmp_path / str(k), 40, 3, limits=False).tally for k in range(2))
    assert (a.codes, a.read) == (b.codes, b.read) and len(a.codes) > 2


def test_the_harness_sees_what_is_broken() -> None:
    def fail() -> None:
        raise ZeroDivisionError("planted")

    def take() -> None:
        block = bytearray(400_000_000)
        block[::4096] = b"x" * len(block[::4096])

    for read, kind in ((fail, "ZeroDivisionError"), (take, "memory")):
        found = outcome(read, 100)
        assert isinstance(found, Broken) and found.kind == kind


# --- strategies -------------------------------------------------------------------------------------

_LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from((*NUMBERS, *WORDS))
JSON = st.recursive(_LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=5)
_KEY = st.sampled_from(("a", "images", "schema", '"x y"', "a.b", "'q'", "ç", "", "1"))
_VALUE = st.sampled_from((
    "1", '"t"', "[1, [2]]", "{a = 1}", "2005-03-13", "nan", "'''a\nb'''", "0x1F", "1e999", *NUMBERS[:20],
))  # fmt: skip
_LINE = st.one_of(
    st.tuples(_KEY, _VALUE).map(" = ".join), _KEY.map("[{}]".format), _KEY.map("[[{}]]".format), st.text(max_size=20)
)
TOML = st.lists(_LINE, max_size=12).map("\n".join)
_WORD = st.text(max_size=9)
CRS = st.one_of(
    st.text(max_size=40), st.sampled_from(WORDS),
    st.builds("EPSG:{}+{}".format, st.integers(0, 10**8), st.integers(0, 10**8)),
    st.builds("+proj={} +zone={} +ellps={}".format, st.sampled_from(("utm", "x")), st.integers(), _WORD),
    st.builds('GEOGCS["{}",DATUM["{}",SPHEROID["s",{},1]]]'.format, _WORD, _WORD, st.floats()),
)  # fmt: skip


def _read_or_refused(read: Any, *arguments: Any) -> Any:
    try:
        return read(*arguments)
    except FgOrientError as error:
        assert len(str(error).splitlines()) == 1
        return None


@given(JSON)
@settings(max_examples=12)
def test_json(value: Any) -> None:
    """The parser reads valid JSON as ``json.loads`` does, or refuses it."""
    text = json.dumps(value)
    found = _read_or_refused(parse_json, text.encode(), "a.json", "interchange.json")
    if found is not None and "e+" not in text and not any(mark in text for mark in ("NaN", "Infinity")):
        expected = json.loads(text)
        assert found == expected or any(len(word) > 18 for word in text.replace("-", "").split())


@given(st.binary(max_size=100))
@settings(max_examples=20)
def test_bytes_as_json_and_npz(data: bytes) -> None:
    _read_or_refused(parse_json, data, "a.json", "interchange.json")
    _read_or_refused(load_npz, b"PK\x03\x04" + data, "checkpoint.unreadable", "a.npz")


@given(TOML)
@settings(max_examples=30)
def test_toml(text: str) -> None:
    with tempfile.NamedTemporaryFile(suffix=".toml") as file:
        Path(file.name).write_text(text, "utf-8")
        _read_or_refused(parse_toml, Path(file.name))


@given(CRS)
@settings(max_examples=8)
def test_crs(text: str) -> None:
    _read_or_refused(epsg_code, text)
