"""Ayhan (1996): surfaces of revolution by close-range photogrammetry, from the measurements printed there.

The thesis prints raw data: comparator coordinates of 15 points, refined coordinates of 49
points, and geodetic coordinates. Numbers that follow from these data are recomputed. Some
numbers may have been computed in single precision or with other parameters; each such
number is given with a spread for this effect. This module recomputes rings, geodetic
points, fitted surfaces, the mapping and sums.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.closerange.surface import Kind, Surface, map_points
from fg_orient.closerange.surface_fit import fit_surface
from fg_orient.studies.reproduce import ayhan1996_photos as photos
from fg_orient.studies.reproduce.ayhan1996_photos import GEODETIC, GON, POINTS, SUMS, cells_of, points_of
from fg_orient.studies.reproduce.verdict import Cells, Recomputed, Values, row_key

#: First and last point of each ring.
RINGS: Final = ((1, 16), (17, 24), (25, 32), (33, 40), (41, 44), (45, 48), (49, 49))
#: Height of the level, m; in tables 3 and 4 it is constant to 0.06 mm.
LEVEL_Z_M: Final = 2.3849
#: Resolution of single precision at 1000 m, m.
SINGLE_M: Final = 6.2e-5
RUNS: Final = 200
XYZ: Final = ("x_m", "y_m", "z_m")
MAPPED: Final = ("x_mapped_m", "y_mapped_m", "z_mapped_m")
MISFITS: Final = ("fx_cm", "fy_cm", "fz_cm")
LARGE_CM: Final = 5.0


def ring_cells(values: Values) -> Cells:
    """Recompute tables 1 and 2 and the text: distances of the rings from the surface's centre, and diameters.

    Source: eqs. 174 and 175.
    """
    rings = [f"ring {k}" for k in range(1, len(RINGS) + 1)]
    across, along, ball = (values[row_key("text", "rig", name)] for name in ("design_a", "design_b", "design_radius"))
    radius = points_of(values, "1", ["radius_m"], rings)
    out: Cells = {}
    for table, a, b in (("1", across, along), ("2", ball, ball)):
        distance = b * np.sqrt(np.maximum(1.0 - (radius / a) ** 2, 0.0))
        out |= cells_of(table, ["distance_m"], rings, distance)
    for key, cell in cells_of("1", ["diameter_in_text_m"], rings, 2.0 * radius).items():
        out[key] = replace(cell, is_exact=True)
    return out


def geodetic_cells(values: Values) -> Cells:
    """Recompute tables 3 and 4: X from the direction (eq. 176), Z from the reading of the level."""
    out: Cells = {}
    for table in ("3", "4"):
        alpha, reading, _, y, _ = points_of(values, table, ("alpha_gon", "level_reading_mm", *XYZ)).T
        x = values[row_key("text", "theodolite", "x")] - (y - 1000.0) / np.tan(alpha * GON)
        z = LEVEL_Z_M - 1e-3 * reading
        out |= cells_of(table, ("x_m",), POINTS, x)
        out |= cells_of(table, ("z_m",), POINTS, z)
    return out


def surface_cells(values: Values) -> Cells:
    """Recompute appendix 3: land spheroid from the coordinates of appendix 1, differences of the printed surfaces."""
    fitted = fit_surface(points_of(values, "ek1.points", GEODETIC), "spheroid", method="algebraic")
    names = list(fitted.parameters)
    land, photo = points_of(values, "ek3.surfaces", ("land_49pt_m", "photo_case_i_m"), names).T
    out = cells_of("ek3.surfaces", ["difference_cm"], names, 100.0 * (land - photo), 0.005)
    for name, value in fitted.parameters.items():
        cell = Recomputed(round(value, 4), low=value - 0.5e-4, high=value + 0.5e-4)
        out[row_key("ek3.surfaces", name, "land_49pt_m")] = cell
    return out


def ring_radius(points: Array, centre: Array) -> Array:
    """Return the radius (49,) of each point's ring, m: half the distance of its extreme targets; apex: ``|X - X0|``.

    Of eight definitions that were tried, only this one gives the printed points.

    Parameters
    ----------
    points : (49, 3) array
        Coordinates X, Y, Z of land points, m.
    centre : (3,) array
        Centre of the surface, m.
    """
    out = np.empty(photos.N)
    for first, last in RINGS:
        x = points[first - 1 : last, 0]
        out[first - 1 : last] = abs(x[0] - centre[0]) if first == last else 0.5 * (x.max() - x.min())
    return out


def _mapped(points: Array, surface: Surface) -> Array:
    """Return the mapped land points (49, 3).

    The root of eq. 182 is positive for any sign of Y - Y0.
    """
    forward = points.copy()
    forward[:, 1] = surface.centre[1] + np.abs(points[:, 1] - surface.centre[1])
    return map_points(forward, surface, ring_radius(points, surface.centre))


def mapping_cells(values: Values) -> Cells:
    """Recompute appendix 3: land points mapped to the printed spheroid of case I."""
    land, rng = points_of(values, "ek1.points", GEODETIC), np.random.default_rng(1)
    names = ("a", "b", "x0", "y0", "z0")
    a, b, *centre = points_of(values, "ek3.surfaces", ["photo_case_i_m"], names)[:, 0].tolist()
    surface = Surface("spheroid", np.array(centre), np.array([a, b, a]))
    ours, runs = _mapped(land, surface), []
    for _ in range(RUNS):
        moved = Surface("spheroid", surface.centre + rng.uniform(-SINGLE_M, SINGLE_M, 3), surface.semi_axes)
        runs.append(_mapped(land + rng.uniform(-SINGLE_M, SINGLE_M, land.shape), moved))
    half = np.abs(np.array(runs) - ours).max(axis=0)
    out = cells_of("ek3.points", MAPPED, POINTS, ours, half)
    f = 100.0 * (land - points_of(values, "ek3.points", MAPPED))
    out |= cells_of("ek3.points", MISFITS, POINTS, f, photos.ROUNDED_CM)
    ms = np.linalg.norm(points_of(values, "ek3.points", MISFITS), axis=1)
    return out | cells_of("ek3.points", ("ms_cm",), POINTS, ms)


def sum_cells(values: Values) -> Cells:
    """Recompute tables 5 to 12: [Fpp] from the three sums in its row, which have two decimals."""
    keys = [key for key in values if key.quantity == "fpp_cm2"]
    return {key: Recomputed.around(sum(values[key._replace(quantity=q)] for q in SUMS), 0.015) for key in keys}


def six_point_cells(values: Values) -> Cells:
    """Recompute tables 13 to 20.

    Case I of table 13 is the case of appendix 3. In other cases, values above the limit are rounding noise, which
    cannot be reproduced.
    """
    out: Cells = {}
    for key, value in values.items():
        if key.quantity == "db_cm" and abs(value) > LARGE_CM:
            facts = (-values[key._replace(quantity="dy0_cm")] / value,)
            out[key] = Recomputed(float("nan"), kind="not_reproducible", facts=facts)
    for name in ("a", "b", "x0", "y0", "z0"):
        same = values[row_key("ek3.surfaces", name, "difference_cm")]
        out[row_key("13", "case 1", f"d{name}_cm")] = Recomputed(same)
    return out


def text_cells(values: Values) -> Cells:
    """Return numbers of the text: the base, the sums of appendix 1, and the largest deviation from the surfaces."""
    stations = points_of(values, "ek1.cameras", photos.STATION, photos.PHOTOS)
    base = float(np.linalg.norm(stations[1] - stations[0]))
    out = {row_key("text", "camera", "computed_base"): Recomputed(base)}
    totals = np.sum(points_of(values, "ek1.points", photos.DIFFERENCE) ** 2, axis=0)
    # three standard deviations of a sum whose terms are rounded to four decimals
    half = 3.0 * 2.0 * np.sqrt(totals / 12.0) * 1e-4
    out |= cells_of("text", ("fxfx", "fyfy", "fzfz"), ["sums"], totals, half)
    fields: tuple[tuple[Kind, Array], ...] = (
        ("spheroid", points_of(values, "ek1.points", GEODETIC)),
        ("sphere", points_of(values, "4", XYZ)),
    )
    for name, points in fields:
        each = 1e3 * np.abs(fit_surface(points, name, method="algebraic").deviations_m)
        words = "/".join(f"{v:.2f}" for v in each.max(axis=0))
        facts = words, int(np.argmax(each.max(axis=1))) + 1
        out[row_key("text", "deviation of field points", name)] = Recomputed(float(each.max()), facts=facts)
    return out


#: Functions that recompute each table from all printed values.
COMPUTERS: Final[dict[str, Callable[[Values], Cells]]] = {
    "1": ring_cells, "2": ring_cells, "3": geodetic_cells, "4": geodetic_cells,
    "5": lambda values: sum_cells(values) | photos.accuracy_cells(values),
    **dict.fromkeys(map(str, range(6, 13)), sum_cells), **dict.fromkeys(map(str, range(13, 21)), six_point_cells),
    "ek1.bundle": photos.bundle_cells, "ek1.cameras": photos.camera_cells, "ek1.comparator": photos.comparator_cells,
    "ek1.points": photos.point_cells, "ek1.refined": photos.refined_cells, "ek2.control": photos.dlt_control_cells,
    "ek2.dlt": photos.dlt_parameter_cells, "ek2.points": photos.dlt_point_cells, "ek3.points": mapping_cells,
    "ek3.surfaces": surface_cells, "text": text_cells,
}  # fmt: skip
