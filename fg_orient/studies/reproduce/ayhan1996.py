"""Ayhan (1996): surfaces of revolution by close-range photogrammetry, from its own printed measurements.

The thesis prints raw data: comparator coordinates of 15 points, refined coordinates of 49 points, geodetic
coordinates. Numbers that follow from these data are recomputed. If the thesis' program computed in single precision or
with other parameters, a spread for this effect is stated with the number. This module: rings, geodetic points, fitted
surfaces, mapping and sums.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from factors._contract import Array
from fg_orient.closerange.surface import Kind, Surface, map_points
from fg_orient.closerange.surface_fit import fit_surface
from fg_orient.studies.reproduce import ayhan1996_photos as photos
from fg_orient.studies.reproduce.ayhan1996_photos import (
    GEODETIC,
    GON,
    POINTS,
    ROUNDED_CM,
    SUMS,
    N,
    cells_of,
    points_of,
)
from fg_orient.studies.reproduce.sources import Source, recomputed_tables
from fg_orient.studies.reproduce.verdict import Cells, Recomputed, Values, row_key

#: First and last point of the rings.
RINGS: Final = ((1, 16), (17, 24), (25, 32), (33, 40), (41, 44), (45, 48), (49, 49))
#: Height of the level, m: constant to 0.06 mm in tables 3 and 4.
LEVEL_Z_M: Final = 2.3849
#: Step of single precision at 1000 m, m.
SINGLE_M: Final = 6.2e-5
RUNS: Final = 200
XYZ: Final = ("x_m", "y_m", "z_m")
MAPPED: Final = ("x_mapped_m", "y_mapped_m", "z_mapped_m")
MISFITS: Final = ("fx_cm", "fy_cm", "fz_cm")
LARGE_CM: Final = 5.0


def ring_cells(values: Values) -> Cells:
    """Tables 1 and 2: distance of each ring from the centre of the surface (eqs. 174, 175), diameters of the text."""
    rings = [f"ring {k}" for k in range(1, len(RINGS) + 1)]
    across, along, ball = (values[row_key("text", "rig", name)] for name in ("design_a", "design_b", "design_radius"))
    radius = points_of(values, "1", ["radius_m"], rings)
    out: Cells = {}
    for table, a, b in (("1", across, along), ("2", ball, ball)):
        distance = b * np.sqrt(np.maximum(1.0 - (radius / a) ** 2, 0.0))
        out |= cells_of(table, ["distance_m"], rings, distance, "b sqrt(1 - r^2/a^2)")
    for key, cell in cells_of("1", ["diameter_in_text_m"], rings, 2.0 * radius, "twice the radius").items():
        out[key] = replace(cell, is_exact=True)
    return out


def geodetic_cells(values: Values) -> Cells:
    """Tables 3 and 4: X from the direction (eq. 176), Z from the reading of the level."""
    out: Cells = {}
    for table in ("3", "4"):
        alpha, reading, _, y, _ = points_of(values, table, ("alpha_gon", "level_reading_mm", *XYZ)).T
        x = values[row_key("text", "theodolite", "x")] - (y - 1000.0) / np.tan(alpha * GON)
        z = LEVEL_Z_M - 1e-3 * reading
        out |= cells_of(table, ("x_m",), POINTS, x, "X of the theodolite minus (Y - 1000) cot alpha")
        out |= cells_of(table, ("z_m",), POINTS, z, f"{LEVEL_Z_M} m minus the reading")
    return out


def surface_cells(values: Values) -> Cells:
    """Appendix 3: the land spheroid from the coordinates of appendix 1, and differences of the printed surfaces."""
    fitted = fit_surface(points_of(values, "ek1.points", GEODETIC), "spheroid", method="algebraic")
    names = list(fitted.parameters)
    land, photo = points_of(values, "ek3.surfaces", ("land_49pt_m", "photo_case_i_m"), names).T
    remark = "the numbers beside it, the first with four decimals"
    out = cells_of("ek3.surfaces", ["difference_cm"], names, 100.0 * (land - photo), remark, 0.005)
    for name, value in fitted.parameters.items():
        remark = "least squares of eq. 142 over 49 points of appendix 1; table 3 gives another Y0 and b"
        cell = Recomputed(round(value, 4), remark, value - 0.5e-4, value + 0.5e-4)
        out[row_key("ek3.surfaces", name, "land_49pt_m")] = cell
    return out


def ring_radius(points: Array, centre: Array) -> Array:
    """Half the distance between the extreme targets of a point's ring; at the apex its own |X - X0|. (49,).

    This definition was found by trial: seven other definitions do not give the printed points.
    """
    out = np.empty(N)
    for first, last in RINGS:
        x = points[first - 1 : last, 0]
        out[first - 1 : last] = abs(x[0] - centre[0]) if first == last else 0.5 * (x.max() - x.min())
    return out


def _mapped(points: Array, surface: Surface) -> Array:
    """Mapped land points (49, 3): the root of eq. 182 is positive whatever the sign of Y - Y0."""
    forward = points.copy()
    forward[:, 1] = surface.centre[1] + np.abs(points[:, 1] - surface.centre[1])
    return map_points(forward, surface, ring_radius(points, surface.centre))


def mapping_cells(values: Values) -> Cells:
    """Appendix 3: land points mapped to the printed spheroid of case I."""
    land, rng = points_of(values, "ek1.points", GEODETIC), np.random.default_rng(1)
    names = ("a", "b", "x0", "y0", "z0")
    a, b, *centre = points_of(values, "ek3.surfaces", ["photo_case_i_m"], names)[:, 0].tolist()
    surface = Surface("spheroid", np.array(centre), np.array([a, b, a]))
    ours, runs = _mapped(land, surface), []
    for _ in range(RUNS):
        moved = Surface("spheroid", surface.centre + rng.uniform(-SINGLE_M, SINGLE_M, 3), surface.semi_axes)
        runs.append(_mapped(land + rng.uniform(-SINGLE_M, SINGLE_M, land.shape), moved))
    half = np.abs(np.array(runs) - ours).max(axis=0)
    remark = f"half the width of a ring as its radius, found by trial; spread: {RUNS} runs in single precision"
    out = cells_of("ek3.points", MAPPED, POINTS, ours, remark, half)
    f = 100.0 * (land - points_of(values, "ek3.points", MAPPED))
    remark = "the printed coordinates, which have four decimals"
    out |= cells_of("ek3.points", MISFITS, POINTS, f, remark, ROUNDED_CM)
    ms = np.linalg.norm(points_of(values, "ek3.points", MISFITS), axis=1)
    return out | cells_of("ek3.points", ("ms_cm",), POINTS, ms, "the numbers beside it")


def sum_cells(values: Values) -> Cells:
    """Tables 5 to 12: [Fpp] from the three sums of its row, each with two decimals."""
    return {
        key: Recomputed.around(
            sum(values[key._replace(quantity=q)] for q in SUMS), 0.015, "sum of the three beside it"
        )
        for key in values if key.quantity == "fpp_cm2"
    }  # fmt: skip


def six_point_cells(values: Values) -> Cells:
    """Tables 13 to 20: case I of table 13 is that of appendix 3; large values of other cases are noise."""
    out: Cells = {}
    for key, value in values.items():
        if key.quantity == "db_cm" and abs(value) > LARGE_CM:
            ratio = -values[key._replace(quantity="dy0_cm")] / value
            remark = (
                f"the points of the case are not printed (a lost figure); -dY0/db = {ratio:.2f} is the direction that "
                "two levels leave open, so the number is noise"
            )
            out[key] = Recomputed(float("nan"), remark, kind="not_reproducible")
    for name in ("a", "b", "x0", "y0", "z0"):
        same = values[row_key("ek3.surfaces", name, "difference_cm")]
        remark = "appendix 3" + ("; there with the other sign" if name == "a" else "")
        out[row_key("13", "case 1", f"d{name}_cm")] = Recomputed(same, remark)
    return out


def text_cells(values: Values) -> Cells:
    """Numbers in the text: the base, the sums of appendix 1, the largest deviation from the surfaces."""
    stations = points_of(values, "ek1.cameras", photos.STATION, photos.PHOTOS)
    base = float(np.linalg.norm(stations[1] - stations[0]))
    out = {row_key("text", "camera", "computed_base"): Recomputed(base, "distance of the printed stations")}
    totals = np.sum(points_of(values, "ek1.points", photos.DIFFERENCE) ** 2, axis=0)
    half = 3.0 * 2.0 * np.sqrt(totals / 12.0) * 1e-4  # of four decimals, rounded
    remark = "squares of the printed differences; spread: their rounding"
    out |= cells_of("text", ("fxfx", "fyfy", "fzfz"), ["sums"], totals, remark, half)
    fields: tuple[tuple[Kind, Array], ...] = (
        ("spheroid", points_of(values, "ek1.points", GEODETIC)), ("sphere", points_of(values, "4", XYZ)),
    )  # fmt: skip
    for name, points in fields:
        each = 1e3 * np.abs(fit_surface(points, name, method="algebraic").deviations_m)
        words = "/".join(f"{v:.2f}" for v in each.max(axis=0))
        remark = f"largest along X/Y/Z: {words} mm, point {int(np.argmax(each.max(axis=1))) + 1}"
        out[row_key("text", "deviation of field points", name)] = Recomputed(float(each.max()), remark)
    return out


MEASURED: Final = "a measurement or a setting: nothing to compute"
#: Reasons why the other cells of a table cannot be reproduced.
REASONS: Final = {
    "ek1.bundle": "an observed value, or a number that depends on weights and steps that are not printed",
    "ek1.refined": "taken as printed: comparator coordinates of this point are not in the thesis",
    "ek1.points": "taken as printed: geodetic, or adjusted in the bundle as a control point",
    "ek2.dlt": "standard deviations and lens terms of 16 parameters that were held by weights not printed",
    "ek2.control": "taken as printed, or a precision by weights that are not printed",
    "ek3.surfaces": "the six points of case I are not printed",
    **{str(k): "image coordinates of this application are not printed" for k in range(6, 13)},
    "5": "which 8, 6 or 3 points were control is not printed: many choices fit, none can be told from the others",
    **{str(k): "the points of the case are not printed (a lost figure)" for k in range(13, 21)},
}
#: Functions that recompute a table from all printed values.
_COMPUTERS: Final[dict[str, tuple[Callable[[Values], Cells], ...]]] = {
    "1": (ring_cells,), "2": (ring_cells,), "3": (geodetic_cells,), "4": (geodetic_cells,),
    **{str(k): (sum_cells,) for k in range(5, 13)}, "5": (sum_cells, photos.accuracy_cells),
    **{str(k): (six_point_cells,) for k in range(13, 21)}, "ek1.bundle": (photos.bundle_cells,),
    "ek1.cameras": (photos.camera_cells,), "ek1.comparator": (photos.comparator_cells,),
    "ek1.points": (photos.point_cells,), "ek1.refined": (photos.refined_cells,),
    "ek2.control": (photos.dlt_control_cells,), "ek2.dlt": (photos.dlt_parameter_cells,),
    "ek2.points": (photos.dlt_point_cells,), "ek3.points": (mapping_cells,), "ek3.surfaces": (surface_cells,),
    "text": (text_cells,),
}  # fmt: skip

SOURCE: Final = Source(
    "ayhan1996",
    "Ayhan (1996), surfaces of revolution by close-range photogrammetry",
    real=recomputed_tables(_COMPUTERS, REASONS, MEASURED),
    about="Recomputed in double precision from the measurements that the thesis prints: comparator and refined image "
    "coordinates, cameras, geodetic points. Single precision of its program, or a model with other parameters, is "
    "stated as a spread beside the number. Control points and image coordinates of most applications are not printed. "
    "The range is the stated spread, if any.",
    meanings={
        "equal": "all printed digits",
        "rounding": "one unit of the last digit, or inside the stated spread",
        "pattern": "the bundle: inside a printed mean error, or 5 % of it, under weights inferred from the listing",
        "not_reproducible": "a measurement, or its measurements are not printed",
    },
    counted="are one unit of the last digit off or inside a stated spread",
    patterned="agree with the bundle under weights inferred from the listing itself",
)
