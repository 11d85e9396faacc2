"""Close-range photo: projective map from ground to ideal image coordinates, corrections, rotations.

Image coordinates x (right) and y (up or down) have any unit, the same as the focal
length: mm or pixels. All rotations transform ground axes to camera axes X right, Y **down**, Z along
the view (``sensors.frame``).

Ayhan 1996 multiplies the triple (X, Z, Y): X right, Z up, Y away from the camera. With X
right, Y forward, Z up this triple is left-handed, so its angles have the opposite sense
of an aerial omega, phi, kappa.

Sets of camera parameters have names; the correction along the radius is computed from the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras import additional_parameters as brown
from factors.cameras import frame_corrections
from factors.cameras import image_corrections as lens
from factors.cameras import image_variants as variants
from factors.records import Record
from fg_orient.closerange.fitting import as_points
from fg_orient.formats.toml import entries
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.sensors.frame import FrameCamera, opk_of_rotation

YAxis = Literal["up", "down"]

Y_AXES: Final[tuple[YAxis, ...]] = ("up", "down")
#: Matrix that exchanges Y and Z: (X, Z, Y) from (X, Y, Z).
_ORDER: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
#: Camera axes from image axes x right, z up, c along the view.
_DOWN: Final = np.diag([1.0, -1.0, 1.0])
#: Camera axes from photogrammetric axes: X right, Y up, view along -Z.
_BACK: Final = np.diag([1.0, -1.0, -1.0])


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
    corrections: Array = field(default_factory=lambda: np.zeros(lens.AT.size))
    y_axis: YAxis = "up"

    def __post_init__(self) -> None:
        for name, size in (("principal", 2), ("corrections", lens.AT.size)):
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
        """Matrix (3, 3) that gives the ideal image coordinates of a direction in camera axes."""
        x, y = self.principal
        return np.array([[self.focal, 0.0, x], [0.0, self.sign * self.focal, y], [0.0, 0.0, 1.0]])

    def tangents(self, image: Array) -> Array:
        """Return the tangents of measured points in camera axes.

        Parameters
        ----------
        image : (n, 2) array
            Measured x, y, in the unit of the focal length.

        Returns
        -------
        (n, 2) array
            X/Z, Y/Z.
        """
        reduced = lens.ideal_points(self.corrections, np.ascontiguousarray(image - self.principal))
        return np.asarray(reduced / self.focal * [1.0, self.sign])


@dataclass(frozen=True)
class Photo:
    """Oriented photo.

    Parameters
    ----------
    name : str
    matrix : (3, 4) array
        Matrix from ``(ground - origin_m, 1)`` to homogeneous ideal image coordinates; its
        last row gives the depth, above 0.
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
        """Return the photo of a camera with rotation and projection centre.

        Raises
        ------
        InputError
            Not a rotation matrix, or values that are not finite.
        """
        camera = FrameCamera(np.asarray(rotation, float), np.asarray(centre_m, float), interior.focal)
        matrix = np.zeros((3, 4))  # relative to the projection centre, no digits are lost by cancellation
        matrix[:, :3] = interior.matrix @ camera.rotation
        return cls(name, matrix, camera.centre_m, interior.principal, interior.corrections)

    def about(self, origin_m: Array) -> Array:
        """Return the matrix (3, 4) for ground coordinates relative to another origin."""
        shift = self.matrix[:, :3] @ (origin_m - self.origin_m)
        return np.column_stack([self.matrix[:, :3], self.matrix[:, 3] + shift])

    def ideal(self, image: npt.ArrayLike) -> Array:
        """Convert measured to ideal coordinates (n, 2)."""
        given = as_points(image, 2, "image")
        return np.asarray(lens.ideal_points(self.corrections, given - self.principal) + self.principal)

    def measured(self, ideal: Array) -> Array:
        """Convert ideal to measured coordinates.

        Parameters
        ----------
        ideal : (n, 2) array
            x, y, in the unit of the image coordinates.

        Raises
        ------
        NoSolutionError
            The corrections cannot be inverted at a point.
        """
        own = lens_of(self.corrections)
        at = np.array([frame_corrections.undistorted(own, x, y) for x, y in (ideal - self.principal).tolist()])
        if not np.isfinite(at).all():  # here the polynomial is not unique: two points have the same ideal point
            raise NoSolutionError.of("closerange.fold", place=self.name)
        return np.asarray(at + self.principal)

    def project(self, ground_m: npt.ArrayLike) -> Array:
        """Return the measured image coordinates of ground points.

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
    """Return the coefficients (7,) of named values; the others are 0."""
    out = np.zeros(lens.AT.size)
    out[[lens.NAMES.index(name) for name in names]] = values
    return out


def ayhan_matrix(omega: float, psi: float, kappa: float) -> Array:
    """Return M = M_kappa M_psi M_omega (3, 3) of Ayhan 1996, eqs. 56-59, on the triple (X, Z, Y).

    Angles in rad.
    """
    so, co, sp, cp, sk, ck = (f(a) for a in (omega, psi, kappa) for f in (np.sin, np.cos))
    return np.array([
        [cp * ck, so * sp * ck + co * sk, -co * sp * ck + so * sk],
        [-cp * sk, -so * sp * sk + co * ck, co * sp * sk + so * ck],
        [sp, -so * cp, co * cp],
    ])  # fmt: skip


def rotation_from_ayhan(omega: float, psi: float, kappa: float) -> Array:
    """Return the rotation (3, 3) from ground to camera axes for the angles of Ayhan 1996, rad."""
    return np.asarray(_DOWN @ ayhan_matrix(omega, psi, kappa) @ _ORDER)


def ayhan_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Return the angles omega, psi, kappa of Ayhan 1996, rad, for a rotation from ground to camera axes."""
    return aerial_from_rotation(_BACK @ _DOWN @ rotation @ _ORDER)


