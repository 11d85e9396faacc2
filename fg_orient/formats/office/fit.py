"""Measure how well a reading of a table fits the images.

A reading is one interpretation of the columns, units and CRS of a table. Its ground
points are projected into the images and compared with the measured pixels. Before the
adjustment, the orientation of an image has errors of metres to tens of metres. They shift
all points of the image by nearly the same number of pixels. The scatter about this shift
shows whether the coordinates were interpreted correctly. The shift itself is used only to
decide between readings that are far apart, or if the images are shown to be accurate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.office.candidates import in_ecef
from fg_orient.formats.office.ground import Triple
from fg_orient.formats.scenes import REACH, Scene
from fg_orient.model.distributions import MAD

#: A reading is rejected if its scatter is larger than this multiple of the scatter of
#: another reading. The second value is the lower limit of that scatter, px.
RATIO: Final = 3.0
LEAST_PX: Final = 0.5
#: Minimum number of points in an image; with fewer points, its scatter is not used.
FEWEST: Final = 5
#: A reading is also rejected if it shifts the images by this distance (m) and by this factor more than another reading.
FAR_M: Final = 40.0
FAR_RATIO: Final = 8.0
#: Images are shown to be accurate if a reading shifts them by less than this, px. A
#: reading that shifts them by more, and by this factor more than the other one, is
#: rejected. Shifts below the last value are noise.
ACCURATE_PX: Final = 2.0
ACCURATE_RATIO: Final = 5.0
NOISE_PX: Final = 0.1
#: Maximum scatter (px) and maximum shift (m) of a plausible reading.
MAX_SCATTER_PX: Final = 20.0
MAX_MOVE_M: Final = 1000.0
#: Two readings are equal if their points differ by less than this in the images, px.
SAME_PX: Final = 0.1


class Evidence(NamedTuple):
    """Agreement of a reading with the images.

    Parameters
    ----------
    scatter_px : float
        Scatter of the differences between projected and measured image points in the worst image.
    move_px, move_m : float
        Largest common shift of the points of an image; nan without image points.
    fewest : int
        Number of points in the image with the fewest points.
    """

    scatter_px: float
    move_px: float
    move_m: float
    fewest: int

    def words(self) -> str:
        """Describe the evidence in words for lists."""
        if np.isnan(self.move_px):
            return ""
        return f"scatter {self.scatter_px:.3g} px, images moved by {self.move_px:.3g} px ({self.move_m:.3g} m)"

    @property
    def believable(self) -> bool:
        """Return whether the reading is plausible."""
        return bool(np.isnan(self.move_px) or (self.scatter_px <= MAX_SCATTER_PX and self.move_m <= MAX_MOVE_M))

    def beats(self, other: Evidence) -> bool:
        """Return whether another reading is clearly worse."""
        if np.isnan(self.move_px):
            return False
        scatter = min(self.fewest, other.fewest) >= FEWEST and other.scatter_px > RATIO * max(self.scatter_px, LEAST_PX)
        far = other.move_m > FAR_M and other.move_px > FAR_RATIO * self.move_px
        accurate = self.move_px <= ACCURATE_PX and other.move_px > ACCURATE_RATIO * max(self.move_px, NOISE_PX)
        return bool(
            self.believable
            and self.scatter_px <= RATIO * max(other.scatter_px, LEAST_PX)
            and (scatter or far or accurate)
        )


NO_EVIDENCE: Final = Evidence(np.nan, np.nan, np.nan, 0)


@dataclass(frozen=True, eq=False)
class Marks:
    """Image points as the tables contain them.

    Parameters
    ----------
    labels : tuple of str
        Names of images in the tables.
    label : (n,) int array
        Position in ``labels`` of each image point.
    ids : n strings
        Ids of the points.
    first, second : (n,) arrays
        Pixel coordinates. ``first`` is the line, unless line and sample are exchanged.
    places : n pairs of str
        File of each image point and its place in the file, for messages.
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
    """One interpretation of the tables.

    Parameters
    ----------
    triple : Triple
        Columns of the three coordinates.
    crs : str
        EPSG code.
    images : tuple of str
        Image of each label.
    exchanged : bool
        Whether line and sample are exchanged.
    evidence : Evidence
    predicted : (n, 2) array
        Places of the points in the images; without image points, on the ground. They are
        used to compare readings.
    same : tuple of str
        Other CRS that give the same places.
    """

    triple: Triple
    crs: str
    images: tuple[str, ...]
    exchanged: bool
    evidence: Evidence
    predicted: Array
    same: tuple[str, ...] = ()


