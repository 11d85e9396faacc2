"""Look-angle collinearity of a pushbroom image: the observation equation of the satellite path.

For an image point measured at (line, sample) of ground point G (docs/equations.md 1 to 3 and 7)::

    1 frame       w = R_OG^T (G - P)
    2 attitude    f = M^T R_UY^T w
    3 look angles t_y = tan psi_y, t_x = tan psi_x
    4 conditions  F_y = f1/f3 - t_y,   F_x = f2/f3 + t_x          (T 2.66-2.67 as corrected)
    5 whitening   r = A (F_y, F_x)

P, V and the attitude a = (roll, pitch, yaw) are metadata plus ``c0 + c1 tau + c2 tau^2`` of each of
the 9 components (27 EOP coefficients); R_OG(P, V) is the orbital frame of convention B, R_UY(a) the
attitude, M a constant mounting of the line. psi_x, psi_y are look angles plus ``sum b_k s^k``.

Angles (DIMAP v1): a = file + correction, M = I, R_OG follows the corrected P and V. Quaternions
(DIMAP v2): a = correction, M = R_OG^T R_q with R_OG of the metadata: R_OG R_UY(a) R_OG^T R_q.

A = -S^-1 J^-1, with J = dF/d(line, sample) and the pixel sigmas S: to first order r is adjusted minus
observed pixel, in sigmas. V has an effect through V x P only, so ``dF/dV . V = dF/dV . P = 0``. The remaining
component of V acts as a yaw. Each quantity is computed as a reference (from the metadata) plus a difference
(``d_...``). The rounding error is then relative to the correction and not to the orbit radius: 1e-13 instead
of 1e-9 sigma.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, inlined, is_finite, kernel_of, register
from factors.cameras import pushbroom_record
from factors.cameras.pushbroom_record import CORRECTION, ROW, STORED, correction, corrections, observation, store, three
from factors.cameras.pushbroom_record import RECORD as RECORD
from factors.geometry import differences, orbital, rotations
from factors.geometry.rotations import sine_cosine


@inlined
def _in_frame(observation: Any, changes: Any, ground: Any) -> Any:
    """Map 1: return w in the orbital frame of the metadata, its difference, the corrected frame, and scales."""
    position, velocity, _, _, _, _, follows, reference, from_position = observation
    dp, dv, _, _ = changes
    frame, lengths = orbital.reference(position, velocity)
    w = rotations.multiply_transposed(frame, from_position)
    dg = (ground[0] - reference[0] - dp[0], ground[1] - reference[1] - dp[1], ground[2] - reference[2] - dp[2])
    near = rotations.multiply_transposed(frame, dg)
    dp = rotations.multiply_transposed(frame, (follows * dp[0], follows * dp[1], follows * dp[2]))
    dv = rotations.multiply_transposed(frame, (follows * dv[0], follows * dv[1], follows * dv[2]))
    d_frame, scales = orbital.turned(lengths, dp, dv)
    a = rotations.multiply_transposed(d_frame, (w[0] + near[0], w[1] + near[1], w[2] + near[2]))
    return w, (near[0] + a[0], near[1] + a[1], near[2] + a[2]), rotations.turned(frame, d_frame), scales


@inlined
def _tangent(psi: Any, d_psi: Any) -> Any:
    """Return the tangent of psi and the exact difference tan(psi + d_psi) - tan(psi)."""
    s, less = sine_cosine(psi)
    t = s / (1.0 + less)
    s, less = sine_cosine(d_psi)
    return t, (1.0 + t * t) * s / (1.0 + (less - t * s))


@inlined
def collinearity(observation: Any, changes: Any, ground: Any, small: Any) -> Any:
    """Return the whitened conditions of one observation, for a factor or a batch.

    Parameters
    ----------
    observation, changes : tuples
        Constants and corrections; see ``factors.cameras.pushbroom_record``.
    ground : tuple of 3
        Ground point, m (local).
    small : bool
        True if the attitude has the small-angle form.

    Returns
    -------
    value : tuple of 2
    maps : tuple
        Values and derivatives of maps 1 to 4, for :func:`derivatives`.
    """
    _, _, angles, mounting, look, whitening, _, _, _ = observation
    _, _, d_angles, d_look = changes
    w, dw, frame, scales = _in_frame(observation, changes, ground)
    if small:
        g, dg, attitude, by_angles = differences.body_from_orbital_small_pair(angles, d_angles, w, dw)
    else:
        g, dg, attitude, by_angles = differences.body_from_orbital_pair(angles, d_angles, w, dw)
    f, df = rotations.multiply_transposed(mounting, g), rotations.multiply_transposed(mounting, dg)
    t_x, d_x = _tangent(look[0], d_look[0])
    t_y, d_y = _tangent(look[1], d_look[1])
    inverse = 1.0 / (f[2] + df[2])
    f_y = ((f[0] - t_y * f[2]) + (df[0] - t_y * df[2])) * inverse - d_y
    f_x = ((f[1] + t_x * f[2]) + (df[1] + t_x * df[2])) * inverse + d_x
    value = whitening[0] * f_y + whitening[1] * f_x, whitening[2] * f_y + whitening[3] * f_x
    w = (w[0] + dw[0], w[1] + dw[1], w[2] + dw[2])
    at = ((f[0] + df[0]) * inverse, (f[1] + df[1]) * inverse, inverse)
    return value, (w, frame, scales, attitude, by_angles, at, t_x + d_x, t_y + d_y)


@inlined
def derivatives(observation: Any, maps: Any) -> Any:
    """Return the derivatives of both whitened conditions by P, V, angles, ground point (3 each) and look angles (2)."""
    _, _, _, mounting, _, (a11, a12, a21, a22), follows, _, _ = observation
    return _row(a11, a12, mounting, follows, maps), _row(a21, a22, mounting, follows, maps)


@inlined
def _row(a: Any, b: Any, mounting: Any, follows: Any, maps: Any) -> Any:
    """Return the derivatives of ``r = a F_y + b F_x``, by the chain rule from the last map to the first."""
    w, frame, scales, attitude, by_angles, at, t_x, t_y = maps
    by_look = b * (1.0 + t_x * t_x), -a * (1.0 + t_y * t_y)
    f1, f2 = a * at[2], b * at[2]
    by_f = (f1, f2, -(f1 * at[0] + f2 * at[1]))  # (a, b, -(a f1 + b f2)/f3)/f3
    by_g = rotations.multiply(mounting, by_f)  # f = M^T g
    by_w = rotations.multiply(attitude, by_g)  # g = R_UY^T w
    by_position, by_velocity, by_ground = orbital.row_derivatives(by_w, w, frame, scales, follows)
    return by_position, by_velocity, rotations.multiply(by_angles, by_g), by_ground, by_look


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Return the whitened conditions A (F_y, F_x): (2,); accepts complex unknowns."""
    i, n = np.int64(0), np.int64(1)  # typed, so that numba does not compile each literal
    changes = correction(corrections(record, setup, x), i, n)
    return np.array(
        collinearity(observation(record, i, n), changes, three(ground, i, n), record[RECORD.small_angle] > 0.5)[0]
    )


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    i, n = np.int64(0), np.int64(1)
    constants, changes = observation(record, i, n), correction(corrections(record, setup, x), i, n)
    value, maps = collinearity(constants, changes, three(ground, i, n), record[RECORD.small_angle] > 0.5)
    out[0, 0], out[1, 0] = value
    if want:
        d, line, sample = np.empty(STORED.size), STORED.line_row.start, STORED.sample_row.start
        store(d, i, n, value, derivatives(constants, maps))
        for j in range(k):
            code = int(setup[0, j])
            column = pushbroom_record.slot(code)
            column = column if column < CORRECTION.psi_x else column - CORRECTION.psi_x + ROW.psi_x
            factor = pushbroom_record.basis(record, code) * setup[1, j]
            out[0, 1 + j], out[1, 1 + j] = d[line + column] * factor, d[sample + column] * factor
        for c in range(3):
            column = ROW.ground.start + c
            out[0, k + 1 + c], out[1, k + 1 + c] = d[line + column], d[sample + column]
    return is_finite(out, k + 4 if want else 1)


LOOK_ANGLE_COLLINEARITY = register(Equation(
    "look_angle_collinearity", kernel_of(fill), residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)),
    "Terlemezoğlu 2019, eqs. 2.34, 2.65-2.67; Topan & Maktav 2010, eqs. 11-13", fill,
))  # fmt: skip
