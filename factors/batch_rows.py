"""Rows of the registered equations over arrays, evaluated for components; layout: ``factors.batch``.

The scalar functions are those of the equations, so that a residual is the same number in a factor and in a batch.
Kernels take a range ``[lo, hi)`` and write what belongs to it only: any division among threads gives the
same bits.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import numpy.typing as npt
from numba import njit

from factors import pushbroom, rfm_equation
from factors._contract import Array, F

Index = npt.NDArray[np.int64]


def threaded(function: F) -> F:
    """Compile with numba so that threads run side by side; products and sums may fuse, sums keep their order."""
    return cast(F, njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})(function))


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
def _pushbroom_places(setup: Array) -> tuple[Index, Index]:
    """Place of each component among the corrections (11,), and of its derivative (14,)."""
    slot, column = np.empty(setup.shape[1], np.int64), np.empty(setup.shape[1], np.int64)
    for k in range(setup.shape[1]):
        code = int(setup[0, k])
        slot[k] = code // 3 if code < pushbroom.N_EOP else 9 + code - pushbroom.N_EOP
        column[k] = slot[k] if slot[k] < 9 else slot[k] + 3
    return slot, column


@threaded
def pushbroom_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Look-angle collinearity of members lo to hi.

    Parameters
    ----------
    members : (m,) int array
        Observations of the group, by their place in the sorted arrays.
    records : (n, d) array
    row, image, point : (n,) int arrays
        Row of ``records``, image and ground point of each sorted observation.
    setup : (2, c) array
        Of :class:`Columns`.
    n_basis : int
    basis : (n, b) array
        Basis values; ``n_basis`` of them are the group's.
    wide : (M, w) array
        Wide unknowns of the images.
    ground : (N, 3) array, m
    value, d_image, d_ground : (n, 2), (n, 2, c), (n, 2, 3) arrays
        Written, whitened; the Jacobians with ``want`` only.

    Returns
    -------
    int
        The first observation that is not finite, or -1.
    """
    c, bad = setup.shape[1], -1
    x, d, (slot, column) = np.empty(c), np.empty(11), _pushbroom_places(setup)
    copy, place = np.empty((1, records.shape[1])), np.empty(3)
    record = copy[0]
    for m in range(lo, hi):
        a = members[m]
        _fetch(records, row[a], ground, point[a], n_basis, basis, a, wide, image[a], copy, place, x)
        d[:] = 0.0
        for k in range(c):
            d[slot[k]] = x[k]
        frame, w, f, df = pushbroom._sight(record, d, place)
        value[a, 0], value[a, 1] = pushbroom._misclosure(record, d, f, df)
        total = 0.0 * value[a, 0] + 0.0 * value[a, 1]
        if want:
            j = pushbroom._line_derivatives(record, d, frame, w, (f[0] + df[0], f[1] + df[1], f[2] + df[2]))
            for r in range(2):
                for k in range(c):
                    d_image[a, r, k] = j[r, column[k]]
                    total += 0.0 * j[r, column[k]]
                for k in range(3):
                    d_ground[a, r, k] = j[r, 9 + k]
                    total += 0.0 * j[r, 9 + k]
        if total != 0.0 and bad < 0:
            bad = a
    return bad


@threaded
def rational_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Rational function of members lo to hi; see :func:`pushbroom_rows`."""
    x, out, bad = np.empty(setup.shape[1]), np.empty((2, setup.shape[1] + 4)), -1
    record, place = np.empty((1, records.shape[1])), np.empty(3)
    for m in range(lo, hi):
        a = members[m]
        _fetch(records, row[a], ground, point[a], n_basis, basis, a, wide, image[a], record, place, x)
        if not rfm_equation.fill(record, 0, setup, x, place, out, want) and bad < 0:
            bad = a
        _store(out, a, value, d_image, d_ground, want)
    return bad
