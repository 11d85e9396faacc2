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

from factors._contract import Array
from fg_orient.formats.tables import Faults, number, read_table
from fg_orient.model.names import Role
from fg_orient.rpc.rfm_points import ControlPoints

COLUMNS: Final = ("id", "line", "sample", "lon_deg", "lat_deg", "height_m")
_SIGMAS: Final = ("sigma_line_px", "sigma_sample_px")
_EXTRAS: Final = (("role",), _SIGMAS)
_NUMBERS: Final = COLUMNS[1:]
AXES: Final = ("line", "sample")


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
        All errors of the file: columns, numbers, roles, ids used twice, invalid coordinates.
    """
    faults = Faults(str(path))
    some = chain.from_iterable(combinations(_EXTRAS, k) for k in range(len(_EXTRAS) + 1))
    table = read_table(path, [(*COLUMNS, *chain.from_iterable(extra)) for extra in some], faults)
    rows = () if table is None else table.rows
    values = np.array([[number(row, name, faults) for name in _NUMBERS] for row in rows]).reshape(-1, 5)
    sigma, check = np.ones((len(rows), 2)), np.zeros(len(rows), dtype=bool)
    first: dict[str, int] = {}
    for k, row in enumerate(rows):
        name, (lon, lat), role = row.cells["id"], values[k, 2:4], row.cells.get("role", Role.CONTROL)
        if abs(lat) > 90.0:
            code = "points.swapped_range" if abs(lon) <= 90.0 and abs(lat) <= 180.0 else "points.latitude"
            faults.add(code, place=row.place("lat_deg"), value=f"{lat:g}")
        if abs(lon) > 180.0:
            faults.add("points.longitude", place=row.place("lon_deg"), value=f"{lon:g}")
        if role not in (Role.CONTROL, Role.CHECK):
            faults.add("rpc.role", place=row.place("role"), value=role)
        check[k] = role == Role.CHECK
        for axis, column in enumerate(_SIGMAS if _SIGMAS[0] in row.cells else ()):
            sigma[k, axis] = number(row, column, faults)
            if sigma[k, axis] <= 0.0:
                faults.add("rpc.sigma", place=row.place(column), value=f"{sigma[k, axis]:g}")
        if name in first:
            faults.add("points.id_twice", place=row.place("id"), value=name, first=first[name])
        first.setdefault(name, row.line)
    faults.raise_if_any()
    return MeasuredPoints(tuple(row.cells["id"] for row in rows), check, values[:, :2], values[:, 2:], sigma)


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
    named = {f"{name}_{axis}_px": float(v) for name, two in figures.items() for axis, v in zip(AXES, two, strict=True)}
    return {"n": len(residuals_px), **named}
