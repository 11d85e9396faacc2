"""Surfaces of the second degree: distances of points, deviations along the axes, one surface mapped on another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.feet import Conditions, feet
from fg_orient.closerange.fitting import as_points
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]
Kind = Literal["sphere", "spheroid", "ellipsoid", "quadric"]

KINDS: Final[tuple[Kind, ...]] = ("sphere", "spheroid", "ellipsoid", "quadric")


@dataclass(frozen=True)
class Surface:
    """A sphere, spheroid, ellipsoid or other quadric.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    centre : (3,) array
        m; of a quadric the point that its coefficients are about.
    semi_axes : (3,) array
        m, along the rows of ``rotation``; of a quadric the unit of length of its coefficients, three times.
    rotation : (3, 3) array
        Axes of the surface from those of the coordinates.
    coefficients : (10,) array
        Of a quadric: A to J of ``factors.conditions.surfaces`` in ``(p - centre)/semi_axes``; else empty.
    """

    kind: Kind
    centre: Array
    semi_axes: Array
    rotation: Array = field(default_factory=lambda: np.eye(3))
    coefficients: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name, shape in (("centre", (3,)), ("semi_axes", (3,)), ("rotation", (3, 3)),
                            ("coefficients", (10,) if self.kind == "quadric" else (0,))):  # fmt: skip
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
        return Conditions(self.rotation.T @ np.diag(self.semi_axes**-2.0) @ self.rotation, np.zeros(3), -1.0)

    def feet(self, points_m: npt.ArrayLike, sigma_m: npt.ArrayLike = 1.0) -> Array:
        """Nearest points of the surface (n, 3), m, weighted by sigmas; nan where there is none or it is not unique."""
        points = as_points(points_m, 3, "points", InputError.of)
        sigma = np.broadcast_to(np.asarray(sigma_m, float), points.shape)
        return feet(self.conditions, points - self.centre, sigma) + self.centre

    def distances(self, points_m: npt.ArrayLike) -> Array:
        """Normal distances (n,) of points, m, above 0 outside (where the condition is positive)."""
        points = as_points(points_m, 3, "points", InputError.of)
        side = np.sign(self.conditions.value(points - self.centre))
        return np.asarray(side * np.linalg.norm(points - self.feet(points), axis=1))

    def deviations(self, points_m: npt.ArrayLike) -> Array:
        """Residuals (n, 3) along X, Y, Z that lead points to the surface, m, to first order.

        The adjustment of conditions of Ayhan 1996, eqs. 155-171, with equal weights and the surface held:
        ``v = -g W/|g|^2``, W the condition and g its slope (eq. 169 lacks the minus).
        """
        points = as_points(points_m, 3, "points", InputError.of) - self.centre
        slope = self.conditions.slope(points)
        return np.asarray(-slope * (self.conditions.value(points) / np.sum(slope**2, axis=1))[:, None])

    def on_rays(self, directions: npt.ArrayLike) -> Array:
        """Points (n, 3) where rays from the centre meet an ellipsoid, m.

        Raises
        ------
        InputError
            The surface is a general quadric, or a direction is zero.
        """
        ray = as_points(directions, 3, "directions", InputError.of)
        if self.kind == "quadric":
            raise InputError.of("closerange.kind", place="on_rays", value=self.kind, known=", ".join(KINDS[:3]))
        size = np.linalg.norm(ray @ self.rotation.T / self.semi_axes, axis=1)
        if not size.all():
            raise InputError.of("closerange.points", place="directions", value="a zero vector", width=3)
        return np.asarray(ray / size[:, None] + self.centre)

    def as_dict(self) -> dict[str, Any]:
        """Content for files."""
        return {
            "kind": self.kind, "centre_m": self.centre.tolist(), "semi_axes_m": self.semi_axes.tolist(),
            "rotation": self.rotation.tolist(), "coefficients": self.coefficients.tolist() or None,
            "shape": shape_of(self.coefficients) if self.kind == "quadric" else self.kind,
        }  # fmt: skip


def map_points(points_m: npt.ArrayLike, target: Surface, radius_m: npt.ArrayLike | None = None) -> Array:
    """Carry points to a spheroid about the y axis: same azimuth and same angle from the axis, seen from its centre.

    Parameters
    ----------
    points_m : (n, 3) array
        Points of another surface.
    target : Surface
    radius_m : (n,) array, optional
        Distance from the axis that gives the angle; default the points' own. Ayhan takes half the distance between
        the extreme targets of a ring.

    Returns
    -------
    (n, 3) array

    Notes
    -----
    Ayhan 1996, eqs. 177-185, where the root loses the sign of Y - Y0; here it is kept.
    """
    away = as_points(points_m, 3, "points", InputError.of) - target.centre
    own = np.hypot(away[:, 0], away[:, 2])
    radius = own if radius_m is None else np.asarray(radius_m, float)
    azimuth = np.arctan2(away[:, 2], away[:, 0])
    return target.on_rays(np.column_stack([radius * np.cos(azimuth), away[:, 1], radius * np.sin(azimuth)]))


def quadric_matrices(coefficients: Array) -> tuple[Array, Array, float]:
    """S (3, 3), u (3,) and c of ten coefficients."""
    a, b, c, d, e, f, g, h, i, j = coefficients.tolist()
    return np.array([[a, d, e], [d, b, f], [e, f, c]]), np.array([g, h, i]), j


def shape_of(coefficients: Array) -> str:
    """Name of a quadric by the signs of its eigenvalues; "other" for cones, cylinders and what has no points."""
    square, linear, constant = quadric_matrices(coefficients)
    values = np.linalg.eigvalsh(square)
    if np.abs(values).min() <= 1e-9 * np.abs(values).max():
        return "other"
    left = constant - linear @ np.linalg.solve(square, linear)
    if left == 0.0:
        return "other"
    against = int(np.count_nonzero(values * left < 0.0))
    return {3: "ellipsoid", 2: "hyperboloid of one sheet", 1: "hyperboloid of two sheets"}.get(against, "other")
