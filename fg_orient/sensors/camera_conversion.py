"""Conversion of an interior orientation with its covariance into another program's convention.

Two conventions of the same direction and projection map exactly if the second has all terms in use. Otherwise
the second is fitted to the directions of the first: least squares of the observation equation on a grid
of pixels with equal weights. Covariances follow by the derivatives of the map, or of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from factors.arrays import Array
from factors.cameras import frame_corrections
from fg_orient.model.errors import InputError
from fg_orient.sensors.conventions import (
    OURS,
    POWER,
    Convention,
    Image,
    given_values,
    interior_parameters,
    named,
    require_image,
    with_parameters,
)
from fg_orient.sensors.frame import MEASURED_TO_IDEAL
from fg_orient.sensors.interior import Interior, directions, pixel_grid

#: Step of the complex derivatives.
_STEP: Final = 1e-30
#: Root mean square of the movement of image points in differences, px, far above rounding (1e-13 px) and with third
#: derivatives below 1e-9, because k1 to k4 are hardly separated and magnify both; smallest movement that is used.
_STEP_PX: Final = 3e-4
_SMALLEST: Final = 1e-30


@dataclass(frozen=True, eq=False)
class ConvertedCamera:
    """Camera in another convention.

    Parameters
    ----------
    convention : str
    values : mapping of str to float
        In the order of the program.
    covariance : (k, k) array, optional
        Of all ``values``; those without a counterpart have zero rows.
    interior : Interior
        The same camera for images of fg_orient.
    is_exact : bool
        The conventions map exactly; otherwise the values were fitted.
    rms_px, max_px : float
        Root mean square and largest distance of image points in the two conventions, on a grid of the image.
    at_px : (2,) tuple of float
        Line and sample of the largest distance, (0, 0) is the centre of the first pixel.
    """

    convention: str
    values: Mapping[str, float]
    covariance: Array | None
    interior: Interior
    is_exact: bool
    rms_px: float = 0.0
    max_px: float = 0.0
    at_px: tuple[float, float] = (0.0, 0.0)

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviations by name; empty without covariance."""
        variances = () if self.covariance is None else self.covariance.diagonal()
        return dict(zip(self.values, np.sqrt(variances).tolist(), strict=False))


def convert_camera(
    values: Mapping[str, float], source: str, target: str, *, covariance: npt.ArrayLike | None = None,
    image_size: tuple[int, int] = (0, 0), pixel_mm: float | None = None, r0_mm: float | None = None,
) -> ConvertedCamera:  # fmt: skip
    """Convert an interior orientation with its covariance into another program's convention.

    Parameters
    ----------
    values : mapping of str to float
        Values by the program's names; coefficients that are left out are 0.
    source, target : str
        Names of conventions, see docs/frame-cameras.md.
    covariance : (k, k) array, optional
        Of ``values`` in their order.
    image_size : (n_lines, n_samples), optional
        Needed by conventions that count from the middle of the image, and by conversions that are not exact.
    pixel_mm : float, optional
        Size of a pixel, for conventions in mm.
    r0_mm : float, optional
        Radius of the balanced radial terms.

    Returns
    -------
    ConvertedCamera

    Raises
    ------
    InputError
        A name, value or the covariance is not possible, a needed argument is missing, or the fit has no solution.
    """
    one = named(source)
    image = Image(*image_size, 0.0 if pixel_mm is None else 1.0 / pixel_mm, r0_mm or 0.0)
    require_image(image, one, named(target))
    given, by_name = given_values(values, one, image)
    if covariance is None:
        return converted_interior(one.interior(given, image), target, image)
    by_values = _derivative(lambda v: one.camera(v, image), given) @ by_name
    spread = _covariance(covariance, values, one)
    return converted_interior(one.interior(given, image), target, image, by_values, spread)


def converted_interior(
    interior: Interior, target: str, image: Image, by_values: Array | None = None, covariance: Array | None = None
) -> ConvertedCamera:
    """Convert a camera of fg_orient.

    Parameters
    ----------
    interior : Interior
    target : str
        Name of a convention.
    image : Image
    by_values : (len(OURS), k) array, optional
        Derivatives of the parameters of the camera by k values.
    covariance : (k, k) array, optional
        Of these values.
    """
    two = named(target)
    require_image(image, two)
    spread = np.zeros((0, 0)) if covariance is None else covariance
    by_values = np.zeros((len(OURS), 0)) if by_values is None else by_values
    ours, same = interior_parameters(interior), two.is_of(interior)
    used = (ours != 0.0) | (((by_values @ spread) * by_values).sum(axis=1) > 0.0)
    scale = two.unit_px(image) / float(interior.unit_px or 1.0) if two.direction == MEASURED_TO_IDEAL else 1.0
    factor = np.array([scale ** POWER.get(name, 0) for name in OURS])  # of the change of unit
    if same and two.has(used):
        found = two.values(factor * ours, image)
        by = _derivative(lambda v: two.values(factor * v, image), ours) @ by_values
        left: dict[str, Any] = {"is_exact": True}
    else:
        start = np.where([same or name not in POWER for name in OURS], factor * ours, 0.0)
        found, by, left = _fitted(interior, two, image, two.values(start, image), by_values)
    n, names = len(found), two.names
    full = np.zeros((len(names),) * 2)
    full[:n, :n] = by @ spread @ by.T
    values = dict.fromkeys(names, 0.0) | dict(zip(names, found.tolist(), strict=False))
    return ConvertedCamera(target, values, None if covariance is None else full,
                           two.interior(found, image, interior.name), **left)  # fmt: skip


