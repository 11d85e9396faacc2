"""Close-range photo: ideal image coordinates as a projective map of the ground, corrections, rotations.

Image coordinates x (right) and y (up or down) have any unit, the same as the focal length: mm or pixels. All rotations
lead from ground axes to camera axes X right, Y **down**, Z along the view (``sensors.frame``).

Ayhan 1996 multiplies the triple (X, Z, Y): X right, Z up, Y away from the camera. With X right, Y forward, Z up this
triple is left-handed, so its angles have the opposite sense of an aerial omega, phi, kappa.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras.image_corrections import AT, NAMES, ideal_points, slopes
from fg_orient.closerange.fitting import as_points
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.sensors.frame import FrameCamera, opk_of_rotation

YAxis = Literal["up", "down"]

Y_AXES: Final[tuple[YAxis, ...]] = ("up", "down")
#: (X, Z, Y) from (X, Y, Z).
_ORDER: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
#: Camera axes from image axes x right, z up, c along the view.
_DOWN: Final = np.diag([1.0, -1.0, 1.0])
#: Camera axes from photogrammetric ones: X right, Y up, view along -Z.
_BACK: Final = np.diag([1.0, -1.0, -1.0])
_NEWTON: Final = 30
_TOLERANCE: Final = 1e-12


@dataclass(frozen=True)
class PhotoInterior:
    """Interior orientation of a metric or non-metric camera.

    Parameters
    ----------
    focal : float
        Principal distance, in the unit of the image coordinates.
    principal : (2,) array
        x, y of the principal point.
    corrections : (7,) array
        k1 k2 k3 P1 P2 A B from measured to ideal coordinates (``factors.cameras.image_corrections``).
    y_axis : "up" or "down"
        Direction of y in the image.

    Raises
    ------
    InputError
        A value that is not finite, a focal length not above 0, or another axis.
    """

    focal: float
    principal: Array = field(default_factory=lambda: np.zeros(2))
    corrections: Array = field(default_factory=lambda: np.zeros(AT.size))
    y_axis: YAxis = "up"

    def __post_init__(self) -> None:
        for name, size in (("principal", 2), ("corrections", AT.size)):
            value = np.array(getattr(self, name), float)
            if value.shape != (size,) or not np.isfinite(value).all():
                raise InputError.of("closerange.camera", place=name, value=value.tolist(), expected=f"{size} numbers")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not (np.isfinite(self.focal) and self.focal > 0.0):
            raise InputError.of("closerange.camera", place="focal", value=self.focal, expected="a number above 0")
        if self.y_axis not in Y_AXES:
            raise InputError.of("closerange.camera", place="y_axis", value=self.y_axis, expected="up or down")

    @property
    def sign(self) -> float:
        """1 if y points down like the camera's Y, else -1."""
        return 1.0 if self.y_axis == "down" else -1.0

    @property
    def matrix(self) -> Array:
        """Ideal coordinates of directions in camera axes: (3, 3)."""
        x, y = self.principal
        return np.array([[self.focal, 0.0, x], [0.0, self.sign * self.focal, y], [0.0, 0.0, 1.0]])

    def tangents(self, image: Array) -> Array:
        """Tangents of measured points in camera axes.

        Parameters
        ----------
        image : (n, 2) array
            Measured x, y, in the unit of the focal length.

        Returns
        -------
        (n, 2) array
            X/Z, Y/Z.
        """
        reduced = ideal_points(self.corrections, np.ascontiguousarray(image - self.principal))
        return np.asarray(reduced / self.focal * [1.0, self.sign])


