"""In random configurations each constraint is met and is the limit of weighted constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.bundle_result import BundleResult
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.model.constraint import KINDS, Constraint

from .conftest import SIGMA, Array

#: Of a point from the photos, m, about.
NOISE = 0.002


def _frame(rng: np.random.Generator) -> Array:
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def _round(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    angle = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    return np.cos(angle), np.sin(angle)


def _sphere(rng: np.random.Generator, n: int) -> Array:
    u = rng.normal(size=(n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def _distance(rng: np.random.Generator) -> Array:
    return rng.normal(size=(2, 3))


def _parallel(rng: np.random.Generator) -> Array:
    a, b, d = rng.normal(size=3), 3.0 + rng.normal(size=3), _frame(rng)[0]
    return np.array([a, a + rng.uniform(0.5, 2.0) * d, b, b + rng.uniform(0.5, 2.0) * d])


def _perpendicular(rng: np.random.Generator) -> Array:
    a, b, d = rng.normal(size=3), 3.0 + rng.normal(size=3), _frame(rng)
    return np.array([a, a + rng.uniform(0.5, 2.0) * d[0], b, b + rng.uniform(0.5, 2.0) * d[1]])


def _equal(rng: np.random.Generator) -> Array:
    a, b, size = rng.normal(size=3), 3.0 + rng.normal(size=3), rng.uniform(0.5, 2.0)
    return np.array([a, a + size * _frame(rng)[0], b, b + size * _frame(rng)[0]])


def _plane(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + rng.normal(size=(6, 2)) @ _frame(rng)[:2]


def _line(rng: np.random.Generator) -> Array:
    along = np.arange(5.0) - 2.0 + rng.uniform(-0.3, 0.3, 5)
    return rng.normal(size=3) + along[:, None] * _frame(rng)[0]


def _plumb(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) * [1, 1, 0] + rng.normal(size=(4, 1)) * [0, 0, 1]


def _circle(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + rng.uniform(0.5, 2.0) * np.column_stack(_round(rng, 6)) @ _frame(rng)[:2]


def _horizontal(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + rng.uniform(0.5, 2.0) * np.column_stack([*_round(rng, 6), np.zeros(6)])


def _spheroid(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + _sphere(rng, 14) * [1.0, rng.uniform(0.6, 0.9), 1.0]


SHAPES: dict[str, Callable[[np.random.Generator], Array]] = {
    "distance": _distance, "parallel": _parallel, "perpendicular": _perpendicular, "equal": _equal,
    "plane": _plane, "line": _line, "plumb line": _plumb,
    "circle": _circle, "horizontal circle": _horizontal, "spheroid": _spheroid,
    "sphere": lambda rng: rng.normal(size=3) + rng.uniform(0.5, 2.0) * _sphere(rng, 10),
    "base": _distance, "equal attitude": lambda rng: np.vstack([_frame(rng), _frame(rng)]),
}  # fmt: skip


@pytest.mark.behaviour
def test_every_kind_has_a_shape() -> None:
    assert set(SHAPES) == set(KINDS)


#: Photos around the origin, whose rays meet at right angles.
CENTRES = np.array([[-12.0, -14.0, 1.0], [0.0, -18.0, -2.0], [12.0, -14.0, 2.0]])


def _quadric(points: Array) -> Array:
    """Return the misfits (n,) of a least-squares spheroid about y.

    x^2 + z^2 + a y^2 + b x + c y + d z + e = 0.
    """
    p = points - points.mean(axis=0)
    x, y, z = p.T
    design = np.column_stack([y * y, x, y, z, np.ones(len(p))])
    fit = np.linalg.lstsq(design, -(x * x + z * z), rcond=None)[0]
    return np.asarray(x * x + z * z + design @ fit)


def _round_misfit(points: Array) -> Array:
    """Return the misfits (n,) of a circle or sphere of least squares in the axes of the points, m^2."""
    p = points - points.mean(axis=0)
    squares = np.sum(p**2, axis=1)
    design = np.column_stack([p, np.ones(len(p))])
    return np.asarray(squares - design @ np.linalg.lstsq(design, squares, rcond=None)[0])


def _spread(points: Array, free: int) -> Array:
    """Return the extents of points across their ``free`` main directions, m."""
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[free:]


def _in_plane(points: Array) -> Array:
    p = points - points.mean(axis=0)
    return np.asarray(p @ np.linalg.svd(p)[2][:2].T)


def _lines(points: Array) -> tuple[Array, Array]:
    return points[1] - points[0], points[3] - points[2]


#: Misclosures of points, by numpy; those of photos stand in :func:`misclosure`.
MISCLOSURES: dict[str, Callable[[Array, Array], Array]] = {
    "distance": lambda p, true: np.array([np.linalg.norm(p[1] - p[0]) - np.linalg.norm(true[1] - true[0])]),
    "parallel": lambda p, _: np.cross(*(d / np.linalg.norm(d) for d in _lines(p))),
    "perpendicular": lambda p, _: np.array([np.dot(*(d / np.linalg.norm(d) for d in _lines(p)))]),
    "equal": lambda p, _: np.diff([np.linalg.norm(d) for d in _lines(p)]),
    "plane": lambda p, _: _spread(p, 2), "line": lambda p, _: _spread(p, 1),
    "plumb line": lambda p, _: np.ptp(p[:, :2], axis=0),
    "circle": lambda p, _: np.append(_spread(p, 2), _round_misfit(_in_plane(p))),
    "horizontal circle": lambda p, _: np.append(np.ptp(p[:, 2]), _round_misfit(p[:, :2])),
    "sphere": lambda p, _: _round_misfit(p), "spheroid": lambda p, _: _quadric(p),
}  # fmt: skip


@dataclass(frozen=True)
class Configuration:
    """Photos of the points of a constraint; a constraint of photos has other points."""

    kind: str
    shape: Array
    seed: int

    @property
    def of_photos(self) -> bool:
        return self.kind in ("base", "equal attitude")

    @property
    def rotations(self) -> list[Array]:
        """Return rotations of photos that look to the origin, but for some degrees."""
        turns = Rotation.from_rotvec(np.random.default_rng(self.seed + 1).normal(scale=0.05, size=(3, 3))).as_matrix()
        out = []
        for centre, turn in zip(CENTRES, turns, strict=True):
            ahead = -centre / np.linalg.norm(centre)
            right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
            out.append(turn @ np.array([right, np.cross(ahead, right), ahead]))
        return out

    @property
    def base_m(self) -> float:
        return float(np.linalg.norm(CENTRES[1] - CENTRES[0]))

    @property
    def offset(self) -> Array:
        return np.asarray(self.rotations[1] @ self.rotations[0].T)

    def adjusted(
        self, sigma: float | None, backend: str = "dense", optimizer: str = "levenberg-marquardt"
    ) -> BundleResult:
        """Return the bundle with the constraint. Photos are held; those with a constraint are observed with noise."""
        rng, rotations = np.random.default_rng(self.seed + 2), self.rotations
        points = rng.uniform(-3.0, 3.0, (8, 3)) if self.of_photos else self.shape
        names, photos, interior = [f"p{k}" for k in range(len(points))], ("ph0", "ph1", "ph2"), PhotoInterior(60.0)
        seen = [Photo.of("", interior, r, c).project(points) for r, c in zip(rotations, CENTRES, strict=True)]
        image = np.concatenate(seen) + rng.normal(scale=SIGMA, size=(3 * len(points), 2))
        start = points + rng.normal(scale=NOISE, size=points.shape)
        given = []
        for name, turn, centre in zip(photos, rotations, CENTRES, strict=True):
            if self.of_photos:
                away = Rotation.from_rotvec(rng.normal(scale=1e-4, size=3)).as_matrix()
                sigmas = {"sigma_centre_m": np.full(3, NOISE), "sigma_turn_rad": np.full(3, 1e-4)}
                at = centre + rng.normal(scale=NOISE, size=3)
                given.append(BundlePhoto(name, interior, away @ turn, at, **sigmas))
            else:
                # an adjustment has unknowns of the photos: the principal distance is known to a millionth
                given.append(BundlePhoto(name, interior, turn, centre, ("c",), observed={"c": (60.0, 6e-5)}, held=True))
        size = {"base": self.base_m, "distance": float(np.linalg.norm(self.shape[1] - self.shape[0]))}.get(self.kind)
        offset = self.offset if self.kind == "equal attitude" else np.eye(3)
        one = Constraint(self.kind, photos[:2] if self.of_photos else tuple(names), size, sigma, offset=offset)
        return adjust_bundle(
            given, names, start, np.repeat(range(3), len(points)), np.tile(range(len(points)), 3), image, sigma=SIGMA,
            constraints=[one], backend=backend, optimizer=optimizer,
        )  # fmt: skip

    def misclosure(self, found: BundleResult) -> float:
        """Return the largest misclosure at a solution, m, m^2 or a sine."""
        if self.kind == "base":
            return float(abs(np.linalg.norm(found.centres_m[1] - found.centres_m[0]) - self.base_m))
        if self.kind == "equal attitude":
            return float(np.abs(found.rotations[1] @ found.rotations[0].T - self.offset).max())
        return float(np.abs(MISCLOSURES[self.kind](found.points_m, self.shape)).max())


def configuration(kind: str, seed: int) -> Configuration:
    return Configuration(kind, SHAPES[kind](np.random.default_rng(seed)), seed)


def unknowns(found: BundleResult) -> Array:
    """Return the points and stations as one vector, m and rad."""
    return np.concatenate([found.points_m.ravel(), *(photo.values for photo in found.photos)])


@pytest.mark.oracle
@pytest.mark.parametrize(("runs", "optimizer"), [
    (2, "levenberg-marquardt"),
    *(pytest.param(100, name, marks=pytest.mark.slow) for name in ("levenberg-marquardt", "gauss-newton")),
])  # fmt: skip
@pytest.mark.parametrize("kind", KINDS)
def test_random_configurations(kind: str, runs: int, optimizer: str) -> None:
    """Hard constraints are met within 1e-11, and soft ones approach them with the square of their sigma."""
    for seed in range(0, 2 * runs, 2):
        one = configuration(kind, seed)
        spread = 1e-4 if kind == "equal attitude" else NOISE
        hard, *soft = (one.adjusted(s, optimizer=optimizer) for s in (None, spread * 1e-1, spread * 1e-2))
        assert one.misclosure(hard) <= 1e-11 and one.misclosure(soft[0]) > 1e-10
        away = [float(np.abs(unknowns(s) - unknowns(hard)).max()) for s in soft]
        assert away[0] <= NOISE and away[1] <= 0.1 * away[0] + 5e-8  # the adjustment ends with steps of 1e-8 m
        assert hard.redundancy == soft[0].redundancy


@pytest.mark.consistency
@pytest.mark.parametrize("kind", KINDS)
def test_backends_agree(kind: str) -> None:
    """Dense and graph backend have the same unknowns and sigmas of points, stations and figures."""
    dense, graph = (configuration(kind, 5).adjusted(None, backend) for backend in ("dense", "graph"))
    assert unknowns(dense) == pytest.approx(unknowns(graph), abs=1e-6 * NOISE)
    roots = [
        np.sqrt(np.concatenate([found.cofactors, *(f.cofactors for f in found.figures)])) for found in (dense, graph)
    ]
    assert roots[0] == pytest.approx(roots[1], rel=1e-5, abs=1e-3 * NOISE)
