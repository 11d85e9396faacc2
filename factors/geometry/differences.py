"""Attitudes applied to vectors, as a reference plus an exact difference.

A vector of the orbital frame has 16 digits. Its rounding error is 1e-16 of the orbit
radius. This causes a noise of 1e-9 sigma in each residual, which changes the 8th digit of
a sum of squares. Therefore the attitude applied to ``v + dv`` with angles ``a + da`` is
split into its value at the reference (a, v) and the exact difference, which is computed
from small quantities only. The sum of both equals the attitude times ``v + dv`` up to
rounding, but the difference alone has 16 correct digits.
"""

from __future__ import annotations

from typing import Any

from factors._contract import inlined
from factors.geometry import rotations
from factors.geometry.rotations import Matrix, Vector, sine_cosine


@inlined
def _sines(a: Any, da: Any) -> Any:
    """Return sine and cosine of ``a``, and their changes from ``a`` to ``a + da``."""
    s, less = sine_cosine(a)
    ds, dc = sine_cosine(da)
    c = 1.0 + less
    return s, c, s * dc + c * ds, c * dc - s * ds


@inlined
def _turn(sines: Any, u: Any, v: Any, du: Any, dv: Any) -> Any:
    """Return (c u + s v, -s u + c v), with c, s of a + da, as reference and difference."""
    s, c, ds, dc = sines
    s2, c2 = s + ds, c + dc
    return c * u + s * v, c * v - s * u, c2 * du + s2 * dv + (dc * u + ds * v), c2 * dv - s2 * du + (dc * v - ds * u)


@inlined
def body_from_orbital_pair(angles: Vector, d: Vector, w: Vector, dw: Vector) -> tuple[Vector, Vector, Matrix, Matrix]:
    """Return the attitude ``f = R_UY(angles + d)^T (w + dw)`` as reference and difference, and its derivatives.

    Parameters
    ----------
    angles, d : tuples of 3
        Roll, pitch, yaw (rad), and their corrections.
    w, dw : tuples of 3
        Vector in the orbital frame: reference and difference.

    Returns
    -------
    f, df : tuples of 3
        Reference and difference.
    turn : tuple of 9
        R_UY(angles + d), row-major.
    d_f : tuple of 9
        Derivatives of f + df by roll, pitch and yaw, in this order.
    """
    roll, pitch, yaw = _sines(angles[0], d[0]), _sines(angles[1], d[1]), _sines(angles[2], d[2])
    sr, cr, sp, cp = roll[0] + roll[2], roll[1] + roll[3], pitch[0] + pitch[2], pitch[1] + pitch[3]
    sy, cy = yaw[0] + yaw[2], yaw[1] + yaw[3]
    y, z, dy, dz = _turn(pitch, w[1], w[2], dw[1], dw[2])
    y_p, z_p = y + dy, z + dz
    z, x, dz, dx = _turn(roll, z, w[0], dz, dw[0])
    x_r, z_r = x + dx, z + dz
    x, y, dx, dy = _turn(yaw, x, y, dx, dy)
    d_f = (
        -cy * z_r, sy * z_r, x_r,
        cy * sr * y_p + sy * z_p, cy * z_p - sy * sr * y_p, -cr * y_p,
        y + dy, -(x + dx), 0.0 * dx,
    )  # fmt: skip
    return (x, y, z), (dx, dy, dz), rotations.from_sines(sr, cr, sp, cp, sy, cy), d_f


@inlined
def body_from_orbital_small_pair(
    angles: Vector, d: Vector, w: Vector, dw: Vector
) -> tuple[Vector, Vector, Matrix, Matrix]:
    """Return the same as :func:`body_from_orbital_pair`, for the transposed small-angle matrix I + [a]x."""
    r, p, y = angles
    r2, p2, y2 = r + d[0], p + d[1], y + d[2]
    reference = (w[0] + y * w[1] - r * w[2], w[1] - y * w[0] + p * w[2], w[2] + r * w[0] - p * w[1])
    difference = (
        dw[0] + y2 * dw[1] - r2 * dw[2] + d[2] * w[1] - d[0] * w[2],
        dw[1] - y2 * dw[0] + p2 * dw[2] - d[2] * w[0] + d[1] * w[2],
        dw[2] + r2 * dw[0] - p2 * dw[1] + d[0] * w[0] - d[1] * w[1],
    )
    w1, w2, w3 = w[0] + dw[0], w[1] + dw[1], w[2] + dw[2]
    zero = 0.0 * w1
    d_f = (-w3, zero, w1, zero, w3, -w2, w2, -w1, zero)
    return reference, difference, rotations.orbital_from_body_small(r2, p2, y2), d_f
