"""Sensor of a frame image: one projection centre, interior orientation, Brown's distortion.

Ground points are in metres, Earth-fixed (ECEF); if the camera is not georeferenced, they
refer to a local Cartesian system. Pixels are (line, sample). If the principal point is
(0, 0), pixels are relative to it. Camera axes are X along the samples, Y down along the
lines, Z forward. :data:`HALF_TURN` converts them to axes of cameras that look along -Z
with Y up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from factors.cameras import frame_corrections, frame_extended
from factors.cameras.frame import FRAME_COLLINEARITY, RECORD
from factors.cameras.frame_camera import CAMERA
from factors.cameras.frame_extended import FRAME_EXTENDED
from factors.geometry import ellipsoid
from fg_orient.kernels.batch import batch
from fg_orient.model.errors import Finding, InputError
from fg_orient.model.parameters import require_unknowns

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.model.block import ImagePoints, Options
from fg_orient.sensors.base import ImageModel, Sensor, ground_rows, placed, same_length
from fg_orient.sensors.frame_unknowns import FURTHER, INTERIOR, NAMES, UNKNOWNS, camera_parameters

#: Names of the two distortion equations. The name states the direction of the polynomial.
IDEAL_TO_MEASURED: Final = "brown_ideal_to_measured"
MEASURED_TO_IDEAL: Final = "brown_measured_to_ideal"
#: Converts photogrammetric camera axes (X right, Y up, view along -Z; also BAL) to ours: rotation = HALF_TURN @ theirs.
HALF_TURN: Final = np.diag([1.0, -1.0, -1.0])
#: A matrix is a rotation if its columns are orthonormal within this tolerance. Files may contain 9 rounded digits.
ORTHONORMAL: Final = 1e-6


def away_from_rotation(matrices: Array) -> Array:
    """Return the largest element (...) of M M^T - I for matrices (..., 3, 3).

    Infinite for reflections.
    """
    away = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-2, -1), initial=0.0)
    return np.where((np.linalg.det(matrices) < 0.0) & (away <= ORTHONORMAL), np.inf, away)


def not_a_rotation(away: float) -> str:
    """Describe a value of :func:`away_from_rotation` in words."""
    return f"{away:.1e} from orthonormal" if np.isfinite(away) else "a mirror image"


@dataclass(frozen=True, eq=False)
class FrameCamera:
    """Exterior and interior orientation of one frame image, and its unknowns.

    Parameters
    ----------
    rotation : (3, 3) array
        Rotates ground axes to camera axes.
    centre_m : (3,) array
        Projection centre.
    focal_px : float
    principal_px : (2,) array
        Line and sample of the principal point.
    distortion : (5,) array
        k1, k2, k3, p1, p2 of Brown's polynomial.
    model : str
        Direction of the polynomial: "brown_ideal_to_measured" (OpenCV, COLMAP, BAL,
        Metashape) or "brown_measured_to_ideal" (Ayhan, DBAT).
    unit_px : float, optional
        Unit of length of a polynomial from measured to ideal coordinates, px. If the
        coefficients are in mm, it is 1 mm in pixels. The default is the given focal
        length.
    aspect : float
        Samples are stretched by 1 + aspect. This is done before a polynomial from
        measured to ideal coordinates, and after a polynomial of the other direction.
    sigma : mapping
        Prior sigmas of the unknowns by name (:data:`UNKNOWNS`, :data:`NAVIGATION`), in
        rad, m, px; k and p have no unit. All other parameters are held fixed.
    shared : mapping
        Ids of shared unknowns by name, for example {"focal": "camera 1"}. All images with
        the same id for a name have one common unknown. Their start values and prior
        sigmas must agree.
    further : mapping
        Values of further coefficients by name (:data:`FURTHER`): shear, fisheye lens,
        affinity, Brown's additional parameters, alternative terms. The equation is
        ``factors.cameras.frame_extended`` in three cases: one of these is a value or an unknown, one of
        the next five arguments is given, or there is an aspect from ideal to measured coordinates.
    is_fisheye : bool
        Fisheye projection (Kannala, Brandt 2006; OpenCV).
    lines_up : bool
        Lines are counted upwards.
    nominal_px, radius_px : float, optional
        Fixed principal distance of the additional parameters, px, and radius of the
        orthogonal polynomials, in the unit of the coefficients; default 1.
    is_condition : bool
        Residuals are misclosures of conditions in pixels times metres (Ayhan 1996, eq. 76), not pixels.

    Raises
    ------
    InputError
        A value is not finite; the matrix is not a rotation; the focal length, the unit or
        a prior sigma is not above zero; or a name or the model is unknown.
    """

    rotation: Array
    centre_m: Array
    focal_px: float
    principal_px: Array = field(default_factory=lambda: np.zeros(2))
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    sigma: Mapping[str, float] = field(default_factory=dict)
    model: str = IDEAL_TO_MEASURED
    unit_px: float | None = None
    aspect: float = 0.0
    shared: Mapping[str, str] = field(default_factory=dict)
    further: Mapping[str, float] = field(default_factory=dict)
    is_fisheye: bool = False
    lines_up: bool = False
    nominal_px: float | None = None
    radius_px: float | None = None
    is_condition: bool = False

    def __post_init__(self) -> None:
        for name, shape in (("rotation", (3, 3)), ("centre_m", (3,)), ("principal_px", (2,)), ("distortion", (5,))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError.of("frame.camera", place=name, value=value, expected=f"finite numbers {shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.unit_px is None:
            object.__setattr__(self, "unit_px", float(self.focal_px))
        away, unit = float(away_from_rotation(self.rotation)), float(self.unit_px or 0.0)
        models = (IDEAL_TO_MEASURED, MEASURED_TO_IDEAL)
        for name, shown, expected, right in (
            ("rotation", not_a_rotation(away), "a rotation", away <= ORTHONORMAL),
            ("focal_px", self.focal_px, "pixels above zero", np.isfinite(self.focal_px) and self.focal_px > 0.0),
            ("model", self.model, " or ".join(models), self.model in models),
            ("unit_px", self.unit_px, "pixels above zero", np.isfinite(unit) and unit > 0.0),
            ("aspect", self.aspect, "a number", np.isfinite(self.aspect)),
        ):
            if not right:
                raise InputError.of("frame.camera", place=name, value=shown, expected=expected)
        for name, coefficient in self.further.items():
            if name not in FURTHER or not np.isfinite(coefficient):
                raise InputError.of("frame.unknown", place=name, value=coefficient, known=", ".join(FURTHER))
        for name, sigma in self.sigma.items():
            if name not in NAMES or not (np.isfinite(sigma) and sigma > 0.0):
                raise InputError.of("frame.unknown", place=name, value=sigma, known=", ".join(NAMES))
        for name, with_whom in self.shared.items():
            if name not in self.sigma or not with_whom:
                raise InputError.of("frame.unknown", place=f"shared {name}", value=with_whom,
                                    known=", ".join(self.sigma))  # fmt: skip

    @cached_property
    def is_extended(self) -> bool:
        """Return whether the equation is ``factors.cameras.frame_extended``."""
        given = self.further, self.is_fisheye, self.lines_up, self.nominal_px, self.radius_px, self.is_condition
        aspect = not self.corrects_measured and (self.aspect != 0.0 or "aspect" in self.sigma)
        return any(given) or aspect or not self.sigma.keys().isdisjoint(FURTHER)

    @property
    def equation(self) -> Equation:
        """Return the observation equation."""
        return FRAME_EXTENDED if self.is_extended else FRAME_COLLINEARITY

    @cached_property
    def record(self) -> Array:
        """Return a record of the equation with pixel 0, 0, whitening 1 and origin 0."""
        return self._all if self.is_extended else self._all[: RECORD.size]

    @cached_property
    def _all(self) -> Array:
        """Return the record of ``frame_extended``, which begins like the record of ``frame``."""
        values = np.array([self.further.get(name, 0.0) for name in FURTHER])
        parts = np.split(values, np.cumsum([*frame_corrections.FURTHER.sizes.values()])[:-1])
        further = dict(zip(frame_corrections.FURTHER.fields, parts, strict=True))
        return frame_extended.RECORD.pack(
            line=0.0, sample=0.0, a_line=1.0, a_sample=1.0, rotation=self.rotation.ravel(), centre=self.centre_m,
            focal=self.focal_px, principal=self.principal_px[::-1], distortion=self.distortion, aspect=self.aspect,
            unit=self.unit_px if self.corrects_measured else 0.0, **further | {"shear": values[0]},
            is_fisheye=self.is_fisheye, sign=-1.0 if self.lines_up else 1.0, nominal=self.nominal_px or 1.0,
            radius=self.radius_px or 1.0, w12=0.0, power=self.is_condition,
        )  # fmt: skip

    @property
    def corrects_measured(self) -> bool:
        """Return whether the polynomial converts measured to ideal coordinates."""
        return self.model == MEASURED_TO_IDEAL

    def corrected(self, correction: npt.ArrayLike | None = None) -> Array:
        """Return the corrected camera of ``factors.cameras.frame_corrections``; it computes pixels and directions.

        ``correction`` (k,) contains corrections of all unknowns or of the first k
        unknowns, in physical units, in the order of
        :data:`fg_orient.sensors.frame_unknowns.NAMES`.
        """
        x = np.zeros(0) if correction is None else np.array(correction, dtype=float)
        codes = np.stack([np.arange(len(x), dtype=float), np.ones(len(x))])
        return np.asarray(frame_extended.camera(self._all, codes, x))

    def linearised(self, names: Sequence[str], line: Array, sample: Array, ground_m: Array) -> tuple[Array, Array]:
        """Return residuals (n, 2), px, of pixels (n,) and ground points (n, 3).

        Also return their derivatives (n, 2, k) by k unknowns.
        """
        n, k = len(line), len(names)
        records = np.tile(self.record, (n, 1))
        records[:, RECORD.line], records[:, RECORD.sample] = line, sample
        rows, columns = batch(self.equation, np.array([[NAMES.index(name) for name in names], [1.0] * k]), records)
        residual, derivatives, order = np.empty((n, 2)), np.zeros((n, 2, k)), np.arange(n, dtype=np.int32)
        rows(
            0, n, order, records, order, np.zeros(n, np.int32), order, columns.setup, 1, np.ones((n, 1)),
            np.zeros((1, k)), np.ascontiguousarray(ground_m), residual, derivatives, np.empty((n, 2, 3)), True,
        )  # fmt: skip
        return residual, derivatives


def rotation_of_opk(omega_rad: float, phi_rad: float, kappa_rad: float) -> Array:
    """Compute the rotation (3, 3) of a :class:`FrameCamera` from the photogrammetric angles omega, phi, kappa.

    ``R3(kappa) R2(phi) R1(omega)`` converts ground axes to photogrammetric camera axes.
    Each of the three matrices rotates the axes, not the points (Kraus 2007; DBAT).
    :data:`HALF_TURN` converts the result to the axes of this module.
    """
    (so, co), (sp, cp), (sk, ck) = ((np.sin(a), np.cos(a)) for a in (omega_rad, phi_rad, kappa_rad))
    r1 = np.array([[1.0, 0.0, 0.0], [0.0, co, so], [0.0, -so, co]])
    r2 = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    r3 = np.array([[ck, sk, 0.0], [-sk, ck, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(HALF_TURN @ r3 @ r2 @ r1)


def opk_of_rotation(rotation: Array) -> tuple[Array, Array]:
    """Compute omega, phi, kappa (3,), rad, of a rotation, and their derivatives (3, 3).

    The derivatives are with respect to rotations about the camera's axes. Phi lies in
    [-pi/2, pi/2]. At the ends of this interval only the sum of omega and kappa is
    defined, and the derivatives are nan.
    """
    r = HALF_TURN @ rotation
    angles = np.array([np.arctan2(-r[2, 1], r[2, 2]), np.arcsin(np.clip(r[2, 0], -1.0, 1.0)),
                       np.arctan2(-r[1, 0], r[0, 0])])  # fmt: skip
    (sp, cp), (sk, ck) = ((np.sin(a), np.cos(a)) for a in angles[1:])
    # omega rotates about the first ground axis, phi about the rotated second, kappa about the rotated third axis
    turns = -np.array([[cp * ck, sk, 0.0], [-cp * sk, ck, 0.0], [sp, 0.0, 1.0]])
    with np.errstate(divide="ignore"):
        derivatives = np.linalg.inv(turns) @ HALF_TURN if cp > 1e-9 else np.full((3, 3), np.nan)
    return angles, derivatives


class FrameSensor(Sensor):
    """Sensor of a frame image.

    Parameters
    ----------
    camera : FrameCamera
    n_lines, n_samples : int
        Size of the image.
    first_line, first_sample : float, optional
        Pixel coordinates of the first pixel's centre. They are not 0 if pixels are
        relative to the principal point.
    georeferenced : bool, optional
        False for a local coordinate system; pixels can then not be located at ellipsoidal heights.
    file : str, optional
    notes : tuple of Finding, optional
    """

    orients = False  # the start values of its orientation may be inaccurate

    def __init__(
        self, camera: FrameCamera, n_lines: int, n_samples: int, *, first_line: float = 0.0, first_sample: float = 0.0,
        georeferenced: bool = True, file: str = "", notes: tuple[Finding, ...] = (),
    ) -> None:  # fmt: skip
        self.camera, self.n_lines, self.n_samples = camera, n_lines, n_samples
        self.first_line, self.last_line = first_line, first_line + n_lines - 1.0
        self.first_sample, self.last_sample = first_sample, first_sample + n_samples - 1.0
        self.georeferenced, self.notes, self.file = georeferenced, notes, file

    def with_camera(self, camera: FrameCamera, file: str) -> FrameSensor:
        """Return a sensor with another camera; size, pixels and notes are the same."""
        return FrameSensor(
            camera, self.n_lines, self.n_samples, first_line=self.first_line, first_sample=self.first_sample,
            georeferenced=self.georeferenced, file=file, notes=self.notes,
        )  # fmt: skip

    def records(self, line: npt.ArrayLike, sample: npt.ArrayLike, origin_m: Array | None = None) -> Array:
        """Return the constants (N, d) of the camera's equation for N image points without whitening.

        ``origin_m`` (3,) is the local origin of the ground unknowns (default 0).
        """
        line, sample = same_length(line, sample)
        out = np.tile(self.camera.record, (len(line), 1))
        out[:, RECORD.line], out[:, RECORD.sample] = line, sample
        if origin_m is not None:
            out[:, RECORD.centre] -= origin_m
        return out

    # --- image to ground ---------------------------------------------------------------------

    def rays(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: npt.ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return the projection centre (N, 3), m, and unit viewing directions (N, 3) of N pixels.

        InputError: the distortion cannot be inverted at a pixel.
        """
        line, sample = same_length(line, sample)
        camera = self.camera.corrected(correction)
        ideal = frame_corrections.directions(camera, line, sample)
        bad = np.flatnonzero(np.isnan(ideal).any(axis=1))
        if len(bad):
            place = f"line {line[bad[0]]:g}, sample {sample[bad[0]]:g}"
            raise InputError.of("frame.no_direction", file=self.file, place=place, value=f"{len(bad)} pixel(s)")
        direction = np.column_stack([ideal, np.ones(len(ideal))]) @ camera[CAMERA.rotation].reshape(3, 3)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return np.tile(camera[CAMERA.centre], (len(line), 1)), direction

    # --- ground to image ---------------------------------------------------------------------

    def project(self, ground_m: npt.ArrayLike, correction: npt.ArrayLike | None = None) -> tuple[Array, Array]:
        """Return line and sample of N ground points (N, 3), m; nan if a point is not in front of the camera."""
        ground = ground_rows(ground_m)
        line, sample, inverse = frame_corrections.pixels(self.camera.corrected(correction), ground).T
        seen = inverse > 0.0
        return np.where(seen, line, np.nan), np.where(seen, sample, np.nan)

    @cached_property
    def centre_m(self) -> Array:
        """Return the ground point (3,), m, of the image centre at height 0.

        If the ray misses the ground, return the projection centre.
        """
        if not self.georeferenced:
            return self.camera.centre_m
        p, u = self.rays(0.5 * (self.first_line + self.last_line), 0.5 * (self.first_sample + self.last_sample))
        ground = ellipsoid.intersect(p, u, np.zeros(1))[0]
        return ground if np.isfinite(ground).all() else self.camera.centre_m

    # --- adjustment --------------------------------------------------------------------------

    def image_model(self, options: Options) -> ImageModel:
        """See :class:`FrameImageModel`."""
        return FrameImageModel(self, options)

    def correction_of(self, values: Mapping[str, float], options: Options) -> Array:
        """Make corrections from the values of the unknowns by name.

        See :meth:`Sensor.correction_of`.
        """
        return placed(values, NAMES if self.camera.is_extended else UNKNOWNS)

    def shared_starts(self) -> dict[tuple[str, str], float]:
        """Return values of shared unknowns, and the polynomial's unit and direction.

        See :meth:`Sensor.shared_starts`.
        """
        camera, at = self.camera, self.camera.corrected()
        interior = at[CAMERA.focal], *at[CAMERA.principal], *at[CAMERA.distortion], camera.aspect
        values = dict(zip(INTERIOR, interior, strict=False)) | dict(camera.further)
        unit = float(camera.unit_px or 0.0) if camera.corrects_measured else 0.0
        return {
            (with_whom, part): float(value)
            for name, with_whom in camera.shared.items()
            for part, value in ((name, values.get(name, 0.0)), ("unit", unit), ("model", camera.corrects_measured))
        }


