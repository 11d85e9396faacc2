"""Surfaces as models of an adjustment: unknowns, start values, conditions, in normalised coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, evaluate
from factors.cameras.frame_camera import CAMERA
from factors.conditions import surfaces
from factors.conditions.surfaces import RECORD
from fg_orient.closerange.feet import Conditions
from fg_orient.closerange.surface import Kind, Surface, quadric_matrices
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

AXES: Final = ("x", "y", "z")
#: Axis of a spheroid that is an unknown.
FREE: Final = "free"
#: Flattening of a start spheroid whose axis is unknown.
OBLATE: Final = 0.2
_CENTRE: Final = ("x0", "y0", "z0")
_QUADRIC: Final = tuple("ABCDEFGHIJ")


@dataclass(frozen=True)
class Model:
    """A surface near a start: state (u,) are corrections for ellipsoids, values for spheres and quadrics.

    Parameters
    ----------
    kind : str
    equation : Equation
    record : (d,) array
    setup : (2, k) array
    names : tuple of str
        Of the unknowns.
    start : (u,) array
    is_length : (u,) bool array
        Whether an unknown is a length (the others are angles or have no unit).
    """

    kind: Kind
    equation: Equation
    record: Array
    setup: Array
    names: tuple[str, ...]
    start: Array
    is_length: npt.NDArray[np.bool_]

    def derivatives(self, x: Array, points: Array, *, want: bool = True) -> tuple[Array, Array, Array]:
        """Value (n,), derivatives with respect to the unknowns (n, u) and to the points (n, 3)."""
        n = len(points)
        value, blocks = evaluate(
            self.equation, np.tile(self.record, (n, 1)), [self.setup] * n, [x] * n, points, jacobian=want
        )
        if not want:
            return value[:, 0], np.zeros((0, len(x))), np.zeros((0, 3))
        return value[:, 0], np.concatenate(blocks[0]), np.concatenate(blocks[1])

    def moved(self, x: Array, step: Array) -> Array:
        """State after a step; the coefficients of a quadric keep length 1."""
        out = np.asarray(x + step)
        return out / np.linalg.norm(out) if self.kind == "quadric" else out

    def surface(self, x: Array) -> Surface:
        """Surface of a state."""
        if self.kind == "quadric":
            return Surface("quadric", np.zeros(3), np.ones(3), coefficients=x)
        if self.kind == "sphere":
            return Surface("sphere", x[:3], np.full(3, abs(x[3])))
        centre, turn, semi = surfaces.shape(self.record, self.setup, x)
        return Surface(self.kind, centre, np.abs(semi), turn[CAMERA.rotation].reshape(3, 3))

    def conditions(self, x: Array) -> tuple[Conditions, Array]:
        """Conditions of a state and the point they are about."""
        if self.kind == "quadric":
            return Conditions(*quadric_matrices(x)), np.zeros(3)
        if self.kind == "sphere":
            return Conditions(np.eye(3), np.zeros(3), -float(x[3] ** 2)), x[:3]
        centre, turn, semi = surfaces.shape(self.record, self.setup, x)
        rotation = turn[CAMERA.rotation].reshape(3, 3)
        return Conditions(rotation.T @ np.diag(semi**-2.0) @ rotation, np.zeros(3), -1.0), centre

    def values(self, x: Array) -> Array:
        """Unknowns as a user knows them (u,): centre, semi-axes; turns from the start; coefficients."""
        if self.kind in ("sphere", "quadric"):
            return x
        return np.asarray(x * self.setup[1] + _start_values(self.record, self.setup))

    def settled(self, x: Array) -> tuple[Model, Array]:
        """Model that starts at a state, and the state there: turns 0, semi-axes above 0, of an ellipsoid sorted."""
        if self.kind == "quadric":
            return self, x
        if self.kind == "sphere":
            return self, np.append(x[:3], abs(x[3]))
        centre, turn, semi = surfaces.shape(self.record, self.setup, x)
        semi, rotation = np.abs(semi), turn[CAMERA.rotation].reshape(3, 3)
        if self.kind == "ellipsoid":
            order = np.argsort(-semi, kind="stable")
            semi, rotation = semi[order], rotation[order]
            rotation = rotation * np.sign(np.linalg.det(rotation))
        factor = self.record[RECORD.factor]
        record = RECORD.pack(factor=factor, centre=centre, rotation=rotation.ravel(), semi_axes=semi)
        return replace(self, record=record), np.zeros(len(x))


def _start_values(record: Array, setup: Array) -> Array:
    """What the record holds of each unknown of an ellipsoid."""
    semi = record[RECORD.semi_axes]
    of_code = np.concatenate([record[RECORD.centre], np.zeros(3), semi, np.roll(semi, -1)])
    return np.asarray(of_code[setup[0].astype(int)])


def models_of(kind: Kind, points: Array, axis: str) -> list[Model]:
    """Models of a kind near all start values worth trying.

    Parameters
    ----------
    kind : str
    points : (n, 3) array
        Normalised.
    axis : str
        Of a spheroid: "x", "y", "z" or "free".

    Raises
    ------
    InputError
        No such kind or axis.
    """
    if kind == "quadric":
        return [_quadric(points)]
    ball = start_sphere(points)
    if kind == "sphere":
        return [Model("sphere", surfaces.SPHERE, np.ones(1), np.zeros((2, 0)), (*_CENTRE, "a"), ball, np.ones(4, bool))]
    if kind == "spheroid" and axis in AXES:
        return [_spheroid(AXES.index(axis), ball[:3], np.eye(3), np.full(3, ball[3]), free=False)]
    # a ball does not see turns: where no quadric helps, oblate ones
    oblate = [(ball[:3], np.eye(3), ball[3] * (1.0 - OBLATE * np.eye(3)[k])) for k in range(3)]
    starts = _from_quadric(points)
    if kind == "ellipsoid":
        codes, names = (0, 1, 2, 3, 4, 5, 6, 7, 8), (*_CENTRE, "turn_1", "turn_2", "turn_3", "a", "b", "c")
        return [_ellipsoid("ellipsoid", codes, names, *start) for start in starts or oblate]
    if kind != "spheroid":
        raise InputError.of("closerange.kind", place="kind", value=kind, known="sphere, spheroid, ellipsoid, quadric")
    if axis != FREE:
        raise InputError.of("closerange.axis", place="axis", value=axis)
    return [_spheroid(_odd_one(semi), centre, turn, semi, free=True) for centre, turn, semi in starts or oblate]


def _odd_one(semi: Array) -> int:
    """Semi-axis that the other two resemble least."""
    return int(np.argmax([abs(np.log(semi[k] ** 2 / np.prod(np.delete(semi, k)))) for k in range(3)]))


def _spheroid(k: int, centre: Array, turn: Array, semi: Array, *, free: bool) -> Model:
    """Spheroid about axis number ``k``; a across it, b along it (Ayhan 1996, eq. 142)."""
    across = float(np.delete(semi, k).mean())
    semi = np.where(np.arange(3) == k, semi[k], across)
    tilts = tuple(j for j in range(3) if j != k) if free else ()
    codes = (9 + k, 6 + k, 0, 1, 2, *(3 + j for j in tilts))
    names = ("a", "b", *_CENTRE, *("tilt_1", "tilt_2")[: len(tilts)])
    return _ellipsoid("spheroid", codes, names, centre, turn, semi)


def _ellipsoid(
    kind: Kind, codes: tuple[int, ...], names: tuple[str, ...], centre: Array, turn: Array, semi: Array
) -> Model:
    record = RECORD.pack(factor=1.0, centre=centre, rotation=turn.ravel(), semi_axes=semi)
    setup = np.ascontiguousarray(np.stack([np.array(codes, float), np.ones(len(codes))]))
    is_length = np.array([code not in (3, 4, 5) for code in codes])
    return Model(kind, surfaces.ELLIPSOID, record, setup, names, np.zeros(len(codes)), is_length)


def start_sphere(points: Array) -> Array:
    """Centre and radius (4,) of the linear fit of Ayhan 1996, eqs. 138-141."""
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    found = np.linalg.lstsq(design, np.sum(points**2, axis=1), rcond=None)[0]
    square = float(found[3] + found[:3] @ found[:3])
    return np.append(found[:3], np.sqrt(square) if square > 0.0 else 1.0)


def _algebraic_quadric(points: Array) -> Array:
    """Coefficients (10,) of length 1 with the least sum of squared conditions."""
    x, y, z = points.T
    terms = [x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z, np.ones(len(x))]
    return np.asarray(np.linalg.svd(np.column_stack(terms), full_matrices=True)[2][-1])


def _quadric(points: Array) -> Model:
    start = _algebraic_quadric(points)
    return Model("quadric", surfaces.QUADRIC, np.ones(1), np.zeros((2, 0)), _QUADRIC, start, np.zeros(10, bool))


def _from_quadric(points: Array) -> list[tuple[Array, Array, Array]]:
    """Centre, rotation and semi-axes of the best quadric, if that is an ellipsoid."""
    if len(points) < 10:
        return []
    square, linear, constant = quadric_matrices(_algebraic_quadric(points))
    values, axes = np.linalg.eigh(square)
    if np.abs(values).min() <= 1e-9 * np.abs(values).max():
        return []
    centre = -np.linalg.solve(square, linear)
    size = -(constant + linear @ centre) / values
    if (size <= 0.0).any():
        return []
    turn = axes.T * np.sign(np.linalg.det(axes))
    return [(np.asarray(centre), np.ascontiguousarray(turn), np.asarray(np.sqrt(size)))]
