"""Rows of the look-angle collinearity, many observations in one vector instruction; layout: ``factors.batch``.

Observations are copied in blocks to arrays whose entries lie BLOCK apart, where the loop over ``factors.sight`` has
neither branches nor calls. Nothing is fused or reordered: a residual is the same number in a factor and in a batch,
whatever its place in a block.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors import pushbroom
from factors._compile import exact
from factors._contract import Array
from factors.batch_rows import Index
from factors.sight import STORED, derivatives, sight, store

#: Observations of one block: with 80 numbers each they stay in the first-level cache.
BLOCK: Final = 32
_SMALL: Final = 27


@exact
def _places(setup: Array) -> tuple[Index, Index]:
    """Place of each component among the corrections (11,), and of its derivative among the 14 of a row."""
    slot, column = np.empty(setup.shape[1], np.int64), np.empty(setup.shape[1], np.int64)
    for k in range(setup.shape[1]):
        code = int(setup[0, k])
        slot[k] = code // 3 if code < pushbroom.N_EOP else 9 + code - pushbroom.N_EOP
        column[k] = slot[k] if slot[k] < 9 else slot[k] + 3
    return slot, column


@exact
def _any_small(first: int, size: int, members: Index, records: Array, row: Index) -> bool:
    """Whether an observation of a block has the small-angle form.

    One number of each line of memory of each record is read: records lie in the order of the input, and lines that
    are waited for together cost 150 ns per observation less than one after the other (measured, random order).
    """
    flags = 0.0
    for i in range(size):
        r = row[members[first + i]]
        flags += records[r, _SMALL] + 0.0 * (records[r, 0] + records[r, 8] + records[r, 16] + records[r, 33])
    return flags != 0.0  # also where a number is nan


@exact
def _gather(
    first: int, size: int, members: Index, records: Array, row: Index, image: Index, point: Index, slot: Index,
    n_basis: int, basis: Array, wide: Array, ground: Array, constants: Array, d: Array, place: Array,
) -> None:  # fmt: skip
    """Copy the observations of a block."""
    c = len(slot)
    for i in range(size):
        a = members[first + i]
        r, m, j = row[a], image[a], point[a]
        for k in range(pushbroom.RECORD_SIZE):
            constants[k * BLOCK + i] = records[r, k]
        for k in range(3):
            place[k * BLOCK + i] = ground[j, k]
        for k in range(c):
            x = 0.0
            for b in range(n_basis):
                x += basis[a, b] * wide[m, b * c + k]
            d[slot[k] * BLOCK + i] = x


@exact
def _evaluate(constants: Array, d: Array, place: Array, size: int, small: bool, want: bool, out: Array) -> None:
    """Evaluate a block; the loops that matter are those of the full rotation."""
    n, full = np.int64(BLOCK), np.bool_(False)  # typed, so that numba makes no variant for each literal
    if small:
        for i in range(size):
            value, seen = sight(constants, d, place, i, n, constants[i + _SMALL * n] > 0.5)
            store(out, i, n, value, derivatives(constants, i, n, seen))
    elif want:
        for i in range(size):
            value, seen = sight(constants, d, place, i, n, full)
            store(out, i, n, value, derivatives(constants, i, n, seen))
    else:
        for i in range(size):
            value, seen = sight(constants, d, place, i, n, full)
            out[i], out[i + n] = value
            out[i + (STORED - 1) * n] = value[0] + value[1]


@exact
def _scatter(
    first: int, size: int, members: Index, column: Index, out: Array, value: Array, d_image: Array, d_ground: Array,
    want: bool,
) -> int:  # fmt: skip
    """Copy the results of a block to the arrays of the observations; the first one that is not finite, or -1."""
    bad = -1
    for i in range(size):
        a = members[first + i]
        for r in range(2):
            value[a, r] = out[r * BLOCK + i]
            if want:
                for k in range(len(column)):
                    d_image[a, r, k] = out[(2 + 14 * r + column[k]) * BLOCK + i]
                for k in range(3):
                    d_ground[a, r, k] = out[(11 + 14 * r + k) * BLOCK + i]
        if bad < 0 and not np.isfinite(out[(STORED - 1) * BLOCK + i]):
            bad = a
    return bad


@exact
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
    slot, column = _places(setup)
    constants, d, place = np.empty(pushbroom.RECORD_SIZE * BLOCK), np.zeros(11 * BLOCK), np.empty(3 * BLOCK)
    out, bad = np.empty(STORED * BLOCK), -1
    for first in range(lo, hi, BLOCK):
        size = BLOCK if hi - first > BLOCK else hi - first
        small = _any_small(first, size, members, records, row)
        _gather(
            first, size, members, records, row, image, point, slot, n_basis, basis, wide, ground, constants, d, place
        )
        _evaluate(constants, d, place, size, small, want, out)
        found = _scatter(first, size, members, column, out, value, d_image, d_ground, want)
        bad = found if bad < 0 else bad
    return bad
