"""Tables 7.2 to 7.6: areas and coastlines of the Princes' Islands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from fg_orient.model.cells import CellKey
from fg_orient.model.errors import InputError
from fg_orient.rectification.areas import mean_spacing_m, pixel_area_m2, planar_area_m2
from fg_orient.rectification.projections import gauss_krueger, lambert_cylindrical, lambert_polar, project, unproject
from fg_orient.rectification.study import REPRODUCED_RUNS, SHEET_EXTENT_KM, digitised_sheets
from fg_orient.studies.reproduce.found import Found, attempt

Values = Mapping[CellKey, float]

PIXEL_M: Final = 30.0
#: Latitude and longitude, degrees, from a map; an error of 0.01 changes the area ratio by 1e-5.
PLACES: Final = {
    "buyukada": (40.858, 29.121), "heybeliada": (40.877, 29.094), "burgazada": (40.881, 29.066),
    "sedef_adasi": (40.850, 29.146), "kasik_adasi": (40.884, 29.077),
}  # fmt: skip
CENTRAL_MERIDIAN_DEG: Final = 27.0
#: Radius of the sphere; the thesis gives "the mean latitude" only. It was solved for: its roundness is the evidence.
RADIUS_M: Final = 6_370_000.0
#: Standard deviation of a vertex across the coast from latitude and longitude rounded to 0.01 seconds, m: uniform over
#: 0.309 m and 0.234 m, mean of both directions.
ROUNDED_M: Final = 0.079
JOINED: Final = {"heybeliada_plus_kasik": ("heybeliada", "kasik_adasi")}
#: Errors of table 7.6, by island and side.
KNOWN: Final = {
    ("heybeliada_plus_kasik", "utm"): "; the printed areas beside it give 21492, too",
    ("sedef_adasi", "azimuthal"): "; 347700 is printed for the 347400 of its own table 7.5",
}
_SIDES: Final = ("utm", "azimuthal")


def _key(table: str, row: str, quantity: str) -> CellKey:
    return CellKey(table, quantity=quantity, parameter=row)


def area_ratio(island: str, area_m2: float, projection: str) -> float:
    """Area on Gauss-Krueger (scale 1, Hayford) by that in a Lambert projection of the sphere.

    A circle of the island's area stands for its outline; geodetic latitude is taken for spherical, as in the source.
    nan for an area that no projection holds.
    """
    latitude, longitude = PLACES[island]
    definition, angle = gauss_krueger(CENTRAL_MERIDIAN_DEG), np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    circle = np.sqrt(area_m2 / np.pi) * np.column_stack([np.cos(angle), np.sin(angle)])
    plane = project(definition, longitude, latitude) + circle
    try:
        lambert = project(projection, *unproject(definition, plane).T)
    except InputError:  # an altered area beyond the projection
        return float("nan")
    return float(np.divide(planar_area_m2(plane), planar_area_m2(lambert)))


def utm_areas(values: Values) -> dict[CellKey, Found]:
    """Table 7.2: the areas need the outlines; their RMS is compared with what one calibration of the sheet gives."""
    share = float(digitised_sheets(SHEET_EXTENT_KM, REPRODUCED_RUNS).determinant.std(ddof=1))
    remark = f"one calibration of the sheet leaves {share:.1e} of any area ({REPRODUCED_RUNS} simulated calibrations)"
    return {
        _key("7.2", island, "area_rms"): Found(share * values[_key("7.2", island, "area_utm")], remark, is_order=True)
        for island in PLACES
    }


def spacings(values: Values) -> dict[CellKey, Found]:
    """Table 7.3: mean spacing of the vertices."""
    out = {}
    for island in PLACES:
        length, n = (values[_key("7.3", island, name)] for name in ("coastline", "n_vertices"))
        out[_key("7.3", island, "mean_spacing")] = Found(
            attempt(mean_spacing_m, length, n), "length by vertices", is_exact=True
        )
    return out


def lambert_areas(values: Values) -> dict[CellKey, Found]:
    """Table 7.4 from table 7.2 by the ratio of areas; the spread is that of rounded latitudes and longitudes."""
    out = {}
    for island in PLACES:
        utm, n = values[_key("7.2", island, "area_utm")], values[_key("7.3", island, "n_vertices")]
        sigma = np.sqrt(n) * values[_key("7.3", island, "mean_spacing")] * ROUNDED_M
        for name, projection in (
            ("azimuthal", lambert_polar(RADIUS_M)),
            ("cylindrical", lambert_cylindrical(RADIUS_M)),
        ):
            ratio = area_ratio(island, utm, projection)
            area = utm / ratio
            remark = (
                f"area of table 7.2 by the ratio {ratio:.6f} (scale 1 to a sphere of 6370 km, a radius that was solved "
                "for), 1.96 sigma of positions rounded to 0.01 seconds"
            )
            out[_key("7.4", island, f"area_{name}")] = Found(area, remark, area - 1.96 * sigma, area + 1.96 * sigma)
    return out


def pixel_areas(values: Values) -> dict[CellKey, Found]:
    """Table 7.5: pixels of 30 m."""
    rows = [key.parameter for key in values if key.table == "7.5" and key.quantity == "pixels_utm"]
    return {
        _key("7.5", row, f"satellite_area_{side}"): Found(
            attempt(pixel_area_m2, values[_key("7.5", row, f"pixels_{side}")], PIXEL_M), "pixels of 900 m2",
            is_exact=True,
        )
        for row in rows for side in _SIDES
    }  # fmt: skip


def differences(values: Values) -> dict[CellKey, Found]:
    """Table 7.6 from tables 7.2, 7.4 and 7.5."""
    out = {}
    for row in [key.parameter for key in values if key.table == "7.6" and key.quantity == "abs_difference_utm"]:
        for side in _SIDES:
            table, name = ("7.2", "area_utm") if side == "utm" else ("7.4", "area_azimuthal")
            computed = sum(values[_key(table, island, name)] for island in JOINED.get(row, (row,)))
            satellite = attempt(pixel_area_m2, values[_key("7.5", row, f"pixels_{side}")], PIXEL_M)
            known = KNOWN.get((row, side), "")
            out[_key("7.6", row, f"computed_area_{side}")] = Found(computed, f"table {table}", is_exact=True)
            out[_key("7.6", row, f"satellite_area_{side}")] = Found(
                satellite, f"pixels of table 7.5{known}", is_exact=True
            )
            out[_key("7.6", row, f"abs_difference_{side}")] = Found(
                abs(satellite - computed), f"pixels of table 7.5 and table {table}{known}", is_exact=True
            )
    return out


COMPUTERS: Final[dict[str, Callable[[Values], dict[CellKey, Found]]]] = {
    "7.2": utm_areas, "7.3": spacings, "7.4": lambert_areas, "7.5": pixel_areas, "7.6": differences,
}  # fmt: skip
