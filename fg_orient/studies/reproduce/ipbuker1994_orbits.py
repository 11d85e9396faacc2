"""Numbers of the text, tables 3.3 and 5.1, resampling, effective resolution: orbits, sensors, geometry."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from fg_orient.model.cells import CellKey
from fg_orient.rectification.scanner import swath_m, total_angle_rad
from fg_orient.rectification.standards import effective_resolution_m
from fg_orient.studies.reproduce.found import Found, attempt

Values = Mapping[CellKey, float]

DAY_MIN: Final = 1440.0
#: WGS84: semi-major axis (m), flattening, gravitational constant (m3/s2), J2; rotation of the Earth (rad/s).
A_M: Final = 6_378_137.0
FLATTENING: Final = 1.0 / 298.257223563
GM: Final = 3.986004418e14
J2: Final = 1.08263e-3
#: Mean motion of the Sun, rad/s: a sun-synchronous node follows it.
SUN_RAD_S: Final = 2.0 * math.pi / (365.2422 * 86400.0)
#: Landsat 1 to 3: inclination in degrees, orbits per cycle.
LANDSAT_1_INCLINATION_DEG: Final = 99.092
LANDSAT_1_ORBITS: Final = 251
#: Landsat 4 and 5: swath and height, m (TM).
TM_SWATH_M: Final = 185e3
TM_HEIGHT_M: Final = 705e3


def speed_m_s(height_m: float) -> float:
    """Speed in a circular orbit."""
    return float(np.sqrt(GM / (A_M + height_m)))


def sun_synchronous_deg(height_m: float) -> float:
    """Inclination of a circular sun-synchronous orbit, first order in J2."""
    a = A_M + height_m
    rate = 1.5 * J2 * np.sqrt(GM / a**3) * (A_M / a) ** 2
    return math.degrees(np.arccos(-SUN_RAD_S / rate))


def geodetic_minus_geocentric_rad(latitude_rad: float) -> float:
    """Angle between the vertical of the ellipsoid and the direction to the Earth's centre."""
    return latitude_rad - math.atan((1.0 - FLATTENING) ** 2 * math.tan(latitude_rad))


def text(values: Values) -> dict[CellKey, Found]:
    """Numbers of the text that follow from others."""

    def printed(system: str, quantity: str) -> float:
        return values[CellKey("text", quantity=quantity, parameter=system)]

    orbits, days = printed("landsat-5", "orbits_per_repeat"), printed("landsat-5", "repeat")
    mss_height = 1e3 * printed("landsat_mss", "altitude_used_for_scan_angle")
    swath = 1e3 * printed("landsat_mss", "swath")
    view, spot_height = math.radians(printed("spot_hrv", "field_of_view_each")), 1e3 * printed("spot", "altitude")
    off = printed("spot_hrv", "mirror_step") * printed("spot_hrv", "mirror_steps")
    latitudes = np.radians(np.linspace(0.0, 90.0, 9001)[1:-1])
    vertical = [geodetic_minus_geocentric_rad(float(v)) for v in latitudes]
    edge = geodetic_minus_geocentric_rad(math.radians(180.0 - LANDSAT_1_INCLINATION_DEG))
    half_swath = math.degrees(0.5 * swath / A_M)
    found = {
        ("landsat-5", "orbits_per_day"): (orbits / days, "orbits by days of the cycle"),
        ("landsat-5", "period"): (days * DAY_MIN / orbits, "days of the cycle by orbits"),
        ("landsat-5", "adjacent_ground_track_spacing_equator"): (
            2e-3 * math.pi * A_M * days / orbits, "equator by orbits per day: tracks one orbit apart"),
        ("landsat-5", "daily_track_shift"): (360.0 / orbits, "circle by tracks; printed cut off, not rounded"),
        ("landsat_mss", "total_scan_angle_printed"): (
            math.degrees(attempt(total_angle_rad, swath, mss_height)),
            "2 arctan(W/2H) of the printed swath and altitude"),
        ("landsat_mss", "scene_volume"): (
            4e-6 * printed("landsat_mss", "scan_lines") * printed("landsat_mss", "pixels_per_line"), "four bands"),
        ("landsat_tm", "ifov"): (1e6 * 30.0 / TM_HEIGHT_M, "30 m from 705 km"),
        ("spot_hrv", "swath_nadir"): (1e-3 * attempt(swath_m, view, spot_height),
            "field of view from the altitude, flat Earth"),
        ("spot_hrv", "swath_twin"): (
            2.0 * printed("spot_hrv", "swath_nadir") - printed("spot_hrv", "overlap_twin"), "two swaths less overlap"),
        ("spot_hrv", "max_off_nadir"): (off, "steps of the mirror"),
        ("spot_hrv", "swath_at_max_off_nadir"): (
            1e-3 * attempt(swath_m, view, spot_height, math.radians(off), A_M),
            "field of view at 27 degrees, curved Earth"),
        ("som_landsat_1_3", "longitude_shift_per_orbit"): (
            360.0 * printed("som_landsat_1_3", "repeat") / LANDSAT_1_ORBITS, "days of the cycle by 251 orbits"),
        ("som_landsat_1_3", "latitude_limit"): (
            180.0 - LANDSAT_1_INCLINATION_DEG + half_swath, "inclination of 99.092 degrees and half the swath"),
        ("som_ellipsoid", "max_geodetic_geocentric_angle"): (math.degrees(max(vertical)) * 60.0, "WGS84"),
        ("som_ellipsoid", "max_cross_track_angle"): (
            math.degrees(edge) * 60.0, "geodetic minus geocentric latitude where the track turns"),
        ("som_ellipsoid", "max_cross_track_offset"): (1e-3 * edge * mss_height, "that angle at 915 km"),
    }  # fmt: skip
    return {CellKey("text", quantity=q, parameter=s): Found(*pair) for (s, q), pair in found.items()}


