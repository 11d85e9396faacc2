"""Evaluation of registered image-point equations for whole arrays, without a Python call per image point.

An image unknown changes one of a few *components* of an observation (a coordinate of the orbit, an angle, a
look angle), times a constant *basis* value (1, tau, tau^2, powers of the sample). The Jacobian is therefore a
Kronecker product of which some columns are left out. Equations are evaluated with the components as unknowns,
so at most 11 columns are computed and stored for any set of unknowns. The *wide* numbers of an image are its
unknowns for each pair of basis value and component, ordered by basis value.

Kernels process a range ``[lo, hi)`` and write only the results of this range, so any division among threads gives the
same bits. Observations are sorted by ground point; ``fg_orient.kernels.batch_points`` and
``fg_orient.kernels.batch_pairs`` process them further.

Look-angle collinearity (:func:`rows_of_form`) processes many observations with one vector instruction.
Observations are copied in blocks to arrays in which the entries of one observation are BLOCK places apart.
Their rows are copied back. The loop of ``pushbroom.collinearity`` over a block has neither branches nor
calls. Operations are not fused or reordered: a residual is the same number in a factor and in a batch, at any
place in a block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, Final

import numpy as np

from factors._compile import exact
from factors._contract import Array, Equation
from factors.cameras import frame, pushbroom
from factors.cameras.pushbroom import collinearity, derivatives
from factors.cameras.pushbroom_record import (
    CORRECTION,
    CURVE,
    CURVES,
    N_EOP,
    RECORD,
    ROW,
    STORED,
    correction,
    observation,
    store,
    three,
)
from fg_orient.kernels.batch_rows import Index, frame_rows, rows_of
from fg_orient.kernels.vectors import N_COMPONENTS, SIDE, turn_in, turn_out, write_eight

#: Number of observations of one block; their 80 numbers each fit in the first-level cache.
BLOCK: Final = 32
#: Place of the last of the nine usual components; the first eight form one vector.
YAW: Final = CORRECTION.angles.stop - 1


@exact
def usual(slot: Index) -> bool:
    """Return whether the components are exactly position, velocity and angles, in this order."""
    for k in range(len(slot)):
        if slot[k] != k:
            return False
    return len(slot) == N_COMPONENTS


@exact
def places(setup: Array) -> tuple[Index, Index]:
    """Return each component's place among the corrections (11,), and the place of its derivative in a row (14,)."""
    slot, column = np.empty(setup.shape[1], np.int64), np.empty(setup.shape[1], np.int64)
    for k in range(setup.shape[1]):
        code = int(setup[0, k])
        look = code - 3 * CORRECTION.psi_x  # the first codes are three per EOP component
        slot[k] = code // 3 if look < 0 else CORRECTION.psi_x + look
        column[k] = slot[k] if look < 0 else ROW.psi_x + look
    return slot, column


def any_small_angle(records: Array) -> bool:
    """Return whether any observation has the small-angle form."""
    return bool(records[:, RECORD.small_angle].any())


@exact
def any_small(first: int, size: int, members: Index, records: Array, row: Index) -> bool:
    """Return whether any observation of a block has the small-angle form.

    The loop also reads one number of each cache line of each record. Records are in the order of the input,
    so their lines are not yet in the cache. Reading them together here saves 150 ns per observation
    (measured, random order).
    """
    flags = 0.0
    for i in range(size):
        r = row[members[first + i]]
        touched = 0.0  # a separate sum, so that the processor requests the next record before this one arrives
        for k in range(0, RECORD.size, SIDE):
            touched += records[r, k]
        flags += records[r, RECORD.small_angle] + 0.0 * touched
    return flags != 0.0  # this is also true if a number is nan


@exact
def gather(
    first: int,
    size: int,
    members: Index,
    records: Array,
    row: Index,
    point: Index,
    ground: Array,
    constants: Array,
    place: Array,
    own: Index,
) -> None:
    """Copy records and ground points of a block."""
    whole = size - size % SIDE
    for i in range(0, whole, SIDE):
        for q in range(SIDE):
            own[q] = row[members[first + i + q]] * records.shape[1]
        for k in range(0, RECORD.size, SIDE):
            at = min(k, RECORD.size - SIDE)
            turn_in(records, constants, own, at, at * BLOCK + i, BLOCK)
    for i in range(whole, size):
        r = row[members[first + i]]
        for k in range(RECORD.size):
            constants[k * BLOCK + i] = records[r, k]
    for i in range(size):
        j = point[members[first + i]]
        for k in range(3):
            place[k * BLOCK + i] = ground[j, k]


