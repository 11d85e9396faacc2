"""Sine and cosine without calls or branches, so that loops over observations become vector instructions.

The argument is reduced by multiples of pi/2 in two parts (Cody & Waite 1980, ch. 8) and the series end where the
remainder is below rounding. The cosine is given as its difference to one, which keeps the digits of small corrections.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from factors._contract import inlined
from factors._plain import on_arrays

#: pi/2 to 33 bits, so that its multiples up to 2^20 are exact, and the remainder.
_HIGH: Final = int(0.5 * math.pi * 2.0**32) / 2.0**32
_LOW: Final = (0.5 * math.pi - _HIGH) + 6.123233995736766e-17
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = ((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 9))
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16 = ((-1) ** k / math.factorial(2 * k) for k in range(1, 9))


@on_arrays(np.where)
@inlined
def _chosen(condition: Any, one: Any, other: Any) -> Any:
    """``one`` where the condition is true, else ``other``."""
    return one if condition else other


@inlined
def sine_cosine(x: Any) -> Any:
    """Sine, and cosine minus one, of an angle (rad), real or complex near the real axis.

    Absolute errors below 2.2e-16 up to 1e6 rad, below 1e-15 relative up to pi/4; beyond 1e15 rad no digit is correct.
    """
    k = np.floor(x.real * (2.0 / math.pi) + 0.5)
    half = np.floor(0.5 * k)
    sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
    r = (x - k * _HIGH) - k * _LOW
    z = r * r
    s = r + r * z * (_S3 + z * (_S5 + z * (_S7 + z * (_S9 + z * (_S11 + z * (_S13 + z * (_S15 + z * _S17)))))))
    c = z * (_C2 + z * (_C4 + z * (_C6 + z * (_C8 + z * (_C10 + z * (_C12 + z * (_C14 + z * _C16)))))))
    odd = k - 2.0 * half > 0.5
    first, second = 1.0 + c, -1.0 - s
    return sign * _chosen(odd, first, s), sign * _chosen(odd, second, c) + (sign - 1.0)
