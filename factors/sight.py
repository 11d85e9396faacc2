"""The look-angle collinearity of one observation: whitened conditions and their derivatives, as maps on scalars.

A factor and a batch call the same functions (``factors.pushbroom``, ``factors.batch_pushbroom``), which have neither
branches nor calls for a loop of observations of one attitude form, and every operation is rounded as written: both get
the same bits. ``record``, ``d`` and ``ground`` are flat arrays; entry k of observation i stands at ``i + k n``:
constants (34, ``factors.pushbroom``), corrections of EOP and look angles (11), ground point (3).

The derivatives carry the row vector dF/df back through the rotations instead of turning each column forward.
"""

from __future__ import annotations

from typing import Any, Final

from factors import differences, orbital, rotations
from factors._contract import inlined
from factors.sines import sine_cosine

#: Numbers that :func:`store` writes.
STORED: Final = 31


@inlined
def _three(a: Any, i: Any, n: Any) -> Any:
    """Entry ``i`` and the next two, which lie ``n`` apart."""
    return a[i], a[i + n], a[i + 2 * n]


@inlined
def _mount(record: Any, i: Any, n: Any) -> Any:
    """Mounting M (9)."""
    a, b, c = _three(record, i + 9 * n, n), _three(record, i + 12 * n, n), _three(record, i + 15 * n, n)
    return (a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])


@inlined
def _position(record: Any, d: Any, ground: Any, i: Any, n: Any) -> Any:
    """Coordinates of the ground point in the corrected orbital frame: reference, difference; that frame, its scales."""
    p, v, follows = _three(record, i, n), _three(record, i + 3 * n, n), record[i + 26 * n]
    frame, lengths = orbital.reference(p[0], p[1], p[2], v[0], v[1], v[2])
    r, g, at = _three(record, i + 31 * n, n), _three(ground, i, n), _three(record, i + 28 * n, n)
    ref = rotations.multiply_transposed(frame, r[0], r[1], r[2])
    dp, dv = _three(d, i, n), _three(d, i + 3 * n, n)
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
        Entry k of observation i stands at ``i + k n``: constants (34), corrections (11), ground point (3).
    small : bool
        Whether the attitude has the small-angle form (entry 27 of the record).

    Returns
    -------
    value : tuple of 2
        Whitened conditions.
    sight : tuple
        What :func:`derivatives` needs.
    """
    w0, dw, frame, scales = _position(record, d, ground, i, n)
    angles, turns, mount = _three(record, i + 6 * n, n), _three(d, i + 6 * n, n), _mount(record, i, n)
    if small:
        g, dg, turn, d_g = differences.body_from_orbital_small_pair(angles, turns, w0, dw)
    else:
        g, dg, turn, d_g = differences.body_from_orbital_pair(angles, turns, w0, dw)
    f = rotations.multiply_transposed(mount, g[0], g[1], g[2])
    df = rotations.multiply_transposed(mount, dg[0], dg[1], dg[2])
    t_x, d_x = _look(record[i + 19 * n], d[i + 9 * n])
    t_y, d_y = _look(record[i + 20 * n], d[i + 10 * n])
    one = 1.0 / (f[2] + df[2])
    f_y = ((f[0] - t_y * f[2]) + (df[0] - t_y * df[2])) * one - d_y
    f_x = ((f[1] + t_x * f[2]) + (df[1] + t_x * df[2])) * one + d_x
    value = (record[i + 22 * n] * f_y + record[i + 23 * n] * f_x, record[i + 24 * n] * f_y + record[i + 25 * n] * f_x)
    w = (w0[0] + dw[0], w0[1] + dw[1], w0[2] + dw[2])
    at = ((f[0] + df[0]) * one, (f[1] + df[1]) * one, one)
    return value, (w, frame, scales, turn, d_g, mount, at, t_x + d_x, t_y + d_y)


@inlined
def derivatives(record: Any, i: Any, n: Any, seen: Any) -> Any:
    """Derivatives of both conditions by P, V, roll, pitch, yaw (0-8), ground (9-11), psi_x, psi_y: (14,) each."""
    follows = record[i + 26 * n]
    return (
        _row(record[i + 22 * n], record[i + 23 * n], follows, seen),
        _row(record[i + 24 * n], record[i + 25 * n], follows, seen),
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
    return (
        p[0], p[1], p[2], v[0], v[1], v[2], angles[0], angles[1], angles[2], ground[0], ground[1], ground[2],
        b * (1.0 + t_x * t_x), -a * (1.0 + t_y * t_y),
    )  # fmt: skip


@inlined
def _sum(y: Any) -> Any:
    """Sum of a row of derivatives."""
    return (y[0] + y[1] + y[2] + y[3]) + (y[4] + y[5] + y[6] + y[7]) + (y[8] + y[9] + y[10] + y[11]) + (y[12] + y[13])


@inlined
def store(out: Any, i: Any, n: Any, value: Any, rows: Any) -> None:
    """Write the STORED numbers of an observation: conditions, both rows of derivatives, and the sum of all."""
    y, x = rows
    out[i], out[i + n] = value
    (
        out[i + 2 * n], out[i + 3 * n], out[i + 4 * n], out[i + 5 * n], out[i + 6 * n], out[i + 7 * n], out[i + 8 * n],
        out[i + 9 * n], out[i + 10 * n], out[i + 11 * n], out[i + 12 * n], out[i + 13 * n], out[i + 14 * n],
        out[i + 15 * n],
    ) = y  # fmt: skip
    (
        out[i + 16 * n], out[i + 17 * n], out[i + 18 * n], out[i + 19 * n], out[i + 20 * n], out[i + 21 * n],
        out[i + 22 * n], out[i + 23 * n], out[i + 24 * n], out[i + 25 * n], out[i + 26 * n], out[i + 27 * n],
        out[i + 28 * n], out[i + 29 * n],
    ) = x  # fmt: skip
    out[i + 30 * n] = (value[0] + value[1]) + (_sum(y) + _sum(x))
