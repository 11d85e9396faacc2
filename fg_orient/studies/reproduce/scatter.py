"""Chart of published against reproduced values: one point per number, both axes logarithmic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from fg_orient.report.chart import Axis, Chart, plain_exponent
from fg_orient.studies.reproduce.reproduction import Row

SIZE: Final = 520.0
#: Largest range of the axes, powers of ten; sizes outside are drawn at the border.
RANGE: Final = (-30, 15)
#: Largest ratio of numbers of the same order.
BAND: Final = 10.0


def scatter(rows: Sequence[Row]) -> Chart | None:
    """Sizes of all numbers other than zero that are published and reproduced; None if fewer than two.

    Points at the same place are drawn once.
    """
    pairs = [(abs(r.published), abs(r.reproduced), r) for r in rows]
    pairs = [p for p in pairs if all(math.isfinite(v) and v > 0.0 for v in p[:2])]
    if len(pairs) < 2:
        return None
    powers = [math.log10(v) for p in pairs for v in p[:2]]
    low, high = (min(max(f, RANGE[0]), RANGE[1]) for f in (math.floor(min(powers)), math.ceil(max(powers))))
    limits = 10.0**low, 10.0 ** max(high, low + 1)
    x, y = (Axis(words, limits, log=True, write=_power) for words in ("published", "reproduced"))
    chart = Chart("published against reproduced sizes", x, y, width=SIZE, height=SIZE, left=60.0)
    line = np.array(limits)
    chart.add("area", "band", np.append(line, line[::-1]), np.append(line * BAND, line[::-1] / BAND))
    chart.add("line", "curve", line, line)
    drawn: dict[tuple[int, int, str], tuple[float, float, Row]] = {}
    for published, reproduced, row in pairs:
        across, up = (min(max(v, limits[0]), limits[1]) for v in (published, reproduced))
        at = chart.place(across, up)
        drawn.setdefault((round(at[0]), round(at[1]), row.verdict), (across, up, row))
    for kind in dict.fromkeys(row.verdict for _, _, row in drawn.values()):
        mine = [dot for dot in drawn.values() if dot[2].verdict == kind]
        tips = [f"{r.table}, {r.cell}: published {r.printed}, reproduced {r.reproduced:.3g}" for _, _, r in mine]
        chart.add("dots", f"dot {kind}", [p for p, _, _ in mine], [v for _, v, _ in mine], tips=tips)
    return chart


def _power(value: float) -> str:
    return plain_exponent(f"{value:.0e}")
