"""Collinearity of a frame image in an inertial frame, with right ascension, declination and twist as unknowns.

For an image point with ideal coordinates (u, v) on the focal plane, that is without distortion, of ground point G::

    1 camera       P = C_0 + dC (inertial axes),  R = F R3(twist) R1(90 deg - dec) R3(90 deg + ra)
    2 collinearity q = R (T G - P),  T: inertial axes from the axes of the ground
    3 difference   d = f (q1/q3, q2/q3) - (u, v)
    4 whitening    r = W d

R1, R3 are rotations of the axes, F is a fixed rotation that follows the three angles. f is negative for a
camera that looks against its third axis. Distortion and detector are constants: they give (u, v) from the
measured pixel. These are the unknowns of ISIS jigsaw (Edmundson et al. 2012) for images of one exposure. The
record contains the projection centre in ground axes, so that it has the same local origin as the ground
point: ``q = R (T (G - C_0) - dC)``.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, inlined, is_finite, kernel_of, register
from factors.geometry.rotations import multiply, multiply_transposed
from factors.records import Record

#: Ideal coordinates mm; W of line and sample, 1/mm; ra, dec, twist rad; T and F row-major; the projection centre in
#: ground axes minus the local origin, m; focal length mm.
RECORD: Final = Record(
    ideal="u v", whitening="w11 w12 w21 w22", angles="ra dec twist", inertial="t11 t12 t13 t21 t22 t23 t31 t32 t33",
    mounting="f11 f12 f13 f21 f22 f23 f31 f32 f33", centre="x y z", focal=1,
)  # fmt: skip
#: Setup: codes of the unknowns and their prior sigmas: projection centre in inertial axes m, angles rad.
UNKNOWN: Final = Record(position="px py pz", angles="a1 a2 a3")
N_UNKNOWNS: Final = UNKNOWN.size


@inlined
def inertial(record: Any) -> Any:
    """Return the rotation T: nine numbers, row-major."""
    return (
        record[RECORD.t11], record[RECORD.t12], record[RECORD.t13], record[RECORD.t21], record[RECORD.t22],
        record[RECORD.t23], record[RECORD.t31], record[RECORD.t32], record[RECORD.t33],
    )  # fmt: skip


@inlined
def mounting(record: Any) -> Any:
    """Return the rotation F: nine numbers, row-major."""
    return (
        record[RECORD.f11], record[RECORD.f12], record[RECORD.f13], record[RECORD.f21], record[RECORD.f22],
        record[RECORD.f23], record[RECORD.f31], record[RECORD.f32], record[RECORD.f33],
    )  # fmt: skip


@compiled
def unknowns(setup: Any, x: Any) -> Any:
    """Return the corrections (6,), in physical units, for unknowns (k,) in prior sigmas."""
    d = np.zeros(N_UNKNOWNS, x.dtype)
    for j in range(setup.shape[1]):
        d[int(setup[0, j])] += setup[1, j] * x[j]
    return d


@compiled
def turns(record: Any, d: Any) -> Any:
    """Return sine and cosine of the three rotations about the third, first, third axis: six numbers."""
    first = 0.5 * np.pi + record[RECORD.ra] + d[UNKNOWN.a1]
    second = 0.5 * np.pi - record[RECORD.dec] - d[UNKNOWN.a2]
    third = record[RECORD.twist] + d[UNKNOWN.a3]
    return np.sin(first), np.cos(first), np.sin(second), np.cos(second), np.sin(third), np.cos(third)


@compiled
def seen(record: Any, d: Any, gx: Any, gy: Any, gz: Any) -> Any:
    """Return the vector T (G - C_0) - dC (3) in inertial axes."""
    x, y, z = multiply(inertial(record), (gx - record[RECORD.x], gy - record[RECORD.y], gz - record[RECORD.z]))
    return x - d[UNKNOWN.px], y - d[UNKNOWN.py], z - d[UNKNOWN.pz]


@compiled
def rotated(turn: Any, p: Any) -> Any:
    """Return the vector after the rotation about the third axis, after two rotations, and after all three."""
    s1, c1, s2, c2, s3, c3 = turn
    a = c1 * p[0] + s1 * p[1], -s1 * p[0] + c1 * p[1], p[2]
    b = a[0], c2 * a[1] + s2 * a[2], -s2 * a[1] + c2 * a[2]
    return a, b, (c3 * b[0] + s3 * b[1], -s3 * b[0] + c3 * b[1], b[2])


@compiled
def whitened(record: Any, q: Any) -> Any:
    """Return the result of maps 3 and 4 for a vector in camera axes: two numbers."""
    f = record[RECORD.focal] / q[2]
    u, v = f * q[0] - record[RECORD.u], f * q[1] - record[RECORD.v]
    return record[RECORD.w11] * u + record[RECORD.w12] * v, record[RECORD.w21] * u + record[RECORD.w22] * v


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Return the whitened residual (2,); accepts complex unknowns."""
    d = unknowns(setup, x)
    p = seen(record, d, ground[0], ground[1], ground[2])
    line, sample = whitened(record, multiply(mounting(record), rotated(turns(record, d), p)[2]))
    return np.array([line, sample])


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    d = unknowns(setup, x)
    turn = turns(record, d)
    a, b, c = rotated(turn, seen(record, d, ground[0], ground[1], ground[2]))
    q = multiply(mounting(record), c)
    out[0, 0], out[1, 0] = whitened(record, q)
    if want:
        for i in range(2):
            _row(record, turn, (a, b, c, q), i, setup, out)
    return is_finite(out, k + 4 if want else 1)


@compiled
def _row(record: Array, turn: Any, vectors: Any, i: int, setup: Array, out: Array) -> None:
    """Write the derivatives of row i, computed by the chain rule from the camera axes back to the ground."""
    s1, c1, s2, c2, s3, c3 = turn
    a, b, c, q = vectors
    f = record[RECORD.focal] / q[2]
    w1, w2 = record[RECORD.w11], record[RECORD.w12]
    if i == 1:
        w1, w2 = record[RECORD.w21], record[RECORD.w22]
    by_q = f * w1, f * w2, -f * (w1 * q[0] + w2 * q[1]) / q[2]
    g = multiply_transposed(mounting(record), by_q)
    by_twist = g[0] * c[1] - g[1] * c[0]
    g = c3 * g[0] - s3 * g[1], s3 * g[0] + c3 * g[1], g[2]
    by_second = g[1] * b[2] - g[2] * b[1]
    g = g[0], c2 * g[1] - s2 * g[2], s2 * g[1] + c2 * g[2]
    by_first = g[0] * a[1] - g[1] * a[0]
    g = c1 * g[0] - s1 * g[1], s1 * g[0] + c1 * g[1], g[2]
    d = -g[0], -g[1], -g[2], by_first, -by_second, by_twist
    k = setup.shape[1]
    for j in range(k):
        out[i, 1 + j] = d[int(setup[0, j])] * setup[1, j]
    out[i, 1 + k], out[i, 2 + k], out[i, 3 + k] = multiply_transposed(inertial(record), g)


FRAME_ANGLES = register(Equation(
    "frame_angles", kernel_of(fill), residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)),
    "Edmundson et al. 2012 (ISIS jigsaw), ISPRS Annals I-4, 203-208", fill,
))  # fmt: skip
