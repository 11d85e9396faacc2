"""Observations of ground points: control points and heights.

``control_point``: residual ``W (G - G_0)`` of a ground point observed with covariance ``C = (W^T W)^-1``, W upper
triangular. :func:`whitening` rotates sigmas in East, North, Up to the axes of the unknown (docs/equations.md 7,
stochastic weights).

``height_control``: height of a ground point observed in an elevation model, as a plane near the point::

    residual = n . (G - G_0) / sigma,   n = up - slope_east east - slope_north north

G_0 is the point of the elevation model at the position of the ground point. The residual is therefore the
height of G above the plane. The planes are updated until the points have converged; the height then agrees
with the model.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, compiled, register_condition
from factors.records import Record

#: W row-major, G_0 m.
POINT: Final = Record(whitening="w11 w12 w13 w21 w22 w23 w31 w32 w33", place="x y z")
#: Record of an observed height: n / sigma; G_0, m.
HEIGHT: Final = Record(normal="n1 n2 n3", place="x y z")


def whitening(covariance: Array) -> Array:
    """Return the upper triangular W with ``W^T W = C^-1`` for a covariance (k, k).

    Raises
    ------
    ValueError
        The covariance is not symmetric or not positive definite.
    """
    scale = np.abs(covariance).max()
    if not np.isfinite(scale) or np.abs(covariance - covariance.T).max() > 1e-12 * scale:
        raise ValueError("the covariance is not symmetric and finite")
    try:
        return np.ascontiguousarray(np.linalg.cholesky(np.linalg.inv(covariance)).T)
    except np.linalg.LinAlgError as error:
        raise ValueError("the covariance is not positive definite") from error


@compiled
def whitened(record: Any, d: Any) -> Any:
    """Return the product W d (3,)."""
    return np.array([
        record[POINT.w11] * d[0] + record[POINT.w12] * d[1] + record[POINT.w13] * d[2],
        record[POINT.w21] * d[0] + record[POINT.w22] * d[1] + record[POINT.w23] * d[2],
        record[POINT.w31] * d[0] + record[POINT.w32] * d[1] + record[POINT.w33] * d[2],
    ])  # fmt: skip


@compiled
def residual_point(record: Any, setup: Any, ground: Any) -> Any:
    """Return ``W (G - G_0)``: (3,)."""
    return whitened(record, ground - record[POINT.place])


def jacobian_point(record: Array, setup: Array, value: Array, ground: Array) -> Array:
    """Return the Jacobian (3, 3) of an observed ground point."""
    return np.array(record[POINT.whitening]).reshape((3, 3))


@compiled
def residual_height(record: Any, setup: Any, ground: Any) -> Any:
    """Return ``n . (G - G_0) / sigma``: (1,)."""
    d0, d1, d2 = ground[0] - record[HEIGHT.x], ground[1] - record[HEIGHT.y], ground[2] - record[HEIGHT.z]
    return np.array([record[HEIGHT.n1] * d0 + record[HEIGHT.n2] * d1 + record[HEIGHT.n3] * d2])


def jacobian_height(record: Array, setup: Array, value: Array, ground: Array) -> Array:
    """Return the Jacobian (1, 3) of an observed height."""
    return np.array(record[HEIGHT.normal]).reshape((1, 3))


_GROUND: Final = Argument("ground", "m", is_point=True)
_SOURCE: Final = "docs/equations.md 7, stochastic weights"
CONTROL_POINT = register_condition(
    "control_point", residual_point, jacobian_point, (_GROUND,), _SOURCE, n_constants=POINT.size
)
HEIGHT_CONTROL = register_condition(
    "height_control", residual_height, jacobian_height, (_GROUND,), _SOURCE, n_constants=HEIGHT.size
)
