"""Rows of the look-angle collinearity, many observations in one vector instruction; layout: ``kernels.batch``.

Observations are copied in blocks (``fg_orient.kernels.batch_blocks``) to arrays whose entries lie BLOCK apart, where
the loop over ``pushbroom.collinearity`` has neither branches nor calls. Nothing is fused or reordered: a residual is
the same number in a factor and in a batch, whatever its place in a block.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._compile import exact
from factors._contract import Array
from factors.cameras.pushbroom import collinearity, derivatives
from factors.cameras.pushbroom_record import CORRECTION, RECORD, STORED, correction, observation, store, three
from fg_orient.kernels.batch_blocks import BLOCK, any_small, correct, gather, places, scatter, usual
from fg_orient.kernels.batch_rows import Index
from fg_orient.kernels.batch_tiles import SIDE


@exact
def _evaluate(constants: Array, d: Array, place: Array, size: int, small: Any, want: bool, out: Array) -> None:
    """Evaluate a block; ``small`` None: it is the full rotation, and the branch is not compiled."""
    n, full = np.int64(BLOCK), np.bool_(False)  # typed, so that numba makes no variant for each literal
    if small is not None:
        for i in range(size):
            seen, form = observation(constants, i, n), constants[i + RECORD.small_angle * n] > 0.5
            value, maps = collinearity(seen, correction(d, i, n), three(place, i, n), form)
            store(out, i, n, value, derivatives(seen, maps))
    elif want:
        for i in range(size):
            seen = observation(constants, i, n)
            value, maps = collinearity(seen, correction(d, i, n), three(place, i, n), full)
            store(out, i, n, value, derivatives(seen, maps))
    else:
        for i in range(size):
            value, _ = collinearity(observation(constants, i, n), correction(d, i, n), three(place, i, n), full)
            out[i + STORED.line * n], out[i + STORED.sample * n] = value
            out[i + STORED.total * n] = value[0] + value[1]


@exact
def rows_of_form(
    small: Any, lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Look-angle collinearity of members lo to hi.

    Parameters
    ----------
    small : None or True
        True where observations may have the small-angle form; None compiles the full rotation alone.
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
    slot, column = places(setup)
    constants, d, place = np.empty(RECORD.size * BLOCK), np.empty(CORRECTION.size * BLOCK), np.empty(3 * BLOCK)
    for k in range(len(d)):
        d[k] = 0.0
    out, bad = np.empty(STORED.size * BLOCK), -1
    own, lines, space, nine = np.empty(SIDE, np.int64), np.empty(SIDE, np.int64), np.empty(SIDE * SIDE), usual(slot)
    for k in range(SIDE):
        lines[k] = SIDE * k
    for first in range(lo, hi, BLOCK):
        size = BLOCK if hi - first > BLOCK else hi - first
        other = any_small(first, size, members, records, row)
        gather(first, size, members, records, row, point, ground, constants, place, own)
        correct(first, size, members, image, slot, n_basis, basis, wide, d, nine, lines, space)
        _evaluate(constants, d, place, size, small, want, out)
        found = scatter(first, size, members, column, out, value, d_image, d_ground, want, nine, own)
        if other and small is None and found < 0:
            found = first  # not a number
        bad = found if bad < 0 else bad
    return bad


def pushbroom_rows(*arguments: Any) -> int:
    """See :func:`rows_of_form`: the full rotation."""
    return rows_of_form(None, *arguments)


def small_angle_rows(*arguments: Any) -> int:
    """See :func:`rows_of_form`: small-angle forms among them."""
    return rows_of_form(True, *arguments)
