"""Surfaces of the second degree: distances and deviations of points, mapping of points, models for a fit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, evaluate
from factors.arrays import Array, Mask
from factors.cameras.frame_camera import CAMERA
from factors.conditions import surfaces
from factors.conditions.surfaces import RECORD
from fg_orient.adjustment.constraint_rows import linear_round
from fg_orient.closerange.fitting import Conditions, as_points, as_sigmas, foot_points
from fg_orient.model.errors import InputError

Kind = Literal["sphere", "spheroid", "ellipsoid", "quadric"]

KINDS: Final[tuple[Kind, ...]] = ("sphere", "spheroid", "ellipsoid", "quadric")
AXES: Final = ("x", "y", "z")
#: Name of an unknown axis of a spheroid.
FREE: Final = "free"
#: Flattening of a start spheroid with unknown axis.
OBLATE: Final = 0.2
_CENTRE: Final = ("x0", "y0", "z0")
_QUADRIC: Final = tuple("ABCDEFGHIJ")


@dataclass(frozen=True)
class Surface:
    """Sphere, spheroid, ellipsoid or other quadric.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    centre : (3,) array
        Centre, m; for a quadric the origin of its coefficients.
    semi_axes : (3,) array
        Semi-axes, m, along the rows of ``rotation``; for a quadric the unit of length of
        its coefficients, three times.
    rotation : (3, 3) array
        Rotates axes of the coordinates to axes of the surface.
    coefficients : (10,) array
        Coefficients A to J of a quadric, as in ``factors.conditions.surfaces``, in ``(p -
        centre)/semi_axes``; otherwise empty.
    """

    kind: Kind
    centre: Array
    semi_axes: Array
    rotation: Array = field(default_factory=lambda: np.eye(3))
    coefficients: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name, shape in (
            ("centre", (3,)),
            ("semi_axes", (3,)),
            ("rotation", (3, 3)),
            ("coefficients", (10,) if self.kind == "quadric" else (0,)),
        ):
            value = np.array(getattr(self, name), float)
            if value.shape != shape or not np.isfinite(value).all() or (name == "semi_axes" and (value <= 0.0).any()):
                raise InputError.of("closerange.surface", place=name, value=value.tolist(), shape=shape)
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def conditions(self) -> Conditions:
        """The surface as a condition on ``p - centre``, in metres."""
        if self.kind == "quadric":
            scale = self.semi_axes
            square, linear, constant = quadric_matrices(self.coefficients)
            return Conditions(square / np.outer(scale, scale), linear / scale, constant)
        return _ellipsoid_conditions(self.rotation, self.semi_axes)

    def foot_points(self, points_m: npt.ArrayLike, sigma_m: npt.ArrayLike = 1.0) -> Array:
        """Return the nearest points (n, 3) of the surface, m, weighted by sigmas; nan if not unique."""
        points = as_points(points_m, 3, "points")
        sigma = as_sigmas(sigma_m, points, "sigma_m")
        return foot_points(self.conditions, points - self.centre, sigma) + self.centre

    def distances(self, points_m: npt.ArrayLike) -> Array:
        """Return the normal distances (n,) of points, m, positive outside (where the condition is positive)."""
        points = as_points(points_m, 3, "points")
        side = np.sign(self.conditions.value(points - self.centre))
        return np.asarray(side * np.linalg.norm(points - self.foot_points(points), axis=1))

    def deviations(self, points_m: npt.ArrayLike) -> Array:
        """Return the residuals (n, 3) along X, Y, Z from points to the surface, m, to first order.

        Condition adjustment of Ayhan 1996, eqs. 155-171, with equal weights and a fixed
        surface: ``v = -g W/|g|^2``, W the condition and g its slope (the minus is missing
        in eq. 169).
        """
        points = as_points(points_m, 3, "points") - self.centre
        slope = self.conditions.slope(points)
        return np.asarray(-slope * (self.conditions.value(points) / np.sum(slope**2, axis=1))[:, None])

    def on_rays(self, directions: npt.ArrayLike) -> Array:
        """Return the intersections (n, 3) of rays from the centre with an ellipsoid, m.

        Raises
        ------
        InputError
            The surface is a general quadric, or a direction is zero.
        """
        ray = as_points(directions, 3, "directions")
        if self.kind == "quadric":
            raise InputError.of("closerange.kind", place="on_rays", value=self.kind, known=", ".join(KINDS[:3]))
        size = np.linalg.norm(ray @ self.rotation.T / self.semi_axes, axis=1)
        if not size.all():
            raise InputError.of("closerange.points", place="directions", value="a zero vector", width=3)
        return np.asarray(ray / size[:, None] + self.centre)

    def as_dict(self) -> dict[str, Any]:
        """Return the content for files."""
        return {
            "kind": self.kind,
            "centre_m": self.centre.tolist(),
            "semi_axes_m": self.semi_axes.tolist(),
            "rotation": self.rotation.tolist(),
            "coefficients": self.coefficients.tolist() or None,
            "shape": shape_of(self.coefficients) if self.kind == "quadric" else self.kind,
        }


def map_points(points_m: npt.ArrayLike, target: Surface, radius_m: npt.ArrayLike | None = None) -> Array:
    """Map points to a spheroid about the y axis with the same azimuth and the same angle from the axis at its centre.

    Parameters
    ----------
    points_m : (n, 3) array
        Points of another surface.
    target : Surface
    radius_m : (n,) array, optional
        Distance from the axis that defines the angle; default: the distance of each point. Ayhan uses
        half the distance between the extreme targets of a ring.

    Returns
    -------
    (n, 3) array

    Notes
    -----
    Ayhan 1996, eqs. 177-185, but with the sign of Y - Y0, which the root in those equations loses.
    """
    away = as_points(points_m, 3, "points") - target.centre
    own = np.hypot(away[:, 0], away[:, 2])
    radius = own if radius_m is None else np.asarray(radius_m, float)
    azimuth = np.arctan2(away[:, 2], away[:, 0])
    return target.on_rays(np.column_stack([radius * np.cos(azimuth), away[:, 1], radius * np.sin(azimuth)]))


def _ellipsoid_conditions(rotation: Array, semi: Array) -> Conditions:
    """Return the conditions of an ellipsoid about its centre."""
    return Conditions(rotation.T @ np.diag(semi**-2.0) @ rotation, np.zeros(3), -1.0)


def quadric_matrices(coefficients: Array) -> tuple[Array, Array, float]:
    """Return S (3, 3), u (3,) and c of ten coefficients."""
    a, b, c, d, e, f, g, h, i, j = coefficients.tolist()
    return np.array([[a, d, e], [d, b, f], [e, f, c]]), np.array([g, h, i]), j


def shape_of(coefficients: Array) -> str:
    """Return the name of a quadric from the signs of its eigenvalues.

    The name is "other" for cones, cylinders and quadrics without points.
    """
    central = Conditions(*quadric_matrices(coefficients)).central()
    if central is None:
        return "other"
    real = int(np.count_nonzero(central[1] > 0.0))
    return {3: "ellipsoid", 2: "hyperboloid of one sheet", 1: "hyperboloid of two sheets"}.get(real, "other")


# --- models of a fit, in normalised coordinates ----------------------------------------------------


@dataclass(frozen=True)
class SurfaceModel:
    """Surface near a start; the state (u,) contains corrections for ellipsoids, values for spheres and quadrics.

    ``names``, ``start`` and ``is_length`` (the others are angles or have no unit)
    describe the unknowns (u,); record (d,) and setup (2, k) belong to the equation.
    """

    kind: Kind
    equation: Equation
    record: Array
    setup: Array
    names: tuple[str, ...]
    start: Array
    is_length: Mask

    def derivatives(self, x: Array, points: Array, *, with_jacobians: bool = True) -> tuple[Array, Array, Array]:
        """Return the value (n,), derivatives with respect to the unknowns (n, u) and to the points (n, 3)."""
        n = len(points)
        value, blocks = evaluate(
            self.equation, np.tile(self.record, (n, 1)), [self.setup] * n, [x] * n, points, jacobian=with_jacobians
        )
        if not with_jacobians:
            return value[:, 0], np.zeros((0, len(x))), np.zeros((0, 3))
        return value[:, 0], np.concatenate(blocks[0]), np.concatenate(blocks[1])

    def moved(self, x: Array, step: Array) -> Array:
        """Return the state after a step; the coefficients of a quadric keep length 1."""
        out = np.asarray(x + step)
        return out / np.linalg.norm(out) if self.kind == "quadric" else out

    def surface(self, x: Array) -> Surface:
        """Return the surface of a state."""
        if self.kind == "quadric":
            return Surface("quadric", np.zeros(3), np.ones(3), coefficients=x)
        centre, rotation, semi = self._ellipsoid(x)
        return Surface(self.kind, centre, np.abs(semi), rotation)

    def _ellipsoid(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the centre, rotation (3, 3) and semi-axes of a state of a sphere, spheroid or ellipsoid."""
        if self.kind == "sphere":
            return x[:3], np.eye(3), np.full(3, x[3])
        centre, turn, semi = surfaces.shape(self.record, self.setup, x)
        return centre, turn[CAMERA.rotation].reshape(3, 3), semi

    def conditions(self, x: Array) -> tuple[Conditions, Array]:
        """Return the conditions of a state and their origin."""
        if self.kind == "quadric":
            return Conditions(*quadric_matrices(x)), np.zeros(3)
        centre, rotation, semi = self._ellipsoid(x)
        return _ellipsoid_conditions(rotation, semi), centre

    def values(self, x: Array) -> Array:
        """Return the values (u,) for users: centre, semi-axes, rotations from the start; or coefficients."""
        if self.kind in ("sphere", "quadric"):
            return x
        semi = self.record[RECORD.semi_axes]
        of_code = np.concatenate([self.record[RECORD.centre], np.zeros(3), semi, np.roll(semi, -1)])
        return np.asarray(x * self.setup[1] + of_code[self.setup[0].astype(int)])

    def settled(self, x: Array) -> tuple[SurfaceModel, Array]:
        """Return a model that starts at a state, and this state: rotations 0, semi-axes positive (ellipsoid sorted)."""
        if self.kind == "quadric":
            return self, x
        if self.kind == "sphere":
            return self, np.append(x[:3], abs(x[3]))
        centre, rotation, semi = self._ellipsoid(x)
        semi = np.abs(semi)
        if self.kind == "ellipsoid":
            order = np.argsort(-semi, kind="stable")
            semi, rotation = semi[order], rotation[order]
            rotation = rotation * np.sign(np.linalg.det(rotation))
        factor = self.record[RECORD.factor]
        record = RECORD.pack(factor=factor, centre=centre, rotation=rotation.ravel(), semi_axes=semi)
        return replace(self, record=record), np.zeros(len(x))


