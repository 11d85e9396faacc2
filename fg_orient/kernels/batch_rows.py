"""Rows of the registered equations over arrays, evaluated for components; layout: ``fg_orient.kernels.batch``.

The scalar functions are those of the equations, so that a residual is the same number in a factor and in a batch.
Kernels take a range ``[lo, hi)`` and write what belongs to it only: any division among threads gives the
same bits.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors._compile import threaded
from factors._contract import Array
from factors.cameras import rfm_equation

Index = npt.NDArray[np.int64]
Small = np.ndarray[tuple[int], np.dtype[np.int32]]
Flags = np.ndarray[tuple[int], np.dtype[np.int8]]


@threaded
def _fetch(
    records: Array, row: int, ground: Array, j: int, n_basis: int, basis: Array, a: int, wide: Array, i: int,
    record: Array, place: Array, x: Array,
) -> None:  # fmt: skip
    """Copy record (1, d) and ground point (3,), and write the components of one observation.

    Copies, because a view of a shared array counts references in one place for all threads: they would wait for each
    other (two threads were no faster than one).
    """
    for k in range(records.shape[1]):
        record[0, k] = records[row, k]
    for k in range(3):
        place[k] = ground[j, k]
    c = len(x)
    for k in range(c):
        x[k] = 0.0
        for b in range(n_basis):
            x[k] += basis[a, b] * wide[i, b * c + k]


@threaded
def _store(out: Array, a: int, value: Array, d_image: Array, d_ground: Array, want: bool) -> None:
    """Copy what an equation wrote to the arrays of one observation."""
    c = out.shape[1] - 4
    for r in range(2):
        value[a, r] = out[r, 0]
        if want:
            for k in range(c):
                d_image[a, r, k] = out[r, 1 + k]
            for k in range(3):
                d_ground[a, r, k] = out[r, 1 + c + k]


@threaded
def rational_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Rational function of members lo to hi; see :func:`fg_orient.kernels.batch_pushbroom.rows_of_form`."""
    x, out, bad = np.empty(setup.shape[1]), np.empty((2, setup.shape[1] + 4)), -1
    record, place = np.empty((1, records.shape[1])), np.empty(3)
    for m in range(lo, hi):
        a = members[m]
        _fetch(records, row[a], ground, point[a], n_basis, basis, a, wide, image[a], record, place, x)
        if not rfm_equation.fill(record, np.int64(0), setup, x, place, out, want) and bad < 0:
            bad = a
        _store(out, a, value, d_image, d_ground, want)
    return bad
