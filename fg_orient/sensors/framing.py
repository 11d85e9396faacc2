"""Sensor of a frame image whose position and angles are given in an inertial frame, on any body.

Image support data (ISD) of ALE and states of the Community Sensor Model (CSM) describe
such images. Ground points have body-fixed coordinates, m. The unknowns are defined as in ISIS jigsaw:
position in inertial axes, right ascension, declination and twist (``factors.cameras.frame_angles``).
Distortion and detector are constants. Residuals are differences on the ideal focal plane, in pixels of
the image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from factors.cameras.frame_angles import FRAME_ANGLES, RECORD
from fg_orient.model.errors import Finding, InputError
from fg_orient.model.parameters import ImageParameters, require_unknowns
from fg_orient.sensors.base import ImageModel, Sensor, ground_rows, placed, same_length
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation

if TYPE_CHECKING:
    from fg_orient.geodesy.bodies import Body
    from fg_orient.model.block import ImagePoints, Options
    from fg_orient.sensors.focal_plane import Detector, Distortion

UNKNOWNS: Final = ("position_x", "position_y", "position_z", "right_ascension", "declination", "twist")
UNITS: Final = ("m", "m", "m", "rad", "rad", "rad")
WORDS: Final = (
    *(f"position {axis} in inertial axes (m)" for axis in "XYZ"), "right ascension (rad)", "declination (rad)",
    "twist (rad)",
)  # fmt: skip


def turn_of(angles_rad: npt.ArrayLike) -> Array:
    """Return the rotation (3, 3) from inertial to camera axes, R3(twist) R1(90 deg - dec) R3(90 deg + ra)."""
    ra, dec, twist = np.asarray(angles_rad, float)
    out = np.eye(3)
    for axis, angle in ((2, 0.5 * np.pi + ra), (0, 0.5 * np.pi - dec), (2, twist)):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[i, i], step[i, j], step[j, i], step[j, j] = c, s, -s, c
        out = step @ out
    return out


def angles_of(turn: Array) -> Array:
    """Return right ascension, declination and twist (3,), rad, of a rotation; inverse of :func:`turn_of`.

    At a declination of 90 degrees, only the difference of the other two angles is
    defined. Right ascension is then 0.
    """
    dec = np.arctan2(turn[2, 2], np.hypot(turn[2, 0], turn[2, 1]))
    if np.hypot(turn[2, 0], turn[2, 1]) < 1e-15:
        return np.array([0.0, dec, np.arctan2(-turn[0, 0], turn[1, 0])])
    return np.array([np.arctan2(turn[2, 1], turn[2, 0]), dec, np.arctan2(turn[0, 2], turn[1, 2])])


@dataclass(frozen=True, eq=False)
class FramingCamera:
    """Exterior and interior orientation of one frame image in an inertial frame.

    Parameters
    ----------
    position_m : (3,) array
        Projection centre in inertial axes, m.
    angles_rad : (3,) array
        Right ascension, declination, twist, rad.
    mounting : (3, 3) array
        Rotates the axes defined by the three angles to camera axes.
    inertial : (3, 3) array
        Rotates body-fixed axes to inertial axes.
    focal_mm : float
        Focal length; negative if the camera looks along its negative third axis.
    detector : Detector
    distortion : Distortion

    Raises
    ------
    InputError
        A value is not finite, a matrix is not a rotation, or the focal length is zero.
    """

    position_m: Array
    angles_rad: Array
    mounting: Array
    inertial: Array
    focal_mm: float
    detector: Detector
    distortion: Distortion

    def __post_init__(self) -> None:
        for name, shape in (("position_m", (3,)), ("angles_rad", (3,)), ("mounting", (3, 3)), ("inertial", (3, 3))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError.of("frame.camera", place=name, value=value, expected=f"finite numbers {shape}")
            if len(shape) == 2 and away_from_rotation(value) > ORTHONORMAL:
                away = not_a_rotation(float(away_from_rotation(value)))
                raise InputError.of("frame.camera", place=name, value=away, expected="a rotation")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not (np.isfinite(self.focal_mm) and self.focal_mm != 0.0):
            raise InputError.of("frame.camera", place="focal_mm", value=self.focal_mm, expected="mm, not zero")

    def corrected(self, correction: npt.ArrayLike | None) -> FramingCamera:
        """Return the camera with corrections (6,) in m and rad, in the order of :data:`UNKNOWNS`."""
        if correction is None:
            return self
        d = np.asarray(correction, float)
        return replace(self, position_m=self.position_m + d[:3], angles_rad=self.angles_rad + d[3:])

    @property
    def centre_m(self) -> Array:
        """Return the projection centre (3,) in body-fixed axes."""
        return np.asarray(self.inertial.T @ self.position_m)

    @property
    def rotation(self) -> Array:
        """Return the rotation (3, 3) from body-fixed axes to camera axes."""
        return np.asarray(self.mounting @ turn_of(self.angles_rad) @ self.inertial)


@dataclass(frozen=True)
class Taken:
    """Description of an image: platform, instrument, serial number of ISIS, and format of the metadata."""

    platform: str = ""
    instrument: str = ""
    serial: str = ""
    form: str = ""


class FramingSensor(Sensor):
    """Sensor of a frame image in an inertial frame.

    Parameters
    ----------
    camera : FramingCamera
    n_lines, n_samples : int
    body : Body or None
        Body that the image shows; None for the Earth.
    taken : Taken, optional
    file : str, optional
    notes : tuple of Finding, optional
    """

    def __init__(
        self, camera: FramingCamera, n_lines: int, n_samples: int, body: Body | None, *, taken: Taken | None = None,
        file: str = "", notes: tuple[Finding, ...] = (),
    ) -> None:  # fmt: skip
        self.camera, self.n_lines, self.n_samples, self.body = camera, n_lines, n_samples, body
        self.georeferenced = body is None
        self.first_line, self.last_line = 0.0, n_lines - 1.0
        self.first_sample, self.last_sample = 0.0, n_samples - 1.0
        self.taken, self.file, self.notes = taken or Taken(), file, notes
        self.serial = self.taken.serial

    def rays(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: npt.ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return the body-fixed projection centre (N, 3), m, and unit viewing directions (N, 3) of N pixels."""
        line, sample = same_length(line, sample)
        camera = self.camera.corrected(correction)
        ideal = camera.distortion.ideal(camera.detector.millimetres(line, sample))
        bad = np.flatnonzero(np.isnan(ideal).any(axis=1))
        if len(bad):
            place = f"line {line[bad[0]]:g}, sample {sample[bad[0]]:g}"
            raise InputError.of("frame.no_direction", file=self.file, place=place, value=f"{len(bad)} pixel(s)")
        direction = np.column_stack([ideal, np.full(len(ideal), camera.focal_mm)]) @ camera.rotation
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return np.tile(camera.centre_m, (len(line), 1)), direction

    def project(self, ground_m: npt.ArrayLike, correction: npt.ArrayLike | None = None) -> tuple[Array, Array]:
        """Return line and sample of N body-fixed points (N, 3), m; nan if a point is not in front of the camera."""
        camera = self.camera.corrected(correction)
        q = (ground_rows(ground_m) - camera.centre_m) @ camera.rotation.T
        seen = q[:, 2] * camera.focal_mm > 0.0
        with np.errstate(all="ignore"):
            ideal = camera.focal_mm * q[:, :2] / np.where(seen, q[:, 2], np.nan)[:, None]
        ideal[~seen] = 0.0
        line, sample = camera.detector.pixels(camera.distortion.measured(ideal))
        return np.where(seen, line, np.nan), np.where(seen, sample, np.nan)

    def footprint(self) -> Array:
        """Return the corners in the order of the image, clockwise: (4, 2) longitude, latitude, degrees.

        If a corner shows the sky, its nearest point on the limb is used.
        """
        if self.body is None:
            return super().footprint()
        return self.body.coordinates(self.body.nearest(*self.rays(*self.corners())))[:, :2]

    @cached_property
    def centre_m(self) -> Array:
        """Return the ground point (3,), m, of the image centre.

        If the centre shows the sky, a point on the limb.
        """
        middle = 0.5 * (self.first_line + self.last_line), 0.5 * (self.first_sample + self.last_sample)
        if self.body is None:
            return np.asarray(self.locate(*middle, height_m=0.0)[0])
        return np.asarray(self.body.nearest(*self.rays(*middle))[0])

    def image_model(self, options: Options) -> ImageModel:
        """See :class:`FramingImageModel`."""
        return FramingImageModel(self, options)

    def correction_of(self, values: Mapping[str, float], options: Options) -> Array:
        """Make corrections from the values of the unknowns by name.

        See :meth:`Sensor.correction_of`.
        """
        return placed(values, UNKNOWNS)


