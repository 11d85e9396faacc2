"""How well readings of a table fit the images: ground points projected into them, compared with the measured pixels.

The orientation of an image that is not adjusted is wrong by metres to tens of metres, which moves all its points by
nearly the same pixels. The scatter about this move shows whether the coordinates are read well; the move itself decides
only between readings that are far apart, or if the images prove accurate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.office.parts import Triple
from fg_orient.formats.scenes import REACH, Scene
from fg_orient.geodesy import (
    crs_kind,
    ecef_to_geodetic,
    from_geographic,
    offline_pyproj,
    operation_to_ecef,
    spatial_crs,
    to_ecef,
)
from fg_orient.geodesy.crs import WGS84
from fg_orient.model.errors import InputError

#: A reading is turned down if its scatter is this many times that of another one, which is at least this, px.
RATIO: Final = 3.0
LEAST_PX: Final = 0.5
#: Fewest points in an image by whose scatter a reading is judged.
FEWEST: Final = 5
#: It is turned down, too, if its images would be moved by so much (m) and so many times more than in another one.
FAR_M: Final = 40.0
FAR_RATIO: Final = 8.0
#: Largest move of images whose orientation has proved accurate, px.
ACCURATE_PX: Final = 2.0
#: A reading is believed if scatter (px) and move (m) are not larger.
MAX_SCATTER_PX: Final = 20.0
MAX_MOVE_M: Final = 1000.0
#: Readings are the same if no point moves by more in the images, px.
SAME_PX: Final = 0.1
#: Margin of the area of a CRS, degrees; distance beyond the images at which a CRS is left out, m.
_MARGIN_DEG: Final = 1.0
_MARGIN_M: Final = 20_000.0
#: Width of the area of a national datum, degrees.
WIDEST_DEG: Final = 70.0
#: Difference of coordinates in two datums that agree, degrees.
_AGREES_DEG: Final = 1e-9
#: Names of CRS that are left out: older global datums, and realisations of systems that offices name WGS84 or ETRS89.
_LEFT_OUT: Final = ("WGS 72", "WGS 66", "NSWC", "PZ-90", "ITRF", "ETRF", "IGS", "IGb", "WGS 84 (", "NSIDC", "ETRS89/",
                    "Hughes")  # fmt: skip


class Evidence(NamedTuple):
    """Scatter of the differences in the worst image, and largest move of an image; nan without image points."""

    scatter_px: float
    move_px: float
    move_m: float
    fewest: int

    def words(self) -> str:
        """For lists."""
        if np.isnan(self.move_px):
            return ""
        return f"scatter {self.scatter_px:.3g} px, images moved by {self.move_px:.3g} px ({self.move_m:.3g} m)"

    @property
    def believable(self) -> bool:
        """Whether the reading may be right at all."""
        return bool(np.isnan(self.move_px) or (self.scatter_px <= MAX_SCATTER_PX and self.move_m <= MAX_MOVE_M))

    def beats(self, other: Evidence) -> bool:
        """Whether another reading is clearly worse."""
        if np.isnan(self.move_px):
            return False
        scatter = min(self.fewest, other.fewest) >= FEWEST and other.scatter_px > RATIO * max(self.scatter_px, LEAST_PX)
        far = other.move_m > FAR_M and other.move_px > FAR_RATIO * self.move_px
        accurate = self.move_px <= ACCURATE_PX and other.move_px > FAR_RATIO * max(self.move_px, 0.1)
        return bool(
            self.believable
            and self.scatter_px <= RATIO * max(other.scatter_px, LEAST_PX)
            and (scatter or far or accurate)
        )


NO_EVIDENCE: Final = Evidence(np.nan, np.nan, np.nan, 0)


@dataclass(frozen=True, eq=False)
class Marks:
    """Image points as read: name of the image in the table, id of the point, first and second pixel coordinate.

    ``first`` is the line, unless line and sample are exchanged. ``places`` are file and place of each, for messages.
    """

    labels: tuple[str, ...]
    label: Index
    ids: tuple[str, ...]
    first: Array
    second: Array
    places: tuple[tuple[str, str], ...] = ()

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Reading:
    """A triple of columns in a CRS, an image for each label, and whether line and sample are exchanged."""

    triple: Triple
    crs: str
    images: tuple[str, ...]
    exchanged: bool
    evidence: Evidence
    predicted: Array
    same: tuple[str, ...] = ()


class Fit:
    """Images and marks against which readings are tried.

    Parameters
    ----------
    sensors : mapping of str to Sensor
        Georeferenced images; empty if nothing can be projected.
    marks : Marks
    row : mapping of str to int
        Row of each ground point.
    """

    def __init__(self, sensors: Mapping[str, Any], marks: Marks, row: Mapping[str, int]) -> None:
        self.sensors, self.marks = sensors, marks
        self.used = np.array([k for k, name in enumerate(marks.ids) if name in row], np.intp)
        self.rows = np.array([row[marks.ids[k]] for k in self.used], np.intp)
        self.scenes = [Scene.from_footprint(name, s.footprint()) for name, s in sensors.items()]
        self.gsd_m = {name: _gsd_m(s) for name, s in sensors.items()}

    def near(self, ecef: Array) -> bool:
        """Whether more than half of the points (n, 3) lie near an image."""
        if not self.scenes or not len(ecef):
            return True
        centres = np.stack([scene.centre_m for scene in self.scenes])
        reach = np.array([REACH * scene.diagonal_m for scene in self.scenes])
        apart = np.linalg.norm(ecef[:, None] - centres[None], axis=2)
        return bool(((apart <= reach).any(axis=1)).mean() > 0.5)

    def predicted(self, ecef: Array) -> dict[str, Array]:
        """Pixels (n, 2) of the points of the marks in every image."""
        ground = ecef[self.rows]
        return {name: np.stack(s.project(ground), axis=1) for name, s in self.sensors.items()}

    def evidence(self, predicted: Mapping[str, Array], images: Sequence[str], exchanged: bool,
                 first_pixel: float = 0.0) -> tuple[Evidence, Array]:  # fmt: skip
        """Evidence of images for the labels, and the pixels (n, 2) of the marks by the reading."""
        m = self.marks
        if not len(self.used) or not self.sensors:
            return NO_EVIDENCE, np.empty((0, 2))
        pair = (m.second, m.first) if exchanged else (m.first, m.second)
        seen = np.stack(pair, axis=1)[self.used] - first_pixel
        label = m.label[self.used]
        where = np.empty_like(seen)
        scatter = move = move_m = 0.0
        fewest = len(seen)
        for k, name in enumerate(images):
            own = label == k
            if not own.any():
                continue
            where[own] = predicted[name][own]
            apart = seen[own] - where[own]
            apart = np.where(np.isfinite(apart), apart, 1e9)
            middle = np.median(apart, axis=0)
            scatter = max(scatter, 1.4826 * float(np.median(np.abs(apart - middle), axis=0).max()))
            here = float(np.linalg.norm(middle))
            move, move_m = max(move, here), max(move_m, here * self.gsd_m[name])
            fewest = min(fewest, int(own.sum()))
        return Evidence(scatter, move, move_m, fewest), where


def _gsd_m(sensor: Any) -> float:
    """Size of a pixel on the ground in the middle of the image, m."""
    line, sample = 0.5 * (sensor.first_line + sensor.last_line), 0.5 * (sensor.first_sample + sensor.last_sample)
    step = min(10.0, sensor.last_line - line)
    ends = sensor.locate([line, line + step], [sample, sample], height_m=sensor.mean_height_m)
    return float(np.linalg.norm(ends[1] - ends[0])) / step if step else 1.0


def scene_box(sensors: Mapping[str, Any]) -> tuple[float, float, float, float]:
    """West, south, east, north (degrees) of all images."""
    corners = np.vstack([s.footprint() for s in sensors.values()])
    return (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())


def possible_crs(kind: str, coordinates: Array, box: tuple[float, float, float, float] | None) -> list[str]:
    """CRS of EPSG in which coordinates of a kind may lie in the box, the usual ones first."""
    if kind == "geocentric":
        return ["EPSG:4978"]
    if box is None:
        return []
    west, south, east, north = box
    middle = np.array([0.5 * (west + east), 0.5 * (south + north)])
    known = coordinates[np.isfinite(coordinates[:, :2]).all(axis=1), :2]
    if not len(known):
        return []
    median = np.median(known, axis=0)
    if kind == "geographic":
        if (np.abs(median - middle) > 1.0 + np.array([east - west, north - south])).any():
            return []
        return [WGS84, *_geographic(tuple(np.round(box, 1)))]
    size_m = 1.2e5 * max(east - west, north - south)
    found = []
    for code, place in _projected(tuple(np.round(box, 1))):
        if np.linalg.norm(np.array(place(*middle)) - median) < REACH * size_m + _MARGIN_M:
            found.append(code)
    return sorted(found, key=usual_first)


def usual_first(crs: str) -> tuple[bool, int]:
    """Order of CRS that give the same places: WGS84 first, then by number."""
    number = int(crs.partition(":")[2].partition("+")[0])
    return not (number in (4979, 3857) or 32600 < number <= 32660 or 32700 < number <= 32760), number


def _query(kind: str, box: tuple[float, ...]) -> list[Any]:
    proj = offline_pyproj()

    area = proj.aoi.AreaOfInterest(max(box[0] - _MARGIN_DEG, -180.0), max(box[1] - _MARGIN_DEG, -90.0),
                                     min(box[2] + _MARGIN_DEG, 180.0), min(box[3] + _MARGIN_DEG, 90.0))  # fmt: skip
    infos = proj.database.query_crs_info("EPSG", getattr(proj.enums.PJType, kind), area_of_interest=area)
    return [info for info in infos if not any(info.name.startswith(name) for name in _LEFT_OUT)]


@cache
def _projected(box: tuple[float, ...]) -> list[tuple[str, Any]]:
    """Projected CRS of a box, and their projection of longitude and latitude on the own datum."""
    proj = offline_pyproj()
    out = []
    for info in {one.code: one for one in _query("PROJECTED_CRS", box)}.values():
        try:
            crs_kind(f"EPSG:{info.code}")
            out.append((f"EPSG:{info.code}", proj.Proj(f"EPSG:{info.code}")))
        except (InputError, proj.exceptions.CRSError, proj.exceptions.ProjError):
            continue
    return out


@cache
def _geographic(box: tuple[float, ...]) -> list[str]:
    """Geographic CRS of the countries of a box that have projected CRS, too, and do not agree with WGS84."""
    mapped = {info.name.partition(" / ")[0] for info in _query("PROJECTED_CRS", box)}
    out = []
    for info in (one for one in _query("GEOGRAPHIC_2D_CRS", box) if one.name in mapped):
        area, code = info.area_of_use, f"EPSG:{info.code}"
        if area is None or (area.east - area.west + 360.0 * (area.east < area.west)) > WIDEST_DEG:
            continue
        with suppress(InputError):
            there = from_geographic(code, box[0], box[1])
            if not np.allclose(np.ravel(there), box[:2], rtol=0.0, atol=_AGREES_DEG):
                out.append(code)
    return sorted(out, key=usual_first)


def in_ecef(crs: str, coordinates: Array, sensors: Mapping[str, Any]) -> Array | None:
    """Points (n, 3) in ECEF, nan where a coordinate is missing; None if the CRS cannot hold them."""
    heights = [s.mean_height_m for s in sensors.values()] or [0.0]
    whole = np.isfinite(coordinates[:, :2]).all(axis=1)
    out = np.full((len(coordinates), 3), np.nan)
    if not whole.any():
        return out
    given = np.where(np.isfinite(coordinates), coordinates, float(np.mean(heights)))[whole]
    try:
        if not sensors:
            xyz = to_ecef(crs, *given.T)
        elif (operation := _transformer(crs, scene_box(sensors))) is not None:
            xyz = np.stack(operation.transform(*given.T), axis=1)
        else:
            return None
    except InputError:
        return None
    if not np.isfinite(xyz).all():
        return None
    out[whole] = xyz
    return out


@cache
def _transformer(crs: str, box: tuple[float, float, float, float]) -> Any:
    """Operation from a CRS to ECEF for a box in degrees, searched once for all readings; None if there is none."""
    try:
        return operation_to_ecef(crs, spatial_crs(crs), np.array(box).reshape(2, 2))[0]
    except InputError:
        return None


def lonlat(ecef: Array) -> Array:
    """Longitude and latitude (n, 2) degrees."""
    lon, lat, _ = ecef_to_geodetic(ecef)
    return np.stack([lon, lat], axis=1)
