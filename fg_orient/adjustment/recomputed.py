"""A large array of a dataclass that can be released: it is computed again at its next use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from factors.arrays import Array, Index

#: Computes some rows of an array, or all of them (None).
Compute = Callable[[Index | slice | None], Array]
Kind = TypeVar("Kind", bound=type)
Owner = TypeVar("Owner")


def recomputed(name: str) -> Callable[[Kind], Kind]:
    """Class decorator: the array ``name`` of a dataclass can be released."""

    def changed(kind: Kind) -> Kind:
        again = cached_property(lambda owner: vars(owner)[_function(name)](None))
        again.__set_name__(kind, name)
        setattr(kind, name, again)  # the array of an object hides it until the array is released
        return kind

    return changed


def computed_by(owner: Any, name: str, function: Compute) -> None:
    """State the function that computes an array of ``owner`` again."""
    vars(owner)[_function(name)] = function


def held(owner: Owner, name: str) -> Owner:
    """``owner`` with the array computed."""
    getattr(owner, name)
    return owner


def release(owner: Any, name: str) -> None:
    """Free an array of ``owner``, if a function computes it again."""
    if _function(name) in vars(owner):
        vars(owner).pop(name, None)


def replaced(owner: Owner, name: str, **changes: Any) -> Owner:
    """``dataclasses.replace`` of other fields; an array that is released stays so."""
    if name in vars(owner):
        return replace(owner, **changes)  # type: ignore[type-var]
    out: Owner = replace(owner, **changes, **{name: np.empty((0, 0))})  # type: ignore[type-var]
    computed_by(out, name, vars(owner)[_function(name)])
    release(out, name)
    return out


def some_rows(owner: Any, name: str, rows: Index | slice) -> Array:
    """Rows of an array of ``owner``; of a released array only these rows are computed."""
    if name not in vars(owner):
        return vars(owner)[_function(name)](rows)  # type: ignore[no-any-return]
    return getattr(owner, name)[rows]  # type: ignore[no-any-return]


def _function(name: str) -> str:
    return f"_{name}_again"
