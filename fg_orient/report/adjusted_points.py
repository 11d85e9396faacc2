"""Adjusted points of a result as a point cloud with covariances: LAZ, LAS, PLY, CSV or GeoPackage.

The points are the tie and check points of an adjustment. They check the orientation; they are not a dense surface
model. Coordinates are in the CRS and above the zero level of the project's point table; without one, in UTM
(WGS 84) with ellipsoidal heights. Standard deviations and covariances are the same as in the tables of
the result. They refer to East, North, Up in the tangent plane of the point, in the scale that the
column ``sigma_scale`` names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import fg_orient
from factors.arrays import Array, Mask
from fg_orient.formats.atomic import outputs, require_free_files
from fg_orient.formats.exchange.gis import GROUND, libraries, write_point_layer
from fg_orient.formats.heights import ZeroLevel, coordinates_in
from fg_orient.formats.load import foreign_bytes
from fg_orient.formats.point_clouds import library, write_las, write_ply
from fg_orient.formats.table_write import save_table
from fg_orient.geodesy import COORDINATE_COLUMNS, crs_kind
from fg_orient.geodesy.crs import utm_code, with_codes, wkt
from fg_orient.model.block import GroundSystem
from fg_orient.model.errors import Finding, InputError, findings_of, judged
from fg_orient.model.names import Role
from fg_orient.result.plain import of_axes
from fg_orient.result.record import Result, doubts_about, read_result, require_earth

SUFFIXES: Final = (".laz", ".las", ".ply", ".csv", ".gpkg")
PURPOSE: Final = "points of an adjustment, a check of the orientation, no dense surface model"
#: Number of each role in point clouds, because point clouds cannot contain texts.
ROLES: Final = {Role.TIE: 0, Role.CHECK: 1, Role.CONTROL: 2}
_SIGMAS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_PAIRS: Final = ("east_north", "east_up", "north_up")


@dataclass(frozen=True)
class Selection:
    """Choice of the points that are written.

    Parameters
    ----------
    control : bool
        Write control points, too.
    rejected : bool
        Also write points for which the search for gross errors left out an observation.
    min_rays : int
        Smallest number of image points of a written point.
    max_sigma_height_m : float, optional
        Largest standard deviation of the height. If it is given, points without a standard deviation are left
        out.
    """

    control: bool = False
    rejected: bool = False
    min_rays: int = 2
    max_sigma_height_m: float | None = None

    def rows(self, result: Result) -> tuple[npt.NDArray[np.intp], dict[str, int]]:
        """Return the rows of the selected points in the table, and the number of omitted points by reason."""
        table = result.points
        roles, sigma = np.array(table.words["role"], dtype=str), table.figures["sigma_up_m"]
        kept = np.ones(len(table), bool)
        counts = {}
        for reason, out in (
            ("control", roles == str(Role.CONTROL) if not self.control else ~kept),
            ("no_coordinates", ~np.isfinite(table.numbers("x_m", "y_m", "z_m")).all(axis=1)),
            ("rejected", _rejected(result) if not self.rejected else ~kept),
            ("few_rays", table.figures["n_rays"] < self.min_rays),
            ("sigma_height", ~(sigma <= (math.inf if self.max_sigma_height_m is None else self.max_sigma_height_m))
             if self.max_sigma_height_m is not None else ~kept),
        ):  # fmt: skip
            counts[reason] = int((kept & out).sum())
            kept &= ~out
        return np.flatnonzero(kept), counts


def _rejected(result: Result) -> Mask:
    """Return points with an observation that was left out and not included again."""
    found = result.tables.get("outliers")
    names = set()
    if found is not None:
        gone = np.isnan(found.figures["readmitted"]).tolist()
        names = {name for name, out in zip(found.words["id"], gone, strict=True) if out}
    return np.array([name in names for name in result.points.words["id"]], bool)


def export_points(
    folder: str | Path, out: str | Path, *, crs: str = "", geoid: str | Path | None = None,
    selection: Selection | None = None, overwrite: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Write the adjusted points of a result.

    Parameters
    ----------
    folder : path
        Result folder of ``adjust``.
    out : path
        File; its suffix chooses the format.
    crs : str
        CRS that replaces the CRS of the project:
        ``EPSG:n`` (ellipsoidal heights), or ``EPSG:n+m`` or ``EPSG:n+NAME``.
    geoid : path, optional
        Geoid file that defines the zero level of the heights, instead of the project's.
    selection : Selection, optional
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    dict
        ``file``, ``points``, ``left_out`` (number by reason), ``crs`` (None: local coordinates), ``heights``,
        ``sigma_scale``, ``purpose``, and status and findings as :func:`fg_orient.model.errors.judged` gives them.

    Raises
    ------
    InputError
        No result, an unknown suffix, a missing library, no point left, a CRS that cannot be used, or a file that may
        not be written.
    """
    target, chosen = Path(out), selection or Selection()
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise InputError.of("cloud.suffix", file=out, option="out", value=suffix or "none", known=known)
    if suffix in (".laz", ".las"):
        library(target)
    elif suffix == ".gpkg":
        libraries(target)
    require_free_files(target, overwrite=overwrite)
    result = read_result(folder)
    with foreign_bytes("report.damaged", folder), outputs(target, overwrite=overwrite):
        return _export(result, target, Path(folder), chosen, with_codes(crs), geoid)