def models_of(kind: Kind, points: Array, axis: str) -> list[SurfaceModel]:
    """Return the models of a kind for all possible start values; normalised points (n, 3), axis of a spheroid.

    Raises
    ------
    InputError
        The kind or axis does not exist.
    """
    plain = np.ones(1), np.zeros((2, 0))
    if kind == "quadric":
        start = _algebraic_quadric(points)
        return [SurfaceModel(kind, surfaces.QUADRIC, *plain, _QUADRIC, start, np.zeros(10, bool))]
    ball = np.append(*linear_round(points))
    if kind == "sphere":
        return [SurfaceModel(kind, surfaces.SPHERE, *plain, (*_CENTRE, "a"), ball, np.ones(4, bool))]
    if kind == "spheroid" and axis in AXES:
        return [_spheroid(AXES.index(axis), ball[:3], np.eye(3), np.full(3, ball[3]), free=False)]
    # rotations have no effect on a sphere, so a start without a quadric is flattened
    oblate = [(ball[:3], np.eye(3), ball[3] * (1.0 - OBLATE * np.eye(3)[k])) for k in range(3)]
    starts = _from_quadric(points)
    if kind == "ellipsoid":
        codes, names = (0, 1, 2, 3, 4, 5, 6, 7, 8), (*_CENTRE, "turn_1", "turn_2", "turn_3", "a", "b", "c")
        return [_ellipsoid("ellipsoid", codes, names, *start) for start in starts or oblate]
    if kind != "spheroid":
        raise InputError.of("closerange.kind", place="kind", value=kind, known="sphere, spheroid, ellipsoid, quadric")
    if axis != FREE:
        raise InputError.of("closerange.axis", place="axis", value=axis)
    out = []
    for centre, turn, semi in starts or oblate:
        apart = [abs(np.log(semi[k] ** 2 / np.prod(np.delete(semi, k)))) for k in range(3)]
        out.append(_spheroid(int(np.argmax(apart)), centre, turn, semi, free=True))
    return out


