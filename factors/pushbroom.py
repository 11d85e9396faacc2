"""Look-angle collinearity of a pushbroom image: the observation equation of the satellite path.

For an image point measured at (line, sample) of ground point G::

    w = R_OG^T (G - P),   f = M^T R_UY^T w,
    F_y = f1/f3 - tan psi_y,   F_x = f2/f3 + tan psi_x          (T 2.66-2.67 as corrected)

P, V and the attitude a = (roll, pitch, yaw) are metadata plus ``c0 + c1 tau + c2 tau^2`` of each of
the 9 components (27 EOP coefficients); R_OG(P, V) is the orbital frame of convention B, R_UY(a) the
attitude, M a constant mounting of the line; psi_x, psi_y are look angles plus ``sum b_k s^k``.

Angles (DIMAP v1): a = file + correction, M = I, R_OG follows the corrected P and V. Quaternions
(DIMAP v2): a = correction, M = R_OG^T R_q with R_OG of the metadata: R_OG R_UY(a) R_OG^T R_q.

Whitening: the residual is ``A F``, A = S^-1 J^-1, J = dF/d(line, sample), S the pixel sigmas: a unit
is one sigma of a pixel coordinate. V enters through V x P only: ``dF/dV . V = dF/dV . P = 0``; the
rest is a yaw (docs/equations.md 3). Everything is formed as reference (metadata) plus difference, so
that rounding is relative to the correction and not to the orbit radius: 1e-13 instead of 1e-9 sigma.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors import differences, orbital, rotations
from factors._contract import Argument, Array, Equation, Example, compiled, register

#: Record: P 0:3 m, V 3:6 m/s, angles 6:9 rad, M 9:18 row-major, tau 18, psi_x 19, psi_y 20, s 21,
#: A 22:26 row-major, frame follows P and V 26 (1/0), small-angle form 27 (1/0), reference ground point
#: 28:31 m (local) and the same minus P 31:34 m (ECEF axes).
RECORD_SIZE = 34
#: Setup: codes and prior sigmas of the unknowns. Code 3 component + degree for EOP (X Y Z VX VY VZ roll
#: pitch yaw); 27 + 2 k for psi_x and 28 + 2 k for psi_y, coefficient of s^k.
N_EOP = 27


@compiled
def corrections(record: Any, setup: Any, x: Any) -> Any:
    """Corrections of the 9 EOP and of psi_x, psi_y at the observation: (11,) physical units."""
    tau, s = record[18], record[21]
    d = np.zeros(11, x.dtype)
    for j in range(setup.shape[1]):
        code = int(setup[0, j])
        if code < N_EOP:
            d[code // 3] += x[j] * setup[1, j] * tau ** (code % 3)
        else:
            d[9 + (code - N_EOP) % 2] += x[j] * setup[1, j] * s ** ((code - N_EOP) // 2)
    return d


@compiled
def _sight(record: Any, d: Any, ground: Any) -> Any:
    """Orbital frame, w in it (total), f in the body frame as reference and difference."""
    frame = rotations.ecef_from_orbital(record[0], record[1], record[2], record[3], record[4], record[5])
    ref = rotations.multiply_transposed(frame, record[31], record[32], record[33])
    gx, gy, gz = ground[0] - record[28] - d[0], ground[1] - record[29] - d[1], ground[2] - record[30] - d[2]
    dw = rotations.multiply_transposed(frame, gx, gy, gz)
    if record[26] > 0.5:
        turned = differences.d_ecef_from_orbital(frame, record[0:6], d)
        a = rotations.multiply_transposed(turned, record[31] + gx, record[32] + gy, record[33] + gz)
        dw = (dw[0] + a[0], dw[1] + a[1], dw[2] + a[2])
        frame = rotations.add(frame, turned)
    else:
        frame = rotations.scaled(frame, 1.0 + 0.0 * d[0])
    w = (ref[0] + dw[0], ref[1] + dw[1], ref[2] + dw[2])
    if record[27] > 0.5:
        g0, dg = differences.body_from_orbital_small_pair(record[6:9], d[6:9], ref, dw)
    else:
        g0, dg = differences.body_from_orbital_pair(record[6:9], d[6:9], ref, dw)
    f = rotations.multiply_transposed(record[9:18], g0[0], g0[1], g0[2])
    return frame, w, f, rotations.multiply_transposed(record[9:18], dg[0], dg[1], dg[2])


@compiled
def _misclosure(record: Any, d: Any, f: Any, df: Any) -> Any:
    """Whitened conditions from f (reference and difference): a pair."""
    t_x, t_y = np.tan(record[19]), np.tan(record[20])
    b_x, b_y = np.tan(d[9]), np.tan(d[10])
    # tan(psi + b) - tan(psi), exact for small b
    d_x, d_y = (1.0 + t_x * t_x) * b_x / (1.0 - t_x * b_x), (1.0 + t_y * t_y) * b_y / (1.0 - t_y * b_y)
    f3 = f[2] + df[2]
    f_y = ((f[0] - t_y * f[2]) + (df[0] - t_y * df[2])) / f3 - d_y
    f_x = ((f[1] + t_x * f[2]) + (df[1] + t_x * df[2])) / f3 + d_x
    return record[22] * f_y + record[23] * f_x, record[24] * f_y + record[25] * f_x


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened conditions A (F_y, F_x): (2,); accepts complex unknowns."""
    d = corrections(record, setup, x)
    _, _, f, df = _sight(record, d, ground)
    return np.array(_misclosure(record, d, f, df))


