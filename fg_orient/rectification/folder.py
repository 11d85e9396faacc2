"""The result folder of ``rectify fit``: tables, JSON, figure, report."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from fg_orient.formats.atomic import Contents
from fg_orient.model.errors import sentences
from fg_orient.rectification.figure import residual_chart, residual_file
from fg_orient.rectification.points import PointFit
from fg_orient.report.words import scientific
from fg_orient.result.plain import dumps

#: What the folder holds; transformation.json is its mark.
CONTENTS: Final = Contents(
    "transformation.json",
    ("transformation.json", "result.json", "points.csv", "coefficients.csv", "residuals.svg", "report.html"),
)


def write_folder(folder: Path, found: PointFit, record: dict[str, Any]) -> None:
    """Fill an empty folder with the results of a fit."""
    transformation = found.fit.transformation.as_dict()
    kept = {key: value for key, value in record.items() if key != "out"}
    (folder / "transformation.json").write_text(dumps(transformation, indent=1) + "\n", encoding="utf-8")
    (folder / "result.json").write_text(dumps(kept, indent=1) + "\n", encoding="utf-8")
    (folder / "residuals.svg").write_text(residual_file(record) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(_report(kept), encoding="utf-8")
    _table(folder / "points.csv", record["points"])
    _table(folder / "coefficients.csv", record["coefficients"])


def _table(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a CSV table; None and nan are empty cells."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(rows[0])
        for row in rows:
            values = ["" if v is None or v != v else str(v).lower() if isinstance(v, bool) else v for v in row.values()]
            writer.writerow(values)


def _report(record: dict[str, Any]) -> str:
    """Render the HTML report: one file on the shell of all reports."""
    from fg_orient.report.page import environment

    heads = [f"residual {axis}, {record['unit']}" for axis in record["axes"]]
    return environment("fg_orient.rectification").get_template("rectify.html.j2").render(
        r=record, figure=residual_chart(record), heads=heads, verdict=_verdict(record), problems=sentences(record),
    )  # fmt: skip


def _verdict(record: dict[str, Any]) -> dict[str, str]:
    """Say how good the fit is: ``kind`` (good, warn), ``title`` and ``text``."""
    unit = "" if record["weighted"] else f" {record['unit']}"
    text = (
        f"{record['n_control']} control points, {record['n_unknowns']} unknowns, redundancy {record['redundancy']}. "
        "m0 is per coordinate and divided by the redundancy; RMSE is divided by the number of points."
    )
    found = f"m0 {scientific(record['m0'])}{unit}; {text}"
    if not sentences(record):
        return {"kind": "good", "title": "Fitted, nothing stands out", "text": found}
    title = "Fitted, with doubts" if record["redundancy"] else "Fitted, unchecked"
    return {"kind": "warn", "title": title, "text": found}
