"""Round lengths of scale bars, and exaggerations, as people read them."""

from __future__ import annotations

import math


def round_down(value: float) -> float:
    """Largest of 1, 2, 5 times a power of ten that is not above the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-12))


def thousands(value: float) -> str:
    """Two or three digits that count: an exaggeration is no measurement."""
    return f"{float(f'{value:.2g}'):,.0f}"