def mss_and_tm(values: Values) -> dict[CellKey, Found]:
    """Table 3.3: what is called IFOV is the total scan angle."""
    name = "ifov_as_printed_actually_total_scan_angle"
    found = {"MSS": (TM_SWATH_M, 915e3), "TM": (TM_SWATH_M, TM_HEIGHT_M)}
    return {
        CellKey("3.3", quantity=name, parameter=sensor): Found(
            math.degrees(total_angle_rad(*pair)),
            f"2 arctan(W/2H), 185 km from {1e-3 * pair[1]:g} km; the row is called IFOV",
        )
        for sensor, pair in found.items()
    }


def mapping_sensor(values: Values) -> dict[CellKey, Found]:
    """Table 5.1: orbit and data rate of the sensor after Light (1990)."""

    def printed(group: str, quantity: str) -> float:
        return values[CellKey("5.1", quantity=quantity, parameter=group)]

    height, days = 1e3 * printed("orbit", "altitude_preferred"), printed("orbit", "repeat")
    orbits = printed("orbit", "orbits_to_cover_globe")
    ground = speed_m_s(height) * A_M / (A_M + height)
    detectors, pixel = printed("sensor", "detectors_per_array"), printed("sensor", "pixel_pan")
    coarse = printed("sensor", "pixel_multispectral")
    rate = printed("data", "quantisation") * ground * detectors * pixel * (2.0 / pixel**2 + 4.0 / coarse**2)
    found = {
        ("orbit", "inclination"): (sun_synchronous_deg(height), "sun-synchronous at this altitude (J2)"),
        ("orbit", "period"): (days * DAY_MIN / orbits, "days of the cycle by orbits"),
        ("orbit", "orbits_per_day"): (orbits / days, "orbits by days of the cycle"),
        ("orbit", "orbital_speed"): (1e-3 * speed_m_s(height), "circular orbit at this altitude"),
        ("orbit", "ground_speed"): (1e-3 * ground, "the same on the ground"),
        ("sensor", "swath"): (1e-3 * detectors * pixel, "detectors times pixel"),
        ("data", "rate_after_8_to_5_compression"): (
            1e-6 * rate * 5.0 / 8.0, "two panchromatic and four multispectral arrays, 8 bit to 5"),
    }  # fmt: skip
    return {CellKey("5.1", quantity=q, parameter=g): Found(*pair) for (g, q), pair in found.items()}


def resampling(values: Values) -> dict[CellKey, Found]:
    """Section 4.2.2: pixels under the kernel of each method."""
    support = {"nearest_neighbour": 1, "bilinear": 2, "cubic_convolution": 4}
    return {
        CellKey("s4.2.2", quantity="pixels", parameter=name): Found(float(width**2), "support of the kernel")
        for name, width in support.items()
    }


def resolutions(values: Values) -> dict[CellKey, Found]:
    """Half a millimetre at map scale."""
    return {
        key: Found(effective_resolution_m(float(key.parameter.partition(":")[2])), "0.5 mm at map scale")
        for key in values if key.table == "summary"
    }  # fmt: skip


COMPUTERS: Final[dict[str, Callable[[Values], dict[CellKey, Found]]]] = {
    "text": text, "3.3": mss_and_tm, "5.1": mapping_sensor, "s4.2.2": resampling, "summary": resolutions,
}  # fmt: skip
