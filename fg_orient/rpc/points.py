"""Image points with ground coordinates from a CSV file, and statistics of their residuals.

Columns: id, line, sample (pixels, (0, 0) = centre of the first pixel), lon_deg, lat_deg, height_m (ellipsoidal); and,
if wanted, role (control or check), sigma_line_px, sigma_sample_px.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.tables import Faults, Row, number, read_table
from fg_orient.model.names import Role
from fg_orient.rpc.rfm_points import ControlPoints

Array = npt.NDArray[np.float64]

COLUMNS: Final = ("id", "line", "sample", "lon_deg", "lat_deg", "height_m")
_EXTRAS: Final = (("role",), ("sigma_line_px", "sigma_sample_px"))
_NUMBERS: Final = COLUMNS[1:]


@dataclass(frozen=True)
class MeasuredPoints:
    """Points of one image.

    Parameters
    ----------
    ids : tuple of str
    check : (n,) bool array
        Those that take no part in an estimation.
    image : (n, 2) array
        Line and sample, pixels.
    ground : (n, 3) array
        Longitude, latitude (degrees), height (m).
    sigma_px : (n, 2) array
        Of line and sample; 1 where the file has none.
    """

    ids: tuple[str, ...]
    check: npt.NDArray[np.bool_]
    image: Array
    ground: Array
    sigma_px: Array

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, index: npt.NDArray[np.bool_]) -> MeasuredPoints:
        """Some of the points."""
        ids = tuple(name for name, wanted in zip(self.ids, index, strict=True) if wanted)
        return MeasuredPoints(ids, self.check[index], self.image[index], self.ground[index], self.sigma_px[index])

    @property
    def points(self) -> ControlPoints:
        """As the estimators take them; there must be one."""
        return ControlPoints(self.image[:, 0], self.image[:, 1], self.ground)


def read_measured(path: Path) -> MeasuredPoints:
    """Read a CSV file of measured points.

    Raises
    ------
    InputError
        All faults of the file: columns, numbers, roles, ids used twice, coordinates that are none.
    """
    faults = Faults(str(path))
    some = chain.from_iterable(combinations(_EXTRAS, k) for k in range(len(_EXTRAS) + 1))
    table = read_table(path, [(*COLUMNS, *chain.from_iterable(extra)) for extra in some], faults)
    rows = () if table is None else table.rows
    values = np.array([[number(row, name, faults) for name in _NUMBERS] for row in rows]).reshape(-1, 5)
    sigma, check = np.ones((len(rows), 2)), np.zeros(len(rows), dtype=bool)
    for k, row in enumerate(rows):
        _require_coordinates(row, faults)
        check[k] = "role" in row.cells and _role(row, faults) is Role.CHECK
        if "sigma_line_px" in row.cells:
            sigma[k] = [_sigma(row, f"sigma_{axis}_px", faults) for axis in ("line", "sample")]
    _require_different(rows, faults)
    faults.raise_if_any()
    ids = tuple(row.cells["id"] for row in rows)
    return MeasuredPoints(ids, check, values[:, :2], values[:, 2:], sigma)


def _require_coordinates(row: Row, faults: Faults) -> None:
    """Note longitudes and latitudes that are none."""
    quiet = Faults(faults.file)
    lon, lat = (number(row, name, quiet) for name in ("lon_deg", "lat_deg"))
    if abs(lat) > 90.0:
        code = "points.swapped_range" if abs(lon) <= 90.0 and abs(lat) <= 180.0 else "points.latitude"
        faults.add(code, place=row.place("lat_deg"), value=f"{lat:g}")
    if abs(lon) > 180.0:
        faults.add("points.longitude", place=row.place("lon_deg"), value=f"{lon:g}")


def _role(row: Row, faults: Faults) -> Role:
    text = row.cells["role"]
    if text not in (Role.CONTROL, Role.CHECK):
        faults.add("rpc.role", place=row.place("role"), value=text)
        return Role.CONTROL
    return Role(text)


def _sigma(row: Row, column: str, faults: Faults) -> float:
    value = number(row, column, faults)
    if value <= 0.0:
        faults.add("rpc.sigma", place=row.place(column), value=f"{value:g}")
    return value


def _require_different(rows: tuple[Row, ...], faults: Faults) -> None:
    first: dict[str, int] = {}
    for row in rows:
        name = row.cells["id"]
        if name in first:
            faults.add("points.id_twice", place=row.place("id"), value=name, first=first[name])
        first.setdefault(name, row.line)


def statistics(residuals_px: Array) -> dict[str, Any] | None:
    """Mean, RMS and largest amount of residuals (n, 2) of line and sample; None without points."""
    if not len(residuals_px):
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        figures = {
            "mean": residuals_px.mean(axis=0),
            "rms": np.sqrt(np.mean(residuals_px**2, axis=0)),
            "max": np.abs(residuals_px).max(axis=0),
        }
    out: dict[str, Any] = {"n": len(residuals_px)}
    for name, pair in figures.items():
        out |= {f"{name}_line_px": float(pair[0]), f"{name}_sample_px": float(pair[1])}
    return out
