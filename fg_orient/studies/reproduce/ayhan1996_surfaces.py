"""Rings, geodetic points, fitted surfaces, mapping and sums of Ayhan 1996."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.surface import Kind, Surface, map_points
from fg_orient.closerange.surface_fit import fit_surface
from fg_orient.model.cells import CellKey
from fg_orient.studies.reproduce.ayhan1996_photos import GEODETIC, GON, POINTS, SUMS, N, cells_of, points_of
from fg_orient.studies.reproduce.found import Found

Array = npt.NDArray[np.float64]
Values = Mapping[CellKey, float]
Cells = dict[CellKey, Found]

#: First and last point of the rings.
RINGS: Final = ((1, 16), (17, 24), (25, 32), (33, 40), (41, 44), (45, 48), (49, 49))
#: Height of the level, m: constant to 0.06 mm in tables 3 and 4.
LEVEL_Z_M: Final = 2.3849
#: Step of single precision at 1000 m, m.
SINGLE_M: Final = 6.2e-5
RUNS: Final = 200
XYZ: Final = ("x_m", "y_m", "z_m")
LARGE_CM: Final = 5.0


def _text(values: Values, row: str, quantity: str) -> float:
    return values[CellKey("text", quantity=quantity, parameter=row)]


def ring_cells(values: Values) -> Cells:
    """Tables 1 and 2: distance of each ring from the centre of the surface (eqs. 174, 175), diameters of the text."""
    out: Cells = {}
    across, along, ball = (_text(values, "rig", name) for name in ("design_a", "design_b", "design_radius"))
    for k in range(1, len(RINGS) + 1):
        radius = values[CellKey("1", quantity="radius_m", parameter=f"ring {k}")]
        for table, (a, b) in (("1", (across, along)), ("2", (ball, ball))):
            distance = b * np.sqrt(max(1.0 - (radius / a) ** 2, 0.0))
            out[CellKey(table, quantity="distance_m", parameter=f"ring {k}")] = Found(
                float(distance), "b sqrt(1 - r^2/a^2)"
            )
        key = CellKey("1", quantity="diameter_in_text_m", parameter=f"ring {k}")
        out[key] = Found(2.0 * float(radius), "twice the radius", is_exact=True)
    return out


def _plain(numbers: Array, remark: str) -> Callable[[int, int], Found]:
    """Numbers of a column."""
    return lambda i, _: Found(float(numbers[i]), remark)


def geodetic_cells(values: Values) -> Cells:
    """Tables 3 and 4: X from the direction (eq. 176), Z from the reading of the level."""
    out: Cells = {}
    for table in ("3", "4"):
        alpha, reading, _, y, _ = points_of(values, table, ("alpha_gon", "level_reading_mm", *XYZ)).T
        x = _text(values, "theodolite", "x") - (y - 1000.0) / np.tan(alpha * GON)
        z = LEVEL_Z_M - 1e-3 * reading
        out |= cells_of(table, ("x_m",), POINTS, _plain(x, "X of the theodolite minus (Y - 1000) cot alpha"))
        out |= cells_of(table, ("z_m",), POINTS, _plain(z, f"{LEVEL_Z_M} m minus the reading"))
    return out


def surface_cells(values: Values) -> Cells:
    """Appendix 3: the land spheroid from the coordinates of appendix 1, and differences of the printed surfaces."""
    fitted = fit_surface(points_of(values, "ek1.points", GEODETIC), "spheroid", method="algebraic")
    out: Cells = {}
    for name, value in fitted.parameters.items():
        key = CellKey("ek3.surfaces", quantity="land_49pt_m", parameter=name)
        remark = "least squares of eq. 142 over 49 points of appendix 1; table 3 gives another Y0 and b"
        out[key] = Found(round(value, 4), remark, value - 0.5e-4, value + 0.5e-4)
        photo = values[key._replace(quantity="photo_case_i_m")]
        difference = 100.0 * (values[key] - photo)
        remark = "the numbers beside it, the first with four decimals"
        out[key._replace(quantity="difference_cm")] = Found(difference, remark, difference - 0.005, difference + 0.005)
    return out


def _printed_spheroid(values: Values) -> Surface:
    """Spheroid of case I as printed."""
    p = {
        name: values[CellKey("ek3.surfaces", quantity="photo_case_i_m", parameter=name)]
        for name in ("a", "b", "x0", "y0", "z0")
    }
    return Surface("spheroid", np.array([p["x0"], p["y0"], p["z0"]]), np.array([p["a"], p["b"], p["a"]]))


def ring_radius(points: Array, centre: Array) -> Array:
    """Half the distance between the extreme targets of a point's ring; at the apex its own |X - X0|. (49,).

    Found by trial: seven other definitions miss the printed points.
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
    """Appendix 3: land points mapped to the spheroid of case I."""
    land, surface = points_of(values, "ek1.points", GEODETIC), _printed_spheroid(values)
    ours, rng = _mapped(land, surface), np.random.default_rng(1)
    runs = []
    for _ in range(RUNS):
        moved = Surface("spheroid", surface.centre + rng.uniform(-SINGLE_M, SINGLE_M, 3), surface.semi_axes)
        runs.append(_mapped(land + rng.uniform(-SINGLE_M, SINGLE_M, land.shape), moved))
    half = np.abs(np.array(runs) - ours).max(axis=0)
    remark = f"half the width of a ring as its radius, found by trial; spread: {RUNS} runs in single precision"
    out = cells_of("ek3.points", ("x_mapped_m", "y_mapped_m", "z_mapped_m"), POINTS, lambda i, j: Found(
        float(ours[i, j]), remark, float(ours[i, j] - half[i, j]), float(ours[i, j] + half[i, j])))  # fmt: skip
    printed = points_of(values, "ek3.points", ("x_mapped_m", "y_mapped_m", "z_mapped_m"))
    f = 100.0 * (land - printed)
    out |= cells_of("ek3.points", ("fx_cm", "fy_cm", "fz_cm"), POINTS, lambda i, j: Found(
        float(f[i, j]), "the printed coordinates, which have four decimals", float(f[i, j] - 0.011),
        float(f[i, j] + 0.011)))  # fmt: skip
    ms = np.linalg.norm(points_of(values, "ek3.points", ("fx_cm", "fy_cm", "fz_cm")), axis=1)
    return out | cells_of("ek3.points", ("ms_cm",), POINTS, lambda i, j: Found(float(ms[i]), "the numbers beside it"))


