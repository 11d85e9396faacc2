"""Convert pixels to ideal coordinates on the focal plane of a camera, by detector and distortion.

A detector is an affine map between pixels and millimetres on the focal plane: ``detector
sample = centre + t0 + t1 x + t2 y``, as in the image support data (ISD) of ALE. A
distortion converts measured to ideal coordinates, mm. Newton's method computes its
inverse. Models and names are taken from USGSCSM; the model "metric" is used for metric cameras in ISIS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.errors import InputError

#: Steps of Newton's method, and its tolerance: mm, and a share of the coordinates for a detector in pixels.
STEPS: Final = 30
TOLERANCE_MM: Final = 1e-12
ROUNDING: Final = 4.0 * float(np.finfo(float).eps)
#: Step of complex derivatives, mm.
_H: Final = 1e-30
#: Names of the distortion models, and their numbers of coefficients.
MODELS: Final = {"none": 0, "radial": 3, "transverse": 20, "metric": 8, "radtan": 6}


_TO_MEASURED: Final = ("transverse", "radtan")


@dataclass(frozen=True)
class Distortion:
    """Distortion model of a camera with its coefficients.

    Parameters
    ----------
    model : str
        "none"; "radial": ideal = m (1 - k0 - k1 r^2 - k2 r^4); "transverse": m =
        polynomials of degree 3 in the ideal coordinates, 10 coefficients of x, then of y;
        "metric": Conrady-Brown of ISIS's metric cameras, with coefficients xp, yp, k1,
        k2, k3, j1, j2, t0 (mm, rad); "radtan": measured = Brown's polynomials in ideal
        coordinates divided by the focal length, coefficients k1, k2, p1, p2, k3 as in
        OpenCV, and the focal length, mm.
    coefficients : tuple of float
    """

    model: str = "none"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError.of("isd.distortion", place="distortion", value=self.model, known=", ".join(MODELS))
        expected, given = MODELS[self.model], np.array(self.coefficients, float)
        if given.shape != (expected,) or not np.isfinite(given).all():
            raise InputError.of("isd.coefficients", place="distortion", value=f"{len(self.coefficients)} coefficients",
                                model=self.model, expected=expected)  # fmt: skip

    def ideal(self, measured_mm: Array) -> Array:
        """Convert measured coordinates (n, 2) to ideal coordinates (n, 2), mm."""
        if self.model in _TO_MEASURED:
            return self._solved(measured_mm, self._distorted)
        return self._forward(measured_mm)

    def measured(self, ideal_mm: Array) -> Array:
        """Convert ideal coordinates (n, 2) to measured coordinates (n, 2), mm; nan if there is no solution."""
        return self._distorted(ideal_mm) if self.model in _TO_MEASURED else self._solved(ideal_mm, self._forward)

    def mirrored(self) -> Distortion:
        """Return the distortion of a camera whose first axis has the opposite direction."""
        c = np.array(self.coefficients)
        if self.model == "transverse":
            odd = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])  # signs by the power of x
            c = np.concatenate([-odd * c[:10], odd * c[10:]])
        if self.model == "metric":
            c[[0, 7]] *= -1.0
        if self.model == "radtan":
            c[3] *= -1.0
        return replace(self, coefficients=tuple(c.tolist()))

    def _distorted(self, xy: Array) -> Array:
        """Compute measured coordinates, for models that are functions of the ideal coordinates, as in USGSCSM."""
        x, y = xy.T
        if self.model == "radtan":
            k1, k2, p1, p2, k3, focal = self.coefficients
            x, y = x / focal, y / focal
            r = x * x + y * y
            radial = 1.0 + r * (k1 + r * (k2 + r * k3))
            u = x * radial + 2.0 * p1 * x * y + p2 * (r + 2.0 * x * x)
            v = y * radial + 2.0 * p2 * x * y + p1 * (r + 2.0 * y * y)
            return focal * np.stack([u, v], axis=1)
        terms = np.stack([0.0 * x + 1.0, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1)
        return np.asarray(terms @ np.array(self.coefficients).reshape(2, 10).T)

    def _forward(self, xy: Array) -> Array:
        """Compute ideal coordinates, for models that are functions of the measured coordinates."""
        c = self.coefficients
        if self.model == "radial":
            r = np.sum(xy**2, axis=1)
            return np.asarray(xy * (1.0 - (c[0] + r * (c[1] + r * c[2])))[:, None])
        if self.model == "metric":
            x, y = (xy - np.array(c[:2])).T
            r = x * x + y * y
            radial, tangential = 1.0 + r * (c[2] + r * (c[3] + r * c[4])), r * (c[5] + r * c[6])
            return np.stack([x * radial - tangential * np.sin(c[7]), y * radial + tangential * np.cos(c[7])], axis=1)
        return xy

    def _solved(self, wanted: Array, function: Callable[[Array], Array]) -> Array:
        """Find the arguments (n, 2) of a function that give the values ``wanted`` (n, 2).

        Newton's method is used, with derivatives by complex steps.
        """
        xy = np.array(wanted, float)
        enough = max(TOLERANCE_MM, ROUNDING * float(np.abs(wanted).max(initial=0.0)))
        for _ in range(STEPS):
            at = function(xy)
            (a, c), (b, d) = (function(xy + 1j * _H * axis).imag.T / _H for axis in np.eye(2))
            u, v = (wanted - at).T
            with np.errstate(all="ignore"):
                step = np.stack([d * u - b * v, a * v - c * u], axis=1) / (a * d - b * c)[:, None]
            xy = xy + step
            if not np.abs(step).max(initial=0.0) > enough:
                return np.asarray(xy)
        return np.where(np.abs(step) > enough, np.nan, xy)


@dataclass(frozen=True)
class Detector:
    """Affine map between pixels of an image and millimetres on the focal plane.

    Parameters
    ----------
    centre : (2,) tuple
        Line and sample of the detector that are the origin of the affine maps; 0.5 is the
        centre of the first pixel.
    lines, samples : (3,) tuples
        Coefficients of ``detector line - centre = lines . (1, x, y)``, and of the same form for the
        samples; pixels, and pixels per mm.
    summing : (2,) tuple
        Numbers of detector lines and samples in one image pixel.
    start : (2,) tuple
        Detector line and sample at which the image begins.
    """

    centre: tuple[float, float]
    lines: tuple[float, float, float]
    samples: tuple[float, float, float]
    summing: tuple[float, float] = (1.0, 1.0)
    start: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def per_mm(self) -> Array:
        """Return image lines and samples (2, 2) per mm of x and y."""
        return np.asarray(np.array([self.lines[1:], self.samples[1:]]) / np.array(self.summing)[:, None])

    def millimetres(self, line: Array, sample: Array) -> Array:
        """Convert pixels (n,) to measured coordinates (n, 2), mm; 0 is the centre of the first pixel."""
        return np.asarray((np.stack([line, sample], axis=1) - self._origin) @ np.linalg.inv(self.per_mm).T)

    def pixels(self, measured_mm: Array) -> tuple[Array, Array]:
        """Convert measured coordinates (n, 2), mm, to lines and samples (n,)."""
        line, sample = (measured_mm @ self.per_mm.T + self._origin).T
        return line, sample

    @cached_property
    def _origin(self) -> Array:
        """Return line and sample of the image at x = y = 0."""
        first = np.array([self.lines[0], self.samples[0]])
        return np.asarray((np.array(self.centre) + first - self.start) / np.array(self.summing) - 0.5)