class FramingImageModel(ImageModel):
    """See ``fg_orient.sensors.base.ImageModel``.

    Parameters
    ----------
    sensor : FramingSensor
    options : Options
        Options of the adjustment. ``position_sigma_m`` and ``attitude_sigma_rad`` give
        the prior sigmas by their constant terms. ``image_unknowns`` selects the unknowns.

    Raises
    ------
    InputError
        ``image_unknowns`` selects none of the unknowns.
    """

    def __init__(self, sensor: FramingSensor, options: Options) -> None:
        self.sensor, self.equation = sensor, FRAME_ANGLES
        chosen = options.image_unknowns
        codes = tuple(k for k, name in enumerate(UNKNOWNS) if not chosen or name in chosen)
        require_unknowns(options, codes, sensor.file, UNKNOWNS)
        sigma = np.repeat([options.position_sigma_m[0], options.attitude_sigma_rad[0]], 3)
        self.parameters = ImageParameters(
            codes, sigma[list(codes)], tuple(UNKNOWNS[k] for k in codes), tuple(UNITS[k] for k in codes),
            tuple(WORDS[k] for k in codes),
        )  # fmt: skip

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Return constants that are whitened with the standard deviations of the pixels on the ideal focal plane."""
        camera, n = self.sensor.camera, len(points)
        ideal = camera.distortion.ideal(camera.detector.millimetres(points.line, points.sample))
        sigma = np.stack([points.sigma_line_px, points.sigma_sample_px], axis=1)
        whitening = camera.detector.per_mm / sigma[:, :, None]
        return RECORD.pack(
            ideal=ideal, whitening=whitening.reshape(n, 4), angles=camera.angles_rad,
            inertial=camera.inertial.ravel(), mounting=camera.mounting.ravel(), centre=camera.centre_m - origin_m,
            focal=camera.focal_mm,
        )  # fmt: skip

    def correction(self, x: Array) -> Array:
        """Return the corrections (6,) in physical units by code."""
        out = np.zeros(len(UNKNOWNS))
        out[list(self.parameters.codes)] = x * self.parameters.sigma
        return out

    def is_valid(self, ground_m: Array) -> Mask:
        """Return a mask of the points that lie in front of the camera in its approximate orientation."""
        return np.isfinite(self.sensor.project(ground_m)[0])

    def facts(self) -> dict[str, Any]:
        """Return the metadata of the image."""
        own = self.sensor.taken
        return {
            "model": "frame", "mission": own.platform or "frame camera", "instrument": own.instrument,
            "format": own.form, "metadata_polynomials": [],
        }  # fmt: skip
