"""Direct linear transformation of a frame image with distortion: 11 parameters and up to five coefficients.

    x + dx = (L1 X + L2 Y + L3 Z + L4)/A,   y + dy = (L5 X + L6 Y + L7 Z + L8)/A,   A = L9 X + L10 Y + L11 Z + 1

(Abdel-Aziz & Karara 1971; Ayhan 1996, eqs. 34-36). dx and dy are the corrections of
``factors.cameras.image_corrections`` about a fixed point. L1 to L11 also determine a principal point (eq.
43). It is not used as the centre of dx and dy: the points hardly separate it from the coefficients, and an
adjustment would converge very slowly.

The record contains the fields of ``factors.cameras.plane`` (ground coordinates, image coordinates, whitening) and the
centre of distortion. The unknowns are L1 to L11, followed by the coefficients whose numbers (0 to 4) and steps are in
the setup (2, k). Coordinates should be centred and of size 1: with coordinates of 1000 m the form with "+1" is nearly
singular.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, register
from factors._plain import plain
from factors.cameras.image_corrections import AT, ideal, terms
from factors.cameras.plane import RECORD as PLANE_RECORD
from factors.cameras.plane import whiten_rows, whitened
from factors.records import Record

RECORD: Final = Record(**PLANE_RECORD.fields, centre="centre_x centre_y")
#: Number of possible coefficients: the 11 parameters already contain the affinity.
N_DISTORTION: Final = 5


def _numerators(record: Any, x: Any) -> tuple[Any, Any, Any]:
    """Return both numerators and 1/A."""
    a, b, c = record[..., RECORD.x], record[..., RECORD.y], record[..., RECORD.z]
    below = x[8] * a + x[9] * b + x[10] * c + 1.0
    return x[0] * a + x[1] * b + x[2] * c + x[3], x[4] * a + x[5] * b + x[6] * c + x[7], 1.0 / below


def _reduced(record: Any) -> Any:
    """Return the image coordinates about the centre of distortion: two numbers."""
    return record[..., RECORD.u] - record[..., RECORD.centre_x], record[..., RECORD.v] - record[..., RECORD.centre_y]


def residual(record: Any, setup: Any, x: Any) -> Any:
    """Return the whitened residual (..., 2): computed minus corrected; accepts complex unknowns."""
    u, v, g = _numerators(record, x)
    u, v = u * g, v * g
    if setup.shape[1] > 0:
        c = np.zeros(AT.size, x.dtype)
        np.add.at(c, setup[0].astype(np.intp), setup[1] * x[11:])
        px, py = _reduced(record)
        qx, qy = plain(ideal)(c, px, py)
        u, v = u - (qx - px), v - (qy - py)
    return whitened(record, u, v)


def kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Return the residual (..., 2) and Jacobian (..., 2, 11 + k)."""
    value = residual(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    out = np.zeros((*record.shape[:-1], 2, 11 + setup.shape[1]))
    *numerators, g = _numerators(record, x)
    for row, f in enumerate(numerators):
        for k in range(3):
            out[..., row, 4 * row + k] = record[..., k] * g
            out[..., row, 8 + k] = -f * g * g * record[..., k]
        out[..., row, 4 * row + 3] = g
    by_coefficient = plain(terms)(*_reduced(record))
    for j, (code, step) in enumerate(setup.T):
        dx, dy = by_coefficient[:, int(code)]
        out[..., 0, 11 + j], out[..., 1, 11 + j] = -step * dx, -step * dy
    return value, whiten_rows(record, out)


DLT = register(Equation(
    "dlt_brown_measured_to_ideal", kernel, residual, (Argument("parameters", "normalised"),),
    "Abdel-Aziz & Karara 1971; Ayhan 1996, eqs. 34-43", arrays=True,
))  # fmt: skip
