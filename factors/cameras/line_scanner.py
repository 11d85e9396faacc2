"""Images of line scanners without orientation data: 3-D affine, parallel projection, line-scanner DLT.

Records as in ``factors.cameras.plane``: ground coordinates X, Y, Z of a plane coordinate system (source), line and
sample
(target), whitening. All three families keep their form when ground and image coordinates are shifted and scaled axis by
axis, so they are adjusted in normalised coordinates. A line scanner is central along its lines only: the line is
affine in the ground coordinates in all three, the sample is affine, nearly affine, or a quotient.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.cameras.plane import RECORD, example_record, whiten_rows, whitened


@compiled
def _affine(x: Any, first: int, record: Any) -> Any:
    b_x, b_y, b_z = x[first + 1] * record[RECORD.x], x[first + 2] * record[RECORD.y], x[first + 3] * record[RECORD.z]
    return x[first] + b_x + b_y + b_z


@compiled
def _affine_rows(record: Array, width: int) -> Array:
    """Jacobian (2, width) of two affine functions of the ground in the first eight unknowns."""
    out = np.zeros((2, width))
    for row in range(2):
        out[row, 4 * row] = 1.0
        for k in range(3):
            out[row, 4 * row + 1 + k] = record[k]
    return out


@compiled
def residual_affine(record: Any, setup: Any, x: Any) -> Any:
    """``line = a0 + a1 X + a2 Y + a3 Z, sample = b0 + b1 X + b2 Y + b3 Z``."""
    return whitened(record, _affine(x, 0, record), _affine(x, 4, record))


@compiled
def kernel_affine(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 8)."""
    value = residual_affine(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    return value, whiten_rows(record, _affine_rows(record, 8))


@compiled
def residual_parallel(record: Any, setup: Any, x: Any) -> Any:
    """As affine, but ``sample = q/(1 + t q)`` with ``q = b0 + b1 X + b2 Y + b3 Z``; t is unknown 8."""
    q = _affine(x, 4, record)
    return whitened(record, _affine(x, 0, record), q / (1.0 + x[8] * q))


@compiled
def kernel_parallel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 9)."""
    value = residual_parallel(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    q = _affine(x, 4, record)
    g = 1.0 / (1.0 + x[8] * q)
    jacobian = _affine_rows(record, 9)
    for k in range(4, 8):
        jacobian[1, k] *= g * g
    jacobian[1, 8] = -q * q * g * g
    return value, whiten_rows(record, jacobian)


@compiled
def residual_dlt(record: Any, setup: Any, x: Any) -> Any:
    """As affine, but the sample divided by ``1 + c1 X + c2 Y + c3 Z``; unknowns 8 to 10."""
    below = 1.0 + x[8] * record[RECORD.x] + x[9] * record[RECORD.y] + x[10] * record[RECORD.z]
    return whitened(record, _affine(x, 0, record), _affine(x, 4, record) / below)


@compiled
def kernel_dlt(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 11)."""
    value = residual_dlt(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    g = 1.0 / (1.0 + x[8] * record[RECORD.x] + x[9] * record[RECORD.y] + x[10] * record[RECORD.z])
    sample = _affine(x, 4, record) * g
    jacobian = _affine_rows(record, 11)
    for k in range(4, 8):
        jacobian[1, k] *= g
    for k in range(3):
        jacobian[1, 8 + k] = -sample * record[k] * g
    return value, whiten_rows(record, jacobian)


def _example_affine(rng: np.random.Generator) -> Example:
    return Example(example_record(rng), np.zeros((2, 0)), (rng.normal(size=8),))


def _example_parallel(rng: np.random.Generator) -> Example:
    x = np.concatenate([rng.uniform(-1.0, 1.0, 8), rng.uniform(-0.1, 0.1, 1)])
    return Example(example_record(rng), np.zeros((2, 0)), (x,))


def _example_dlt(rng: np.random.Generator) -> Example:
    x = np.concatenate([rng.normal(size=8), rng.uniform(-0.2, 0.2, 3)])
    return Example(example_record(rng), np.zeros((2, 0)), (x,))


AFFINE_PROJECTION = register(Equation(
    "affine_projection", kernel_affine, residual_affine, (Argument("coefficients", "pixel"),), _example_affine,
    "Okamoto 1981; Fraser & Yamakawa 2004",
))  # fmt: skip
PARALLEL_PROJECTION = register(Equation(
    "parallel_projection", kernel_parallel, residual_parallel, (Argument("coefficients", "pixel"),),
    _example_parallel, "Morgan 2004: parallel projection with the perspective-to-parallel term of the scan line",
))  # fmt: skip
LINE_SCANNER_DLT = register(Equation(
    "line_scanner_dlt", kernel_dlt, residual_dlt, (Argument("coefficients", "pixel"),), _example_dlt,
    "Gupta & Hartley 1997: the linear pushbroom camera",
))  # fmt: skip
