"""Fixtures are points of an invented scene and the reproduction of İpbüker 1994, computed once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.model.names import CellKey
from fg_orient.studies.reproduce.reproduction import Reproduction, Row, reproduce

Array = np.ndarray

#: Transformations from ground coordinates with heights to the image.
SPATIAL = ("affine-3d", "parallel", "dlt")


@pytest.fixture(scope="session")
def reproduction() -> Reproduction:
    """Return all cells of İpbüker 1994."""
    return reproduce("ipbuker1994")


@pytest.fixture(scope="session")
def rows(reproduction: Reproduction) -> dict[tuple[str, str, str], Row]:
    """Return the rows by table, row and quantity."""
    found = {}
    for row in reproduction.rows:
        quantity, _, name = row.cell.partition(", ")
        found[row.table, name, quantity] = row
    assert len(found) == len(reproduction.rows)
    return found


def scene(rng: np.random.Generator, n: int = 30, noise_m: float = 15.0) -> tuple[Array, Array, Array]:
    """Return line and sample, easting and northing, and height of points of a TM scene with noise.

    Map coordinates are full UTM metres; the scene has 1024 x 1024 pixels.
    """
    image = rng.uniform(0.0, 1023.0, (n, 2))
    line, sample = image.T
    east = 660_000.0 + 28.4 * sample + 4.1 * line + 2e-4 * sample**2
    north = 4_550_000.0 - 28.4 * line + 4.1 * sample + 1e-4 * line * sample
    plane = np.stack([east, north], axis=1) + rng.normal(0.0, noise_m, (n, 2))
    return image, plane, rng.uniform(0.0, 400.0, n)


def write_points(
    path: Path, image: Array, plane: Array, *, check: int = 0, heights: Array | None = None, sigma: str = ""
) -> Path:
    """Write a table of points, the last ``check`` of them check points."""
    columns = ["id", "line", "sample", "easting_m", "northing_m", "role"]
    columns += ["height_m"] if heights is not None else []
    columns += sigma.split(",")[:2] if sigma else []
    lines = [",".join(columns)]
    for k, (a, b) in enumerate(zip(image, plane, strict=True)):
        role = "check" if k >= len(image) - check else "control"
        cells = [f"P{k + 1}", *map(repr, a.tolist()), *map(repr, b.tolist()), role]
        cells += [repr(float(heights[k]))] if heights is not None else []
        cells += ["10", "20"] if sigma else []
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def key(table: str, row: str, quantity: str) -> CellKey:
    """Return the address of a cell."""
    return CellKey(table, quantity=quantity, parameter=row)
