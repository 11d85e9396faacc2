"""All tests share these fixtures: the folder of real files, a fixed seed, and hypothesis without time limits."""

from __future__ import annotations

import copy
import gc
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest

from tests.support import kinds

REPOSITORY = Path(__file__).resolve().parents[1]
REAL_DATA_VARIABLE = "FG_ORIENT_REAL_DATA"
NUMBERS = pytest.StashKey[dict[str, int]]()  # of test functions, by kind

# The first call of a compiled kernel takes seconds, so hypothesis may not watch the clock;
# derandomized, it draws the same examples on every machine.
hypothesis.settings.register_profile("fg_orient", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("fg_orient")


@pytest.fixture(scope="session")
def repository() -> Path:
    """Return the root of the source tree."""
    return REPOSITORY


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Return the folder of real metadata files, or skip; the test also carries the marker ``real_data``."""
    name = os.environ.get(REAL_DATA_VARIABLE, "")
    if not name:
        pytest.skip(f"{REAL_DATA_VARIABLE} is not set: no real metadata files")
    folder = Path(name)
    if not folder.is_dir():
        pytest.fail(f"{REAL_DATA_VARIABLE}={name} is not a folder")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a random generator with a fixed seed."""
    return np.random.default_rng(20261121)


@pytest.fixture(scope="session", autouse=True)
def look_angles_read_once() -> Iterator[None]:
    """Read and write the same look angles once in each worker.

    The 12 000 detectors of a SPOT-5 file take 0.2 s, the half of most commands, and hundreds of tests read the same
    ones. The cache uses the text of the elements as its key; a fault in them is found again each time.
    """
    from lxml import etree

    from fg_orient.formats import dimap1, dimap_write

    read, write = dimap1._look_angles, dimap_write._look_rows
    known, written = dict[Any, Any](), dict[Any, Any]()
    sections = dict[Any, bytes]()

    def section(root: Any) -> bytes:
        """Return the digest of the elements; those of a tree that is kept are not written out again."""
        if root.element not in sections:
            if len(sections) > 50:
                sections.clear()
            text = etree.tostring(root.one("Data_Strip/Sensor_Configuration").element)
            sections[root.element] = hashlib.sha256(text).digest()
        return sections[root.element]

    def read_once(root: Any, n_samples: int) -> Any:
        key = section(root), n_samples
        if key not in known:
            known[key] = read(root, n_samples)
        return copy.deepcopy(known[key])

    def write_once(look: Any) -> Any:
        key = tuple(column.tobytes() for column in (look.sample, look.psi_x_rad, look.psi_y_rad))
        if key not in written:
            written[key] = write(look)
        return written[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dimap1, "_look_angles", read_once)
        patch.setattr(dimap_write, "_look_rows", write_once)
        yield


@pytest.fixture(scope="session", autouse=True)
def trees_parsed_once() -> Iterator[None]:
    """Parse the same large metadata file once in each worker while it is in use; nothing changes a tree."""
    from lxml import etree

    from fg_orient.formats import xml

    class Parser:
        def __getattr__(self, name: str) -> Any:
            return getattr(etree, name)

        def fromstring(self, data: bytes, parser: Any) -> Any:
            if data not in kept:
                tree = etree.fromstring(data, parser)
                if len(data) < 100_000:
                    return tree
                if len(kept) == 20:
                    kept.clear()
                kept[data] = tree
            return kept[data]

    kept = dict[bytes, Any]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(xml, "etree", Parser())
        yield


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give all files of a folder to one worker (``--dist loadscope``): they share what their conftest.py makes."""
    if config.getvalue("dist") != "loadscope":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class Folders(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return nodeid.partition("::")[0].rpartition("/")[0]

    return Folders(config, log)


def pytest_collection_finish() -> None:
    """Exclude imported and collected objects from all later garbage collections; they took a tenth of the run."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse a test without its kind or with unmarked use of real files; count the kinds."""
    config.stash[NUMBERS] = kinds.counted(items)
    for item in items:
        if "real_data" in getattr(item, "fixturenames", ()) and item.get_closest_marker("real_data") is None:
            raise pytest.UsageError(f"{item.nodeid} uses the fixture real_data without @pytest.mark.real_data")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Send the counts of a worker to the process that started it, which collects nothing itself."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["kinds"] = session.config.stash.get(NUMBERS, {})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Keep the count of a worker; all workers collect the same."""
    numbers = getattr(node, "workeroutput", {}).get("kinds")
    if numbers:
        node.config.stash[NUMBERS] = numbers


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print the shares of the kinds, of what was collected before any selection by name or marker."""
    numbers = config.stash.get(NUMBERS, {})
    if any(numbers.values()):
        terminalreporter.write_line(kinds.sentence(numbers))