def _fitted(
    interior: Interior, two: Convention, image: Image, start: Array, by_values: Array
) -> tuple[Array, Array, dict[str, Any]]:
    """Values (k,) that fit best to the directions of a camera, their derivatives (k, n), and the remaining distance."""
    require_image(image, is_fit=True)
    line, sample = pixel_grid(interior)
    shown = [OURS.index(name) for name in two.ours]

    def ground(camera: Interior) -> Array:
        return np.column_stack([directions(camera, line, sample), np.ones(len(line))])

    def rows(values: Array, at: Array) -> tuple[Array, Array]:
        residual, by_ours = _rows(two.interior(values, image), line, sample, at, two.ours)
        by = by_ours @ _derivative(lambda v: two.camera(v, image), values)[shown]
        return residual.ravel(), by.reshape(-1, len(values))

    here = ground(interior)
    # the cost hides the last digits of the values: Newton's step of its gradient, with second derivatives, finds them
    residual: Callable[[Any], Array] = lambda v: rows(v, here)[0]  # noqa: E731
    jacobian: Callable[[Any], Array] = lambda v: rows(v, here)[1]  # noqa: E731
    solved = least_squares(residual, start, jacobian, method="lm", x_scale="jac")
    found = np.asarray(solved.x)
    steps = _STEP_PX / np.sqrt(np.mean(rows(found, here)[1] ** 2, axis=0))

    def gradient(moves: Array, at: Array) -> Array:
        value, design = rows(found + steps * moves, at)
        return np.asarray(value @ design * steps)

    n, k = len(found), by_values.shape[1]
    hessian = _differences(lambda t: gradient(t, here), n)
    found = found - steps * np.linalg.solve(hessian, gradient(np.zeros(n), here))
    camera = two.interior(found, image).camera(np.eye(3), np.zeros(3))
    pixels = frame_corrections.pixels(camera.corrected(), here)
    apart = np.hypot(pixels[:, 0] - line, pixels[:, 1] - sample)
    worst = int(np.argmax(apart))  # the first nan, if there is one
    if not np.isfinite(apart[worst]):
        raise InputError.of(
            "conventions.fit (failure): no camera of this convention fits over the whole image -> choose a convention "
            "of the same projection and direction", place=interior.name, value=two.title,
        )  # fmt: skip
    left = {"rms_px": float(np.sqrt(np.mean(apart**2))), "max_px": float(apart[worst]),
            "at_px": (float(line[worst]), float(sample[worst]))}  # fmt: skip
    by = np.zeros((n, k))
    if k:  # the gradient stays 0 when the values of the source change
        ours, by_own = interior_parameters(interior), _rows(interior, line, sample, here, OURS)[1] @ by_values
        moves = _STEP_PX / np.maximum(np.sqrt(np.mean(by_own**2, axis=(0, 1))), _SMALLEST)
        mixed = _differences(
            lambda t: gradient(np.zeros(n), ground(with_parameters(interior, ours + by_values @ (moves * t)))), k
        )
        by = -steps[:, None] * np.linalg.solve(hessian, mixed) / moves
    return found, by, {"is_exact": False, **left}


def _differences(function: Callable[[Array], Array], n: int) -> Array:
    """Derivatives (m, n) of a function of n numbers at 0 by central differences of step 1."""
    return np.stack([0.5 * (function(e) - function(-e)) for e in np.eye(n)], axis=1)


def _rows(interior: Interior, line: Array, sample: Array, ground: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Residuals (N, 2) px of the observation equation, and their derivatives (N, 2, k) by parameters."""
    own = replace(interior, further={"shear": 0.0, **interior.further})  # the equation with all terms
    return own.camera(np.eye(3), np.zeros(3)).linearised(names, line, sample, ground)


def _derivative(function: Callable[[Any], Any], at: Array) -> Array:
    """Derivatives (m, k) of a function of k numbers by complex steps."""
    steps = 1j * _STEP * np.eye(len(at))
    return np.stack([function(at + step).imag / _STEP for step in steps], axis=1)


def _covariance(covariance: npt.ArrayLike, values: Mapping[str, float], one: Convention) -> Array:
    """Covariance (k, k), symmetric and not negative."""
    out, k = np.asarray(covariance, float), len(values)
    right = out.shape == (k, k) and bool(np.isfinite(out).all())
    if right:
        scale = np.sqrt(np.abs(out.diagonal()))
        scaled = out / np.outer(*(np.where(scale > 0.0, scale, 1.0),) * 2)
        right = np.abs(scaled - scaled.T).max(initial=0.0) <= 1e-9 and np.linalg.eigvalsh(scaled).min(initial=0) > -1e-9
    if not right:
        raise InputError.of(
            "conventions.covariance (failure): this is not a covariance matrix of the values -> give a symmetric "
            "matrix {k} x {k} without negative eigenvalues", place=one.title, value=out.shape, k=k,
        )  # fmt: skip
    return out
