"""The look-angle collinearity of one observation: whitened conditions and their derivatives, as maps on scalars.

A factor and a batch call the same functions (``factors.cameras.pushbroom``, ``fg_orient.kernels.batch_pushbroom``),
which have neither branches nor calls for a loop of observations of one attitude form, and every operation is rounded as
written: both get the same bits. ``record``, ``d`` and ``ground`` are flat arrays; entry k of observation i stands at
``i + k n``: constants (``RECORD``), corrections of EOP and look angles (``CORRECTION``), ground point (3).

The derivatives carry the row vector dF/df back through the rotations instead of turning each column forward.
"""

from __future__ import annotations

from typing import Any, Final

from factors._contract import inlined
from factors.geometry import differences, orbital, rotations
from factors.geometry.sines import sine_cosine
from factors.records import Record

#: P m, V m/s, angles rad, M row-major; tau, look angles rad, s; A row-major; whether the frame follows P and V and the
#: attitude has the small-angle form (1/0); reference ground point m (local), the same minus P m (ECEF axes).
RECORD: Final = Record(
    position=3, velocity=3, angles=3, mounting="m11 m12 m13 m21 m22 m23 m31 m32 m33", tau=1, look="psi_x psi_y", s=1,
    whitening="a11 a12 a21 a22", follows=1, small_angle=1, reference=3, from_position=3,
)  # fmt: skip
#: Corrections: m, m/s, rad.
CORRECTION: Final = Record(position=3, velocity=3, angles=3, look="psi_x psi_y")
#: Derivatives of one condition.
ROW: Final = Record(position=3, velocity=3, angles=3, ground=3, look="psi_x psi_y")
#: What :func:`store` writes: whitened conditions, their derivatives, the sum of all.
STORED: Final = Record(line=1, sample=1, line_row=ROW.size, sample_row=ROW.size, total=1)


@inlined
def _three(a: Any, i: Any, n: Any) -> Any:
    """Entry ``i`` and the next two, which lie ``n`` apart."""
    j = i + n
    return a[i], a[j], a[j + n]


@inlined
def _write_three(a: Any, i: Any, n: Any, values: Any) -> None:
    """Write entry ``i`` and the next two, which lie ``n`` apart."""
    j = i + n
    a[i], a[j], a[j + n] = values


@inlined
def _mounting(record: Any, i: Any, n: Any) -> Any:
    """Mounting M (9)."""
    a, b = _three(record, i + RECORD.m11 * n, n), _three(record, i + RECORD.m21 * n, n)
    return a + b + _three(record, i + RECORD.m31 * n, n)


@inlined
def _position(record: Any, d: Any, ground: Any, i: Any, n: Any) -> Any:
    """Coordinates of the ground point in the corrected orbital frame: reference, difference; that frame, its scales."""
    p, v = _three(record, i + RECORD.position.start * n, n), _three(record, i + RECORD.velocity.start * n, n)
    frame, lengths = orbital.reference(p[0], p[1], p[2], v[0], v[1], v[2])
    r, at = _three(record, i + RECORD.from_position.start * n, n), _three(record, i + RECORD.reference.start * n, n)
    g, follows = _three(ground, i, n), record[i + RECORD.follows * n]
    ref = rotations.multiply_transposed(frame, r[0], r[1], r[2])
    dp, dv = _three(d, i + CORRECTION.position.start * n, n), _three(d, i + CORRECTION.velocity.start * n, n)
    near = rotations.multiply_transposed(frame, g[0] - at[0] - dp[0], g[1] - at[1] - dp[1], g[2] - at[2] - dp[2])
    dp = rotations.multiply_transposed(frame, follows * dp[0], follows * dp[1], follows * dp[2])
    dv = rotations.multiply_transposed(frame, follows * dv[0], follows * dv[1], follows * dv[2])
    turned, scales = orbital.turned(lengths, dp, dv)
    a = rotations.multiply_transposed(turned, ref[0] + near[0], ref[1] + near[1], ref[2] + near[2])
    return ref, (near[0] + a[0], near[1] + a[1], near[2] + a[2]), rotations.turned(frame, turned), scales


@inlined
def _look(psi: Any, b: Any) -> Any:
    """Tangent of psi, and its exact difference to that of psi + b."""
    s, less = sine_cosine(psi)
    t = s / (1.0 + less)
    s, less = sine_cosine(b)
    return t, (1.0 + t * t) * s / (1.0 + (less - t * s))