@dataclass(frozen=True)
class Photo:
    """An oriented photo.

    Parameters
    ----------
    name : str
    matrix : (3, 4) array
        Homogeneous ideal image coordinates of ``(ground - origin_m, 1)``; its last row gives the depth, above 0.
    origin_m : (3,) array
    principal : (2,) array
        Origin of the corrections.
    corrections : (7,) array
        See :class:`PhotoInterior`.
    """

    name: str
    matrix: Array
    origin_m: Array
    principal: Array
    corrections: Array

    @classmethod
    def of(cls, name: str, interior: PhotoInterior, rotation: npt.ArrayLike, centre_m: npt.ArrayLike) -> Photo:
        """Photo of a camera with rotation and projection centre.

        Raises
        ------
        InputError
            Not a rotation matrix, or values that are not finite.
        """
        camera = FrameCamera(np.asarray(rotation, float), np.asarray(centre_m, float), interior.focal)
        matrix = np.zeros((3, 4))  # about the projection centre: nothing to cancel
        matrix[:, :3] = interior.matrix @ camera.rotation
        return cls(name, matrix, camera.centre_m, interior.principal, interior.corrections)

    def about(self, origin_m: Array) -> Array:
        """Matrix (3, 4) for ground coordinates about another origin."""
        shift = self.matrix[:, :3] @ (origin_m - self.origin_m)
        return np.column_stack([self.matrix[:, :3], self.matrix[:, 3] + shift])

    def ideal(self, image: npt.ArrayLike) -> Array:
        """Ideal coordinates (n, 2) of measured ones."""
        given = as_points(image, 2, "image")
        return np.asarray(ideal_points(self.corrections, given - self.principal) + self.principal)

    def measured(self, ideal: Array) -> Array:
        """Measured coordinates of ideal ones, by Newton.

        Parameters
        ----------
        ideal : (n, 2) array
            x, y, in the unit of the image coordinates.

        Raises
        ------
        NoSolutionError
            The corrections cannot be inverted at a point.
        """
        wanted = ideal - self.principal
        at = wanted.copy()
        for _ in range(_NEWTON):
            xx, xy, yx, yy = slopes(self.corrections, at[:, 0], at[:, 1])
            left = wanted - ideal_points(self.corrections, at)
            det = xx * yy - xy * yx
            with np.errstate(all="ignore"):
                step = np.column_stack([yy * left[:, 0] - xy * left[:, 1], xx * left[:, 1] - yx * left[:, 0]])
                step = step / det[:, None]
            at = at + step
            # beyond the fold of the polynomial two points have the same ideal point
            if not (np.isfinite(at).all() and (det > 0.0).all() and (xx > 0.0).all()):
                break
            if np.abs(step).max(initial=0.0) <= _TOLERANCE * (1.0 + np.abs(at).max(initial=0.0)):
                return np.asarray(at + self.principal)
        raise NoSolutionError.of("closerange.fold", place=self.name)

    def project(self, ground_m: npt.ArrayLike) -> Array:
        """Measured image coordinates of ground points.

        Parameters
        ----------
        ground_m : (n, 3) array

        Returns
        -------
        (n, 2) array
            x, y in their unit; nan behind the camera.
        """
        ground = as_points(ground_m, 3, "ground") - self.origin_m
        q = ground @ self.matrix[:, :3].T + self.matrix[:, 3]
        with np.errstate(all="ignore"):
            ideal = np.where(q[:, 2:] > 0.0, q[:, :2] / q[:, 2:], np.nan)
        out, seen = np.full_like(ideal, np.nan), np.isfinite(ideal).all(axis=1)
        if seen.any():
            out[seen] = self.measured(ideal[seen])
        return out


def corrections_of(names: Sequence[str], values: npt.ArrayLike) -> Array:
    """Coefficients (7,) of named values; the others are 0."""
    out = np.zeros(AT.size)
    out[[NAMES.index(name) for name in names]] = values
    return out


def ayhan_matrix(omega: float, psi: float, kappa: float) -> Array:
    """M = M_kappa M_psi M_omega (3, 3) of Ayhan 1996, eqs. 56-59, on the triple (X, Z, Y); angles in rad."""
    so, co, sp, cp, sk, ck = (f(a) for a in (omega, psi, kappa) for f in (np.sin, np.cos))
    return np.array([
        [cp * ck, so * sp * ck + co * sk, -co * sp * ck + so * sk],
        [-cp * sk, -so * sp * sk + co * ck, co * sp * sk + so * ck],
        [sp, -so * cp, co * cp],
    ])  # fmt: skip


def rotation_from_ayhan(omega: float, psi: float, kappa: float) -> Array:
    """Camera axes from ground axes (3, 3) of the angles of Ayhan 1996, rad."""
    return np.asarray(_DOWN @ ayhan_matrix(omega, psi, kappa) @ _ORDER)


def ayhan_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Angles omega, psi, kappa of Ayhan 1996, rad, of camera axes from ground axes."""
    return aerial_from_rotation(_BACK @ _DOWN @ rotation @ _ORDER)


def rotation_from_aerial(omega: float, phi: float, kappa: float) -> Array:
    """Camera axes from ground axes (3, 3) of aerial angles, rad; camera X right, Y up, view along -Z."""
    return np.asarray(_BACK @ ayhan_matrix(omega, phi, kappa))


def aerial_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Aerial angles omega, phi, kappa, rad: first about X, then the turned Y, then the turned Z."""
    omega, phi, kappa = opk_of_rotation(rotation)[0].tolist()
    return omega, phi, kappa
