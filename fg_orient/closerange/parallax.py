"""Parallax equations of a stereo pair in the normal case: no turns, a base along x.

Coordinates as in Ayhan 1996: X right, Y away from the cameras, Z up; image x right, z up about the principal points.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.fitting import as_points
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]


def normal_case(
    left: npt.ArrayLike, right: npt.ArrayLike, base_m: float, focal: float, focal_right: float | None = None,
    station_m: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Array:  # fmt: skip
    """Points of a stereo pair.

    Parameters
    ----------
    left, right : (n, 2) arrays
        Ideal x, z of the points, about the principal points.
    base_m : float
    focal, focal_right : float
        Principal distances c1, c2, in the unit of the image coordinates; c2 = c1 if not given.
    station_m : (3,) array
        X0, Y0, Z0 of the left photo.

    Returns
    -------
    (n, 3) array
        X, Y, Z in m.

    Raises
    ------
    InputError
        A parallax that is not above 0, or values that are not possible.

    Notes
    -----
    Ayhan 1996, eqs. 29 and 30: Y - Y0 = b c1 c2/(x1 c2 - x2 c1), X - X0 = (Y - Y0) x1/c1, Z - Z0 = (Y - Y0) z1/c1.
    """
    first, second = as_points(left, 2, "left", InputError.of), as_points(right, 2, "right", InputError.of)
    other = focal if focal_right is None else focal_right
    for place, value in (("base_m", base_m), ("focal", focal), ("focal_right", other)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError.of("closerange.camera", place=place, value=value, expected="a number above 0")
    parallax = first[:, 0] * other - second[:, 0] * focal
    bad = np.flatnonzero(~(parallax > 0.0))
    if len(bad):
        raise InputError.of("closerange.parallax", place=f"point {bad[0] + 1}", value=parallax[bad[0]])
    depth = base_m * focal * other / parallax
    away = np.column_stack([depth * first[:, 0] / focal, depth, depth * first[:, 1] / focal])
    return np.asarray(away + np.asarray(station_m, float))


def turned_about_z(image: npt.ArrayLike, focal: float, phi: float) -> Array:
    """Image of the normal case (n, 2) of a photo turned by ``phi`` (rad) about the vertical.

    Ayhan 1996, eq. 27: x' = c (x cos phi - c sin phi)/(x sin phi + c cos phi), z' = c z/(same).
    """
    x, z = as_points(image, 2, "image", InputError.of).T
    below = x * np.sin(phi) + focal * np.cos(phi)
    return np.asarray(focal * np.column_stack([x * np.cos(phi) - focal * np.sin(phi), z]) / below[:, None])
