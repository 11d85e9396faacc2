"""Fixtures are scenes of the SPOT twin with linear features as the only control."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.rows import image_models
from fg_orient.model.block import Block, Coordinates, GroundPoints, ImagePoints, WithheldCoordinates
from fg_orient.model.names import Role
from fg_orient.sensors.base import OrientedSensor
from fg_orient.sensors.lines import LineFeature, LinePoints, with_lines
from fg_orient.sensors.navigation import enu_axes
from fg_orient.simulate import ZonguldakOptions, zonguldak_block

Array = npt.NDArray[np.float64]

N_CHECK, PER_IMAGE, LENGTH_M = 20, 3, 3000.0


@cache
def twin() -> Block:
    return zonguldak_block(ZonguldakOptions(seed=3))[0]


@dataclass
class OnFeature:
    """Imaged ground point of a feature: its image, place, and directions along and across (columns)."""

    image: int
    place: Array
    frame: Array


@dataclass
class Scene:
    """Block, true check points, true image unknowns in prior sigmas, true points of the features, sigmas px and m."""

    block: Block
    check: Array
    unknowns: list[Array]
    on_features: list[OnFeature]
    noise_px: float
    across_m: float

    def project(self, image: int, unknowns: Array, ground: Array) -> Array:
        """Return the line and sample (n, 2) of ground points."""
        return projected(self.block, image, unknowns, ground)

    def bound(self) -> Array:
        """Return the covariance (60, 60) of the check points by the information of all observations at the truth."""
        sizes = [len(x) for x in self.unknowns]
        u, n = sum(sizes), 3 * len(self.check)
        information = np.zeros((u + n, u + n))
        if self.block.options.priors:
            information[:u, :u] = np.eye(u)
        for k, x in enumerate(self.unknowns):
            own = slice(sum(sizes[:k]), sum(sizes[: k + 1]))
            mine = [one for one in self.on_features if one.image == k]
            for on_feature, places in ((False, self.check), (True, np.array([one.place for one in mine]))):
                by_image = self._differences(lambda d, x=x, p=places, k=k: self.project(k, x + d, p), len(x), 1e-3)
                by_ground = self._differences(lambda d, x=x, p=places, k=k: self.project(k, x, p + d), 3, 1.0)
                for j, (a, b) in enumerate(zip(by_image / self.noise_px, by_ground / self.noise_px, strict=True)):
                    if on_feature:
                        # free along the feature, known across it
                        moved = b @ mine[j].frame * [1.0, self.across_m, self.across_m]
                        known = moved.T @ moved + np.diag([0.0, 1.0, 1.0])
                        weight = np.eye(2) - moved @ np.linalg.solve(known, moved.T)
                        information[own, own] += a.T @ weight @ a
                    else:
                        at = slice(u + 3 * j, u + 3 * j + 3)
                        information[own, own] += a.T @ a
                        information[at, at] += b.T @ b
                        information[own, at] += a.T @ b
                        information[at, own] += b.T @ a
        return np.asarray(np.linalg.inv(information)[u:, u:])

    @staticmethod
    def _differences(function, size: int, step: float) -> Array:
        """Return the derivatives (n, 2, size) by central differences."""
        columns = [(function(step * e) - function(-step * e)) / (2.0 * step) for e in np.eye(size)]
        return np.stack(columns, axis=2)


def projected(block: Block, image: int, unknowns: Array, ground: Array) -> Array:
    model = image_models(block.images, block.options)[image]
    return np.stack(OrientedSensor(block.images[image].sensor, model.correction(unknowns)).project(ground), axis=1)


def scene(
    seed: int, *, n_features: int = 10, direction: Array | None = None, kind: str = "line", noise_px: float = 0.5,
    across_m: float = 0.3, **options: object,
) -> Scene:  # fmt: skip
    """Return a block of features without control points.

    ``direction`` is East, North, Up of all of them; without it each has its own.
    """
    rng, block = np.random.default_rng(seed), replace(twin(), options=replace(twin().options, **options))
    unknowns = [rng.normal(size=len(m.parameters)) for m in image_models(block.images, block.options)]
    known = block.points.known.ecef_m
    known = known[np.isfinite(known).all(axis=1)]
    check, axes = known[:N_CHECK], enu_axes(known.mean(axis=0))
    features, truth, rows = [], [], []
    for k in range(n_features):
        along = (rng.normal(size=3) * [1.0, 1.0, 0.2] if direction is None else direction) @ axes
        along = along / np.linalg.norm(along)
        start = known[rng.integers(N_CHECK, len(known))] - 0.5 * LENGTH_M * along
        first = np.cross(along, axes[2]) / np.linalg.norm(np.cross(along, axes[2]))
        second = np.cross(first, along)
        places = np.array([0.0, 1.0]) if kind == "line" else np.linspace(0.0, 1.0, 6)
        bent = np.zeros(len(places)) if kind == "line" else 300.0 * np.sin(4.0 * places)
        vertices = start + LENGTH_M * places[:, None] * along + bent[:, None] * first
        feature = LineFeature(f"L{k}", kind, vertices, np.array([across_m or 0.1] * 2))
        features.append(feature)
        for image in range(2):
            for t in rng.uniform(0.0, 1.0, PER_IMAGE):
                error = across_m * (rng.normal() * first + rng.normal() * second)
                place = start + t * LENGTH_M * along if kind == "line" else of_spline(feature, t)
                truth.append(OnFeature(image, place + error, np.column_stack([along, first, second])))
                pixel = projected(block, image, unknowns[image], truth[-1].place[None])[0]
                rows.append((feature.id, block.images[image].id, *(pixel + noise_px * rng.normal(size=2))))
    sigma = np.full((len(rows), 2), noise_px or 0.1)
    names, images, line, sample = (tuple(column) for column in zip(*rows, strict=True))
    measured = LinePoints(names, images, np.array(line), np.array(sample), sigma)
    pixels = np.vstack([projected(block, k, x, check) for k, x in enumerate(unknowns)])
    pixels = pixels + noise_px * rng.normal(size=pixels.shape)
    n, ids = len(check), tuple(f"c{k}" for k in range(len(check)))
    none = Coordinates(np.full((n, 3), np.nan), np.full((n, 3), np.nan), np.zeros(n, bool))
    sealed = WithheldCoordinates(ids, lambda: Coordinates(check, np.full((n, 3), 0.01), np.zeros(n, bool)))
    one = np.full(2 * n, noise_px or 0.1)
    observed = ImagePoints(np.repeat([0, 1], n), np.tile(np.arange(n), 2), *pixels.T, one, one)
    bare = replace(block, points=GroundPoints(ids, (Role.CHECK,) * n, none), observations=observed, withheld=sealed)
    return Scene(with_lines(bare, features, measured), check, unknowns, truth, noise_px, across_m)


def of_spline(feature: LineFeature, share: float | Array) -> Array:
    """Return the places at shares of the chord length, by scipy in the original coordinates."""
    from scipy.interpolate import CubicSpline

    chords = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(feature.vertices_m, axis=0), axis=1)))
    return np.asarray(CubicSpline(chords, feature.vertices_m, bc_type="natural")(share * chords[-1]))
