"""Check arguments; invalid values are refused with a message of the catalogue."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.arrays import array
from fg_orient.model.errors import InputError


def numbers(place: str, values: npt.ArrayLike) -> Array:
    """Return one or more numbers as an array.

    They need not be finite. InputError: a value is not a number.
    """
    out = array(values, place)
    if not out.size:
        raise InputError.of("rectify.numbers", place=place, value="none")
    return out


def finite(place: str, values: npt.ArrayLike) -> Array:
    """Return one or more finite numbers as an array; raise InputError for other values."""
    out = numbers(place, values)
    if not np.isfinite(out).all():
        raise InputError.of("rectify.numbers", place=place, value=f"{np.sum(~np.isfinite(out))} not finite")
    return out


def number(place: str, value: float, unit: str, *, least: float = -math.inf) -> float:
    """Return a finite number that is not below ``least``; raise InputError for other values."""
    out = numbers(place, value)
    if out.ndim or not math.isfinite(out) or out < least:
        words = f"a finite number of {unit}" + (f", not below {least:g}" if least > -math.inf else "")
        raise InputError.of("options.value", place=place, value=value, expected=words)
    return float(out)


def positive(place: str, value: float, unit: str) -> float:
    """Return a finite number above 0; raise InputError for other values."""
    out = numbers(place, value)
    if out.ndim or not math.isfinite(out) or out <= 0.0:
        raise InputError.of("rectify.positive", place=place, value=value, unit=unit)
    return float(out)


def whole(place: str, value: int, least: int) -> int:
    """Return a whole number that is not below ``least``; raise InputError for other values."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError.of("options.value", place=place, value=value, expected=f"a whole number from {least}")
    return int(value)
