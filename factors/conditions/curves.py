"""Observation of a ground point on a known line or spline in object space: control by linear features.

    r = (n_1 . (G - c(t)) / s_1,  n_2 . (G - c(t)) / s_2),   c'(t) . (G - c(t)) = 0

c(t) is the foot point of G on the curve; n_1 = c' x a / |c' x a| and n_2 = n_1 x c' / |c'| are normals of the
curve. With a = up, n_1 is horizontal. The image point on the feature is an ordinary image point of G. The
position of G along the curve is free, so each image point gives one condition. For a straight line this
condition is equivalent to the coplanarity of the ray with the line (Mulawa & Mikhail 1988; Habib et al.
2003).

A curve is a sequence of cubic segments, each with t from 0 to 1. The setup (K, 12) contains the coefficients of t^0 to
t^3 of each segment, m. A straight line is one segment of degree 1. The first and the last segment continue beyond their
ends.

A block has at most some hundred such observations, so the kernels are plain numpy without compilation.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, register_condition
from factors.records import Record

#: Reference direction a, and the standard deviations s_1 and s_2, m.
RECORD: Final = Record(axis=3, sigma=2)
#: A segment is divided into this number of parts; the search for the nearest point begins at
#: their ends. The second number is the largest number of steps of the search.
_PARTS: Final = 4
_STEPS: Final = 30
#: Change of t at which the search ends. :func:`residual` makes one more step, whose error is the square of this.
_CLOSE: Final = 1e-9


def curve(segment: Array, t: Any) -> tuple[Any, Any, Any]:
    """Return the point c (3,) of a segment (12,), and its derivatives c' and c'' by t."""
    a, b, c, d = segment.reshape(4, 3)
    return a + t * (b + t * (c + t * d)), b + t * (2.0 * c + 3.0 * t * d), 2.0 * c + 6.0 * t * d


def foot(setup: Array, ground: Array) -> tuple[int, float]:
    """Return the segment of a curve (K, 12), and its t, nearest to a ground point (3,)."""
    ends = np.linspace(0.0, 1.0, _PARTS + 1)
    samples = np.einsum("pj,kji->kpi", ends[:, None] ** np.arange(4), setup.reshape(-1, 4, 3)) - ground
    nearest = int(np.argmin(np.sum(samples**2, axis=2)))
    k, t, last = nearest // len(ends), float(ends[nearest % len(ends)]), len(setup) - 1
    for _ in range(_STEPS):
        c, first, second = curve(setup[k], t)
        speed, bend = float(first @ first), float(second @ (c - ground))
        # if the point is far from a strongly curved segment, Newton's step would move away from the foot point
        step = float(first @ (ground - c)) / (speed + bend if speed + bend > 0.1 * speed else speed)
        t += step if last == 0 else min(max(step, -0.5), 0.5)
        if t > 1.0 and k < last:
            k, t = k + 1, 0.0
        elif t < 0.0 and k > 0:
            k, t = k - 1, 1.0
        elif abs(step) <= _CLOSE:
            break
    return k, t


def _normals(first: Any, axis: Array) -> tuple[Any, Any, Any, Any]:
    """Return normals n_1 and n_2, length of ``c' x a``, and unit tangent; accepts complex numbers."""
    across, speed = np.cross(first, axis), np.sqrt(first @ first)
    length = np.sqrt(across @ across)
    return across / length, np.cross(across / length, first / speed), length, first / speed


def residual(record: Any, setup: Any, ground: Any) -> Any:
    """Return the distances (2,) from the curve along both normals, in their sigmas; accepts a complex ground point."""
    k, t = foot(setup, np.real(ground))
    c, first, second = curve(setup[k], t)
    at = t + first @ (ground - c) / (first @ first + second @ (c - ground))
    c, first, _ = curve(setup[k], at)
    n_1, n_2, _, _ = _normals(first, record[RECORD.axis])
    return np.stack([n_1 @ (ground - c), n_2 @ (ground - c)]) / record[RECORD.sigma]


def jacobian(record: Array, setup: Array, value: Array, ground: Array) -> Array:
    """Return the Jacobian (2, 3): the normals, and their rotation as the foot point moves."""
    k, t = foot(setup, ground)
    c, first, second = curve(setup[k], t)
    axis, d = record[RECORD.axis], ground - c
    n_1, n_2, length, tangent = _normals(first, axis)
    across = np.cross(second, axis)
    by_t_1 = (across - n_1 * (n_1 @ across)) / length
    by_t_tangent = (second - tangent * (tangent @ second)) / np.sqrt(first @ first)
    by_t_2 = np.cross(by_t_1, tangent) + np.cross(n_1, by_t_tangent)
    t_by_ground = first / (first @ first - second @ d)
    rows = np.stack([n_1 + (by_t_1 @ d) * t_by_ground, n_2 + (by_t_2 @ d) * t_by_ground])
    return np.asarray(rows / record[RECORD.sigma][:, None])


CURVE_CONTROL: Final = register_condition(
    "curve_control", residual, jacobian, (Argument("ground", "m", is_point=True),),
    "Mulawa & Mikhail 1988; Habib et al. 2003", n_constants=RECORD.size)  # fmt: skip
