"""Checks of arguments given from Python: type, shape and values of arrays, and names of points and images.

Rows are counted from 0, as in Python.
"""

from __future__ import annotations

import operator
from collections.abc import Collection, Sequence
from itertools import repeat
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.model.errors import InputError, finding
from fg_orient.model.names import LARGEST, SMALLEST, Role

#: Numpy types accepted for each kind of value. Texts are refused, masks are refused as numbers, and no value is cut.
_ACCEPTED: Final[dict[type, tuple[str, str]]] = {
    np.float64: ("iuf", "numbers"), np.intp: ("iu", "whole numbers"), np.bool_: ("b", "true and false"),
}  # fmt: skip
_SIGMAS: Final = f"standard deviations from {SMALLEST:g} to {LARGEST:g}"


def wrong(place: str, value: object, expected: str) -> InputError:
    """Return the error for an argument."""
    return InputError(
        finding(
            "argument.value (failure): the value of this argument is not allowed -> give {expected}",
            place=place,
            value=value,
            expected=expected,
        )
    )


def array(
    values: npt.ArrayLike, place: str, shape: tuple[int, ...] | None = None, kind: type = np.float64
) -> npt.NDArray[Any]:
    """Return a copy of an array, in C order.

    Parameters
    ----------
    values : array_like
        Numbers, whole numbers or masks, as ``kind`` requires; an empty array may have any type.
    place : str
        Name of the argument, for the message.
    shape : tuple of int, optional
        Required shape; -1 allows any length.
    kind : type
        ``numpy.float64``, ``numpy.intp`` or ``numpy.bool_``.

    Raises
    ------
    InputError
        The array has another type or shape.
    """
    accepted, words = _ACCEPTED[kind]
    try:
        given = np.asarray(values)
    except ValueError:  # numpy raises this for rows of different lengths
        raise wrong(place, "rows of unequal length", f"an array of {words}") from None
    if np.ma.is_masked(values):  # numpy would use the numbers below the mask
        raise wrong(place, "masked values", f"an array of {words} without masked values")
    if given.size and given.dtype.kind not in accepted:
        seen = type(values).__name__ if given.dtype == object and not given.ndim else given.dtype
        raise wrong(place, seen, f"an array of {words}")
    if shape is not None and (
        given.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, given.shape, strict=True))
    ):
        sizes = ", ".join("n" if n < 0 else str(n) for n in shape)
        expected = f"{words} of shape ({sizes}{',' if len(shape) == 1 else ''})"
        raise wrong(place, f"shape {given.shape}", expected)
    return np.array(given, dtype=kind, order="C")


def refuse(bad: Mask, place: str, values: Any, expected: str) -> None:
    """Raise InputError for the first row with a fault; ``bad`` is a mask (n,) or (n, k)."""
    rows = bad if bad.ndim == 1 else bad.any(axis=1)
    if rows.any():
        k = int(rows.argmax())
        value = np.asarray(values[k]).tolist() if isinstance(values, np.ndarray) else repr(values[k])
        raise wrong(f"{place}, row {k}", value, expected)


def require_size(values: Array, place: str, *, missing: Mask | None = None) -> None:
    """Raise InputError for rows (n,) or (n, k) that are not finite or too large for a coordinate.

    Rows ``missing`` are allowed.
    """
    bad = ~(np.abs(values) <= LARGEST)
    if missing is not None:
        bad &= ~(missing if bad.ndim == 1 else missing[:, None])
    refuse(bad, place, values, f"a finite number, at most {LARGEST:g} in size")


def require_sigmas(values: Array, place: str, *, missing: bool = False) -> None:
    """Raise InputError for rows (n,) or (n, k) with impossible standard deviations; rows ``missing`` may be nan."""
    possible = (values >= SMALLEST) & (values <= LARGEST)
    refuse(~(possible | np.isnan(values) if missing else possible), place, values, _SIGMAS)


def require_positions(values: Index, place: str, of: str, count: int | None = None) -> None:
    """Raise InputError for positions (n,) below 0, or equal to ``count`` or above; ``of`` names what they count."""
    if len(values) and (values.min() < 0 or (count is not None and values.max() >= count)):
        last = "" if count is None else f" to {count - 1}"
        beyond = values < 0 if count is None else (values < 0) | (values >= count)
        refuse(beyond, place, values, f"positions of {of}, from 0{last}")


def having_role(roles: Sequence[Role | None], wanted: Role | None) -> Mask:
    """Return True for each point (n,) that has the wanted role."""
    return np.fromiter(map(operator.is_, roles, repeat(wanted)), bool, len(roles))


def sequence(values: Any, place: str) -> tuple[Any, ...]:
    """Return the items of a sequence or array as a tuple; raise InputError for a single text or any other value."""
    if isinstance(values, str | bytes) or not isinstance(values, Collection):
        raise wrong(place, repr(values), "a sequence, such as a tuple")
    return tuple(values.tolist() if isinstance(values, np.ndarray) else values)


def name_fault(name: object) -> str:
    """Return the reason why tables cannot hold this name of a point or image; "" if they can."""
    if not isinstance(name, str):
        return "text"
    if not name:
        return "a text that is not empty"
    if name != name.strip() or any(mark in name for mark in "\r\n\0"):
        return "a text without line breaks and NUL, and without blanks at its ends"
    return ""


def names(values: Sequence[str], place: str) -> tuple[str, ...]:
    """Return the names as a tuple; each must be a text that tables can hold, and must occur once.

    Raises
    ------
    InputError
        A name has another type, is impossible, or occurs twice.
    """
    out = sequence(values, place)
    try:
        joined = "\n".join(out)
        good = all(out) and tuple(map(str.strip, out)) == out
        good = good and joined.count("\n") == max(len(out) - 1, 0) and "\r" not in joined and "\0" not in joined
    except TypeError:
        good = False
    if not good:
        k, reason = next((k, name_fault(one)) for k, one in enumerate(out) if name_fault(one))
        raise wrong(f"{place}, row {k}", repr(out[k]), reason)
    if len(set(out)) < len(out):
        seen = set[str]()
        k = next(k for k, one in enumerate(out) if one in seen or seen.add(one))  # type: ignore[func-returns-value]
        raise wrong(f"{place}, row {k}", repr(out[k]), "each name once")
    return out
