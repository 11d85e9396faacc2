"""Chart of the residual vectors of a rectification; as a file it carries its own colours."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.report.chart import INKS, Chart, large, mapped, round_down
from fg_orient.report.svg import svg
from fg_orient.report.words import printable, scientific

Array = npt.NDArray[np.float64]

#: Length of a large residual (90 % quantile), and of the longest one at most, as shares of the width.
SHARE: Final = 0.07
MOST: Final = 0.3
#: More points than this are thinned.
MAX_POINTS: Final = 3000


def residual_chart(record: dict[str, Any]) -> Chart:
    """Points in the target system with their residuals, enlarged.

    Parameters
    ----------
    record : dict
        See :func:`fg_orient.rectification.record.record_of`.

    Returns
    -------
    Chart
        Maps have north up, images lines downwards.
    """
    (first, second), unit = record["axes"], record["unit"]
    rows = record["points"][:: max(1, math.ceil(len(record["points"]) / MAX_POINTS))]
    across, up = (second, first) if first == "line" else (first, second)
    sign = np.array([1.0, -1.0 if "line" in (first, second) else 1.0])
    at = _columns(rows, f"{across}_{unit}", f"{up}_{unit}") * sign
    vector = _columns(rows, f"residual_{across}_{unit}", f"residual_{up}_{unit}") * sign
    per_width = max(large(vector) / SHARE, float(np.linalg.norm(vector, axis=1).max()) / MOST)
    wide = max(float(np.ptp(at, axis=0).max()), 1e-9)
    room = float(np.abs(vector).max()) / per_width * wide if per_width else 0.0
    chart = mapped("residual vectors", np.vstack([at - room, at + room]), margin=28.0, per_width=per_width)
    roles = np.array([row["role"] for row in rows])
    for role, kind in (("control", "control"), ("check", "check")):
        mine = np.flatnonzero(roles == role)
        if len(mine):
            tips = [f"{printable(rows[k]['id'])}: residual {scientific(float(np.linalg.norm(vector[k])))} {unit}"
                    for k in mine.tolist()]  # fmt: skip
            chart.add("dots", kind, *at[mine].T, label=role, tips=tips, vectors=vector[mine])
    suspicious = np.array([bool(row["suspicious"]) for row in rows])
    if suspicious.any():
        chart.add("dots", "ring", *at[suspicious].T, label="suspicious")
    wide = float(np.ptp(chart.x.limits))
    bar = round_down(0.2 * wide)
    chart.bars = [(bar / wide, f"{bar:g} {unit}")]
    if per_width:
        size = round_down(0.2 * per_width)
        times = f"{float(f'{wide / per_width:.2g}'):,.0f}"
        chart.bars.append((size / per_width, f"{size:g} {unit} residual, enlarged {times} times"))
    return chart


def residual_file(record: dict[str, Any]) -> str:
    """Text of the chart as an SVG file."""
    looks = "".join(
        f".{kind}{{fill:{ink.colour if ink.filled else 'none'};stroke:{ink.colour}}}"
        for kind, ink in INKS.items() if kind in ("control", "check", "ring")
    )  # fmt: skip
    others = "text{font:14px sans-serif}.bar-line{stroke:#566069}.vector,.bar-line{fill:none}"
    head, _, rest = str(svg(residual_chart(record))).partition(">")
    return f'{head} xmlns="http://www.w3.org/2000/svg"><style>{looks}{others}</style>{rest}'


def _columns(rows: list[dict[str, Any]], *names: str) -> Array:
    return np.array([[row[name] for name in names] for row in rows], float)