def sum_cells(values: Values) -> Cells:
    """Tables 5 to 12: [Fpp] from the three sums beside it."""
    out: Cells = {}
    for key in values:
        if key.quantity == "fpp_cm2":
            parts = float(sum(values[key._replace(quantity=q)] for q in SUMS))
            # each of the four has two decimals
            out[key] = Found(parts, "sum of the three beside it", parts - 0.015, parts + 0.015)
    return out


def six_point_cells(values: Values) -> Cells:
    """Tables 13 to 20: case I of table 13 is that of appendix 3; for others what large values tell."""
    out: Cells = {}
    for key, value in values.items():
        if key.quantity == "db_cm" and abs(value) > LARGE_CM:
            ratio = -values[key._replace(quantity="dy0_cm")] / value
            remark = (
                f"the points of the case are not printed (a lost figure); -dY0/db = {ratio:.2f} is the direction that "
                "two levels leave open, so the number is noise"
            )
            out[key] = Found(float("nan"), remark, kind="not_reproducible")
    for name in ("a", "b", "x0", "y0", "z0"):
        key = CellKey("13", quantity=f"d{name}_cm", parameter="case 1")
        same = values[CellKey("ek3.surfaces", quantity="difference_cm", parameter=name)]
        out[key] = Found(same, "appendix 3" + ("; there with the other sign" if name == "a" else ""))
    return out


def text_cells(values: Values) -> Cells:
    """Numbers in the text: the base, the sums of appendix 1, the largest deviation from the surfaces."""

    def station(photo: str) -> Array:
        return np.array([values[CellKey("ek1.cameras", quantity=q, parameter=photo)] for q in ("x0", "y0", "z0")])

    base = float(np.linalg.norm(station("photo 2") - station("photo 1")))
    out = {
        CellKey("text", quantity="computed_base", parameter="camera"): Found(base, "distance of the printed stations")
    }
    differences = points_of(values, "ek1.points", ("dx_cm", "dy_cm", "dz_cm"))
    for name, total in zip(("fxfx", "fyfy", "fzfz"), np.sum(differences**2, axis=0).tolist(), strict=True):
        half = 3.0 * 2.0 * np.sqrt(total / 12.0) * 1e-4  # of four decimals, rounded
        out[CellKey("text", quantity=name, parameter="sums")] = Found(
            total, "squares of the printed differences; spread: their rounding", total - half, total + half
        )
    fields: tuple[tuple[Kind, Array], ...] = (
        ("spheroid", points_of(values, "ek1.points", GEODETIC)), ("sphere", points_of(values, "4", XYZ)),
    )  # fmt: skip
    for name, points in fields:
        fitted = fit_surface(points, name, method="algebraic")
        each = 1e3 * np.abs(fitted.deviations_m)
        words = "/".join(f"{v:.2f}" for v in each.max(axis=0))
        worst = int(np.argmax(each.max(axis=1))) + 1
        key = CellKey("text", quantity=name, parameter="deviation of field points")
        out[key] = Found(float(each.max()), f"largest along X/Y/Z: {words} mm, point {worst}")
    return out


COMPUTERS: Final[dict[str, Callable[[Values], Cells]]] = {
    "1": ring_cells, "2": ring_cells, "3": geodetic_cells, "4": geodetic_cells, "ek3.surfaces": surface_cells,
    "ek3.points": mapping_cells, "text": text_cells, **{str(k): sum_cells for k in range(5, 13)},
    **{str(k): six_point_cells for k in range(13, 21)},
}  # fmt: skip
