"""Fixtures of all tests: the folder of real metadata files, a fixed seed, hypothesis without clocks."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
REAL_DATA_VARIABLE = "FG_ORIENT_REAL_DATA"

# The first call of a compiled kernel takes seconds, so hypothesis may not watch the clock;
# derandomized, it draws the same examples on every machine.
hypothesis.settings.register_profile("fg_orient", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("fg_orient")


@pytest.fixture(scope="session")
def repository() -> Path:
    """Give the root of the source tree."""
    return REPOSITORY


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Give the folder of real metadata files, or skip; the test also carries the marker ``real_data``."""
    name = os.environ.get(REAL_DATA_VARIABLE, "")
    if not name:
        pytest.skip(f"{REAL_DATA_VARIABLE} is not set: no real metadata files")
    folder = Path(name)
    if not folder.is_dir():
        pytest.fail(f"{REAL_DATA_VARIABLE}={name} is not a folder")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """Give a random generator with a fixed seed."""
    return np.random.default_rng(20261121)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse a test that reads real files without saying so by its marker."""
    for item in items:
        if "real_data" in getattr(item, "fixturenames", ()) and item.get_closest_marker("real_data") is None:
            raise pytest.UsageError(f"{item.nodeid} uses the fixture real_data without @pytest.mark.real_data")
