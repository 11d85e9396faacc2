"""Refuse ground points that are far from the footprints of all images, and exchanged lines and samples.

The usual causes of such points are exchanged columns and a wrong CRS. Both move a point
far outside every footprint. Therefore a coarse test is sufficient: a point is refused if
its distance from every image centre is larger than 1.5 diagonals of the image. Direct
orientation has errors of some hundred metres, and relief shifts a footprint by a few
kilometres. The test accepts such differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.formats.faults import Faults
from fg_orient.geodesy import COORDINATE_COLUMNS, crs_kind, ecef_to_geodetic, geodetic_to_ecef, known_crs, to_ecef
from fg_orient.geodesy.crs import on_own_datum, other_zones
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.geodesy.bodies import Body

#: Maximum distance of a plausible ground point from the image centre, as a multiple of the footprint's diagonal.
REACH: Final = 1.5
#: Bound of heights and differences between datums, m.
ROUGH_M: Final = 2e4
#: Zones are searched whose area of use is at most this far from the image centres, degrees.
ZONES_DEG: Final = 3.0
#: Minimum number of points that show a mistake of the whole table.
LEAST_POINTS: Final = 3


@dataclass(frozen=True)
class Scene:
    """Footprint of an image at height 0: its centre (3,), ECEF m, and its diagonal, m."""

    image: str
    centre_m: Array
    diagonal_m: float

    @classmethod
    def from_footprint(cls, image: str, footprint_deg: Array, body: Body | None = None) -> Scene:
        """Compute the scene from four corners (4, 2): longitude and latitude, degrees.

        The body None is the Earth.
        """
        zero = np.zeros(len(footprint_deg))
        if body is not None:
            corners = body.body_fixed(np.column_stack([footprint_deg, zero]))
        else:
            corners = geodetic_to_ecef(footprint_deg[:, 0], footprint_deg[:, 1], zero)
        apart = np.linalg.norm(corners[:, None] - corners[None], axis=2)
        return cls(image, np.asarray(corners.mean(axis=0)), float(apart.max()))


def check_positions(
    scenes: Sequence[Scene], crs: str, given: Array, ecef_m: Array, place: Callable[[int], str], faults: Faults
) -> None:
    """Note points that are far from every image.

    If an exchange of two columns, or another zone of the projection, would move most of them into images, note this
    instead. If most points are far, one fault states their number.

    Parameters
    ----------
    scenes : sequence of Scene
        One scene for each image; nothing is checked if there is no scene.
    crs : str
        CRS of ``given``.
    given, ecef_m : (n, 3) array
        Coordinates as in the file, and in ECEF, m. Rows of nan are skipped.
    place : callable
        Function that gives the place of point k in its file.
    faults : Faults
        Collects the faults.
    """
    rows = np.flatnonzero(np.isfinite(ecef_m).all(axis=1))
    if not scenes or not len(rows):
        return
    far = rows[_in_reach(scenes, ecef_m[rows]) > 1.0]
    if not len(far):
        return
    kind = crs_kind(crs)
    flat = kind != "geocentric"
    exchanged = _inside(scenes, crs, given[far][:, [1, 0, 2]]) if flat else np.zeros(len(far), bool)
    if flat and 2 * exchanged.sum() > len(far):
        first, second = COORDINATE_COLUMNS[kind][:2]
        example = " ".join(f"{v:.10g}" for v in given[far[exchanged]][0, :2])
        faults.add(
            "points.swapped", place=f"{place(int(far[exchanged][0]))}, columns {first} and {second}", value=example,
            first=first, second=second, count=int(exchanged.sum()), total=len(rows),
        )  # fmt: skip
        far = far[~exchanged]
    whole = len(far) >= LEAST_POINTS and 2 * len(far) > len(rows)  # one cause for the table
    if whole and kind == "projected":
        zone, inside = _other_zone(scenes, crs, given[rows])
        if 2 * inside > len(rows):
            faults.add(
                "points.other_zone", place=place(int(far[0])), value=crs, zone=zone, name=known_crs(zone).name,
                count=inside, total=len(rows),
            )  # fmt: skip
            return
    for k in far[:1] if whole else far:
        nearest = min(scenes, key=lambda scene: float(np.linalg.norm(ecef_m[k] - scene.centre_m)))
        distance = float(np.linalg.norm(ecef_m[k] - nearest.centre_m))
        faults.add(
            "points.far_most" if whole else "points.far",
            place=place(int(k)), value=" ".join(f"{v:.10g}" for v in given[k]), distance_km=distance / 1e3,
            size_km=nearest.diagonal_m / 1e3, image=nearest.image, count=len(far), total=len(rows),
        )  # fmt: skip


def _in_reach(scenes: Sequence[Scene], ecef_m: Array, more_m: float = 0.0) -> Array:
    """Return the distance divided by the allowed distance, as the smallest value (n,) over all images."""
    ratios = [np.linalg.norm(ecef_m - scene.centre_m, axis=1) / (REACH * scene.diagonal_m + more_m) for scene in scenes]
    return np.asarray(np.min(ratios, axis=0))


def _inside(scenes: Sequence[Scene], crs: str, given: Array) -> Mask:
    """Return a mask (n,) of the points with these coordinates that lie in an image; impossible points do not.

    The exact transformation is searched only for points near an image, because far from the area of a CRS PROJ takes
    seconds for each point.
    """
    inside = np.zeros(len(given), bool)
    lonlat = on_own_datum(crs, given[:, 0], given[:, 1])
    some = np.flatnonzero(np.isfinite(lonlat).all(axis=1))
    if not len(some):
        return inside
    lon, lat = lonlat[some].T
    rough = geodetic_to_ecef(lon, lat, np.zeros(len(some)))
    some = some[_in_reach(scenes, rough, ROUGH_M) <= 1.0]
    with suppress(InputError):
        if len(some):
            inside[some] = _in_reach(scenes, to_ecef(crs, *given[some].T)) <= 1.0
    return inside


def _other_zone(scenes: Sequence[Scene], crs: str, given: Array) -> tuple[str, int]:
    """Return the other zone of a projection in which most points lie in images, and their number; "" and 0 if none."""
    centres = np.stack(ecef_to_geodetic(np.array([scene.centre_m for scene in scenes]))[:2], axis=1)
    (west, south), (east, north) = centres.min(axis=0) - ZONES_DEG, centres.max(axis=0) + ZONES_DEG
    box = max(west, -180.0), max(south, -90.0), min(east, 180.0), min(north, 90.0)
    best, most = "", 0
    for code in other_zones(crs, box):
        inside = int(np.count_nonzero(_inside(scenes, code, given)))
        best, most = (code, inside) if inside > most else (best, most)
    return best, most


def exchanged_pixels(image: Index, pixels: Array, size: Array) -> tuple[Mask, Mask]:
    """Find images in which pixels are outside, but all are inside after an exchange of line and sample.

    Parameters
    ----------
    image : (n,) int array
        Image of each pixel.
    pixels : (n, 2) array
        Line and sample; rows of nan are skipped.
    size : (n, 2) array
        Numbers of lines and samples of the image of each pixel; infinite if they are unknown.

    Returns
    -------
    rows, outside : (n,) mask
        Pixels of these images, and those of them that are outside. Both are empty if fewer than three are outside.
    """
    outside = _outside(pixels, size)
    fits = np.isin(image, image[outside]) & ~np.isin(image, image[_outside(pixels[:, ::-1], size)])
    if np.count_nonzero(outside & fits) < LEAST_POINTS:
        return np.zeros_like(fits), np.zeros_like(fits)
    return fits, outside & fits


def _outside(pixels: Array, size: Array) -> Mask:
    """Return a mask (n,) of the pixels outside their images."""
    return np.asarray(((pixels < -0.5) | (pixels > size - 0.5)).any(axis=1))
