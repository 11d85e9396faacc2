"""The fixture is one run of each publication on the twin of seed 1."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fg_orient.model.names import CellKey
from fg_orient.studies.published import tables
from fg_orient.studies.published.tables import PublishedTables, load
from fg_orient.studies.reproduce.reproduction import SOURCES

Computed = dict[CellKey, npt.NDArray[np.float64]]


@pytest.fixture(scope="session")
def printed() -> dict[str, PublishedTables]:
    """Return the published tables as packaged."""
    return {name: load(name) for name in SOURCES}


@pytest.fixture(scope="session")
def computed(printed: dict[str, PublishedTables]) -> dict[str, Computed]:
    """Return all cells of the publications that can be computed, on the twin of seed 1."""
    return {
        name: source.compute(tuple(printed[name].titles), [1], as_run=False, progress=None)
        for name, source in SOURCES.items()
        if source.compute is not None
    }


@pytest.fixture
def copied(tmp_path: Path) -> Callable[[str], Path]:
    """Copy the published tables of a source into a folder that a test may spoil."""

    def copy(name: str) -> Path:
        folder = tmp_path / name
        shutil.copytree(Path(tables.__file__).parent / name, folder)
        folder.chmod(0o755)  # the installation may be read-only, and its rights are copied
        return folder

    return copy
