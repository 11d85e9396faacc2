"""Loops that evaluate any registered image-point equation for arrays; ``fg_orient.kernels.batch`` describes the layout.

The loop calls the scalar function of the equation, so a residual is the same number in a factor and in a batch. Some
equations also have a faster loop (``fg_orient.kernels.batch``). Kernels process a range ``[lo, hi)`` and write only the
results of this range, so any division among threads gives the same bits.

The loop over frame images computes an image's camera (rotation with its Jacobian, projection centre, interior
orientation) at the image's first ray in the range. It keeps the camera in a table, so that only the pixel and its
weights are read from a record.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
import numpy.typing as npt

from factors._compile import threaded
from factors._contract import Array, Equation, is_finite
from factors.cameras import frame
from factors.cameras.frame import RECORD
from factors.cameras.frame_camera import CAMERA

Index = npt.NDArray[np.int64]
Small = np.ndarray[tuple[int], np.dtype[np.int32]]
Flags = np.ndarray[tuple[int], np.dtype[np.int8]]

#: Functions of the equation that the loops below call; :func:`rows_of` sets them.
fill: Any = None
kernel: Any = None


def _rows(
    lo: int,
    hi: int,
    members: Index,
    records: Array,
    row: Index,
    image: Index,
    point: Index,
    setup: Array,
    n_basis: int,
    basis: Array,
    wide: Array,
    ground: Array,
    value: Array,
    d_image: Array,
    d_ground: Array,
    want: bool,
) -> int:
    """Evaluate the rows of members lo to hi; see :func:`fg_orient.kernels.batch.rows_of_form`.

    Record (1, d) and ground point (3,) are copied. With views of a shared array all threads would change one
    reference counter and wait for each other (two threads were no faster than one).
    """
    c, bad = setup.shape[1], -1
    x, out, record, place = np.empty(c), np.empty((2, c + 4)), np.empty((1, records.shape[1])), np.empty(3)
    for m in range(lo, hi):
        a = members[m]
        for k in range(records.shape[1]):
            record[0, k] = records[row[a], k]
        for k in range(3):
            place[k] = ground[point[a], k]
        for k in range(c):
            x[k] = 0.0
            for b in range(n_basis):
                x[k] += basis[a, b] * wide[image[a], b * c + k]
        if not fill(record, np.int64(0), setup, x, place, out, want) and bad < 0:
            bad = a
        for r in range(2):
            value[a, r] = out[r, 0]
            if want:
                for k in range(c if d_image.shape[2] > 0 else 0):
                    d_image[a, r, k] = out[r, 1 + k]
                for k in range(3):
                    d_ground[a, r, k] = out[r, 1 + c + k]
    return bad


def _filled(records: Array, row: int, setup: Array, x: Array, place: Array, out: Array, want: bool) -> bool:
    """Write one row with the kernel of an equation without ``fill``; see ``factors._contract.Equation``."""
    c = len(x)
    residual, by_image, by_ground = kernel(records[row], setup, x, place, want)
    fits = len(residual) == 2 and (not want or (by_image.shape == (2, c) and by_ground.shape == (2, 3)))
    out[:] = np.nan
    if not fits:
        return False
    for r in range(2):
        out[r, 0] = residual[r]
        if want:
            for k in range(c):
                out[r, 1 + k] = by_image[r, k]
            for k in range(3):
                out[r, 1 + c + k] = by_ground[r, k]
    return is_finite(out, c + 4 if want else 1)


def _bound(loop: Any, equation: Equation, name: str, function: Any) -> Any:
    """Return a loop of this module for an equation: compiled, or as plain Python if the equation is not compiled."""
    own = FunctionType(loop.__code__, {**loop.__globals__, name: function}, loop.__name__)
    own.__qualname__ = f"{loop.__name__}_{equation.name}"  # the compiled code of each equation needs its own file
    return threaded(own) if hasattr(function, "py_func") else own


@cache
def rows_of(equation: Equation) -> Callable[..., int]:
    """Return the row kernel of a registered equation with arguments (image, ground point) and two residuals."""
    own = equation.fill or _bound(_filled, equation, "kernel", equation.kernel)
    rows: Callable[..., int] = _bound(_rows, equation, "fill", own)
    return rows


@threaded
def frame_rows(
    lo: int,
    hi: int,
    members: Index,
    records: Array,
    row: Index,
    image: Index,
    point: Index,
    setup: Array,
    n_basis: int,
    basis: Array,
    wide: Array,
    ground: Array,
    value: Array,
    d_image: Array,
    d_ground: Array,
    want: bool,
) -> int:
    """Evaluate the frame collinearity of members lo to hi; see :func:`fg_orient.kernels.batch.rows_of_form`."""
    c, bad, d = setup.shape[1], -1, np.zeros((2, frame.COLUMN.size))
    table, known = np.empty((len(wide), CAMERA.size)), np.zeros(len(wide), np.bool_)
    column, sigma = frame.columns_of(setup), setup[1].copy()
    for m in range(lo, hi):
        a = members[m]
        i, k, p = image[a], row[a], point[a]
        if not known[i]:
            known[i] = True
            table[i] = frame.camera(records[k], setup, wide[i, :c])
        observed = (
            records[k, RECORD.line],
            records[k, RECORD.sample],
            records[k, RECORD.a_line],
            records[k, RECORD.a_sample],
        )
        place = ground[p, 0], ground[p, 1], ground[p, 2]
        value[a, 0], value[a, 1], zero = frame.evaluated(table[i], observed, place, d, want)
        if want:
            for r in range(2):
                for j in range(c if d_image.shape[2] > 0 else 0):
                    d_image[a, r, j] = d[r, column[j]] * sigma[j]
                for j in range(3):
                    d_ground[a, r, j] = d[r, frame.GROUND + j]
        if zero != 0.0 and bad < 0:
            bad = a
    return bad
