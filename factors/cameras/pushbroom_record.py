"""Layout of the arrays of look-angle collinearity: constants, corrections, derivatives, and codes of the coefficients.

A factor and a batch (``fg_orient.kernels.batch``) read the same arrays: entry k of observation i is at ``i + k n`` of a
flat array. All functions are scalar maps without branches or calls, so that a loop over observations becomes vector
instructions. Operations are not fused or reordered, so factor and batch give the same bits.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import compiled, inlined
from factors.records import Record

#: Units: position m, velocity m/s, angles and look angles rad; matrices row by row. ``follows`` is 1 if
#: the orbital frame changes with position and velocity, otherwise 0; ``small_angle`` is 1 if the
#: attitude has the small-angle form. ``reference`` is a ground point in local coordinates, m;
#: ``from_position`` is its difference from the position in ECEF axes, m.
RECORD: Final = Record(
    position=3, velocity=3, angles=3, mounting="m11 m12 m13 m21 m22 m23 m31 m32 m33", tau=1, look="psi_x psi_y", s=1,
    whitening="a11 a12 a21 a22", follows=1, small_angle=1, reference=3, from_position=3,
)  # fmt: skip
#: Corrections in m, m/s and rad.
CORRECTION: Final = Record(position=3, velocity=3, angles=3, look="psi_x psi_y")
#: Derivatives of one condition.
ROW: Final = Record(position=3, velocity=3, angles=3, ground=3, look="psi_x psi_y")
#: Results written by :func:`store`: whitened conditions, their derivatives, and the sum of all.
STORED: Final = Record(line=1, sample=1, line_row=ROW.size, sample_row=ROW.size, total=1)
#: Setup: codes and prior sigmas of the unknowns. The code is 3 component + degree for EOP (X Y Z VX VY VZ
#: roll pitch yaw); 27 + 2 k for psi_x and 28 + 2 k for psi_y (coefficient of s^k). For curve k of a component
#: the code is CURVE + CURVES component + k. The value of the curve at the observation is stored after the
#: record, at RECORD.size + k.
N_EOP = 27
CURVE, CURVES = 64, 32


@compiled
def corrections(record: Any, setup: Any, x: Any) -> Any:
    """Return the corrections (11,) of the 9 EOP and of psi_x, psi_y at the observation, in units of ``CORRECTION``."""
    d = np.zeros((CORRECTION.size, *record.shape[1:]), x.dtype)
    for j in range(setup.shape[1]):
        code = int(setup[0, j])
        d[slot(code)] += x[j] * setup[1, j] * basis(record, code)
    return d


@inlined
def slot(code: int) -> int:
    """Return the number of the EOP (0 to 8) or look angle (9, 10) to which a coefficient is added."""
    if code < N_EOP:
        return code // 3
    return CORRECTION.psi_x + (code - N_EOP) % 2 if code < CURVE else (code - CURVE) // CURVES


@inlined
def basis(record: Any, code: int) -> Any:
    """Return the factor of a coefficient: power of tau or of the sample, or value of the curve."""
    if code < N_EOP:
        tau, degree = record[RECORD.tau], code % 3
        return 1.0 if degree == 0 else tau if degree == 1 else tau * tau
    if code < CURVE:
        return record[RECORD.s] ** ((code - N_EOP) // 2)
    return record[RECORD.size + (code - CURVE) % CURVES]


@inlined
def three(a: Any, i: Any, n: Any) -> Any:
    """Return entry ``i`` and the next two, with stride ``n``."""
    j = i + n
    return a[i], a[j], a[j + n]


@inlined
def observation(record: Any, i: Any, n: Any) -> Any:
    """Return the constants of observation i: P, V, angles, M, look angles, A, follows (1 or 0), G_0, G_0 - P."""
    a, b = three(record, i + RECORD.m11 * n, n), three(record, i + RECORD.m21 * n, n)
    return (
        three(record, i + RECORD.position.start * n, n), three(record, i + RECORD.velocity.start * n, n),
        three(record, i + RECORD.angles.start * n, n), a + b + three(record, i + RECORD.m31 * n, n),
        (record[i + RECORD.psi_x * n], record[i + RECORD.psi_y * n]),
        (record[i + RECORD.a11 * n], record[i + RECORD.a12 * n],
         record[i + RECORD.a21 * n], record[i + RECORD.a22 * n]),
        record[i + RECORD.follows * n], three(record, i + RECORD.reference.start * n, n),
        three(record, i + RECORD.from_position.start * n, n),
    )  # fmt: skip


@inlined
def correction(d: Any, i: Any, n: Any) -> Any:
    """Return the corrections of observation i: of P, V, angles and look angles."""
    return (
        three(d, i + CORRECTION.position.start * n, n), three(d, i + CORRECTION.velocity.start * n, n),
        three(d, i + CORRECTION.angles.start * n, n), (d[i + CORRECTION.psi_x * n], d[i + CORRECTION.psi_y * n]),
    )  # fmt: skip


@inlined
def _sum(y: Any) -> Any:
    """Return the sum of the derivatives of one quantity by all unknowns."""
    p, v, a, g, look = y
    return (p[0] + p[1] + p[2] + v[0]) + (v[1] + v[2] + a[0] + a[1]) + (a[2] + g[0] + g[1] + g[2]) + (look[0] + look[1])


@inlined
def _write_three(a: Any, i: Any, n: Any, values: Any) -> None:
    """Write entry ``i`` and the next two, with stride ``n``."""
    j = i + n
    a[i], a[j], a[j + n] = values


@inlined
def _write_row(out: Any, i: Any, n: Any, row: Any) -> None:
    """Write the derivatives of a condition from entry ``i`` on, in the order of ``ROW``."""
    p, v, angles, ground, look = row
    _write_three(out, i + ROW.position.start * n, n, p)
    _write_three(out, i + ROW.velocity.start * n, n, v)
    _write_three(out, i + ROW.angles.start * n, n, angles)
    _write_three(out, i + ROW.ground.start * n, n, ground)
    out[i + ROW.psi_x * n], out[i + ROW.psi_y * n] = look


@inlined
def store(out: Any, i: Any, n: Any, value: Any, rows: Any) -> None:
    """Write value and derivatives of an observation in the order of ``STORED``."""
    line, sample = rows
    out[i + STORED.line * n], out[i + STORED.sample * n] = value
    _write_row(out, i + STORED.line_row.start * n, n, line)
    _write_row(out, i + STORED.sample_row.start * n, n, sample)
    out[i + STORED.total * n] = (value[0] + value[1]) + (_sum(line) + _sum(sample))
