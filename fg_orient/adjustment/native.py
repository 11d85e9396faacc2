"""Use GTSAM factors, GTSAM's own or a user's, as observations of a block.

A factor names its variables by the keys of
:class:`fg_orient.orientation.factor_graph.FactorGraph`. Every backend and all statistics
need its whitened rows; GTSAM linearises them. The graph contains the factor unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from factors._contract import Argument, Equation
from factors.arrays import Array
from fg_orient.adjustment.constraint_rows import constraint_observation
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.constraint import Constraint
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True, eq=False)
class NativeObservation(ExtraObservation):
    """Observation given as a GTSAM factor."""

    factor: gtsam.NonlinearFactor


def with_observations(block: Block) -> Block:
    """Convert the GTSAM factors and constraints in ``extra`` of a block to observations.

    Raises
    ------
    InputError
        A factor names a variable that does not exist, or cannot be evaluated; the message
        contains its number from 0. A constraint has too few members.
    """
    if all(isinstance(extra, ExtraObservation) for extra in block.extra):
        return block
    return replace(
        block,
        extra=tuple(
            extra
            if isinstance(extra, ExtraObservation)
            else constraint_observation(extra)
            if isinstance(extra, Constraint)
            else _observation(block, extra, n)
            for n, extra in enumerate(block.extra)
        ),
    )


def _observation(block: Block, factor: Any, number: int) -> NativeObservation:
    """Return the observation of one factor."""
    import gtsam

    label = f"extra observation {number} ({type(factor).__name__})"
    if not isinstance(factor, gtsam.NonlinearFactor):
        raise InputError.of("graph.no_factor", place=label, value=type(factor).__name__)
    keys = tuple(int(key) for key in factor.keys())
    names = tuple(_name(block, key, label) for key in keys)
    arguments = tuple(
        Argument(name, "m" if name.startswith("point:") else "prior sigma", name.startswith("point:")) for name in names
    )

    def rows(*x: Array) -> tuple[Array, Array]:
        """Return the whitened residual and Jacobian."""
        values = gtsam.Values()
        for key, argument, own in zip(keys, arguments, x, strict=True):
            if argument.is_point:
                values.insertPoint3(key, own)
            else:
                values.insert(key, np.ascontiguousarray(own))
        try:
            jacobian, right = factor.linearize(values).jacobian()
        except (RuntimeError, ValueError, TypeError) as error:
            why = " ".join(str(error).split())[:160]
            raise InputError.of("graph.broken_factor", place=label, value=", ".join(names), why=why) from error
        residual, design = -np.asarray(right).ravel(), np.asarray(jacobian)
        if not (np.isfinite(residual).all() and np.isfinite(design).all()):
            raise InputError.of("graph.broken_factor", place=label, value=", ".join(names), why="nan, inf or sigma 0")
        return residual, design

    def kernel(_record: Array, _setup: Array, *x_and_want: Any) -> tuple[Array, ...]:
        *x, want = x_and_want
        residual, design = rows(*x)
        if not want:
            return residual, *(np.empty((0, 0)) for _ in x)
        parts = np.split(design, np.cumsum([len(own) for own in x])[:-1], axis=1)
        return residual, *(np.ascontiguousarray(part) for part in parts)

    def residual(_record: Array, _setup: Array, *x: Array) -> Array:
        return rows(*x)[0]

    equation = Equation(label, kernel, residual, arguments, "GTSAM")
    return NativeObservation(equation, names, np.zeros(0), np.zeros((0, 0)), int(factor.dim()), label, factor)


def _name(block: Block, key: int, label: str) -> str:
    """Return the name of the variable of a key."""
    import gtsam

    kind, n = chr(gtsam.symbolChr(key)), int(gtsam.symbolIndex(key))
    if kind == "e" and n < len(block.images):
        return f"image:{block.images[n].id}"
    if kind == "p" and n < len(block.points.ids):
        return f"point:{block.points.ids[n]}"
    raise InputError.of("graph.key", place=label, value=key)
