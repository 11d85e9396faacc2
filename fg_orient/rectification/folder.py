"""Result folder of ``rectify fit``: tables, JSON, chart of the residual vectors, report."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from fg_orient.formats.atomic import Contents
from fg_orient.model.errors import sentences
from fg_orient.rectification.points import PointFit
from fg_orient.report.chart import INKS, Chart, large, mapped, round_down
from fg_orient.report.svg import svg
from fg_orient.report.words import printable, scientific
from fg_orient.result.plain import dumps

#: Contents of the folder; transformation.json is its mark.
CONTENTS: Final = Contents(
    "transformation.json",
    ("transformation.json", "result.json", "points.csv", "coefficients.csv", "residuals.svg", "report.html"),
)
#: Length of a large residual (90 % quantile), and of the longest one at most, as shares of the width.
SHARE: Final = 0.07
MOST: Final = 0.3
#: More points than this are thinned.
MAX_POINTS: Final = 3000


def write_folder(folder: Path, fitted: PointFit, record: dict[str, Any]) -> None:
    """Fill an empty folder with the results of a fit."""
    transformation = fitted.fit.transformation.as_dict()
    kept = {key: value for key, value in record.items() if key != "out"}
    (folder / "transformation.json").write_text(dumps(transformation, indent=1) + "\n", encoding="utf-8")
    (folder / "result.json").write_text(dumps(kept, indent=1) + "\n", encoding="utf-8")
    (folder / "residuals.svg").write_text(residual_file(record) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(_report(kept), encoding="utf-8")
    write_rows(folder / "points.csv", record["points"])
    write_rows(folder / "coefficients.csv", record["coefficients"])


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a CSV table of rows with the same keys; None and nan are empty cells."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(next(iter(rows)))  # the keys
        for row in rows:
            values = ["" if v is None or v != v else str(v).lower() if isinstance(v, bool) else v for v in row.values()]
            writer.writerow(values)


def _report(record: dict[str, Any]) -> str:
    """HTML report, with the shell of all reports."""
    from fg_orient.report.page import environment

    heads = [f"residual {axis}, {record['unit']}" for axis in record["axes"]]
    return environment("fg_orient.rectification").get_template("rectify.html.j2").render(
        r=record, figure=residual_chart(record), heads=heads, verdict=_verdict(record), problems=sentences(record),
    )  # fmt: skip


def _verdict(record: dict[str, Any]) -> dict[str, str]:
    """Assessment of the fit: ``kind`` (good, warn), ``title`` and ``text``."""
    unit = "" if record["weighted"] else f" {record['unit']}"
    text = (
        f"{record['n_control']} control points, {record['n_unknowns']} unknowns, redundancy {record['redundancy']}. "
        "m0 is per coordinate and divided by the redundancy; RMSE is divided by the number of points."
    )
    text = f"m0 {scientific(record['m0'])}{unit}; {text}"
    if not sentences(record):
        return {"kind": "good", "title": "Fitted, nothing stands out", "text": text}
    title = "Fitted, with doubts" if record["redundancy"] else "Fitted, unchecked"
    return {"kind": "warn", "title": title, "text": text}


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
    names = f"{across}_{unit}", f"{up}_{unit}"
    at = np.array([[row[name] for name in names] for row in rows], float) * sign
    vector = np.array([[row[f"residual_{name}"] for name in names] for row in rows], float) * sign
    per_width = max(large(vector) / SHARE, float(np.linalg.norm(vector, axis=1).max()) / MOST)
    wide = max(float(np.ptp(at, axis=0).max()), 1e-9)
    room = float(np.abs(vector).max()) / per_width * wide if per_width else 0.0
    chart = mapped("residual vectors", np.vstack([at - room, at + room]), margin=28.0, per_width=per_width)
    roles = np.array([row["role"] for row in rows])
    for role in ("control", "check"):
        mine = np.flatnonzero(roles == role)
        if len(mine):
            tips = [f"{printable(rows[k]['id'])}: residual {scientific(float(np.linalg.norm(vector[k])))} {unit}"
                    for k in mine.tolist()]  # fmt: skip
            chart.add("dots", role, *at[mine].T, label=role, tips=tips, vectors=vector[mine])
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
