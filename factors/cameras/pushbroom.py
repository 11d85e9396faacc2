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

from factors._contract import Argument, Array, Equation, Example, compiled, inlined, register
from factors._plain import FEW_ARRAYS, plain
from factors.cameras.sight import CORRECTION, ROW, STORED, derivatives, sight, store
from factors.cameras.sight import RECORD as RECORD
from factors.geometry import rotations

#: Setup: codes and prior sigmas of the unknowns. Code 3 component + degree for EOP (X Y Z VX VY VZ roll
#: pitch yaw); 27 + 2 k for psi_x and 28 + 2 k for psi_y, coefficient of s^k; CURVE + CURVES component + k for the curve
#: whose value at the observation stands behind the record, at RECORD.size + k.
N_EOP = 27
CURVE, CURVES = 64, 32


@compiled
def corrections(record: Any, setup: Any, x: Any) -> Any:
    """Corrections of the 9 EOP and of psi_x, psi_y at the observation: (11,) physical units, as ``CORRECTION``."""
    d = np.zeros((CORRECTION.size, *record.shape[1:]), x.dtype)
    for j in range(setup.shape[1]):
        code = int(setup[0, j])
        d[_slot(code)] += x[j] * setup[1, j] * _basis(record, code)
    return d


@inlined
def _slot(code: int) -> int:
    """Which of the 9 EOP and 2 look angles a coefficient adds to."""
    if code < N_EOP:
        return code // 3
    return CORRECTION.psi_x + (code - N_EOP) % 2 if code < CURVE else (code - CURVE) // CURVES


@inlined
def _basis(record: Any, code: int) -> Any:
    """Power of tau or of the sample, or value of the curve, that a coefficient belongs to."""
    if code < N_EOP:
        tau, degree = record[RECORD.tau], code % 3
        return 1.0 if degree == 0 else tau if degree == 1 else tau * tau
    if code < CURVE:
        return record[RECORD.s] ** ((code - N_EOP) // 2)
    return record[RECORD.size + (code - CURVE) % CURVES]


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened conditions A (F_y, F_x): (2,); accepts complex unknowns."""
    i, n = np.int64(0), np.int64(1)
    return np.array(sight(record, corrections(record, setup, x), ground, i, n, record[RECORD.small_angle] > 0.5)[0])


def conditions(records: Array, setup: Array, x: Array, ground: Array) -> Array:
    """Residuals of N observations of one image at N ground points: (N, d), (N, 3) -> (N, 2)."""
    if len(records) > FEW_ARRAYS:
        return _conditions(records, setup, x, ground)
    record = np.ascontiguousarray(records.T)  # entries of all observations at once
    with np.errstate(all="ignore"):  # as compiled code does
        d = plain(corrections)(record, setup, x)
        small = record[RECORD.small_angle].any()
        value, _ = plain(sight)(record, d, np.ascontiguousarray(ground.T), 0, 1, small)
    return np.stack(value, axis=1)


@compiled
def _conditions(records: Array, setup: Array, x: Array, ground: Array) -> Array:
    """The same, compiled."""
    out = np.empty((len(records), 2))
    for i in range(len(records)):
        value = residual(records[i], setup, x, ground[i])
        out[i, 0], out[i, 1] = value[0], value[1]
    return out


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row into ``out`` (2, 1 + k + 3).

    Returns False if the sizes do not fit or a value is not finite.
    """
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    i, n = np.int64(0), np.int64(1)  # typed, so that numba makes no variant for each literal
    value, seen = sight(record, corrections(record, setup, x), ground, i, n, record[RECORD.small_angle] > 0.5)
    out[0, 0], out[1, 0] = value
    if want:
        d, line, sample = np.empty(STORED.size), STORED.line_row.start, STORED.sample_row.start
        store(d, i, n, value, derivatives(record, i, n, seen))
        for j in range(k):
            code = int(setup[0, j])
            column = _slot(code)
            column = column if column < CORRECTION.psi_x else column - CORRECTION.psi_x + ROW.psi_x
            factor = _basis(record, code) * setup[1, j]
            out[0, 1 + j], out[1, 1 + j] = d[line + column] * factor, d[sample + column] * factor
        for c in range(3):
            column = ROW.ground.start + c
            out[0, k + 1 + c], out[1, k + 1 + c] = d[line + column], d[sample + column]
    total = 0.0
    for j in range(k + 4 if want else 1):
        total += 0.0 * out[0, j] + 0.0 * out[1, j]
    return total == 0.0


@compiled
def kernel(record: Array, setup: Array, x: Array, ground: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians with respect to the image unknowns (2, k) and the ground point (2, 3)."""
    k = setup.shape[1]
    out = np.full((2, k + 4), np.nan)  # stays nan if sizes do not fit: never uninitialised memory
    fill(record.reshape((1, -1)), np.int64(0), setup, x, ground, out, want)  # a literal 0 compiles fill once more
    if not want:
        return out[:, 0].copy(), np.empty((0, 0)), np.empty((0, 0))
    return out[:, 0].copy(), out[:, 1 : k + 1].copy(), out[:, k + 1 :].copy()


def example(rng: np.random.Generator) -> Example:
    """Build a SPOT-like observation; both kinds of files and both attitude forms occur, and curves."""
    p = rng.normal(size=3)
    p *= 7.2e6 / np.linalg.norm(p)
    v = np.cross(p, rng.normal(size=3))
    v = 7400.0 * v / np.linalg.norm(v) + 8.0 * p / np.linalg.norm(p)
    psi_x, psi_y = rng.uniform(-0.02, 0.02), rng.uniform(-0.4, 0.4)
    ray = rotations.orbital_frames(p[None], v[None])[0] @ np.array([-np.tan(psi_y), np.tan(psi_x), -1.0])
    turn = rotations.attitude_matrices(rng.normal(scale=1e-3, size=(1, 3)), False)[0]
    record = RECORD.pack(
        position=p, velocity=v, angles=rng.normal(scale=1e-3, size=3), mounting=turn.ravel(), tau=rng.uniform(-1, 1),
        look=[psi_x, psi_y], s=rng.uniform(-1, 1), whitening=rng.normal(scale=5e5, size=4),
        follows=rng.integers(0, 2), small_angle=rng.integers(0, 2), reference=np.zeros(3), from_position=8.4e5 * ray,
    )  # fmt: skip
    sigma = np.repeat([[10.0, 1.0, 0.1], [1e-2, 1e-3, 1e-4], [5e-5, 1e-5, 2e-6]], 3, axis=0).ravel()
    codes = np.concatenate([np.arange(N_EOP + 6.0), [CURVE, CURVE + CURVES + 1.0, CURVE + 7.0 * CURVES]])
    setup = np.ascontiguousarray(np.stack([codes, np.concatenate([sigma, np.full(6, 1e-4), [1.0, 1.0, 1e-5]])]))
    unknowns = rng.normal(size=len(codes)), rng.normal(scale=100.0, size=3)
    return Example(np.concatenate([record, rng.normal(size=2)]), setup, unknowns)


LOOK_ANGLE_COLLINEARITY = register(Equation(
    "look_angle_collinearity", kernel, residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Terlemezoğlu 2019, eqs. 2.34, 2.65-2.67; Topan & Maktav 2010, eqs. 11-13", fill,
))  # fmt: skip