@compiled
def conditions(records: Array, setup: Array, x: Array, ground: Array) -> Array:
    """Residuals of N observations of one image at N ground points: (N, 34), (N, 3) -> (N, 2)."""
    out = np.empty((len(records), 2))
    for i in range(len(records)):
        out[i] = residual(records[i], setup, x, ground[i])
    return out


@compiled
def fill(records: Array, row: int, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row into ``out`` (2, 1 + k + 3); no allocation.

    Returns False if the sizes do not fit or a value is not finite.
    """
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    e = corrections(record, setup, x)
    frame, w, f0, f1 = _sight(record, e, ground)
    out[0, 0], out[1, 0] = _misclosure(record, e, f0, f1)
    if want:
        f = (f0[0] + f1[0], f0[1] + f1[1], f0[2] + f1[2])
        d = _line_derivatives(record, e, frame, w, f)
        for j in range(k):
            code = int(setup[0, j])
            if code < N_EOP:
                column, factor = code // 3, record[18] ** (code % 3) * setup[1, j]
            else:
                column, factor = 12 + (code - N_EOP) % 2, record[21] ** ((code - N_EOP) // 2) * setup[1, j]
            out[0, 1 + j], out[1, 1 + j] = d[0, column] * factor, d[1, column] * factor
        out[:, k + 1 :] = d[:, 9:12]
    total = 0.0
    for j in range(k + 4 if want else 1):
        total += 0.0 * out[0, j] + 0.0 * out[1, j]
    return total == 0.0


@compiled
def _line_derivatives(record: Array, e: Array, frame: Any, w: Any, f: Any) -> Array:
    """Whitened derivatives with respect to P, V, attitude (0-8), ground (9-11), psi_x, psi_y: (2, 14)."""
    for c in range(9):
        e[c] += record[c]
    e[9] += record[19]
    e[10] += record[20]
    if record[27] > 0.5:
        attitude = rotations.orbital_from_body_small(e[6], e[7], e[8])
        d_attitude = rotations.d_orbital_from_body_small()
    else:
        attitude = rotations.orbital_from_body(e[6], e[7], e[8])
        d_attitude = rotations.d_orbital_from_body(e[6], e[7], e[8])
    dw = orbital.coordinate_derivatives(e, frame, w, record[26] > 0.5)
    d = np.empty((2, 14))
    for c in range(12):
        if 6 <= c < 9:
            g = rotations.multiply_transposed(d_attitude[c - 6], w[0], w[1], w[2])
        else:
            k = c if c < 6 else c - 3
            g = rotations.multiply_transposed(attitude, dw[0, k], dw[1, k], dw[2, k])
        df = rotations.multiply_transposed(record[9:18], g[0], g[1], g[2])
        d_y = (df[0] - f[0] / f[2] * df[2]) / f[2]
        d_x = (df[1] - f[1] / f[2] * df[2]) / f[2]
        d[0, c], d[1, c] = record[22] * d_y + record[23] * d_x, record[24] * d_y + record[25] * d_x
    sec2_x, sec2_y = 1.0 / np.cos(e[9]) ** 2, 1.0 / np.cos(e[10]) ** 2
    d[0, 12], d[1, 12] = record[23] * sec2_x, record[25] * sec2_x
    d[0, 13], d[1, 13] = -record[22] * sec2_y, -record[24] * sec2_y
    return d


@compiled
def kernel(record: Array, setup: Array, x: Array, ground: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians with respect to the image unknowns (2, k) and the ground point (2, 3)."""
    k = setup.shape[1]
    out = np.full((2, k + 4), np.nan)  # stays nan if sizes do not fit: never uninitialised memory
    fill(record.reshape((1, -1)), 0, setup, x, ground, out, want)
    if not want:
        return out[:, 0].copy(), np.empty((0, 0)), np.empty((0, 0))
    return out[:, 0].copy(), out[:, 1 : k + 1].copy(), out[:, k + 1 :].copy()


def example(rng: np.random.Generator) -> Example:
    """Build a SPOT-like observation; both kinds of files and both attitude forms occur."""
    p = rng.normal(size=3)
    p *= 7.2e6 / np.linalg.norm(p)
    v = np.cross(p, rng.normal(size=3))
    v = 7400.0 * v / np.linalg.norm(v) + 8.0 * p / np.linalg.norm(p)
    psi_x, psi_y = rng.uniform(-0.02, 0.02), rng.uniform(-0.4, 0.4)
    ray = rotations.orbital_frames(p[None], v[None])[0] @ np.array([-np.tan(psi_y), np.tan(psi_x), -1.0])
    turn = rotations.attitude_matrices(rng.normal(scale=1e-3, size=(1, 3)), False)[0]
    record = np.concatenate([
        p, v, rng.normal(scale=1e-3, size=3), turn.ravel(), rng.uniform(-1, 1, 1), [psi_x, psi_y],
        rng.uniform(-1, 1, 1), rng.normal(scale=5e5, size=4), rng.integers(0, 2, 2).astype(float),
        np.zeros(3), 8.4e5 * ray,
    ])  # fmt: skip
    sigma = np.repeat([[10.0, 1.0, 0.1], [1e-2, 1e-3, 1e-4], [5e-5, 1e-5, 2e-6]], 3, axis=0).ravel()
    setup = np.ascontiguousarray(np.stack([np.arange(N_EOP + 6.0), np.append(sigma, np.full(6, 1e-4))]))
    return Example(record, setup, (rng.normal(size=N_EOP + 6), rng.normal(scale=100.0, size=3)))


LOOK_ANGLE_COLLINEARITY = register(Equation(
    "look_angle_collinearity", kernel, residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Terlemezoğlu 2019, eqs. 2.34, 2.65-2.67; Topan & Maktav 2010, eqs. 11-13", fill,
))  # fmt: skip