class Fit:
    """Images and image points with which readings are compared.

    Parameters
    ----------
    sensors : mapping of str to Sensor
        Georeferenced images; empty if nothing can be projected.
    marks : Marks
    row : mapping of str to int
        Row of each ground point.
    lift_m : float
        Height to be added to the heights of the table to make them ellipsoidal, m, if the user states
        it.
    """

    def __init__(self, sensors: Mapping[str, Any], marks: Marks, row: Mapping[str, int], lift_m: float = 0.0) -> None:
        self.sensors, self.marks, self.lift_m = sensors, marks, lift_m
        self.used = np.array([k for k, name in enumerate(marks.ids) if name in row], np.intp)
        self.rows = np.array([row[marks.ids[k]] for k in self.used], np.intp)
        self.scenes = [Scene.from_footprint(name, s.footprint(), s.body) for name, s in sensors.items()]
        self.gsd_m = {name: _gsd_m(s) for name, s in sensors.items()}

    def in_ecef(self, crs: str, coordinates: Array) -> Array | None:
        """Transform points (n, 3) to ECEF; nan if a coordinate is missing. None if they are impossible in the CRS."""
        lift = np.array([0.0, 0.0, self.lift_m if "+" not in crs and crs != "EPSG:4978" else 0.0])
        return in_ecef(crs, coordinates + lift, self.sensors)

    def crossing_m(self, images: Sequence[str]) -> float:
        """Return the median distance of two rays to the same point, m; infinite if there are no two rays.

        The argument assigns images to the labels.
        """
        m, first, rays = self.marks, dict[str, int](), list[tuple[Array, Array]]()
        for k, name in enumerate(images):
            own = np.flatnonzero(m.label == k)
            inside = self.sensors[name].is_inside(m.first[own], m.second[own])
            if not inside.all():
                return float("inf")
            rays.append(self.sensors[name].rays(m.first[own], m.second[own]))
        row = {int(k): j for label in range(len(images)) for j, k in enumerate(np.flatnonzero(m.label == label))}
        apart = []
        for k, point in enumerate(m.ids):
            one = first.setdefault(point, k)
            if m.label[one] != m.label[k]:
                (p, u), (q, v) = ((rays[m.label[i]][0][row[i]], rays[m.label[i]][1][row[i]]) for i in (one, k))
                across = np.cross(u, v)
                apart.append(abs(float((q - p) @ across)) / max(float(np.linalg.norm(across)), 1e-12))
        return float(np.median(apart)) if apart else float("inf")

    def near(self, ecef: Array) -> bool:
        """Return whether more than half of the points (n, 3) lie near an image."""
        if not self.scenes or not len(ecef):
            return True
        centres = np.stack([scene.centre_m for scene in self.scenes])
        reach = np.array([REACH * scene.diagonal_m for scene in self.scenes])
        apart = np.linalg.norm(ecef[:, None] - centres[None], axis=2)
        return bool(((apart <= reach).any(axis=1)).mean() > 0.5)

    def predicted(self, ecef: Array) -> dict[str, Array]:
        """Project the points of the image points into every image: pixels (n, 2)."""
        ground = ecef[self.rows]
        return {name: np.stack(s.project(ground), axis=1) for name, s in self.sensors.items()}

    def evidence(self, predicted: Mapping[str, Array], images: Sequence[str], exchanged: bool,
                 first_pixel: float = 0.0) -> tuple[Evidence, Array]:  # fmt: skip
        """Return the evidence for an assignment of images to labels, and the predicted pixels (n, 2)."""
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
            scatter = max(scatter, MAD * float(np.median(np.abs(apart - middle), axis=0).max()))
            here = float(np.linalg.norm(middle))
            move, move_m = max(move, here), max(move_m, here * self.gsd_m[name])
            fewest = min(fewest, int(own.sum()))
        return Evidence(scatter, move, move_m, fewest), where


def _gsd_m(sensor: Any) -> float:
    """Return the size of a pixel on the ground in the middle of the image, m."""
    line, sample = 0.5 * (sensor.first_line + sensor.last_line), 0.5 * (sensor.first_sample + sensor.last_sample)
    step = min(10.0, sensor.last_line - line)
    ends = sensor.locate([line, line + step], [sample, sample], height_m=sensor.mean_height_m)
    return float(np.linalg.norm(ends[1] - ends[0])) / step if step else 1.0
