"""Mistakes that move points by thousands of pixels, found from the start values.

An adjustment with one of these mistakes ends far from the solution, where a linearised test has no
meaning. The control points are therefore projected with the orientation of the metadata. Another
reading of the tables, or the coordinates of another control point, must fit ten times better (median
distance).
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError, Finding, finding
from fg_orient.model.names import Role
from fg_orient.quality.mended import with_coordinates_of, with_measured

#: Minimum number of points, factor by which another reading must fit better, maximum number of images compared.
LEAST_POINTS: Final = 3
BETTER: Final = 10.0
MOST_IMAGES: Final = 30
#: No mix-up is assumed if the median distance, px, is at most this, because other readings move points farther.
FAR_PX: Final = 30.0
#: Standard deviations within which two control points have the same coordinates.
SAME: Final = 3.0
#: Distance in pixels assigned to points that a sensor cannot project, for instance on the other side of the Earth.
NOWHERE_PX: Final = 1e6
#: Maximum distance, m, of a projected point from the centre of an image. Beyond it the projection can fail.
REACH_M: Final = 2e6
#: Maximum number of control points whose places are compared.
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
    """Return degrees from packed angles: the first two decimals are minutes, and the next two optionally seconds."""
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
#: Other readings of local coordinates.
LOCAL_READINGS: Final[dict[str, Callable[[Array], Array]]] = {"X and Y exchanged": lambda xyz: xyz[:, [1, 0, 2]]}


@dataclass(frozen=True)
class MixUp:
    """Other reading of the coordinates that fits the control points of an image much better.

    Parameters
    ----------
    image : int
    reading : str
        Key of :data:`READINGS`, :data:`GROUND_READINGS` or :data:`LOCAL_READINGS`; "" for the metadata of another
        image.
    other : int
        Image with these metadata; -1 for another reading.
    points : tuple of int
        Control points that the reading fits.
    of : int
        Number of control points of the image.
    whole : bool
        True if hardly any point of the image lies at the place that the tables state.
    best_px, given_px : float
        Median distance between measured and projected image points of these points, with this reading and as given.
    """

    image: int
    reading: str
    other: int
    points: tuple[int, ...]
    of: int
    whole: bool
    best_px: float
    given_px: float

    def finding(self, block: Block) -> Finding:
        """Return the doubt on this image."""
        name = self.reading or f"the metadata of image {block.images[self.other].id}"
        return finding(
            "solution.mix_up",
            image=block.images[self.image].id,
            n=len(self.points),
            of=self.of,
            best_px=self.best_px,
            given_px=self.given_px,
            reading=name,
            before="",
            after="",
            left="",
        )


def mix_ups(block: Block) -> tuple[MixUp, ...]:
    """Find images whose control points fit far better with another reading of their coordinates, or other metadata.

    At least three control points, and more than half of the control points far from their image points, must fit
    better.

    Parameters
    ----------
    block : Block
    """
    found = (_of_image(block, k) for k in range(len(block.images)))
    return tuple(one for one in found if one is not None)


def _of_image(block: Block, k: int) -> MixUp | None:
    """Return the mix-up of an image."""
    o, known = block.observations, block.points.known.ecef_m
    row = np.flatnonzero((o.image == k) & np.isfinite(known[o.point]).all(axis=1))
    if len(row) < LEAST_POINTS:
        return None
    projected = _projected(block.images[k].sensor, known[o.point[row]])
    given = _away(projected, np.stack([o.line[row], o.sample[row]], axis=1))
    far = given > FAR_PX
    if np.count_nonzero(far) < LEAST_POINTS:
        return None
    best: tuple[tuple[int, float], MixUp] | None = None
    for (reading, other), away in _readings(block, k, row, projected).items():
        fits = far & (BETTER * away < given)
        n = int(np.count_nonzero(fits))
        if n < LEAST_POINTS or 2 * n <= np.count_nonzero(far):
            continue
        middle = float(np.median(away[fits]))
        if best is None or (n, -middle) > best[0]:
            points, whole = tuple(o.point[row[fits]].tolist()), np.count_nonzero(~far) < LEAST_POINTS
            best = (
                (n, -middle),
                MixUp(k, reading, other, points, len(row), bool(whole), middle, float(np.median(given[fits]))),
            )
    return None if best is None else best[1]


@dataclass(frozen=True)
class IdMixUp:
    """Control points with wrong ids: their image points show other control points, or their coordinates are copies.

    Parameters
    ----------
    points : tuple of (str, str)
        Pairs of a point and the point whose place its image points show. Two pairs: the ids are exchanged.
    best_px, given_px : float
        Median distance between measured and projected image points, at the place of the other point and at the point's
        own place.
    copied : bool
        True if instead the point has the coordinates of the other point.
    """

    points: tuple[tuple[str, str], ...]
    best_px: float
    given_px: float
    copied: bool = False

    def finding(self, block: Block) -> Finding:
        """Return the doubt on these points."""
        (name, other), *rest = self.points
        if self.copied:
            return finding(
                "solution.id_copied",
                place=f"point {name}",
                other=other,
                given_px=self.given_px,
                before="",
                after="",
                left="",
            )
        what = (
            f"ids of the control points {name} and {other} exchanged"
            if rest
            else f"one control point under two ids: the image points of {name} show the place of {other}"
        )
        return finding(
            "solution.id_mix_up", what=what, best_px=self.best_px, given_px=self.given_px, before="", after="", left=""
        )


def id_mix_ups(block: Block) -> tuple[IdMixUp, ...]:
    """Find control points whose image points lie near the place of another control point, and far from their own.

    Points are projected with the metadata. The usual distance from their image points is the median
    over all points. A point with more than ten times the usual distance is tested.
    """
    o, control = block.observations, block.points.where(Role.CONTROL)
    if not LEAST_POINTS <= len(control) <= MOST_POINTS:
        return ()
    own = _of_points(block, control, block.points.known.ecef_m[control])
    seen = np.isin(control, o.point)
    usual = float(np.median(own[seen])) if seen.any() else np.inf
    if not (own[seen] > BETTER * usual).any():
        return ()
    place = np.full(len(block.points.ids), -1)
    place[control] = np.arange(len(control))
    row = np.flatnonzero(place[o.point] >= 0)
    away = np.full((len(row), len(control)), np.nan)
    for k in np.unique(o.image[row]).tolist():
        mine = row[o.image[row] == k]
        pixels, shown = np.stack([o.line[mine], o.sample[mine]], axis=1), np.unique(place[o.point[mine]])
        projected = np.full((len(control), 2), np.nan)
        projected[shown] = _projected(block.images[k].sensor, block.points.known.ecef_m[control[shown]])
        away[o.image[row] == k] = np.linalg.norm(pixels[:, None] - projected, axis=2)
    distance = np.full((len(control),) * 2, np.inf)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # numpy warns of pairs of points that no image shows together
        for a in np.flatnonzero(seen).tolist():
            distance[a] = np.nanmedian(away[place[o.point[row]] == a], axis=0)
    distance = np.where(np.isnan(distance), np.inf, distance)
    best, other = distance.min(axis=1), distance.argmin(axis=1)
    wrong = (best <= BETTER * usual) & (own > BETTER * best) & (own > BETTER * usual)
    ids, out = [block.points.ids[j] for j in control], []
    known = block.points.known
    for a in np.flatnonzero(~wrong & seen & (own > BETTER * usual)).tolist():
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
    """Return the block in which control points have the coordinates of the places that their image points show.

    A copied control point has no coordinates.
    """
    gone = np.isin(block.points.ids, [one.points[0][0] for one in found if one.copied])
    right = with_coordinates_of(block, {name: other for one in found if not one.copied for name, other in one.points})
    return replace(right, points=right.points.without_coordinates(gone, Role.TIE)) if gone.any() else right


def undone(block: Block, found: Sequence[MixUp]) -> Block:
    """Return the block with its tables and metadata in the other reading."""
    o, images = block.observations, list(block.images)
    line, sample, of = o.line.copy(), o.sample.copy(), o.image.copy()
    for one in found:
        rows = (o.image == one.image) & (one.whole | np.isin(o.point, one.points))
        if one.reading in READINGS:
            sensor = block.images[one.image].sensor
            line[rows], sample[rows] = READINGS[one.reading](o.line[rows], o.sample[rows], sensor)
        elif one.other >= 0 and one.whole:
            images[one.image] = replace(images[one.image], sensor=block.images[one.other].sensor)
        elif one.other >= 0:
            of[rows] = one.other
    out = replace(block, images=tuple(images), observations=replace(o, image=of, line=line, sample=sample))
    named = [one for one in found if one.reading in (*GROUND_READINGS, *LOCAL_READINGS)]
    if not named:
        return out
    readings = [one.reading for one in named]
    name = max(readings, key=readings.count)
    ecef = block.points.known.ecef_m.copy()
    whole = all(one.whole for one in named)
    wrong = block.points.where(Role.CONTROL) if whole else np.unique([j for one in named for j in one.points])
    moved = _read(name, ecef[wrong])
    ecef[wrong] = np.where(np.isnan(moved), ecef[wrong], moved)
    out = replace(out, points=replace(out.points, known=replace(out.points.known, ecef_m=ecef)))

    place = {one: k for k, one in enumerate(block.points.ids)}
    check = np.array([place[one] for one in block.withheld.ids], np.intp)

    def read(ecef_m: Array) -> Array:
        """Return check points in the other reading, if this reading is far nearer to their image points."""
        moved = _read(name, ecef_m)
        given, other = (_of_points(block, check, xyz) for xyz in (ecef_m, moved))
        wrong = (given > FAR_PX) & (BETTER * other < given)
        return np.asarray(np.where(wrong[:, None], moved, ecef_m))

    return with_measured(out, (Role.CHECK,), read)


def _readings(block: Block, k: int, row: Index, projected: Array) -> dict[tuple[str, int], Array]:
    """Return distances (n,), px, between measured and projected image points.

    There is one array for each other reading of the coordinates and for each other image. ``projected`` (n, 2) are the
    points by the given reading in the given image.
    """
    o, sensor, out = block.observations, block.images[k].sensor, dict[tuple[str, int], Array]()
    pixels = np.stack([o.line[row], o.sample[row]], axis=1)
    for name, reading in READINGS.items():
        try:
            out[name, -1] = _away(projected, np.stack(reading(o.line[row], o.sample[row], sensor), axis=1))
        except AttributeError:  # sensors without an image size have no mirrored readings
            continue
    for name in GROUND_READINGS if block.georeferenced else LOCAL_READINGS:
        other = _read(name, block.points.known.ecef_m[o.point[row]])
        out[name, -1] = _away(_projected(sensor, other), pixels)
    if len(block.images) <= MOST_IMAGES:
        ground = block.points.known.ecef_m[o.point[row]]
        out |= {
            ("", j): _away(_projected(image.sensor, ground), pixels) for j, image in enumerate(block.images) if j != k
        }
    return out


def _of_points(block: Block, points: Index, ecef_m: Array) -> Array:
    """Return the median distances (n,) px between ground points at these coordinates and their image points."""
    o = block.observations
    place = np.full(len(block.points.ids), -1)
    place[points] = np.arange(len(points))
    row = np.flatnonzero(place[o.point] >= 0)
    away = np.empty(len(row))
    for k in np.unique(o.image[row]).tolist():
        mine = row[o.image[row] == k]
        projected = _projected(block.images[k].sensor, ecef_m[place[o.point[mine]]])
        away[o.image[row] == k] = _away(projected, np.stack([o.line[mine], o.sample[mine]], axis=1))
    of = place[o.point[row]]
    return np.array([np.median(away[of == k]) if (of == k).any() else 0.0 for k in range(len(points))])


def _read(name: str, ecef_m: Array) -> Array:
    """Return the coordinates (n, 3) in another reading; nan where they are impossible."""
    if name in LOCAL_READINGS:
        return LOCAL_READINGS[name](ecef_m)
    lon, lat, height = ecef_to_geodetic(ecef_m)
    x, y = GROUND_READINGS[name](lon, lat)
    possible = (np.abs(y) <= 90.0) & (np.abs(x) <= 360.0)
    x, y = (np.where(possible, angle, 0.0) for angle in (x, y))
    return np.where(possible[:, None], geodetic_to_ecef(x, y, height), np.nan)


def _projected(sensor: Any, ground_m: Array) -> Array:
    """Project ground points with the metadata to line and sample (n, 2); nan if they cannot be projected."""
    out = np.full((len(ground_m), 2), np.nan)
    near = np.linalg.norm(ground_m - sensor.centre_m, axis=1) <= REACH_M
    with contextlib.suppress(FgOrientError, AttributeError):
        if near.any():
            out[near] = np.stack([np.asarray(x, np.float64) for x in sensor.project(ground_m[near])], axis=1)
    return out


def _away(projected: Array, pixels: Array) -> Array:
    """Return distances (n,) px of projected and measured image points; points that cannot be projected are far away."""
    return np.asarray(np.nan_to_num(np.linalg.norm(pixels - projected, axis=1), nan=NOWHERE_PX, posinf=NOWHERE_PX))
