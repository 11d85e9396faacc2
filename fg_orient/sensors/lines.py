"""Control by linear features: image points on straight lines and splines with known ground coordinates.

Each image point on a feature gets its own ground point. This ground point can move freely
along the feature. Two observations keep it on the feature
(``factors.conditions.curves``). Therefore an image point contributes one condition,
across the feature. Backends and tests treat it like any other observation.

The errors of the points of one feature are assumed to be independent. A common shift of a
feature is not modelled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from factors.arrays import Array
from factors.conditions.curves import CURVE_CONTROL, RECORD, curve
from fg_orient.model.block import Block, Coordinates, ExtraObservation, GroundPoints, ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.sensors.initial import local_origin
from fg_orient.sensors.navigation import enu_axes

__all__ = ["LineFeature", "LinePoints", "with_lines"]

Kind = Literal["line", "spline"]

#: Minimum number of vertices of a spline.
LEAST_SPLINE: Final = 3
#: A feature is steep if the sine of the angle between one of its tangents and the
#: vertical is smaller than this. Other features have one horizontal and one upward
#: normal.
STEEP: Final = 0.2
#: Number of places of a segment that are compared with a ray; number of repetitions in a
#: shorter interval about the nearest place.
_PLACES: Final = 33
_ROUNDS: Final = 4


@dataclass(frozen=True, eq=False)
class LineFeature:
    """Linear feature with known ground coordinates.

    Parameters
    ----------
    id : str
    kind : str
        "line": straight line through two vertices. "spline": natural cubic spline through all vertices.
    vertices_m : (n, 3) array
        Coordinates in ECEF or in the local system of the images, m.
    sigma_m : (2,) array
        Standard deviations of a point of the feature, across the feature: horizontal and
        upwards, m. For a steep feature, both apply to any direction across it and must be
        equal.

    Raises
    ------
    InputError
        There are too few vertices, two successive vertices are equal, or a standard deviation is not above 0.
    """

    id: str
    kind: Kind
    vertices_m: Array
    sigma_m: Array

    def __post_init__(self) -> None:
        n = len(self.vertices_m)
        if (self.kind == "line" and n != 2) or (self.kind == "spline" and n < LEAST_SPLINE):
            raise InputError.of("lines.vertices", place=f"feature {self.id}", value=n)
        if not (np.linalg.norm(np.diff(self.vertices_m, axis=0), axis=1) > 0.0).all():
            raise InputError.of("lines.equal_vertices", place=f"feature {self.id}", value="0 m apart")
        if not (np.asarray(self.sigma_m) > 0.0).all():
            raise InputError.of("lines.sigma", place=f"feature {self.id}", value=min(self.sigma_m))

    def segments(self, origin_m: Array) -> Array:
        """Return the coefficients (K, 12) of the segments for :data:`CURVE_CONTROL`, relative to an origin."""
        vertices = self.vertices_m - origin_m
        if self.kind == "line":
            return np.concatenate([vertices[0], vertices[1] - vertices[0], np.zeros(6)])[None]
        from scipy.interpolate import CubicSpline

        chords = np.linalg.norm(np.diff(vertices, axis=0), axis=1)
        spline = CubicSpline(np.concatenate([[0.0], np.cumsum(chords)]), vertices, bc_type="natural")
        # in scipy, c[0] is the coefficient of the cube of the length; here, t runs from 0 to 1 in each segment
        scaled = spline.c[::-1] * chords[None, :, None] ** np.arange(4)[:, None, None]
        return np.ascontiguousarray(np.moveaxis(scaled, 0, 1).reshape(len(chords), 12))


@dataclass(frozen=True, eq=False)
class LinePoints:
    """Image points that lie on features.

    Parameters
    ----------
    features, images : tuples of str
        Feature and image of each image point.
    line, sample : (n,) arrays
        Pixels; (0, 0) is the centre of the first pixel.
    sigma_px : (n, 2) array
        Standard deviations of line and sample.
    """

    features: tuple[str, ...]
    images: tuple[str, ...]
    line: Array
    sample: Array
    sigma_px: Array


def with_lines(block: Block, features: Sequence[LineFeature], measured: LinePoints) -> Block:
    """Add image points on features to a block.

    Parameters
    ----------
    block : Block
    features : sequence of LineFeature
    measured : LinePoints

    Returns
    -------
    Block
        Block with a further ground point ``FEATURE/k`` for each image point.

    Raises
    ------
    InputError
        A row names an unknown feature or image, or a steep feature has unequal standard deviations.
    """
    known, origin = {feature.id: feature for feature in features}, local_origin(block.images)
    numbers = {image.id: k for k, image in enumerate(block.images)}
    for names, held, code in ((measured.features, known, "lines.feature"), (measured.images, numbers, "lines.image")):
        missing = [name for name in names if name not in held]
        if missing:
            raise InputError.of(code, place="image points on features", value=missing[0], known=", ".join(held))
    setups = {feature.id: feature.segments(origin) for feature in features}
    axes = {feature.id: _axis(feature, setups[feature.id], block.georeferenced) for feature in features}
    ids, starts, extra, count = list[str](), list[Array](), list[ExtraObservation](), dict[str, int]()
    for row, (name, image) in enumerate(zip(measured.features, measured.images, strict=True)):
        count[name] = count.get(name, 0) + 1
        ids.append(f"{name}/{count[name]}")
        centre, direction = block.images[numbers[image]].sensor.rays(measured.line[row : row + 1],
                                                                     measured.sample[row : row + 1])  # fmt: skip
        starts.append(origin + _nearest_to_ray(setups[name], centre[0] - origin, direction[0]))
        record = RECORD.pack(axis=axes[name], sigma=known[name].sigma_m)
        extra.append(ExtraObservation(CURVE_CONTROL, (f"point:{ids[-1]}",), record, setups[name], 2,
                                      f"{known[name].kind} {name}, point {ids[-1]}"))  # fmt: skip
    return _joined(block, ids, np.reshape(starts, (-1, 3)), [numbers[image] for image in measured.images], measured,
                   extra)  # fmt: skip


def _axis(feature: LineFeature, setup: Array, georeferenced: bool) -> Array:
    """Return the reference direction of the normals: up, or for a steep feature a direction far from its tangents."""
    t = np.linspace(0.0, 1.0, 9)
    tangents = np.array([curve(segment, one)[1] for segment in setup for one in t])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    up = enu_axes(feature.vertices_m.mean(axis=0))[2] if georeferenced else np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(tangents, up), axis=1).min() >= STEEP:
        return up
    if feature.sigma_m[0] != feature.sigma_m[1]:
        raise InputError.of("lines.steep", place=f"feature {feature.id}", value=tuple(feature.sigma_m))
    return np.asarray(np.linalg.svd(tangents)[2][2])


def _nearest_to_ray(setup: Array, centre: Array, direction: Array) -> Array:
    """Return the point (3,) of a curve that is nearest to a ray.

    The point is found by sampling with finer and finer steps.
    """

    def distances(k: int, t: Array) -> tuple[Array, Array]:
        places = np.array([curve(setup[k], one)[0] for one in t])
        return places, np.linalg.norm(np.cross(places - centre, direction), axis=1)

    ends = [distances(k, np.linspace(0.0, 1.0, _PLACES)) for k in range(len(setup))]
    k = int(np.argmin([far.min() for _, far in ends]))
    middle, half = float(np.argmin(ends[k][1])) / (_PLACES - 1), 1.0 / (_PLACES - 1)
    for _ in range(_ROUNDS):
        t = middle + half * np.linspace(-1.0, 1.0, _PLACES)
        places, far = distances(k, t)
        best = int(far.argmin())
        middle, half = float(t[best]), 2.0 * half / (_PLACES - 1)
    return np.asarray(places[best])


def _joined(
    block: Block, ids: list[str], starts: Array, images: list[int], measured: LinePoints, extra: list[ExtraObservation]
) -> Block:
    """Return the block with further points, image points and observations."""
    taken = sorted(set(ids) & set(block.points.ids))
    if taken:
        raise InputError.of("lines.taken", place="feature", value=taken[0])
    n, points, o, known = len(block.points.ids), block.points, block.observations, block.points.known
    joined = GroundPoints(
        (*points.ids, *ids), (*points.roles, *[Role.TIE] * len(ids)),
        Coordinates(np.vstack([known.ecef_m, starts]), np.vstack([known.sigma_enu_m, np.full_like(starts, np.nan)]),
                    np.append(known.fixed, np.zeros(len(ids), bool))),
    )  # fmt: skip
    rows = ImagePoints(
        np.append(o.image, images), np.append(o.point, n + np.arange(len(ids))), np.append(o.line, measured.line),
        np.append(o.sample, measured.sample), np.append(o.sigma_line_px, measured.sigma_px[:, 0]),
        np.append(o.sigma_sample_px, measured.sigma_px[:, 1]),
    )  # fmt: skip
    return replace(block, points=joined, observations=rows, extra=(*block.extra, *extra))


def on_features(extra: Sequence[ExtraObservation]) -> dict[str, tuple[str, Array]]:
    """Return, for each ground point on a feature, the feature and its chord (3,), by the id of the point."""
    found = {}
    for one in extra:
        if getattr(one, "equation", None) is CURVE_CONTROL:
            point, setup = one.unknowns[0].partition(":")[2], one.setup
            assert setup is not None
            chord = curve(setup[-1], 1.0)[0] - curve(setup[0], 0.0)[0]
            found[point] = point.rpartition("/")[0], chord
    return found
