"""Run the commands ``rectify area``, ``projection`` and ``scanner``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.atomic import outputs, require_free_files
from fg_orient.formats.table_write import save_table
from fg_orient.formats.tables import require_table
from fg_orient.model.errors import InputError
from fg_orient.rectification import projections
from fg_orient.rectification.scanner import Scanner, relief_shift_m, total_angle_rad
from fg_orient.result.plain import of_axes, rows_of

PLANE: Final = ("easting_m", "northing_m")
GEOGRAPHIC: Final = ("lon_deg", "lat_deg")
#: Number of scan angles from nadir to the edge of the swath.
STEPS: Final = 5


def measure_outlines(
    path: Path, *, projection: str = "", ellipsoid: str = "WGS84", pixel_m: float | None = None
) -> dict[str, Any]:
    """Return the areas and perimeters of the closed outlines of a table.

    Parameters
    ----------
    path : Path
        Vertices in order: easting_m, northing_m or lon_deg, lat_deg; outline if there are several.
    projection : str
        Projection of vertices in lon_deg, lat_deg
        (:func:`fg_orient.rectification.projections.find_projection`).
    ellipsoid : str
        Ellipsoid of lon_deg, lat_deg, in PROJ.
    pixel_m : float, optional
        Pixel size for the area by count of pixels.

    Returns
    -------
    dict
        Record with ``outlines``: measures of each outline, None if the input does not give them.

    Raises
    ------
    InputError
        The file has errors, which are all listed; a projection is given without lon_deg,
        lat_deg; or pixels are given without plane coordinates.
    """
    table = require_table(path, [(*own, *names) for own in ((), ("outline",)) for names in (PLANE, GEOGRAPHIC)])
    geographic = GEOGRAPHIC[0] in table.columns
    vertices = table.numbers(*(GEOGRAPHIC if geographic else PLANE))
    table.require_valid()
    if projection and not geographic:
        raise InputError.of("rectify.projected", file=path, option="projection", value=projection)
    definition = projections.find_projection(projection) if projection else ""
    if pixel_m is not None and geographic and not projection:
        raise InputError.of("rectify.unprojected", file=path, option="pixel_size", value=pixel_m)
    plane = (
        projections.project(definition, vertices[:, 0], vertices[:, 1])
        if projection
        else None
        if geographic
        else vertices
    )
    names = table.cells["outline"] if "outline" in table.columns else [""] * len(table)
    rows = []
    for name in dict.fromkeys(names):
        mine = np.array([one == name for one in names])
        curved = (
            projections.ellipsoidal_area(vertices[mine, 0], vertices[mine, 1], ellipsoid)
            if geographic
            else (None, None)
        )
        flat = _plane_measures(None if plane is None else plane[mine], pixel_m)
        rows.append({"outline": name, "vertices": len(projections.outline(vertices[mine])), **flat,
                     "ellipsoidal_area_m2": curved[0], "ellipsoidal_perimeter_m": curved[1]})  # fmt: skip
    return {"projection": definition or None, "ellipsoid": ellipsoid if geographic else None, "pixel_m": pixel_m,
            "outlines": rows}  # fmt: skip


def _plane_measures(vertices: Array | None, pixel_m: float | None) -> dict[str, float | None]:
    names = ("area_m2", "perimeter_m", "spacing_m", "pixels", "pixel_area_m2", "sigma_pixel_area_m2")
    out = dict[str, float | None].fromkeys(names)
    if vertices is None:
        return out
    length = projections.perimeter_m(vertices)
    out["area_m2"], out["perimeter_m"] = projections.planar_area_m2(vertices), length
    out["spacing_m"] = projections.mean_spacing_m(length, len(projections.outline(vertices)))
    if pixel_m is not None:
        count = projections.count_pixels(vertices, pixel_m)
        out["pixels"], out["pixel_area_m2"] = count, projections.pixel_area_m2(count, pixel_m)
        out["sigma_pixel_area_m2"] = projections.pixel_area_sigma_m2(length, pixel_m)
    return out


def project_points(
    path: Path, projection: str, *, inverse: bool = False, out: Path | None = None, overwrite: bool = False
) -> dict[str, Any]:
    """Convert a table of longitudes and latitudes to plane coordinates, or back, and return it with scale factors.

    Parameters
    ----------
    path : Path
        Columns id and lon_deg, lat_deg, or with ``inverse`` id and easting_m, northing_m.
    projection : str
        See :func:`fg_orient.rectification.projections.find_projection`. The datum does not change.
    inverse : bool
    out : Path, optional
        Table to write.
    overwrite : bool

    Raises
    ------
    InputError
        The file has errors, which are all listed; the projection is invalid; or a point
        lies outside its domain.
    """
    require_free_files(out, overwrite=overwrite)
    definition = projections.find_projection(projection)
    given = PLANE if inverse else GEOGRAPHIC
    table = require_table(path, [("id", *given)])
    values = table.numbers(*given)
    table.require_valid()
    plane = values if inverse else projections.project(definition, *values.T)
    geographic = projections.unproject(definition, values) if inverse else values
    scales = projections.scale_factors(definition, *geographic.T)
    columns = dict(zip((*GEOGRAPHIC, *PLANE, "scale_meridian", "scale_parallel", "scale_area"),
                       np.column_stack([geographic, plane, scales]).T, strict=True))  # fmt: skip
    if out is not None:
        with outputs(out, overwrite=overwrite):
            save_table(out, {"id": list(table.cells["id"]), **columns})
    return {
        "projection": definition,
        "points": rows_of({"id": table.cells["id"], **columns}),
        "out": None if out is None else str(out),
    }


def scanner_record(
    height_m: float, ifov_along_rad: float, ifov_across_rad: float | None = None, *, angles_deg: Sequence[float] = (),
    swath_m: float | None = None, relief_m: float = 0.0, overlap: float = 0.0, focal_m: float | None = None,
    speed_m_s: float | None = None, rotation_s: float | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the geometry of a scanner at some scan angles (İpbüker 1994, section 3.3.1).

    Parameters
    ----------
    height_m, ifov_along_rad, ifov_across_rad, overlap, focal_m, speed_m_s, rotation_s : float
        See :class:`fg_orient.rectification.scanner.Scanner`. If a value is missing,
        results that need it are None.
    angles_deg : sequence of float
        Scan angles from nadir; default: from nadir to the edge of the swath.
    swath_m : float, optional
        Width on the ground, for the total angle.
    relief_m : float
        Height of a point above the datum, for its displacement.

    Raises
    ------
    InputError
        Neither angles nor swath are given, or an angle is beyond the horizontal. Also see ``Scanner``.
    """
    across = ifov_along_rad if ifov_across_rad is None else ifov_across_rad
    given = {"focal_length_m": focal_m, "speed_m_s": speed_m_s, "rotation_s": rotation_s}
    own = Scanner(height_m, ifov_along_rad, across, overlap=overlap,
                  **{name: value for name, value in given.items() if value is not None})  # fmt: skip
    total = None if swath_m is None else total_angle_rad(swath_m, height_m)
    if not len(angles_deg) and total is None:
        raise InputError.of("options.value", option="angles, swath", value="none", expected="scan angles or a swath")
    theta = np.radians(angles_deg) if len(angles_deg) else np.linspace(0.0, 0.5 * (total or 0.0), STEPS)
    columns: dict[str, Any] = {
        "scan_angle_deg": np.degrees(theta), "ground_y_m": own.ground(0.0, own.focal_length_m * theta)[:, 1],
        **of_axes("element_{}_m", ("along", "across"), own.element_m(theta)),
        "panoramic_shift_m": own.panoramic_shift_m(theta), "relief_shift_m": relief_shift_m(relief_m, theta),
        "mirror_shift_m": [None] * len(theta) if speed_m_s is None or rotation_s is None else own.mirror_shift_m(theta),
    }  # fmt: skip
    return {
        "strip_m": own.strip_m, "image_element_m": None if focal_m is None else own.image_element_m,
        "line_time_s": None if speed_m_s is None else own.line_time_s,
        "total_angle_deg": None if total is None else math.degrees(total), "relief_m": relief_m,
        "angles": rows_of(columns),
    }  # fmt: skip
