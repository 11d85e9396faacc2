"""Fixtures are Ayhan 1996 as packaged, by table, and the results of an independent program."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import load
from fg_orient.studies.reproduce.ayhan1996_photos import points_of
from fg_orient.studies.reproduce.reproduction import Reproduction, reproduce

Array = npt.NDArray[np.float64]
Reference = Callable[..., Array]


@pytest.fixture(scope="session")
def values() -> dict[CellKey, float]:
    return {cell.key: cell.value for cell in load("ayhan1996").cells}


@pytest.fixture(scope="session")
def land(values: dict[CellKey, float]) -> Array:
    """Return the geodetic coordinates (49, 3) of appendix 1."""
    return points_of(values, "ek1.points", ("x_geodetic_m", "y_geodetic_m", "z_geodetic_m"))


@pytest.fixture(scope="session")
def reference() -> Reference:
    """Return the columns of a file of the independent program as numbers."""

    def read(name: str, *columns: str) -> Array:
        path = Path(__file__).parent / "reference" / f"reference_float64_{name}.csv"
        with path.open(encoding="utf-8", newline="") as stream:
            return np.array([[float(row[c]) for c in columns] for row in csv.DictReader(stream)])

    return read


@pytest.fixture(scope="session")
def reproduction() -> Reproduction:
    return reproduce("ayhan1996")