def rotation_from_aerial(omega: float, phi: float, kappa: float) -> Array:
    """Return the rotation (3, 3) from ground to camera axes for aerial angles, rad.

    Camera X right, Y up, view along -Z.
    """
    return np.asarray(_BACK @ ayhan_matrix(omega, phi, kappa))


def aerial_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Return the aerial angles omega, phi, kappa, rad: rotations about X, then the rotated Y, then the rotated Z."""
    omega, phi, kappa = opk_of_rotation(rotation)[0].tolist()
    return omega, phi, kappa


# --- corrections ------------------------------------------------------------------------------------

#: Camera parameters: principal distance, principal point, coefficients of the three modules.
CAMERA: Final = Record(c=1, principal="x0 y0", lens=lens.AT.size, brown=brown.AT.size, variants=variants.AT.size)
NAMES: Final = ("c", "x0", "y0", *lens.NAMES, *brown.NAMES, *variants.NAMES)
#: Number of radii and directions at which corrections are computed.
RADII: Final = 33
DIRECTIONS: Final = 24
#: First correction in a camera vector, after principal distance and principal point.
_FIRST: Final = 3
#: Corrections across the radius below this share of the radius are rounding errors.
_ROUNDING: Final = 1e-13
#: Camera parameters of a form, by its name. dr is radial, along r; equation numbers refer to Ayhan 1996.
SETS: Final[dict[str, tuple[str, ...]]] = {
    "radial": ("k1", "k2", "k3"),  # dr = k1 r^3 + k2 r^5 + k3 r^7, eq. 71
    "radial-even": ("radial_2", "radial_4", "radial_6"),  # dr of even powers, eq. 44 as printed
    "radial-odd": ("radial_1", "k1", "k2"),  # dr of odd powers from r on, eq. 45
    "radial-full": ("radial_1", "radial_2", "k1", "radial_4", "k2", "radial_6"),  # all powers, eq. 45
    "radial-orthogonal": ("orthogonal_1", "orthogonal_2", "orthogonal_3"),  # eq. 46
    "decentring": ("p1", "p2"),  # eqs. 48, 72
    "film-affine": ("x0", "y0", "film_xx", "affinity_a", "film_yx", "affinity_b"),  # six parameters, eqs. 49, 50
    "film-turned": ("film_xx", "affinity_a", "affinity_b"),  # no fiducial marks: kappa contains the rotation, eq. 51
    "film": ("affinity_a", "affinity_b"),  # the principal distance contains one scale, eqs. 53, 54
    "film-scales": ("film_xx", "affinity_b"),  # two scales, eq. 55
    "brown": brown.NAMES[:15],  # without parameters that equal k1 to k3 or the interior orientation, eq. 2
    "brown-21": brown.NAMES,
}


def camera_of(interior: PhotoInterior) -> Array:
    """Return the camera parameters (41,) of an interior orientation."""
    out = np.zeros(CAMERA.size)
    out[CAMERA.c], out[CAMERA.principal], out[CAMERA.lens] = interior.focal, interior.principal, interior.corrections
    return out


def parameters_of(words: Sequence[str], place: str) -> tuple[str, ...]:
    """Return the camera parameters for words that name a parameter or a set, each once.

    Raise InputError for other words.
    """
    out: list[str] = []
    for word in words:
        if word not in SETS and word not in NAMES:
            known = ", ".join((*NAMES[:10], *SETS, "a1 to a21", *NAMES[31:]))
            raise InputError.of("closerange.parameter", place=place, value=word, known=known)
        out += SETS.get(word, (word,))
    return tuple(dict.fromkeys(out))


def profile(camera: Array, rim: float, names: Sequence[str], covariance: Array) -> dict[str, Array]:
    """Return the corrections of a camera over the radius, as arrays (33,), in image units.

    ``radius``; ``radial``: radial part of the correction, mean over all directions;
    ``sigma``: its standard deviation; ``across``: largest part at right angles to the
    radius.

    Parameters
    ----------
    camera : (41,) array
        Parameters in the order of :data:`NAMES`.
    rim : float
        Radius of the outermost image point, image units.
    names, covariance
        Determined parameters, and their covariance (k, k).
    """
    radius = np.linspace(0.0, rim, RADII)
    turn = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    whole = _corrections(camera, radius, along, rim)
    radial = np.einsum("rdk,dk->rd", whole, along).mean(axis=1)
    across = np.abs(whole[..., 0] * -along[:, 1] + whole[..., 1] * along[:, 0]).max(axis=1)
    across[across < _ROUNDING * rim] = 0.0
    slopes = np.zeros((RADII, len(names)))
    for j, name in enumerate(names):
        if NAMES.index(name) >= _FIRST:  # corrections are linear in their parameters
            unit = np.zeros(CAMERA.size)
            unit[CAMERA.c], unit[NAMES.index(name)] = camera[CAMERA.c], 1.0
            slopes[:, j] = np.einsum("rdk,dk->rd", _corrections(unit, radius, along, rim), along).mean(axis=1)
    variance = np.einsum("ri,ij,rj->r", slopes, covariance, slopes)
    return {"radius": radius, "radial": radial, "across": across, "sigma": np.sqrt(np.maximum(variance, 0.0))}


def _corrections(camera: Array, radius: Array, along: Array, rim: float) -> Array:
    """Return the corrections x, y (r, d, 2) at radii (r,) in directions (d, 2)."""
    at = radius[:, None, None] * along
    further = camera[CAMERA.brown], camera[CAMERA.variants]
    own = lens_of(camera[CAMERA.lens], *further, nominal=camera[CAMERA.c], radius=rim)
    ideal = [frame_corrections.distorted(own, x, y) for x, y in at.reshape(-1, 2).tolist()]
    return np.asarray(np.reshape(ideal, at.shape) - at)


def lens_of(
    corrections: Array,
    additional: npt.ArrayLike = 0.0,
    others: npt.ArrayLike = 0.0,
    *,
    nominal: float = 1.0,
    radius: float = 1.0,
) -> Array:
    """Convert the corrections to a camera of ``factors.cameras.frame_corrections``."""
    of, out = frame_corrections.CAMERA, np.zeros(frame_corrections.CAMERA.size)
    k1, k2, k3, p1, p2, *affinity = corrections.tolist()
    out[of.distortion], out[of.affinity] = (k1, k2, k3, p2, p1), affinity
    out[of.additional], out[of.variants], out[of.nominal], out[of.radius] = additional, others, nominal, radius
    return out


def photo_text(photo: Photo, interior: PhotoInterior | None = None, rotation: Array | None = None) -> str:
    """Return one ``[[photos]]`` table: with the rotation of a camera, else with the matrix."""
    place, terms = photo.origin_m.tolist(), dict(zip(lens.NAMES, photo.corrections.tolist(), strict=True))
    own: dict[str, object] = {"matrix": photo.matrix.tolist(), "origin_m": place}
    if interior is not None and rotation is not None:
        own = {"focal": interior.focal, "y_axis": interior.y_axis, "rotation": rotation.tolist(), "centre_m": place}
    own |= {"principal": photo.principal.tolist(), **{name: value for name, value in terms.items() if value != 0.0}}
    return "\n".join(["[[photos]]", *entries({"name": photo.name, **own}), ""])
