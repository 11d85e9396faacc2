"""The sensor of a frame image: one projection centre, interior orientation, Brown's distortion.

Ground points are metres, Earth-fixed (ECEF) or, if the camera is not georeferenced, of a local Cartesian system.
Pixels are (line, sample); with a principal point of (0, 0) they are counted from it. Camera axes: X along the samples,
Y down along the lines, Z forward; :data:`HALF_TURN` leads to cameras that look along -Z with Y up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from factors import ellipsoid, frame, frame_camera
from fg_orient.errors import InputError
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.pixels import PixelRange, same_length
from fg_orient.sensors.surface import landed

Array = npt.NDArray[np.float64]

#: Unknowns of a frame image in the order of their codes (``factors.frame``).
UNKNOWNS: Final = (
    "rotation_x", "rotation_y", "rotation_z", "centre_x", "centre_y", "centre_z", "focal", "principal_sample",
    "principal_line", "k1", "k2", "k3", "p1", "p2",
)  # fmt: skip
#: Camera axes from photogrammetric ones (X right, Y up, view along -Z; BAL): rotation = HALF_TURN @ theirs.
HALF_TURN: Final = np.diag([1.0, -1.0, -1.0])
#: A matrix is a rotation if its columns are orthonormal to this: 9 digits of a file, rounded.
ORTHONORMAL: Final = 1e-6


@dataclass(frozen=True, eq=False)
class FrameCamera:
    """Exterior and interior orientation of one frame image, and which of it is unknown.

    Parameters
    ----------
    rotation : (3, 3) array
        Camera axes from ground axes.
    centre_m : (3,) array
        Projection centre.
    focal_px : float
    principal_px : (2,) array
        Line and sample of the principal point.
    distortion : (5,) array
        k1, k2, k3, p1, p2 of Brown's polynomial from ideal to measured directions (OpenCV, COLMAP, BAL).
    sigma : mapping
        Unknowns of the adjustment by name (:data:`UNKNOWNS`) with their prior sigmas (rad, m, px; k and p have
        no unit). What is not named is held.

    Raises
    ------
    InputError
        A value is not finite, the matrix is no rotation, the focal length or a sigma not above zero, or a name wrong.
    """

    rotation: Array
    centre_m: Array
    focal_px: float
    principal_px: Array = field(default_factory=lambda: np.zeros(2))
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    sigma: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, shape in (("rotation", (3, 3)), ("centre_m", (3,)), ("principal_px", (2,)), ("distortion", (5,))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError.of("frame.camera", place=name, value=value, expected=f"finite numbers {shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        away = float(np.abs(self.rotation @ self.rotation.T - np.eye(3)).max())
        if away > ORTHONORMAL or np.linalg.det(self.rotation) < 0.0:
            raise InputError.of("frame.camera", place="rotation", value=f"{away:.1e}", expected="an orthonormal matrix")
        if not (np.isfinite(self.focal_px) and self.focal_px > 0.0):
            raise InputError.of("frame.camera", place="focal_px", value=self.focal_px, expected="pixels above zero")
        for name, sigma in self.sigma.items():
            if name not in UNKNOWNS or not (np.isfinite(sigma) and sigma > 0.0):
                raise InputError.of("frame.unknown", place=name, value=sigma, known=", ".join(UNKNOWNS))

    @cached_property
    def record(self) -> Array:
        """Columns 4 to 24 of the record of ``factors.frame``, local origin 0: (20,)."""
        principal = self.principal_px[::-1]
        return np.concatenate([self.rotation.ravel(), self.centre_m, [self.focal_px], principal, self.distortion])

    def corrected(self, correction: npt.ArrayLike | None = None) -> Array:
        """Camera (29,) of ``factors.frame_camera`` with corrections (14,) in physical units."""
        codes = np.stack([np.arange(frame.N_UNKNOWNS, dtype=float), np.ones(frame.N_UNKNOWNS)])
        x = np.zeros(frame.N_UNKNOWNS) if correction is None else np.array(correction, dtype=float)
        out: Array = frame.camera(np.concatenate([np.zeros(4), self.record]), codes, x)
        return out


class FrameSensor(PixelRange):
    """A frame image.

    Parameters
    ----------
    camera : FrameCamera
    n_lines, n_samples : int
        Size of the image.
    first_line, first_sample : float, optional
        Pixel coordinates of the first pixel's centre; not 0 where pixels are counted from the principal point.
    georeferenced : bool, optional
        False for a local coordinate system: there are no heights to locate at.
    file : str, optional
    notes : tuple of str, optional
    """

    def __init__(
        self, camera: FrameCamera, n_lines: int, n_samples: int, *, first_line: float = 0.0, first_sample: float = 0.0,
        georeferenced: bool = True, file: str = "", notes: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        self.camera, self.n_lines, self.n_samples = camera, n_lines, n_samples
        self.first_line, self.last_line = first_line, first_line + n_lines - 1.0
        self.first_sample, self.last_sample = first_sample, first_sample + n_samples - 1.0
        self.georeferenced, self.notes = georeferenced, notes
        self._file = file

    @property
    def file(self) -> str:
        """Name of the file of the camera."""
        return self._file

    def records(self, line: npt.ArrayLike, sample: npt.ArrayLike, origin_m: Array | None = None) -> Array:
        """Constants of the frame equation for N image points, unwhitened: (N, 24).

        ``origin_m`` (3,): local origin of the ground unknowns (default 0).
        """
        line, sample = same_length(line, sample)
        out = np.ones((len(line), frame.RECORD_SIZE))
        out[:, 0], out[:, 1], out[:, 4:] = line, sample, self.camera.record
        if origin_m is not None:
            out[:, 13:16] -= origin_m
        return out

    # --- image to ground ---------------------------------------------------------------------

    def rays(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: npt.ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Projection centre (N, 3) m and unit viewing directions (N, 3) of N pixels.

        Raises
        ------
        InputError
            The distortion cannot be inverted at a pixel.
        """
        line, sample = same_length(line, sample)
        camera = self.camera.corrected(correction)
        ideal = frame_camera.ideal_directions(camera, line, sample)
        bad = np.flatnonzero(np.isnan(ideal).any(axis=1))
        if len(bad):
            place = f"line {line[bad[0]]:g}, sample {sample[bad[0]]:g}"
            raise InputError.of("frame.no_direction", file=self.file, place=place, value=f"{len(bad)} pixel(s)")
        direction = np.column_stack([ideal, np.ones(len(ideal))]) @ camera[:9].reshape(3, 3)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return np.tile(camera[9:12], (len(line), 1)), direction

    def locate(
        self,
        line: npt.ArrayLike,
        sample: npt.ArrayLike,
        *,
        height_m: npt.ArrayLike | None = None,
        dem: HeightSurface | None = None,
        correction: npt.ArrayLike | None = None,
    ) -> Array:
        """Ground points (N, 3) ECEF m of N pixels at ellipsoidal heights (default 0), or on a DEM.

        Raises
        ------
        OutOfImage
            A pixel lies outside the image.
        InputError
            The camera is not georeferenced, a ray misses the surface, or the DEM does not cover it.
        """
        if not self.georeferenced:
            raise InputError.of("frame.local", file=self.file, place="locate")
        line, sample = same_length(line, sample)
        self.require_inside(line, sample)
        p, u = self.rays(line, sample, correction)
        return landed(p, u, height_m, dem, (line, sample), self.file)

    # --- ground to image ---------------------------------------------------------------------

    def project(self, ground_m: npt.ArrayLike, correction: npt.ArrayLike | None = None) -> tuple[Array, Array]:
        """Line and sample of N ground points (N, 3) m; nan for points that are not in front of the camera."""
        ground = np.atleast_2d(np.ascontiguousarray(ground_m, dtype=float))
        line, sample, inverse = frame_camera.project(self.camera.corrected(correction), ground).T
        seen = inverse > 0.0
        return np.where(seen, line, np.nan), np.where(seen, sample, np.nan)

    @cached_property
    def centre_m(self) -> Array:
        """Ground point (3,) m of the image centre at height 0; the projection centre where there is none."""
        if not self.georeferenced:
            return self.camera.centre_m
        p, u = self.rays(0.5 * (self.first_line + self.last_line), 0.5 * (self.first_sample + self.last_sample))
        ground = ellipsoid.intersect(p, u, np.zeros(1))[0]
        return ground if np.isfinite(ground).all() else self.camera.centre_m

    def footprint(self) -> Array:
        """Corners at height 0 in image order: (4, 2) longitude, latitude in degrees; (0, 2) if not georeferenced."""
        if not self.georeferenced:
            return np.zeros((0, 2))
        lon, lat, _ = ecef_to_geodetic(self.locate(*self.corners()))
        return np.stack([lon, lat], axis=1)
