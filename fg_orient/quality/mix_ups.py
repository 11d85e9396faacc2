"""Mistakes that move points by thousands of pixels, found from the start values.

An adjustment with such a mistake ends far from the solution, where a linearised test has no meaning. The control points
are therefore projected with the orientation of the metadata, and another reading of the tables, or the coordinates of
another control point, must fit ten times better (median distance).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.rows import local_origin
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError, Finding, finding
from fg_orient.model.names import Role
from fg_orient.quality.mended import with_coordinates_of, with_measured

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Minimum number of points, factor by which another reading must fit better, most images compared.
LEAST_POINTS: Final = 3
BETTER: Final = 10.0
MOST_IMAGES: Final = 30
#: Median distance in pixels up to which nothing is mixed up: other readings move points farther.
FAR_PX: Final = 30.0
#: Standard deviations within which two control points have the same coordinates.
SAME: Final = 3.0
#: Most control points whose places are compared.
MOST_POINTS: Final = 300

Reading = Callable[[Array, Array, Any], tuple[Array, Array]]
GroundReading = Callable[[Array, Array], tuple[Array, Array]]


def _line(line: Array, sensor: Any) -> Array:
    return np.asarray(sensor.first_line + sensor.last_line - line)


def _sample(sample: Array, sensor: Any) -> Array:
    return np.asarray(sensor.first_sample + sensor.last_sample - sample)


#: Other readings of line and sample, by their description.
READINGS: Final[dict[str, Reading]] = {
    "line and sample exchanged": lambda line, sample, _: (sample, line),
    "lines counted from the last one (image mirrored)": lambda line, sample, sensor: (_line(line, sensor), sample),
    "samples counted from the last one (image mirrored)": lambda line, sample, sensor: (line, _sample(sample, sensor)),
    "lines and samples counted from the last ones (image turned by half a turn)": lambda line, sample, sensor: (
        _line(line, sensor), _sample(sample, sensor)
    ),
    "line and sample exchanged, lines counted from the last one (image turned by a quarter)":
        lambda line, sample, sensor: (_line(sample, sensor), line),
    "line and sample exchanged, samples counted from the last one (image turned by a quarter)":
        lambda line, sample, sensor: (sample, _sample(line, sensor)),
}  # fmt: skip


def _unpacked(angle: Array, *, seconds: bool) -> Array:
    """Degrees of an angle whose first two decimals are minutes, and whose next two are seconds if told so."""
    degrees = np.trunc(angle)
    minutes = (angle - degrees) * 100.0
    if seconds:
        whole = np.trunc(np.round(minutes, 9))
        minutes = whole + (minutes - whole) * 100.0 / 60.0
    return np.asarray(degrees + minutes / 60.0)


#: Other readings of longitude and latitude, by their description.
GROUND_READINGS: Final[dict[str, GroundReading]] = {
    "longitude and latitude exchanged": lambda lon, lat: (lat, lon),
    "longitude and latitude in gon": lambda lon, lat: (0.9 * lon, 0.9 * lat),
    "longitude and latitude in radians": lambda lon, lat: (np.degrees(lon), np.degrees(lat)),
    "longitude and latitude in packed degrees and minutes": lambda lon, lat: (
        _unpacked(lon, seconds=False), _unpacked(lat, seconds=False)
    ),
    "longitude and latitude in packed degrees, minutes and seconds": lambda lon, lat: (
        _unpacked(lon, seconds=True), _unpacked(lat, seconds=True)
    ),
}  # fmt: skip


@dataclass(frozen=True)
class MixUp:
    """Another reading that fits the control points of an image far better.

    Parameters
    ----------
    image : int
    reading : str
        Key of :data:`READINGS` or :data:`GROUND_READINGS`, "" for the metadata of another image.
    other : int
        That image; -1 for another reading.
    best_px, given_px : float
        Median distance between measured image points and projected ones, with this reading and as given.
    """

    image: int
    reading: str
    other: int
    best_px: float
    given_px: float

    def finding(self, block: Block) -> Finding:
        """Doubt on this image."""
        name = self.reading or f"the metadata of image {block.images[self.other].id}"
        return finding("solution.mix_up", image=block.images[self.image].id, best_px=self.best_px,
                       given_px=self.given_px, reading=name, before="", after="", left="")  # fmt: skip


def mix_ups(block: Block) -> tuple[MixUp, ...]:
    """Images whose control points fit far better with another reading of their coordinates, or other metadata.

    Parameters
    ----------
    block : Block
    """
    known = np.flatnonzero(np.isfinite(block.points.known.ecef_m).all(axis=1))
    projected = [_projected(image.sensor, block.points.known.ecef_m[known]) for image in block.images]
    out = []
    for k in range(len(block.images)):
        distances = _distances(block, k, known, projected)
        given = distances.pop(("", -1), np.nan)
        if not distances or np.isnan(given):
            continue
        (reading, other), best = min(distances.items(), key=lambda item: item[1])
        if BETTER * best < given:
            out.append(MixUp(k, reading, other, best, given))
    return tuple(out)


@dataclass(frozen=True)
class IdMixUp:
    """Control points whose image points show the places of other ones, or that have the coordinates of others.

    Parameters
    ----------
    points : tuple of (str, str)
        Point, and the point whose place its image points show. Two rows: ids that are exchanged.
    best_px, given_px : float
        Median distance between measured image points and projected ones, at the other place and at the own one.
    copied : bool
        Its coordinates are those of the other point instead.
    """

    points: tuple[tuple[str, str], ...]
    best_px: float
    given_px: float
    copied: bool = False

    def finding(self, block: Block) -> Finding:
        """Doubt on these points."""
        (name, other), *rest = self.points
        if self.copied:
            return finding("solution.id_copied", place=f"point {name}", other=other, given_px=self.given_px, before="",
                           after="", left="")  # fmt: skip
        what = f"ids of the control points {name} and {other} exchanged" if rest else \
               f"one control point under two ids: the image points of {name} show the place of {other}"  # fmt: skip
        return finding("solution.id_mix_up", what=what, best_px=self.best_px, given_px=self.given_px, before="",
                       after="", left="")  # fmt: skip


def id_mix_ups(block: Block) -> tuple[IdMixUp, ...]:
    """Control points whose image points lie near the place of another control point, and far from their own.

    The metadata bring most points near to their places; whatever is farther off than ten times that is looked at.
    """
    o, control = block.observations, block.points.where(Role.CONTROL)
    if not LEAST_POINTS <= len(control) <= MOST_POINTS:
        return ()
    place = np.full(len(block.points.ids), -1)
    place[control] = np.arange(len(control))
    row = np.flatnonzero(place[o.point] >= 0)
    away = np.full((len(row), len(control)), np.nan)
    for k in np.unique(o.image[row]).tolist():
        mine = row[o.image[row] == k]
        pixels = np.stack([o.line[mine], o.sample[mine]], axis=1)
        projected = _projected(block.images[k].sensor, block.points.known.ecef_m[control])
        away[o.image[row] == k] = np.linalg.norm(pixels[:, None] - projected, axis=2)
    away = np.where(np.isfinite(away), away, np.inf)
    seen = np.unique(place[o.point[row]])
    distance = np.full((len(control),) * 2, np.inf)
    for a in seen.tolist():
        distance[a] = np.median(away[place[o.point[row]] == a], axis=0)
    own, usual = np.diag(distance), float(np.median(np.diag(distance)[seen]))
    best, other = distance.min(axis=1), distance.argmin(axis=1)
    wrong = (best <= BETTER * usual) & (own > BETTER * best) & (own > BETTER * usual)
    ids, out = [block.points.ids[j] for j in control], []
    known = block.points.known
    for a in np.flatnonzero(~wrong & np.isfinite(own) & (own > BETTER * usual)).tolist():
        near = np.linalg.norm(known.ecef_m[control] - known.ecef_m[control[a]], axis=1)
        same = near <= SAME * np.nanmin(known.sigma_enu_m[control[a]])
        same[a] = False
        if same.any():
            out.append(IdMixUp(((ids[a], ids[int(np.argmax(same))]),), float(own[a]), float(own[a]), copied=True))
    for a in np.flatnonzero(wrong).tolist():
        b = int(other[a])
        if wrong[b] and other[b] == a and b < a:
            continue
        pairs = ((ids[a], ids[b]), *([(ids[b], ids[a])] if wrong[b] and other[b] == a else []))
        out.append(IdMixUp(pairs, float(best[a]), float(own[a])))
    return tuple(out)


def with_right_ids(block: Block, found: Sequence[IdMixUp]) -> Block:
    """The block in which control points have the coordinates of the places that they show; a copied one has none."""
    gone = np.isin(block.points.ids, [one.points[0][0] for one in found if one.copied])
    right = with_coordinates_of(block, {name: other for one in found if not one.copied for name, other in one.points})
    return replace(right, points=right.points.without_coordinates(gone, Role.TIE)) if gone.any() else right


def undone(block: Block, found: Sequence[MixUp]) -> Block:
    """The block with its tables and metadata read in the other way."""
    o, images = block.observations, list(block.images)
    line, sample = o.line.copy(), o.sample.copy()
    for one in found:
        rows = o.image == one.image
        if one.reading in READINGS:
            sensor = block.images[one.image].sensor
            line[rows], sample[rows] = READINGS[one.reading](o.line[rows], o.sample[rows], sensor)
        elif one.other >= 0:
            images[one.image] = replace(images[one.image], sensor=block.images[one.other].sensor)
    out = replace(block, images=tuple(images), observations=replace(o, line=line, sample=sample))
    names = [one.reading for one in found if one.reading in GROUND_READINGS]
    if not names:
        return out
    reading, centre = GROUND_READINGS[max(names, key=names.count)], local_origin(block.images)

    def read(ecef_m: Array) -> Array:
        """The other reading, where it brings the points nearer to the images: a second table may be right."""
        lon, lat, height = ecef_to_geodetic(ecef_m)
        other = reading(lon, lat)
        if (np.abs(other[1]) > 90.0).any():
            return ecef_m
        moved = geodetic_to_ecef(*other, height)
        away, now = (np.median(np.linalg.norm(xyz - centre, axis=1)) for xyz in (moved, ecef_m))
        return moved if away < now else ecef_m

    return with_measured(out, (Role.CONTROL, Role.CHECK), read)


def _distances(block: Block, k: int, known: Index, projected: Sequence[Array]) -> dict[tuple[str, int], float]:
    """Median distance in pixels for each reading and other image, ("", -1) as given; nothing more where this is small.

    ``projected`` (n, 2) of each image are the points ``known``.
    """
    o, sensor = block.observations, block.images[k].sensor
    row = np.flatnonzero((o.image == k) & np.isin(o.point, known))
    place, pixels = np.searchsorted(known, o.point[row]), np.stack([o.line[row], o.sample[row]], axis=1)
    out = {("", -1): _away(projected[k][place], pixels)}
    if len(row) < LEAST_POINTS or not out["", -1] > FAR_PX:
        return out
    for name, reading in READINGS.items():
        try:
            out[name, -1] = _away(projected[k][place], np.stack(reading(o.line[row], o.sample[row], sensor), axis=1))
        except AttributeError:  # no size of the image
            continue
    if block.georeferenced:
        lon, lat, height = ecef_to_geodetic(block.points.known.ecef_m[o.point[row]])
        for name, turned in GROUND_READINGS.items():
            other = turned(lon, lat)
            if (np.abs(other[1]) <= 90.0).all():
                out[name, -1] = _away(_projected(sensor, geodetic_to_ecef(*other, height)), pixels)
    if len(block.images) <= MOST_IMAGES:
        for j in range(len(block.images)):
            if j != k:
                out["", j] = _away(projected[j][place], pixels)
    return {name: d for name, d in out.items() if np.isfinite(d)}


def _projected(sensor: Any, ground_m: Array) -> Array:
    """Line and sample (n, 2) of ground points with the metadata; nan if they cannot be projected."""
    try:
        return np.stack([np.asarray(x, np.float64) for x in sensor.project(ground_m)], axis=1)
    except (FgOrientError, AttributeError):
        return np.full((len(ground_m), 2), np.nan)


def _away(projected: Array, pixels: Array) -> float:
    """Median distance in pixels of projected from measured image points; nan if too few can be projected."""
    d = np.linalg.norm(pixels - projected, axis=1)
    return float(np.median(d[np.isfinite(d)])) if np.isfinite(d).sum() >= LEAST_POINTS else float("nan")
