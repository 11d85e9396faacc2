"""Each file that fuzzing found is read or refused by its reader."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from tests.fuzz.harness import Broken, outcome
from tests.fuzz.readers import READERS

pytestmark = pytest.mark.behaviour

FOUND = Path(__file__).with_name("found")
#: Files ``READER/NUMBER.NAME.gz``; NAME is the file of the reader that they replace.
CASES = sorted(path.relative_to(FOUND).as_posix() for path in FOUND.glob("*/*.gz"))


@pytest.mark.parametrize("case", CASES)
def test_found_case_is_read_or_refused(tmp_path: Path, case: str) -> None:
    name, _, file = case.partition("/")
    reader = READERS[name]
    reader.make(tmp_path)
    target = min(tmp_path.rglob(file.partition(".")[2].removesuffix(".gz")))
    target.write_bytes(gzip.decompress((FOUND / case).read_bytes()))
    found = outcome(lambda: reader.read(tmp_path), target.stat().st_size)
    assert not isinstance(found, Broken), found.text