@exact
def correct(
    first: int,
    size: int,
    members: Index,
    image: Index,
    slot: Index,
    n_basis: int,
    basis: Array,
    wide: Array,
    d: Array,
    nine: bool,
    lines: Index,
    space: Array,
) -> None:
    """Compute the corrections of a block."""
    c, whole = len(slot), 0
    if nine and n_basis == 3:
        whole = size - size % SIDE
        for i in range(0, whole, SIDE):
            for q in range(SIDE):
                a = members[first + i + q]
                m, b0, b1, b2 = image[a], basis[a, 0], basis[a, 1], basis[a, 2]
                write_eight(space, q * SIDE, wide, m * wide.shape[1], basis, a * basis.shape[1])
                yaw = 0.0 + b0 * wide[m, YAW] + b1 * wide[m, N_COMPONENTS + YAW]
                d[YAW * BLOCK + i + q] = yaw + b2 * wide[m, 2 * N_COMPONENTS + YAW]
            turn_in(space, d, lines, 0, i, BLOCK)
    for i in range(whole, size):
        a = members[first + i]
        for k in range(c):
            x = 0.0
            for b in range(n_basis):
                x += basis[a, b] * wide[image[a], b * c + k]
            d[slot[k] * BLOCK + i] = x


@exact
def scatter(
    first: int,
    size: int,
    members: Index,
    column: Index,
    out: Array,
    value: Array,
    d_image: Array,
    d_ground: Array,
    want: bool,
    nine: bool,
    own: Index,
) -> int:
    """Copy the results of a block to the observations' arrays; return the first that is not finite, or -1."""
    bad, c, whole = -1, len(column), 0
    if want and nine and d_image.shape[2] == N_COMPONENTS:
        whole = size - size % SIDE
        for i in range(0, whole, SIDE):
            for q in range(SIDE):
                a = members[first + i + q]
                own[q] = 2 * N_COMPONENTS * a
                for r in range(2):
                    d_image[a, r, YAW] = out[(STORED.line_row.start + r * ROW.size + YAW) * BLOCK + i + q]
            for r in range(2):
                turn_out(out, d_image, own, N_COMPONENTS * r, (STORED.line_row.start + r * ROW.size) * BLOCK + i, BLOCK)
    for i in range(size):
        a = members[first + i]
        for r in range(2):
            row = STORED.line_row.start + r * ROW.size
            value[a, r] = out[(STORED.line + r) * BLOCK + i]
            if want:
                for k in range(c if i >= whole and d_image.shape[2] > 0 else 0):
                    d_image[a, r, k] = out[(row + column[k]) * BLOCK + i]
                for k in range(3):
                    d_ground[a, r, k] = out[(row + ROW.ground.start + k) * BLOCK + i]
        if bad < 0 and not np.isfinite(out[STORED.total * BLOCK + i]):
            bad = a
    return bad


