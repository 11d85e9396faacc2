"""Report of close range: one self-contained HTML file made from the record of a command, and figures for papers.

The page is made from ``closerange.json`` alone, so that ``fg-orient report DIR`` writes it again at any time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from fg_orient.closerange import report_plots as plots
from fg_orient.closerange.report_maps import columns, deviation_views, distance_histogram, scene_of, views_of
from fg_orient.closerange.report_words import KINDS, photo_rows, problems, significant, suspects, unit_of, verdict
from fg_orient.formats.atomic import write_text
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.report import figures
from fg_orient.report.page import environment
from fg_orient.report.plots import heat_map, iteration_charts, redundancy_chart

#: Record that makes a folder one of close range, and the page in it.
RECORD_FILE: Final = "closerange.json"
REPORT_FILE: Final = "report.html"
PACKAGE: Final = "fg_orient.closerange"
#: Rows of a table that the page shows; closerange.json and points.csv contain all.
MANY: Final = 200
#: Largest residuals that are listed, and photos whose correlations are drawn.
WORST: Final = 20


def is_closerange(folder: Path) -> bool:
    """Whether a folder holds a result of close range."""
    return (folder / RECORD_FILE).is_file()


def read_record(folder: Path) -> dict[str, Any]:
    """Record of a folder; InputError if it is missing or damaged, or of a version that has no report."""
    path = folder / RECORD_FILE
    try:
        record = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError.of("report.damaged", file=path, value=error) from None
    if not isinstance(record, dict) or "report" not in record:
        raise InputError.of("report.damaged", file=path, value="written by an earlier version")
    return record


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` of a close-range folder, whole or not at all; path of the file."""
    path = Path(folder) / REPORT_FILE
    write_text(path, render(read_record(Path(folder))))
    return path


def write_figures(
    folder: str | Path, out: str | Path | None = None, *, overwrite: bool = False, progress: Progress | None = None
) -> tuple[Path, list[str]]:
    """Write the figures of a close-range folder; see :func:`fg_orient.report.figures.write_figures`."""
    figures.require_matplotlib()
    record = _used(read_record(Path(folder)))

    def captions(drawn: Collection[str]) -> str:
        return "\n".join(["# Figures", "", *(f"- `{name}`: {plots.PLOTS[name][1]}" for name in drawn), ""])

    charts = {name: partial(draw, record) for name, (draw, _) in plots.PLOTS.items()}
    return figures.draw_figures(
        charts, captions, out or Path(folder) / figures.FOLDER, overwrite=overwrite, progress=progress
    )


def render(record: dict[str, Any]) -> str:
    """Give the HTML text of a record.

    Parameters
    ----------
    record : dict
        Of ``dlt``, ``resect``, ``intersect``, ``bundle`` or ``surface``.
    """
    record = _used(record)
    lists = ("photos", "cameras", "points", "figures", "residuals", "observations", "distortion", "history")
    photo: dict[str, Any] = {"parameters": [], "interior": None, "observed": None}
    photos = [photo | one for one in record.get("photos", [])]
    # every kind of record has the parts that others have, empty
    record = {name: [] for name in lists} | {"check": None, "significance": None} | record | {"photos": photos}
    shell = environment(PACKAGE)
    shell.filters |= {"significant": significant}
    doubts = problems(record)
    is_surface, points = record["kind"] == "surface", record["points"]
    return shell.get_template("closerange.html.j2").render(
        r=record, kind=KINDS[record["kind"]], verdict=verdict(record, doubts), problems=doubts, many=MANY,
        accuracy=_accuracy(record), suspects=suspects(record)[:WORST],
        views=deviation_views(record) if is_surface else views_of(scene_of(record)),
        histogram=distance_histogram(record) if is_surface else None,
        deviations=sorted(points, key=lambda p: -abs(p["distance_m"])) if is_surface else [],
        residuals=plots.residual_rows(record), panels=plots.residual_panels(record), max_photos=plots.MAX_PHOTOS,
        worst=_worst(record), curves=plots.distortions(record), heat=_heat(record),
        directions=plots.directions_chart(record),
        history=iteration_charts(record["history"], "m, rad or camera steps"),
        redundancy=redundancy_chart(columns(record["residuals"], "redundancy_x", "redundancy_y"), ("x", "y")),
    )  # fmt: skip


def _accuracy(record: dict[str, Any]) -> dict[str, Any]:
    """Mean errors of new points, control points and stations; check points: their RMS; one unit for the table."""
    points = record["points"] if record["kind"] in ("bundle", "intersection") else []
    spreads = {
        words: columns([p for p in points if p.get("role", "new") == role], *(f"sigma_{a}_m" for a in "xyz"))
        for role, words in (("check", "check points, standard deviations"), ("new", "new points"),
                            ("control", "control points"))
    }  # fmt: skip
    spreads["camera stations"] = scene_of(record).station_sigma if record["photos"] else np.zeros((0, 3))
    rows = [(words, len(v), np.sqrt(np.mean(v**2, axis=0)), v.max(axis=0))
            for words, v in spreads.items() if np.isfinite(v[:, 0]).any()]  # fmt: skip
    check = record["check"]
    errors = np.array([check[k] for k in ("rms_mm", "mean_mm", "worst_mm")] if check else []) / 1e3
    unit, factor = unit_of([*(v for _, _, rms, _ in rows for v in rms), *errors.ravel()])
    return {
        "unit": unit, "factor": factor, "rows": [(w, n, factor * rms, factor * top) for w, n, rms, top in rows],
        "check": {"n": check["n"], "values": factor * errors} if check else None,
    }  # fmt: skip


def _used(record: dict[str, Any]) -> dict[str, Any]:
    """The record without image points that a search for gross errors rejected."""
    return record | {"residuals": [row for row in record.get("residuals", []) if row.get("weight") != 0.0]}


def _worst(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Image points with the largest residuals, over their own standard deviations where these are known."""
    rows = record["residuals"] or photo_rows(record)

    def size(row: dict[str, Any]) -> float:
        own = [abs(row[f"w_{a}"]) for a in "xy" if row.get(f"w_{a}") is not None]
        unchecked = "w_x" in row and record.get("loss", "none") == "none"
        return max(own) if own else -1.0 if unchecked else math.hypot(row["residual_x"], row["residual_y"])

    return sorted(rows, key=lambda row: -size(row))[:WORST]


def _heat(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Correlations of the unknowns of each photo and camera as triangles."""
    out = []
    for part in record.get("correlations", {}).get("parts", [])[: plots.MAX_PHOTOS]:
        n = len(part["names"])
        rho = np.full((n, n), np.nan)
        for i, row in enumerate(part["triangle"]):
            rho[i, :i] = np.array(row, float)
        if n > 1:
            out.append({"of": part["of"], "width": 32 * n + 140, "drawing": heat_map(part["of"], part["names"], rho)})
    return out