def _export(
    result: Result, target: Path, folder: Path, chosen: Selection, crs: str, geoid: str | Path | None
) -> dict[str, Any]:
    """Write the chosen points of a result; see :func:`export_points`."""
    rows, left_out = chosen.rows(result)
    if not len(rows):
        raise InputError.of("cloud.no_points", file=folder, value=in_words(left_out) or "none in the table")
    system = _system(result, folder, crs, geoid, rows)
    ecef = result.points.numbers("x_m", "y_m", "z_m", rows=rows)
    coordinates, heights = coordinates_in(system, ecef) if system.crs else (ecef, "")
    scales = set(result.points.words["sigma_scale"][k] for k in rows.tolist()) - {""}
    record = {
        "file": str(target), "points": len(rows), "left_out": left_out, "crs": system.crs or None, "heights": heights,
        "sigma_scale": scales.pop() if scales else None, "purpose": PURPOSE, **judged(_findings(result, folder)),
    }  # fmt: skip
    _write(target, result, rows, coordinates, record)
    return record


def in_words(left_out: dict[str, int]) -> str:
    """Return the numbers of omitted points with the reasons, as a text."""
    return ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in left_out.items() if n)


def describe(record: dict[str, Any]) -> str:
    """Return purpose, CRS, heights and scale of the standard deviations in one line."""
    heights = f", heights {record['heights']}" if record["heights"] else ""
    scale = f"; standard deviations: {record['sigma_scale']} scale" if record["sigma_scale"] else ""
    return f"{record['purpose']}; {record['crs'] or 'local coordinates'}{heights}{scale}"


def _findings(result: Result, folder: str | Path) -> list[Finding]:
    """Return the doubts about the points, and the effects that their standard deviations do not contain."""
    held = (one for one in findings_of(result.record) if one.code == "solution.vendor_datum")
    return [*doubts_about(result.record, folder), *held]


def _system(
    result: Result, folder: Path, crs: str, geoid: str | Path | None, rows: npt.NDArray[np.intp]
) -> GroundSystem:
    """Return CRS and zero level of the file: as given, or as in the project, or UTM and the ellipsoid."""
    place = result.points.numbers("lon_deg", "lat_deg", rows=rows)
    if crs or geoid:
        require_earth(result, folder, option="crs")
    if not np.isfinite(place).all() or result.record.get("body"):
        if crs or geoid:
            raise InputError.of("report.no_map", file=folder, option="crs", value=crs or geoid)
        return GroundSystem()
    stated = result.record.get("ground") or {}
    lon, lat = place[len(place) // 2].tolist()
    utm = utm_code(int((lon + 180.0) // 6.0) % 60 + 1, north=lat >= 0.0)
    chosen = crs or stated.get("crs") or utm
    if geoid or crs:
        return ZeroLevel(geoid=Path(geoid) if geoid else None).system(chosen)
    own = str(folder / stated["geoid"]) if stated.get("geoid") else ""
    return GroundSystem(chosen, own, stated.get("undulation_m"))


def _write(path: Path, result: Result, rows: npt.NDArray[np.intp], coordinates: Array, record: dict[str, Any]) -> None:
    """Write the file in the format of its suffix."""
    table, crs, suffix, text = result.points, record["crs"], path.suffix.lower(), describe(record)
    roles = [table.words["role"][k] for k in rows.tolist()]
    rays = table.figures["n_rays"][rows]
    numbers = {name: table.figures[name][rows] for name in _SIGMAS} | _covariances(result, rows)
    if suffix in (".csv", ".gpkg"):
        ids = [table.words["id"][k] for k in rows.tolist()]
        columns = {"n_rays": rays.astype(np.int64), **numbers}
        if suffix == ".gpkg":
            words = {"id": np.array(ids, object), "role": np.array(roles, object)}
            write_point_layer(path, GROUND, coordinates, {**words, **columns}, crs, text)
            return
        names = COORDINATE_COLUMNS[crs_kind(crs) if crs else "geocentric"]
        save_table(path, {"id": ids, "role": roles, **of_axes("{}", names, coordinates), **columns}, [text])
        return
    cloud: dict[str, npt.NDArray[Any]] = {
        **{name: values.astype(np.float32) for name, values in numbers.items()},
        "n_rays": np.minimum(rays, 2**16 - 1).astype(np.uint16),
        "role": np.array([ROLES[Role(role)] for role in roles], np.uint8),
        "number": (rows + 1).astype(np.uint32),
    }
    text += "; role: " + ", ".join(f"{number} {role}" for role, number in ROLES.items()) + "; number: row in points"
    if suffix == ".ply":
        write_ply(path, coordinates, cloud, comments=[*([f"crs {crs}"] if crs else []), text])
        return
    made = datetime.fromisoformat(result.record["provenance"]["date_time_utc"]).date()
    unit = "degree" if crs and crs_kind(crs) == "geographic" else "metre"
    write_las(path, coordinates, cloud, wkt=wkt(crs) if crs else "", unit=unit, text=text, made=made,
              program=f"fg-orient {fg_orient.__version__}")  # fmt: skip


def _covariances(result: Result, rows: npt.NDArray[np.intp]) -> dict[str, Array]:
    """Return the covariances East-North, East-Up, North-Up; nan in results of earlier versions."""
    known = result.arrays.get("point_covariance_m2", np.full((len(result.points), 3), np.nan))
    return dict(of_axes("covariance_{}_m2", _PAIRS, np.asarray(known, float)[rows]))
