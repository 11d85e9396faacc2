"""İpbüker (1994): arithmetic in its tables, simulation of its precisions, and numbers of orbits and sensors.

Control points, residuals, coefficients and outlines are not in the thesis. The module recomputes numbers that follow
from other printed numbers, laws and spreads that need no data, and physical constants of orbits and sensors.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey
from fg_orient.rectification import study
from fg_orient.rectification.projections import (
    gauss_krueger,
    lambert_cylindrical,
    lambert_polar,
    mean_spacing_m,
    pixel_area_m2,
    planar_area_m2,
    project,
    unproject,
)
from fg_orient.rectification.scanner import swath_m, total_angle_rad
from fg_orient.rectification.standards import effective_resolution_m
from fg_orient.studies.reproduce.verdict import Cells, Recomputed, Values, attempt, row_key

DAY_MIN: Final = 1440.0
#: WGS84: semi-major axis (m), flattening, gravitational constant (m3/s2), J2; Earth rotation (rad/s).
A_M: Final = 6_378_137.0
FLATTENING: Final = 1.0 / 298.257223563
GM: Final = 3.986004418e14
J2: Final = 1.08263e-3
#: Mean motion of the Sun, rad/s; the node of a sun-synchronous orbit has the same rate.
SUN_RAD_S: Final = 2.0 * math.pi / (365.2422 * 86400.0)
#: Landsat 1 to 3: inclination in degrees, and orbits per cycle.
LANDSAT_1_INCLINATION_DEG: Final = 99.092
LANDSAT_1_ORBITS: Final = 251
#: Landsat 4 and 5 (TM): swath and height, m.
TM_SWATH_M: Final = 185e3
TM_HEIGHT_M: Final = 705e3
#: Number of points measured on each rectified image (section 7.1).
POINTS_7_1: Final = 30
DEGREES: Final = (1, 2, 3)
#: Block in table 6.1 that has 20 values.
BLOCK: Final = "1024 x 1024"
#: Pixel sizes (m) of the RMS values in section 6.2 that are given both in metres and in pixels.
PIXELS_M: Final = {"welch_1984a": 28.5, "welch_1985bc": 30.0, "borgeson_1985": 28.5}
PIXEL_M: Final = 30.0
#: Latitude and longitude, degrees, read from a map. An error of 0.01 changes the area ratio by 1e-5.
PLACES: Final = {
    "buyukada": (40.858, 29.121), "heybeliada": (40.877, 29.094), "burgazada": (40.881, 29.066),
    "sedef_adasi": (40.850, 29.146), "kasik_adasi": (40.884, 29.077),
}  # fmt: skip
CENTRAL_MERIDIAN_DEG: Final = 27.0
#: Radius of the sphere, estimated from the printed areas, because the thesis gives only "the mean latitude". The
#: estimate is close to a round value, which supports it.
RADIUS_M: Final = 6_370_000.0
#: Standard deviation (m) of a vertex across the coast due to latitudes and longitudes rounded to 0.01 seconds: uniform
#: over 0.309 m and 0.234 m, mean of both directions.
ROUNDED_M: Final = 0.079
JOINED: Final = {"heybeliada_plus_kasik": ("heybeliada", "kasik_adasi")}
_SIDES: Final = ("utm", "azimuthal")


def _cells(table: str, numbers: Mapping[tuple[str, str], float], *, is_exact: bool = False) -> Cells:
    """Return the cells of a table from numbers by row and quantity."""
    return {row_key(table, *place): Recomputed(number, is_exact=is_exact) for place, number in numbers.items()}


def _rows(values: Values, table: str, quantity: str) -> list[str]:
    """Return the rows of a table that have this quantity."""
    return [key.parameter for key in values if key.table == table and key.quantity == quantity]


# --- orbits and sensors: text, tables 3.3 and 5.1; resampling; effective resolution ---------------


def speed_m_s(height_m: float) -> float:
    """Return the speed in a circular orbit."""
    return float(np.sqrt(GM / (A_M + height_m)))


def geodetic_minus_geocentric_rad(latitude_rad: float) -> float:
    """Return the angle between the ellipsoid's vertical and the direction to the Earth's centre."""
    return latitude_rad - math.atan((1.0 - FLATTENING) ** 2 * math.tan(latitude_rad))


def text(values: Values) -> Cells:
    """Return the numbers of the text that follow from other numbers."""

    def printed(system: str, quantity: str) -> float:
        return values[row_key("text", system, quantity)]

    orbits, days = printed("landsat-5", "orbits_per_repeat"), printed("landsat-5", "repeat")
    mss_height = 1e3 * printed("landsat_mss", "altitude_used_for_scan_angle")
    swath = 1e3 * printed("landsat_mss", "swath")
    view, spot_height = math.radians(printed("spot_hrv", "field_of_view_each")), 1e3 * printed("spot", "altitude")
    off = printed("spot_hrv", "mirror_step") * printed("spot_hrv", "mirror_steps")
    latitudes = np.radians(np.linspace(0.0, 90.0, 9001)[1:-1])
    vertical = [geodetic_minus_geocentric_rad(float(v)) for v in latitudes]
    edge = geodetic_minus_geocentric_rad(math.radians(180.0 - LANDSAT_1_INCLINATION_DEG))
    half_swath = math.degrees(0.5 * swath / A_M)
    oblique = attempt(swath_m, view, spot_height, math.radians(off), A_M)
    mss, nadir = math.degrees(attempt(total_angle_rad, swath, mss_height)), printed("spot_hrv", "swath_nadir")
    return _cells(
        "text",
        {
            ("landsat-5", "orbits_per_day"): orbits / days,
            ("landsat-5", "period"): days * DAY_MIN / orbits,
            ("landsat-5", "adjacent_ground_track_spacing_equator"): 2e-3 * math.pi * A_M * days / orbits,
            ("landsat-5", "daily_track_shift"): 360.0 / orbits,
            ("landsat_mss", "total_scan_angle_printed"): mss,
            ("landsat_mss", "scene_volume"): 4e-6
            * printed("landsat_mss", "scan_lines")
            * printed("landsat_mss", "pixels_per_line"),
            ("landsat_tm", "ifov"): 1e6 * 30.0 / TM_HEIGHT_M,
            ("spot_hrv", "swath_nadir"): 1e-3 * attempt(swath_m, view, spot_height),
            ("spot_hrv", "swath_twin"): 2.0 * nadir - printed("spot_hrv", "overlap_twin"),
            ("spot_hrv", "max_off_nadir"): off,
            ("spot_hrv", "swath_at_max_off_nadir"): 1e-3 * oblique,
            ("som_landsat_1_3", "longitude_shift_per_orbit"): 360.0
            * printed("som_landsat_1_3", "repeat")
            / LANDSAT_1_ORBITS,
            ("som_landsat_1_3", "latitude_limit"): 180.0 - LANDSAT_1_INCLINATION_DEG + half_swath,
            ("som_ellipsoid", "max_geodetic_geocentric_angle"): math.degrees(max(vertical)) * 60.0,
            ("som_ellipsoid", "max_cross_track_angle"): math.degrees(edge) * 60.0,
            ("som_ellipsoid", "max_cross_track_offset"): 1e-3 * edge * mss_height,
        },
    )


def mss_and_tm(values: Values) -> Cells:
    """Recompute table 3.3; the row named IFOV contains the total scan angle."""
    name, heights = "ifov_as_printed_actually_total_scan_angle", {"MSS": 915e3, "TM": TM_HEIGHT_M}
    return _cells(
        "3.3", {(sensor, name): math.degrees(total_angle_rad(TM_SWATH_M, height)) for sensor, height in heights.items()}
    )


def mapping_sensor(values: Values) -> Cells:
    """Recompute table 5.1: orbit and data rate of the sensor after Light (1990)."""

    def printed(group: str, quantity: str) -> float:
        return values[row_key("5.1", group, quantity)]

    height, days = 1e3 * printed("orbit", "altitude_preferred"), printed("orbit", "repeat")
    orbits = printed("orbit", "orbits_to_cover_globe")
    ground = speed_m_s(height) * A_M / (A_M + height)
    detectors, pixel = printed("sensor", "detectors_per_array"), printed("sensor", "pixel_pan")
    coarse = printed("sensor", "pixel_multispectral")
    a = A_M + height
    node = 1.5 * J2 * np.sqrt(GM / a**3) * (A_M / a) ** 2  # rate of the node for inclination 0, first order in J2
    rate = printed("data", "quantisation") * ground * detectors * pixel * (2.0 / pixel**2 + 4.0 / coarse**2)
    return _cells(
        "5.1",
        {
            ("orbit", "inclination"): math.degrees(np.arccos(-SUN_RAD_S / node)),
            ("orbit", "period"): days * DAY_MIN / orbits,
            ("orbit", "orbits_per_day"): orbits / days,
            ("orbit", "orbital_speed"): 1e-3 * speed_m_s(height),
            ("orbit", "ground_speed"): 1e-3 * ground,
            ("sensor", "swath"): 1e-3 * detectors * pixel,
            ("data", "rate_after_8_to_5_compression"): 1e-6 * rate * 5.0 / 8.0,
        },
    )


def resampling(values: Values) -> Cells:
    """Recompute section 4.2.2: number of pixels under the kernel of each method."""
    support = {"nearest_neighbour": 1.0, "bilinear": 4.0, "cubic_convolution": 16.0}
    return _cells("s4.2.2", {(name, "pixels"): n for name, n in support.items()})


def resolutions(values: Values) -> Cells:
    """Recompute the effective resolutions: half a millimetre at map scale."""
    keys = [key for key in values if key.table == "summary"]
    return {key: Recomputed(effective_resolution_m(float(key.parameter.partition(":")[2]))) for key in keys}


# --- accuracies at unpublished points: tables 6.1 and 7.1, sections 6.2 and 7.2 -------------------


def rectifications(values: Values) -> Cells:
    """Recompute table 7.1: find impossible m0 values, and compare distances with those that noise would give."""
    out = {}
    for row in _rows(values, "7.1", "pair_distance_sd"):
        keys = {q: row_key("7.1", row, f"m0_degree_{q}") for q in DEGREES}
        m0 = {q: values[key] for q, key in keys.items()}
        for q in study.growing_degrees(m0, POINTS_7_1) if min(m0.values()) > 0.0 else ():
            out[keys[q]] = _impossible(m0, q)
        key = row_key("7.1", row, "pair_distance_sd")
        out[key] = _distances(row, m0[1], values[key])
    return out


def _impossible(m0: Mapping[int, float], degree: int) -> Recomputed:
    """Return the upper limit of an m0: more terms cannot increase the sum of squares over the same points."""
    redundancy = {q: POINTS_7_1 - study.terms(q) for q in m0}
    most = min(m0[q] * float(np.sqrt(redundancy[q] / redundancy[degree])) for q in m0 if q < degree)
    allowed = study.admissible_points(m0)
    points = f"with {allowed[0]} to {allowed[-1]} points" if allowed else "with no number of points"
    return Recomputed(most, kind="differs", facts=(most, points))


def _distances(row: str, m0: float, printed: float) -> Recomputed:
    """Return the distance differences that noise alone would give, from m0 of degree 1."""
    scenes = study.distance_ratios(study.REPRODUCED_RUNS)
    middle, half = _spread(scenes.ratio * m0)
    more = ""
    if row != "spot_pan" and printed > middle + half:
        scale = np.sqrt(printed**2 - middle**2) / scenes.spread_m.mean()
        more = f"; a scale error of {100 * scale:.2f} % left over would explain it"
    return Recomputed.around(middle, half, more, (middle / m0, len(scenes.ratio), printed / m0))


def north_georgia(values: Values) -> Cells:
    """Recompute table 6.1: RMS = sigma sqrt(1 + p/n), with sigma fitted to the 20 values of one block.

    All values are RMSs at the same test points. Sigma absorbs their common part. Therefore a value is compared with the
    scatter of the other values about the law, not with the spread of an RMS of this number of points.
    """
    factors, rms, keys = [], [], []
    for key, value in values.items():
        if key.table == "6.1" and key.parameter.startswith(BLOCK):
            n, degree = (int(word) for word in re.findall(r"(\d+) GCPs, degree (\d+)", key.parameter)[0])
            keys.append(key)
            factors.append(np.sqrt(1.0 + study.terms(degree) / n))
            rms.append(value)
    g, v = np.array(factors), np.array(rms)
    sigma, out = float(g @ v / (g @ g)), {}
    for k, key in enumerate(keys):
        others = np.arange(len(v)) != k
        scatter = _scatter(g[others], v[others])
        law, half = sigma * float(g[k]), 1.96 * scatter
        more = f"; more than the law and the rounding to 1 m explain, {v[k] - law:+.1f} m"
        facts = sigma, len(v), len(v) - 1, scatter
        out[key] = Recomputed.around(law, half, more if abs(v[k] - law) > half else "", facts)
    return out


def _scatter(factors: Array, rms: Array) -> float:
    """Return the standard deviation of values about sigma times factors, with sigma fitted to them."""
    sigma = float(factors @ rms / (factors @ factors))
    return float(np.sqrt(np.sum((rms - sigma * factors) ** 2) / (len(rms) - 1)))


def literature(values: Values) -> Cells:
    """Recompute section 6.2: RMS in pixels from RMS in metres, if both are printed."""
    out = {}
    for key in values:
        metres = values.get(key._replace(quantity="rmse_m"))
        pixel = PIXELS_M.get(key.parameter.partition(",")[0])
        if key.table == "s6.2" and key.quantity == "rmse_px" and metres is not None and pixel is not None:
            out[key] = Recomputed(metres / pixel, facts=(pixel,))
    return out


def calibration(values: Values) -> Cells:
    """Recompute section 7.2: three precisions of one digitised sheet must be consistent."""
    sheets = study.digitised_sheets(study.SHEET_EXTENT_KM, study.REPRODUCED_RUNS)
    out = {CellKey("s7.2", quantity="affine_m0"): Recomputed(float("nan"), kind="not_reproducible")}
    for quantity, runs in (
        ("pair_distance_diff_sd", sheets.distance_sd),
        ("helmert_mean_point_error", sheets.helmert_point_error),
    ):
        out[CellKey("s7.2", quantity=quantity)] = Recomputed.around(*_spread(runs))
    return out


def _spread(runs: Array) -> tuple[float, float]:
    """Return the mean of some runs, and 1.96 standard deviations."""
    return float(runs.mean()), 1.96 * float(runs.std(ddof=1))


# --- areas and coastlines of the Princes' Islands: tables 7.2 to 7.6 ------------------------------


def area_ratio(island: str, area_m2: float, projection: str) -> float:
    """Return the ratio of areas on Gauss-Krueger (scale 1, Hayford) and in a Lambert projection of the sphere.

    A circle of the island's area replaces its outline. The geodetic latitude is used as spherical latitude, as in the
    source. The result is nan if the area lies outside a projection.
    """
    latitude, longitude = PLACES[island]
    definition, angle = gauss_krueger(CENTRAL_MERIDIAN_DEG), np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    circle = np.sqrt(area_m2 / np.pi) * np.column_stack([np.cos(angle), np.sin(angle)])
    plane = project(definition, longitude, latitude) + circle
    try:
        lambert = project(projection, *unproject(definition, plane).T)
    except InputError:  # a changed area may lie beyond the projection
        return float("nan")
    return float(np.divide(planar_area_m2(plane), planar_area_m2(lambert)))


def utm_areas(values: Values) -> Cells:
    """Compare the RMS of areas in table 7.2 with the RMS for one calibration of the sheet; areas need the outlines."""
    share = float(study.digitised_sheets(study.SHEET_EXTENT_KM, study.REPRODUCED_RUNS).determinant.std(ddof=1))
    areas = {island: values[row_key("7.2", island, "area_utm")] for island in PLACES}
    return {
        row_key("7.2", island, "area_rms"): Recomputed(share * area, is_order=True, facts=(share,))
        for island, area in areas.items()
    }


def spacings(values: Values) -> Cells:
    """Recompute table 7.3: mean spacing of the vertices."""
    printed = {i: [values[row_key("7.3", i, name)] for name in ("coastline", "n_vertices")] for i in PLACES}
    numbers = {(island, "mean_spacing"): attempt(mean_spacing_m, *pair) for island, pair in printed.items()}
    return _cells("7.3", numbers, is_exact=True)


def lambert_areas(values: Values) -> Cells:
    """Recompute table 7.4 from table 7.2 by the ratio of areas; rounded latitudes and longitudes give the spread."""
    out = {}
    for island in PLACES:
        utm, n = values[row_key("7.2", island, "area_utm")], values[row_key("7.3", island, "n_vertices")]
        sigma = np.sqrt(n) * values[row_key("7.3", island, "mean_spacing")] * ROUNDED_M
        projections = {
            "azimuthal": lambert_polar(RADIUS_M),
            "cylindrical": lambert_cylindrical(RADIUS_M),
        }
        for name, projection in projections.items():
            ratio = area_ratio(island, utm, projection)
            number = Recomputed.around(utm / ratio, 1.96 * sigma, facts=(ratio,))
            out[row_key("7.4", island, f"area_{name}")] = number
    return out


def _pixels_m2(values: Values, row: str, side: str) -> float:
    return attempt(pixel_area_m2, values[row_key("7.5", row, f"pixels_{side}")], PIXEL_M)


def pixel_areas(values: Values) -> Cells:
    """Recompute table 7.5: pixels of 30 m."""
    return _cells(
        "7.5",
        {
            (row, f"satellite_area_{side}"): _pixels_m2(values, row, side)
            for row in _rows(values, "7.5", "pixels_utm")
            for side in _SIDES
        },
        is_exact=True,
    )


def differences(values: Values) -> Cells:
    """Recompute table 7.6 from tables 7.2, 7.4 and 7.5."""
    out: Cells = {}
    for row in _rows(values, "7.6", "abs_difference_utm"):
        for side in _SIDES:
            table, name = ("7.2", "area_utm") if side == "utm" else ("7.4", "area_azimuthal")
            computed = sum(values[row_key(table, island, name)] for island in JOINED.get(row, (row,)))
            satellite = _pixels_m2(values, row, side)
            out |= _cells(
                "7.6",
                {
                    (row, f"computed_area_{side}"): computed,
                    (row, f"satellite_area_{side}"): satellite,
                    (row, f"abs_difference_{side}"): abs(satellite - computed),
                },
                is_exact=True,
            )
    return out


#: Functions that recompute each table from all printed values.
COMPUTERS: Final[dict[str, Callable[[Values], Cells]]] = {
    "text": text, "3.3": mss_and_tm, "5.1": mapping_sensor, "s4.2.2": resampling, "summary": resolutions,
    "6.1": north_georgia, "7.1": rectifications, "s6.2": literature, "s7.2": calibration,
    "7.2": utm_areas, "7.3": spacings, "7.4": lambert_areas, "7.5": pixel_areas, "7.6": differences,
}  # fmt: skip