@exact
def _evaluate(constants: Array, d: Array, place: Array, size: int, small: Any, want: bool, out: Array) -> None:
    """Evaluate a block; ``small`` None: only the full rotation, without compiling the small-angle form."""
    n, full = np.int64(BLOCK), np.bool_(False)  # typed, so that numba does not compile each literal
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
    small: Any,
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
    """Evaluate the look-angle collinearity of members lo to hi.

    Parameters
    ----------
    small : None or True
        True if observations may have the small-angle form; None compiles only the full rotation.
    members : (m,) int array
        Observations of the group: places in the sorted arrays.
    records : (n, d) array
    row, image, point : (n,) int arrays
        Row of ``records``, image and ground point of each sorted observation.
    setup : (2, c) array
        Setup of :class:`Columns`.
    n_basis : int
    basis : (n, b) array
        Basis values; the first ``n_basis`` belong to the group.
    wide : (M, w) array
        Wide numbers of the images.
    ground : (N, 3) array, m
    value, d_image, d_ground : (n, 2), (n, 2, c), (n, 2, 3) arrays
        Results, whitened. Jacobians are written only if ``want`` is True, the image Jacobians not if ``d_image`` is (n,
        2, 0).

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
            found = first  # only nan causes this, because the small-angle form is not used
        bad = found if bad < 0 else bad
    return bad


#: Row kernels for images with only the full rotation, and for blocks that contain images in the small-angle form.
pushbroom_rows, small_angle_rows = partial(rows_of_form, None), partial(rows_of_form, True)


#: A basis value has a number: the degree of the look polynomial plus _LOOK, or the number of the curve plus _CURVE.
_LOOK: Final = 10
_CURVE: Final = 100


@dataclass(frozen=True)
class Columns:
    """Assignment of the image unknowns of one setup to components and basis values.

    Parameters
    ----------
    setup : (2, c) array
        Setup of the equation whose unknowns are the components.
    component, basis : (k,) int arrays
        Component and basis value of each unknown.
    scale : (k,) array
        Factor of each unknown.
    values : callable
        Function that returns basis values (n, b) of records (n, d).
    """

    setup: Array
    component: Index
    basis: Index
    scale: Array
    values: Callable[[Array], Array]

    @property
    def n_components(self) -> int:
        """Number of components."""
        return int(self.setup.shape[1])

    @cached_property
    def is_plain(self) -> bool:
        """True if the unknowns are the components themselves, so that both have the same Jacobian."""
        same = np.array_equal(self.component, np.arange(self.n_components))
        return same and not self.basis.any() and bool((self.scale == 1.0).all()) and self.values is _ones

    @cached_property
    def wide(self) -> Index:
        """Place of each unknown (k,) among the wide numbers."""
        return self.basis * self.n_components + self.component


def _pushbroom_columns(setup: Array) -> Columns:
    """Return the EOP and look angles with unknowns as components; powers of tau and sample, and curves, as basis."""
    codes, n_eop = setup[0].astype(np.int64), N_EOP
    eop, look, curve = codes < n_eop, codes - n_eop, codes - CURVE
    constants = np.where(eop, codes - codes % 3, n_eop + look % 2)
    constants = np.where(curve >= 0, 3 * (curve // CURVES), constants)
    degree = np.where(eop, codes % 3, look // 2)
    degree = np.where(curve >= 0, _CURVE + curve % CURVES, degree + _LOOK * (~eop & (degree > 0)))
    names, basis = np.unique(degree, return_inverse=True)
    present, component = np.unique(constants, return_inverse=True)

    def values(records: Array) -> Array:
        return np.stack([_value(records, name) for name in names.tolist()], axis=1)

    compact = np.stack([present.astype(np.float64), np.ones(len(present))])
    return Columns(compact, component.astype(np.int64), basis.astype(np.int64), setup[1].copy(), values)


def _value(records: Array, name: int) -> Array:
    """Return the basis value (n,) with this number."""
    if name >= _CURVE:
        return np.asarray(records[:, RECORD.size + name - _CURVE])
    look = name > _LOOK
    return np.asarray(records[:, RECORD.s] ** (name - _LOOK) if look else records[:, RECORD.tau] ** name)


def _ones(records: Array) -> Array:
    """Return a single basis value (n, 1), which is 1."""
    return np.ones((len(records), 1))


def _plain_columns(setup: Array) -> Columns:
    """Return columns with one component per unknown."""
    k = setup.shape[1]
    return Columns(
        np.ascontiguousarray(setup),
        np.arange(k),
        np.zeros(k, np.int64),
        np.ones(k),
        _ones,
    )


#: Row kernels and columns of the equations that have their own loop; all other equations use :func:`rows_of`.
_BATCHES: Final[dict[str, tuple[Callable[..., int], Callable[[Array], Columns]]]] = {
    pushbroom.LOOK_ANGLE_COLLINEARITY.name: (pushbroom_rows, _pushbroom_columns),
    frame.FRAME_COLLINEARITY.name: (frame_rows, _plain_columns),
}


def batch(equation: Equation, setup: Array, records: Array) -> tuple[Callable[..., int], Columns]:
    """Return the row kernel (see :func:`rows_of_form`) and the columns of an equation for these records."""
    rows, columns = _batch(equation, setup.tobytes(), setup.shape)
    return (small_angle_rows if rows is pushbroom_rows and any_small_angle(records) else rows), columns


@lru_cache(maxsize=256)
def _batch(equation: Equation, setup: bytes, shape: tuple[int, ...]) -> tuple[Callable[..., int], Columns]:
    """Return rows and columns from a cache, because a block has few setups, which are requested thousands of times."""
    rows, columns = _BATCHES.get(equation.name) or (rows_of(equation), _plain_columns)
    return rows, columns(np.frombuffer(setup).reshape(shape))