@inlined
def sight(record: Any, d: Any, ground: Any, i: Any, n: Any, small: Any) -> Any:
    """Observation ``i`` of arrays whose entries lie ``n`` apart: the equation itself, for a factor and for a batch.

    Every operation is rounded as written, so that both get the same bits.

    Parameters
    ----------
    record, d, ground : flat arrays
        Entry k of observation i stands at ``i + k n``: ``RECORD``, ``CORRECTION``, ground point (3).
    small : bool
        Whether the attitude has the small-angle form.

    Returns
    -------
    value : tuple of 2
        Whitened conditions.
    sight : tuple
        What :func:`derivatives` needs.
    """
    w0, dw, frame, scales = _position(record, d, ground, i, n)
    angles, turns = _three(record, i + RECORD.angles.start * n, n), _three(d, i + CORRECTION.angles.start * n, n)
    mount = _mounting(record, i, n)
    if small:
        g, dg, turn, d_g = differences.body_from_orbital_small_pair(angles, turns, w0, dw)
    else:
        g, dg, turn, d_g = differences.body_from_orbital_pair(angles, turns, w0, dw)
    f = rotations.multiply_transposed(mount, g[0], g[1], g[2])
    df = rotations.multiply_transposed(mount, dg[0], dg[1], dg[2])
    t_x, d_x = _look(record[i + RECORD.psi_x * n], d[i + CORRECTION.psi_x * n])
    t_y, d_y = _look(record[i + RECORD.psi_y * n], d[i + CORRECTION.psi_y * n])
    one = 1.0 / (f[2] + df[2])
    f_y = ((f[0] - t_y * f[2]) + (df[0] - t_y * df[2])) * one - d_y
    f_x = ((f[1] + t_x * f[2]) + (df[1] + t_x * df[2])) * one + d_x
    value = (
        record[i + RECORD.a11 * n] * f_y + record[i + RECORD.a12 * n] * f_x,
        record[i + RECORD.a21 * n] * f_y + record[i + RECORD.a22 * n] * f_x,
    )
    w = (w0[0] + dw[0], w0[1] + dw[1], w0[2] + dw[2])
    at = ((f[0] + df[0]) * one, (f[1] + df[1]) * one, one)
    return value, (w, frame, scales, turn, d_g, mount, at, t_x + d_x, t_y + d_y)


@inlined
def derivatives(record: Any, i: Any, n: Any, seen: Any) -> Any:
    """Derivatives of both conditions by P, V, angles, ground point (3 each) and look angles (2): nested tuples."""
    follows = record[i + RECORD.follows * n]
    return (
        _row(record[i + RECORD.a11 * n], record[i + RECORD.a12 * n], follows, seen),
        _row(record[i + RECORD.a21 * n], record[i + RECORD.a22 * n], follows, seen),
    )


@inlined
def _row(a: Any, b: Any, follows: Any, seen: Any) -> Any:
    """Derivatives of ``a F_y + b F_x``: the row vector dF/df is carried back through the rotations."""
    w, frame, scales, turn, d_g, mount, at, t_x, t_y = seen
    f1, f2 = a * at[2], b * at[2]
    g = rotations.multiply(mount, f1, f2, -(f1 * at[0] + f2 * at[1]))
    c = rotations.multiply(turn, g[0], g[1], g[2])
    angles = rotations.multiply(d_g, g[0], g[1], g[2])
    p, v, ground = orbital.row_derivatives(c, w, frame, scales, follows)
    return p, v, angles, ground, (b * (1.0 + t_x * t_x), -a * (1.0 + t_y * t_y))


@inlined
def _sum(y: Any) -> Any:
    """Sum of a row of derivatives."""
    p, v, a, g, look = y
    return (p[0] + p[1] + p[2] + v[0]) + (v[1] + v[2] + a[0] + a[1]) + (a[2] + g[0] + g[1] + g[2]) + (look[0] + look[1])


@inlined
def _write_row(out: Any, i: Any, n: Any, row: Any) -> None:
    """Write the derivatives of a condition from entry ``i`` on, as ``ROW``."""
    p, v, angles, ground, look = row
    _write_three(out, i + ROW.position.start * n, n, p)
    _write_three(out, i + ROW.velocity.start * n, n, v)
    _write_three(out, i + ROW.angles.start * n, n, angles)
    _write_three(out, i + ROW.ground.start * n, n, ground)
    out[i + ROW.psi_x * n], out[i + ROW.psi_y * n] = look


@inlined
def store(out: Any, i: Any, n: Any, value: Any, rows: Any) -> None:
    """Write the numbers of an observation, as ``STORED``."""
    line, sample = rows
    out[i + STORED.line * n], out[i + STORED.sample * n] = value
    _write_row(out, i + STORED.line_row.start * n, n, line)
    _write_row(out, i + STORED.sample_row.start * n, n, sample)
    out[i + STORED.total * n] = (value[0] + value[1]) + (_sum(line) + _sum(sample))
