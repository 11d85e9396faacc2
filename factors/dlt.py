"""Direct linear transformation of a frame image with distortion: 11 parameters and up to five coefficients.

    x + dx = (L1 X + L2 Y + L3 Z + L4)/A,   y + dy = (L5 X + L6 Y + L7 Z + L8)/A,   A = L9 X + L10 Y + L11 Z + 1

(Abdel-Aziz & Karara 1971; Ayhan 1996, eqs. 34-36). dx and dy are the corrections of ``factors.image_corrections``
about a point that is held. L itself gives a principal point (eq. 43), but so poorly beside the coefficients that an
adjustment in which they move it creeps along a valley.

Record (10,): as in ``factors.plane`` ground coordinates, image coordinates, whitening; then the centre of the
distortion. Unknowns: L1 to L11, then the coefficients that the setup (2, k) names by their number (0 to 4), in its
steps. Coordinates should be centred and of size 1: with 1000 m of coordinates the form with "+1" is nearly singular.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.image_corrections import SIZE, by_coefficient, ideal
from factors.plane import example_record, whiten_rows, whitened

#: Coefficients that DLT can have: its 11 parameters hold the affinity already.
N_DISTORTION: Final = 5


@compiled
def _coefficients(setup: Any, x: Any) -> Any:
    c = np.zeros(SIZE, x.dtype)
    for j in range(setup.shape[1]):
        c[int(setup[0, j])] += setup[1, j] * x[11 + j]
    return c


@compiled
def residual(record: Any, setup: Any, x: Any) -> Any:
    """Whitened residual (2,), computed minus corrected; accepts complex unknowns."""
    a, b, c = record[0], record[1], record[2]
    g = 1.0 / (x[8] * a + x[9] * b + x[10] * c + 1.0)
    u, v = (x[0] * a + x[1] * b + x[2] * c + x[3]) * g, (x[4] * a + x[5] * b + x[6] * c + x[7]) * g
    if setup.shape[1] > 0:
        px, py = record[3] - record[8], record[4] - record[9]
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
    g = 1.0 / (x[8] * record[0] + x[9] * record[1] + x[10] * record[2] + 1.0)
    for row in range(2):
        f = x[4 * row] * record[0] + x[4 * row + 1] * record[1] + x[4 * row + 2] * record[2] + x[4 * row + 3]
        for k in range(3):
            out[row, 4 * row + k] = record[k] * g
            out[row, 8 + k] = -f * g * g * record[k]
        out[row, 4 * row + 3] = g
    for j in range(setup.shape[1]):
        dx, dy = by_coefficient(int(setup[0, j]), record[3] - record[8], record[4] - record[9])
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
