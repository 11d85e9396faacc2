"""Convert an interior orientation and its covariance matrix to another program's convention.

The conversion is exact if two conventions have the same direction and projection, and if
the second one has all terms that are used. Otherwise the second convention is fitted to
the viewing directions of the first one. The fit is a least squares adjustment of the
observation equation on a grid of pixels with equal weights. The covariance matrix is
propagated by the derivatives of the conversion or of the fit.
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

#: Step of the derivatives by complex step.
_STEP: Final = 1e-30
#: Steps of numerical differences are chosen such that image points move by this distance
#: (root mean square), px. It is far above rounding (1e-13 px), and the effect of third
#: derivatives is below 1e-9. Both matter, because k1 to k4 are hardly separable and
#: magnify such errors. The next value is the smallest movement that is used.
_STEP_PX: Final = 3e-4
_SMALLEST: Final = 1e-30


@dataclass(frozen=True, eq=False)
class ConvertedCamera:
    """Camera after its conversion to another convention.

    Parameters
    ----------
    convention : str
    values : mapping of str to float
        Values in the order of the program.
    covariance : (k, k) array, optional
        Covariance matrix of all ``values``. Values without a counterpart have rows of zeros.
    interior : Interior
        The same camera in the convention of fg_orient.
    is_exact : bool
        True: the conversion is exact. False: the values were fitted.
    rms_px, max_px : float
        Root mean square and largest distance between image points of the two conventions,
        on a grid over the image.
    at_px : (2,) tuple of float
        Line and sample of the largest distance; (0, 0) is the centre of the first pixel.
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
        """Return the standard deviations by name; empty without a covariance matrix."""
        variances = () if self.covariance is None else self.covariance.diagonal()
        return dict(zip(self.values, np.sqrt(variances).tolist(), strict=False))


def convert_camera(
    values: Mapping[str, float], source: str, target: str, *, covariance: npt.ArrayLike | None = None,
    image_size: tuple[int, int] = (0, 0), pixel_mm: float | None = None, r0_mm: float | None = None,
) -> ConvertedCamera:  # fmt: skip
    """Convert an interior orientation and its covariance matrix to another program's convention.

    Parameters
    ----------
    values : mapping of str to float
        Values by the names of the program. Missing coefficients are 0.
    source, target : str
        Names of conventions; see docs/frame-cameras.md.
    covariance : (k, k) array, optional
        Covariance matrix of ``values`` in their order.
    image_size : (n_lines, n_samples), optional
        Size of the image. Conventions that count from the middle of the image need it,
        and also conversions that are not exact.
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
        A name, a value or the covariance matrix is invalid, a required argument is
        missing, or the fit has no solution.
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
    """Convert a camera of fg_orient to another convention.

    Parameters
    ----------
    interior : Interior
    target : str
        Name of a convention.
    image : Image
    by_values : (len(OURS), k) array, optional
        Derivatives of the camera's parameters with respect to k values.
    covariance : (k, k) array, optional
        Covariance matrix of these values.
    """
    two = named(target)
    require_image(image, two)
    spread = np.zeros((0, 0)) if covariance is None else covariance
    by_values = np.zeros((len(OURS), 0)) if by_values is None else by_values
    ours, same = interior_parameters(interior), two.is_of(interior)
    used = (ours != 0.0) | (((by_values @ spread) * by_values).sum(axis=1) > 0.0)
    scale = two.unit_px(image) / float(interior.unit_px or 1.0) if two.direction == MEASURED_TO_IDEAL else 1.0
    factor = np.array([scale ** POWER.get(name, 0) for name in OURS])  # factors of the change of unit
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
    """Fit the values (k,) to the viewing directions of a camera.

    Also return their derivatives (k, n) and the remaining distances.
    """
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
    # near the minimum the cost is flat, so that the last digits of the values are lost: a
    # Newton step with second derivatives, which sets the gradient to zero, restores them
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
    worst = int(np.argmax(apart))  # argmax gives the first nan, if there is one
    if not np.isfinite(apart[worst]):
        raise InputError.of(
            "conventions.fit (failure): no camera of this convention fits over the whole image -> choose a convention "
            "of the same projection and direction", place=interior.name, value=two.title,
        )  # fmt: skip
    left = {"rms_px": float(np.sqrt(np.mean(apart**2))), "max_px": float(apart[worst]),
            "at_px": (float(line[worst]), float(sample[worst]))}  # fmt: skip
    by = np.zeros((n, k))
    if k:  # when the values of the source change, the gradient must remain 0: this gives the derivatives
        ours, by_own = interior_parameters(interior), _rows(interior, line, sample, here, OURS)[1] @ by_values
        moves = _STEP_PX / np.maximum(np.sqrt(np.mean(by_own**2, axis=(0, 1))), _SMALLEST)
        mixed = _differences(
            lambda t: gradient(np.zeros(n), ground(with_parameters(interior, ours + by_values @ (moves * t)))), k
        )
        by = -steps[:, None] * np.linalg.solve(hessian, mixed) / moves
    return found, by, {"is_exact": False, **left}


def _differences(function: Callable[[Array], Array], n: int) -> Array:
    """Compute derivatives (m, n) of a function of n numbers at 0 by central differences with step 1."""
    return np.stack([0.5 * (function(e) - function(-e)) for e in np.eye(n)], axis=1)


def _rows(interior: Interior, line: Array, sample: Array, ground: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Return residuals (N, 2), px, of the observation equation, and their derivatives (N, 2, k) by the parameters."""
    # a further coefficient, even if it is 0, selects the equation with all terms
    own = replace(interior, further={"shear": 0.0, **interior.further})
    return own.camera(np.eye(3), np.zeros(3)).linearised(names, line, sample, ground)


def _derivative(function: Callable[[Any], Any], at: Array) -> Array:
    """Compute derivatives (m, k) of a function of k numbers by complex steps."""
    steps = 1j * _STEP * np.eye(len(at))
    return np.stack([function(at + step).imag / _STEP for step in steps], axis=1)


def _covariance(covariance: npt.ArrayLike, values: Mapping[str, float], one: Convention) -> Array:
    """Return the covariance matrix (k, k).

    Refuse it if it is not symmetric or has negative eigenvalues.
    """
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
