"""Arguments of the helpers, checked: nonsense is refused with a message of the catalogue, never computed with."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]


def numbers(place: str, values: npt.ArrayLike) -> Array:
    """Give numbers as an array, finite or not.

    Raises
    ------
    InputError
        None at all, or something else than numbers.
    """
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError):
        raise InputError.of("rectify.numbers", place=place, value="no numbers") from None
    if not found.size:
        raise InputError.of("rectify.numbers", place=place, value="none")
    return found


def finite(place: str, values: npt.ArrayLike) -> Array:
    """Give numbers as an array.

    Raises
    ------
    InputError
        See :func:`numbers`; one that is not finite.
    """
    found = numbers(place, values)
    if not np.isfinite(found).all():
        raise InputError.of("rectify.numbers", place=place, value=f"{np.sum(~np.isfinite(found))} not finite")
    return found


def number(place: str, value: float, unit: str, *, least: float = -math.inf) -> float:
    """Give a finite number that is not below ``least``.

    Raises
    ------
    InputError
        It is not.
    """
    found = numbers(place, value)
    if found.ndim or not math.isfinite(found) or found < least:
        words = f"a finite number of {unit}" + (f", not below {least:g}" if least > -math.inf else "")
        raise InputError.of("options.value", place=place, value=value, expected=words)
    return float(found)


def positive(place: str, value: float, unit: str) -> float:
    """Give a finite number above 0.

    Raises
    ------
    InputError
        It is not.
    """
    found = numbers(place, value)
    if found.ndim or not math.isfinite(found) or found <= 0.0:
        raise InputError.of("rectify.positive", place=place, value=value, unit=unit)
    return float(found)


def whole(place: str, value: int, least: int) -> int:
    """Give a whole number that is not below ``least``.

    Raises
    ------
    InputError
        It is not.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError.of("options.value", place=place, value=value, expected=f"a whole number from {least}")
    return int(value)
