"""Registered equations of image points over arrays, without a Python call per image point.

An image unknown changes one of a few *components* of an observation (a coordinate of the orbit, an angle, a look
angle), times a constant *basis* value (1, tau, tau^2, powers of the sample). The Jacobian is therefore a Kronecker
product with columns left out. Equations are evaluated with the components as their unknowns: at most 11 columns are
computed and stored for any set of unknowns. *Wide* numbers of an image are its values over (basis, component), basis
by basis.

Kernels take a range ``[lo, hi)`` and write only its results: any division among threads gives the same bits.
Observations are sorted by ground point; ``fg_orient.kernels.batch_points`` and ``fg_orient.kernels.batch_pairs``
process them further.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np

from factors._contract import Array, Equation
from factors.cameras import frame, pushbroom
from factors.cameras.pushbroom_record import CURVE, CURVES, N_EOP, RECORD
from fg_orient.kernels.batch_pushbroom import any_small_angle, pushbroom_rows, small_angle_rows
from fg_orient.kernels.batch_rows import Index, frame_rows, rows_of

#: Number of a basis value of the look polynomial: its degree plus _LOOK; of a curve: its number plus _CURVE.
_LOOK: Final = 10
_CURVE: Final = 100


@dataclass(frozen=True)
class Columns:
    """Image unknowns of one setup as components times basis values.

    Parameters
    ----------
    setup : (2, c) array
        Setup of the equation with the components as unknowns.
    component, basis : (k,) int arrays
        Component and basis value of each unknown.
    scale : (k,) array
        Factor of each unknown.
    values : callable
        Basis values (n, b) from records (n, d).
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
        """Whether the unknowns are the components, and their Jacobian that of the components."""
        same = np.array_equal(self.component, np.arange(self.n_components))
        return same and not self.basis.any() and bool((self.scale == 1.0).all()) and self.values is _ones

    @cached_property
    def wide(self) -> Index:
        """Place (k,) of each unknown among the wide numbers."""
        return self.basis * self.n_components + self.component


def _pushbroom_columns(setup: Array) -> Columns:
    """Components: EOP and look angles with unknowns; basis: powers of tau, powers of the sample, curves."""
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
    """Basis value (n,) by its number."""
    if name >= _CURVE:
        return np.asarray(records[:, RECORD.size + name - _CURVE])
    look = name > _LOOK
    return np.asarray(records[:, RECORD.s] ** (name - _LOOK) if look else records[:, RECORD.tau] ** name)


def _ones(records: Array) -> Array:
    """One basis value (n, 1), which is 1."""
    return np.ones((len(records), 1))


def _plain_columns(setup: Array) -> Columns:
    """Columns with one component per unknown."""
    k = setup.shape[1]
    return Columns(
        np.ascontiguousarray(setup), np.arange(k), np.zeros(k, np.int64), np.ones(k), _ones,
    )  # fmt: skip


#: Rows and columns of the equations with their own loop; all others use :func:`rows_of`.
_BATCHES: Final[dict[str, tuple[Callable[..., int], Callable[[Array], Columns]]]] = {
    pushbroom.LOOK_ANGLE_COLLINEARITY.name: (pushbroom_rows, _pushbroom_columns),
    frame.FRAME_COLLINEARITY.name: (frame_rows, _plain_columns),
}


def batch(equation: Equation, setup: Array, records: Array) -> tuple[Callable[..., int], Columns]:
    """Row kernel (see ``kernels.batch_pushbroom.rows_of_form``) and columns of an equation, for these records."""
    rows, columns = _batch(equation, setup.tobytes(), setup.shape)
    return (small_angle_rows if rows is pushbroom_rows and any_small_angle(records) else rows), columns


@lru_cache(maxsize=256)
def _batch(equation: Equation, setup: bytes, shape: tuple[int, ...]) -> tuple[Callable[..., int], Columns]:
    """Rows and columns, cached: the images of a block have one or a few setups, requested thousands of times."""
    rows, columns = _BATCHES.get(equation.name) or (rows_of(equation), _plain_columns)
    return rows, columns(np.frombuffer(setup).reshape(shape))
