"""Interior orientation of a frame camera, conversion of its distortion polynomial, and direct georeferencing.

``sensors.frame`` has two distortion polynomials of opposite directions. They are not
exactly inverse to each other. Therefore :func:`converted` fits one of them to the other
and returns their difference in pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras import frame_corrections
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL, FrameCamera

#: Number of points per side of the image in a conversion.
GRID: Final = 41


@dataclass(frozen=True, eq=False)
class Interior:
    """Interior orientation that is common to all images of a camera.

    Parameters
    ----------
    n_lines, n_samples : int
    focal_px : float
    principal_px : (2,) array
        Line and sample of the principal point; (0, 0) is the centre of the first pixel.
    distortion : (5,) array
        k1, k2, k3, p1, p2; see :class:`fg_orient.sensors.frame.FrameCamera`.
    model : str
        Direction of the distortion polynomial.
    unit_px, aspect : float
        See :class:`fg_orient.sensors.frame.FrameCamera`.
    name : str
    further : mapping
        Further coefficients by name; see :class:`fg_orient.sensors.frame.FrameCamera`.
    is_fisheye : bool
        True for the fisheye projection.
    """

    n_lines: int
    n_samples: int
    focal_px: float
    principal_px: Array
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    model: str = IDEAL_TO_MEASURED
    unit_px: float | None = None
    aspect: float = 0.0
    name: str = ""
    further: Mapping[str, float] = field(default_factory=dict)
    is_fisheye: bool = False

    def __post_init__(self) -> None:
        self.camera(np.eye(3), np.zeros(3))  # raises InputError for impossible values

    def camera(
        self, rotation: Array, centre_m: Array, sigma: Mapping[str, float] | None = None,
        shared: Mapping[str, str] | None = None,
    ) -> FrameCamera:  # fmt: skip
        """Make the camera of an image with this rotation and projection centre.

        Raise InputError for impossible values.
        """
        return FrameCamera(
            rotation, centre_m, self.focal_px, self.principal_px, self.distortion, sigma or {}, self.model,
            self.unit_px, self.aspect, shared or {}, self.further, self.is_fisheye,
        )  # fmt: skip

    def ideal(self, line: Array, sample: Array) -> Array:
        """Return ideal directions X/Z, Y/Z (N, 2) of pixels; nan where the polynomial has no unique inverse."""
        own = self.camera(np.eye(3), np.zeros(3))
        return np.asarray(frame_corrections.directions(own.corrected(), line, sample))


@dataclass(frozen=True)
class Conversion:
    """Camera with the other polynomial, and the largest and root mean square difference in the image, px."""

    interior: Interior
    max_px: float
    rms_px: float


def converted(interior: Interior, model: str, *, brown: bool = False) -> Conversion:
    """Fit the polynomial of the other direction over the whole image by least squares.

    Focal length and principal point do not change. An aspect, further coefficients and a
    fisheye projection cannot be converted and become part of the difference.

    Parameters
    ----------
    interior : Interior
    model : str
        "brown_ideal_to_measured" or "brown_measured_to_ideal".
    brown : bool
        If the camera already has this direction, fit Brown's five coefficients to it.

    Raises
    ------
    InputError
        The model is unknown, or the polynomial has no unique inverse inside the image.
    """
    if model not in (IDEAL_TO_MEASURED, MEASURED_TO_IDEAL):
        known = f"{IDEAL_TO_MEASURED} or {MEASURED_TO_IDEAL}"
        raise InputError.of("frame.camera", place="model", value=model, expected=known)
    if model == interior.model and not brown:
        return Conversion(interior, 0.0, 0.0)
    line, sample = pixel_grid(interior)
    ideal = directions(interior, line, sample)
    measured = (np.column_stack([sample, line]) - interior.principal_px[::-1]) / interior.focal_px
    argument, image = (ideal, measured) if model == IDEAL_TO_MEASURED else (measured, ideal)
    design = np.concatenate([_columns(argument, 0), _columns(argument, 1)])
    scale = np.linalg.norm(design, axis=0)
    distortion = np.linalg.lstsq(design / scale, (image - argument).T.ravel(), rcond=None)[0] / scale
    out = replace(interior, distortion=distortion, model=model, unit_px=interior.focal_px, aspect=0.0,
                  further={}, is_fisheye=False)  # fmt: skip
    apart = np.linalg.norm(out.ideal(line, sample) - ideal, axis=1) * interior.focal_px
    return Conversion(out, float(apart.max()), float(np.sqrt(np.mean(apart**2))))


def pixel_grid(interior: Interior) -> tuple[Array, Array]:
    """Return lines and samples (N,) of a grid over the whole image."""
    line, sample = np.meshgrid(
        np.linspace(0.0, interior.n_lines - 1.0, GRID), np.linspace(0.0, interior.n_samples - 1.0, GRID)
    )
    return line.ravel(), sample.ravel()


def directions(interior: Interior, line: Array, sample: Array) -> Array:
    """Return ideal coordinates (N, 2) of pixels.

    Raise InputError if the polynomial has no unique inverse there.
    """
    ideal = interior.ideal(line, sample)
    bad = int((~np.isfinite(ideal).all(axis=1)).sum())
    if bad:
        raise InputError.of("frame.no_direction", place=interior.name, value=f"{bad} of {len(ideal)} pixels")
    return ideal


def _columns(xy: Array, axis: int) -> Array:
    """Return the derivatives (N, 5) of the polynomial's x (axis 0) or y (axis 1) by its coefficients."""
    own, r = xy[:, axis], np.sum(xy**2, axis=1)
    along, across = r + 2.0 * own**2, 2.0 * xy[:, 0] * xy[:, 1]
    p = (across, along) if axis == 0 else (along, across)
    return np.column_stack([own * r, own * r**2, own * r**3, *p])


def direct_orientation(
    receiver_m: npt.ArrayLike, ground_from_body: npt.ArrayLike, lever_m: npt.ArrayLike, camera_from_body: npt.ArrayLike
) -> tuple[Array, Array]:
    """Compute rotation and projection centre of an image from a receiver and an inertial unit.

    Source: Terlemezoğlu 2019, eq. 2.2.

    Parameters
    ----------
    receiver_m : (3,) array
        Position of the receiver in the ground system, m.
    ground_from_body : (3, 3) array
        Attitude of the inertial unit: rotates body axes to ground axes.
    lever_m : (3,) array
        Vector from the receiver to the projection centre in body axes, m.
    camera_from_body : (3, 3) array
        Boresight: rotates body axes to camera axes (X right, Y down, Z along the view).

    Returns
    -------
    rotation : (3, 3) array
        Rotates ground axes to camera axes.
    centre_m : (3,) array
    """
    attitude = np.asarray(ground_from_body, dtype=float)
    rotation = np.asarray(camera_from_body, dtype=float) @ attitude.T
    return rotation, np.asarray(receiver_m, dtype=float) + attitude @ np.asarray(lever_m, dtype=float)