# --- image model ---------------------------------------------------------------------------------


class FrameImageModel(ImageModel):
    """See ``fg_orient.sensors.base.ImageModel``.

    Parameters
    ----------
    sensor : FrameSensor
    options : Options
        Options of the adjustment. The camera states the unknowns and their prior sigmas;
        ``image_unknowns`` may select some of them. A camera without unknowns is held
        fixed; its images define the datum.

    Raises
    ------
    InputError
        ``image_unknowns`` selects none of the camera's unknowns.
    """

    def __init__(self, sensor: FrameSensor, options: Options) -> None:
        self.sensor, self.equation = sensor, sensor.camera.equation
        self.parameters = camera_parameters(sensor.camera, options.image_unknowns)
        if sensor.camera.sigma:
            require_unknowns(options, self.parameters.codes, sensor.file, sensor.camera.sigma)

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Return constants that are whitened with the standard deviations of the pixels."""
        out = self.sensor.records(points.line, points.sample, origin_m)
        out[:, RECORD.a_line], out[:, RECORD.a_sample] = 1.0 / points.sigma_line_px, 1.0 / points.sigma_sample_px
        return out

    def correction(self, x: Array) -> Array:
        """Return the corrections that change pixels, in physical units, by code.

        The shape is (15,), or (k,) with further coefficients.
        """
        out = np.zeros(len(NAMES))
        out[list(self.parameters.codes)] = x * self.parameters.sigma
        return out if self.sensor.camera.is_extended else out[: len(UNKNOWNS)]

    def is_valid(self, ground_m: Array) -> Mask:
        """Return a mask of the points that lie in front of the camera in its approximate orientation."""
        return np.isfinite(self.sensor.project(ground_m)[0])

    def facts(self) -> dict[str, Any]:
        """Return the metadata of a frame image."""
        return {
            "model": "frame", "mission": "frame camera", "instrument": "", "format": "camera",
            "metadata_polynomials": [],
        }  # fmt: skip