def _spheroid(k: int, centre: Array, turn: Array, semi: Array, *, free: bool) -> SurfaceModel:
    """Return the spheroid about axis number ``k``.

    A across it, b along it (Ayhan 1996, eq. 142).
    """
    across = float(np.delete(semi, k).mean())
    semi = np.where(np.arange(3) == k, semi[k], across)
    tilts = tuple(j for j in range(3) if j != k) if free else ()
    codes = (9 + k, 6 + k, 0, 1, 2, *(3 + j for j in tilts))
    names = ("a", "b", *_CENTRE, *("tilt_1", "tilt_2")[: len(tilts)])
    return _ellipsoid("spheroid", codes, names, centre, turn, semi)


def _ellipsoid(
    kind: Kind, codes: tuple[int, ...], names: tuple[str, ...], centre: Array, turn: Array, semi: Array
) -> SurfaceModel:
    record = RECORD.pack(factor=1.0, centre=centre, rotation=turn.ravel(), semi_axes=semi)
    setup = np.ascontiguousarray(np.stack([np.array(codes, float), np.ones(len(codes))]))
    is_length = np.array([code not in (3, 4, 5) for code in codes])
    return SurfaceModel(kind, surfaces.ELLIPSOID, record, setup, names, np.zeros(len(codes)), is_length)


def _algebraic_quadric(points: Array) -> Array:
    """Return the coefficients (10,) of length 1 with the smallest sum of squared conditions."""
    x, y, z = points.T
    terms = [x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z, np.ones(len(x))]
    return np.asarray(np.linalg.svd(np.column_stack(terms), full_matrices=True)[2][-1])


def _from_quadric(points: Array) -> list[tuple[Array, Array, Array]]:
    """Return the centre, rotation and semi-axes of the best quadric, if that is an ellipsoid."""
    if len(points) < 10:
        return []
    central = Conditions(*quadric_matrices(_algebraic_quadric(points))).central()
    if central is None or (central[1] <= 0.0).any():
        return []
    centre, squares, axes = central
    turn = axes.T * np.sign(np.linalg.det(axes))
    return [(centre, np.ascontiguousarray(turn), np.sqrt(squares))]
