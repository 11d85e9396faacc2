"""Direct linear transformation of a frame image with distortion: 11 parameters and up to five coefficients.

    x + dx = (L1 X + L2 Y + L3 Z + L4)/A,   y + dy = (L5 X + L6 Y + L7 Z + L8)/A,   A = L9 X + L10 Y + L11 Z + 1

(Abdel-Aziz & Karara 1971; Ayhan 1996, eqs. 34-36). dx and dy are the corrections of
``factors.cameras.image_corrections`` about a point that is held. L itself gives a principal point (eq. 43), but so
poorly beside the coefficients that an adjustment in which they move it creeps along a valley.

The record is that of ``factors.cameras.plane`` (ground coordinates, image coordinates, whitening) with the centre of
the distortion. Unknowns: L1 to L11, then the coefficients that the setup (2, k) names by their number (0 to 4), in its
steps. Coordinates should be centred and of size 1: with 1000 m of coordinates the form with "+1" is nearly singular.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.cameras.image_corrections import AT, by_coefficient, ideal
from factors.cameras.plane import RECORD as PLANE_RECORD
from factors.cameras.plane import example_record, whiten_rows, whitened
from factors.records import Record

RECORD: Final = Record(**PLANE_RECORD.fields, centre="centre_x centre_y")
#: Coefficients that DLT can have: its 11 parameters hold the affinity already.
N_DISTORTION: Final = 5


@compiled
def _coefficients(setup: Any, x: Any) -> Any:
    c = np.zeros(AT.size, x.dtype)
    for j in range(setup.shape[1]):
        c[int(setup[0, j])] += setup[1, j] * x[11 + j]
    return c


@compiled
def _reduced(record: Any) -> Any:
    """Image coordinates about the centre of the distortion: two numbers."""
    return record[RECORD.u] - record[RECORD.centre_x], record[RECORD.v] - record[RECORD.centre_y]


@compiled
def residual(record: Any, setup: Any, x: Any) -> Any:
    """Whitened residual (2,), computed minus corrected; accepts complex unknowns."""
    a, b, c = record[RECORD.x], record[RECORD.y], record[RECORD.z]
    g = 1.0 / (x[8] * a + x[9] * b + x[10] * c + 1.0)
    u, v = (x[0] * a + x[1] * b + x[2] * c + x[3]) * g, (x[4] * a + x[5] * b + x[6] * c + x[7]) * g
    if setup.shape[1] > 0:
        px, py = _reduced(record)
        qx, qy = ideal(_coefficients(setup, x), px, py)
        u, v = u - (qx - px), v - (qy - py)
    return whitened(record, u, v)


@compiled
def kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 11 + k)."""
    value = residual(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    out = np.zeros((2, 11 + setup.shape[1]))
    a, b, c = record[RECORD.x], record[RECORD.y], record[RECORD.z]
    g = 1.0 / (x[8] * a + x[9] * b + x[10] * c + 1.0)
    for row in range(2):
        f = x[4 * row] * a + x[4 * row + 1] * b + x[4 * row + 2] * c + x[4 * row + 3]
        for k in range(3):
            out[row, 4 * row + k] = record[k] * g
            out[row, 8 + k] = -f * g * g * record[k]
        out[row, 4 * row + 3] = g
    for j in range(setup.shape[1]):
        px, py = _reduced(record)
        dx, dy = by_coefficient(int(setup[0, j]), px, py)
        out[0, 11 + j] = -setup[1, j] * dx
        out[1, 11 + j] = -setup[1, j] * dy
    return value, whiten_rows(record, out)


def _example(rng: np.random.Generator) -> Example:
    x = np.concatenate([rng.normal(size=8), rng.uniform(-0.2, 0.2, 3)])
    codes = np.sort(rng.permutation(N_DISTORTION)[: rng.integers(0, N_DISTORTION + 1)]).astype(float)
    setup = np.ascontiguousarray(np.stack([codes, rng.uniform(0.01, 0.1, len(codes))]))
    record = np.concatenate([example_record(rng), rng.normal(scale=0.2, size=2)])
    return Example(record, setup, (np.concatenate([x, rng.normal(size=len(codes))]),))


DLT = register(Equation(
    "dlt_brown_measured_to_ideal", kernel, residual, (Argument("parameters", "normalised"),), _example,
    "Abdel-Aziz & Karara 1971; Ayhan 1996, eqs. 34-43",
))  # fmt: skip
