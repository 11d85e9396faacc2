"""Measured points of an image from a CSV file, and statistics of their residuals.

Columns: id, line, sample (pixels, (0, 0) = centre of the first pixel), lon_deg, lat_deg, height_m
(ellipsoidal); and, if wanted, role (control or check), sigma_line_px, sigma_sample_px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Array
from fg_orient.formats.tables import Table, require_table
from fg_orient.model.names import Role
from fg_orient.rpc.rfm_points import ControlPoints

COLUMNS: Final = ("id", "line", "sample", "lon_deg", "lat_deg", "height_m")
_SIGMAS: Final = ("sigma_line_px", "sigma_sample_px")
AXES: Final = ("line", "sample")


@dataclass(frozen=True)
class MeasuredPoints:
    """Points of one image.

    Parameters
    ----------
    ids : tuple of str
    check : (n,) bool array
        Points that are not used in an estimation.
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
        """The same for the estimators; at least one point."""
        return ControlPoints(self.image[:, 0], self.image[:, 1], self.ground)


def read_measured(path: Path) -> MeasuredPoints:
    """Read a CSV file of measured points.

    Parameters
    ----------
    path : Path
        Lines and samples in pixels, longitudes and latitudes in degrees (WGS84), ellipsoidal heights in m.

    Raises
    ------
    InputError
        All errors of the file: columns, numbers, roles, ids used twice, invalid coordinates.
    """
    layouts = [(*COLUMNS, *role, *sigmas) for role in ((), ("role",)) for sigmas in ((), _SIGMAS)]
    table = require_table(path, layouts)
    values = table.numbers(*COLUMNS[1:])
    lon, lat = np.abs(values[:, 2:4]).T
    swapped = (lon <= 90.0) & (lat <= 180.0)
    table.refuse((lat > 90.0) & swapped, "points.swapped_range", "lat_deg")
    table.refuse((lat > 90.0) & ~swapped, "points.latitude", "lat_deg")
    table.refuse(lon > 180.0, "points.longitude", "lon_deg")
    ids, check = ids_and_checks(table)
    sigma = positive_numbers(table, _SIGMAS) if _SIGMAS[0] in table.columns else np.ones((len(table), 2))
    table.require_valid()
    return MeasuredPoints(ids, check, values[:, :2], values[:, 2:], sigma)


def ids_and_checks(table: Table) -> tuple[tuple[str, ...], npt.NDArray[np.bool_]]:
    """Ids of the points, and whether their role is "check" (n,), by default "control".

    Empty and repeated ids and other roles are refused.
    """
    ids = tuple(table.cells["id"])
    table.refuse([not name for name in ids], "points.id_missing", "id")
    table.refuse_repeated([name or k for k, name in enumerate(ids)], "points.id_twice", "id")
    return ids, checks(table)


def checks(table: Table) -> npt.NDArray[np.bool_]:
    """Whether the role of a point is "check" (n,), by default "control"; other roles are refused."""
    if "role" not in table.columns:
        return np.zeros(len(table), bool)
    check = table.where("role", Role.CHECK)
    table.refuse(~check & ~table.where("role", Role.CONTROL), "rectify.role", "role")
    return check


def positive_numbers(table: Table, columns: Sequence[str]) -> Array:
    """Columns (n, k) as numbers; those that are not above 0 are refused."""
    values = table.numbers(*columns)
    for name, column in zip(columns, values.T, strict=True):
        table.refuse(column <= 0.0, "rectify.positive", name, unit=name.rpartition("_")[2])
    return values


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
