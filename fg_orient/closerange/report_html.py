"""Renders the report of close range: one HTML file that needs nothing else."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from fg_orient.closerange.report_maps import columns, deviation_views, distance_histogram, scene_of, views_of
from fg_orient.closerange.report_plots import (
    MAX_PHOTOS,
    directions_chart,
    distortions,
    residual_panels,
    residual_rows,
)
from fg_orient.closerange.report_words import KINDS, problems, significant, suspects, unit_of, verdict
from fg_orient.report.page import environment
from fg_orient.report.plots import heat_map, iteration_charts, redundancy_chart

PACKAGE: Final = "fg_orient.closerange"
#: Rows of a table that the page shows; closerange.json and points.csv hold all.
MANY: Final = 200
#: Largest residuals that are listed, and photos whose correlations are drawn.
WORST: Final = 20


def render(record: dict[str, Any]) -> str:
    """Give the HTML text of a record.

    Parameters
    ----------
    record : dict
        Of ``dlt``, ``resect``, ``intersect``, ``bundle`` or ``surface``.
    """
    record = _complete(record)
    shell = environment(PACKAGE)
    shell.filters |= {"significant": significant}
    told = problems(record)
    parts = _surface(record) if record["kind"] == "surface" else _photos(record)
    accuracy = _accuracy(record)
    return shell.get_template("closerange.html.j2").render(
        r=record, kind=KINDS[record["kind"]], verdict=verdict(record, told), problems=told, many=MANY,
        accuracy=accuracy, suspects=suspects(record)[:WORST], **parts,
    )  # fmt: skip


def _complete(record: dict[str, Any]) -> dict[str, Any]:
    """Give every kind of record the parts that others have, empty."""
    lists = ("photos", "cameras", "points", "figures", "residuals", "observations", "distortion", "history")
    photo: dict[str, Any] = {"parameters": [], "interior": None, "observed": None}
    photos = [photo | one for one in record.get("photos", [])]
    return {name: [] for name in lists} | {"check": None} | record | {"photos": photos}


def _surface(record: dict[str, Any]) -> dict[str, Any]:
    """Drawings and tables of a surface."""
    points = sorted(record["points"], key=lambda p: -abs(p["distance_m"]))
    return _empty() | {"views": deviation_views(record), "histogram": distance_histogram(record), "deviations": points}


def _photos(record: dict[str, Any]) -> dict[str, Any]:
    """Drawings and tables of photos and points."""
    redundancy = columns(record.get("residuals", []), "redundancy_x", "redundancy_y")
    return _empty() | {
        "views": views_of(scene_of(record)), "residuals": residual_rows(record),
        "panels": residual_panels(record), "max_photos": MAX_PHOTOS, "worst": _worst(record),
        "curves": distortions(record), "heat": _heat(record), "directions": directions_chart(record),
        "redundancy": redundancy_chart(redundancy, ("x", "y")),
        "history": iteration_charts(record.get("history", []), "m, rad or camera steps"),
    }  # fmt: skip


def _empty() -> dict[str, Any]:
    """What the template asks of every page."""
    lists: dict[str, Any] = {name: [] for name in (
        "views", "residuals", "panels", "worst", "curves", "heat", "deviations", "history")}  # fmt: skip
    return lists | {"histogram": None, "directions": None, "redundancy": None, "max_photos": MAX_PHOTOS}


def _accuracy(record: dict[str, Any]) -> dict[str, Any]:
    """Mean errors of new points, control points and stations; check points: their RMS; one unit for the table."""
    rows: list[tuple[str, int, list[float | None], list[float | None]]] = []
    points = record.get("points", []) if record["kind"] in ("bundle", "intersection") else []
    for role, words in (("check", "check points, standard deviations"), ("new", "new points"),
                        ("control", "control points")):  # fmt: skip
        mine = [[p[f"sigma_{a}_m"] for a in "xyz"] for p in points if p.get("role", "new") == role]
        if any(row[0] is not None for row in mine):
            rows.append((words, len(mine), *_rms_and_largest(mine)))
    centres = [p["exterior"]["sigma_centre_m"] for p in record.get("photos", []) if p.get("exterior")]
    if any(row[0] is not None for row in centres):
        rows.append(("camera stations", len(centres), *_rms_and_largest(centres)))
    check = record.get("check")
    errors = [] if not check else [[v / 1e3 for v in check[k]] for k in ("rms_mm", "mean_mm", "worst_mm")]
    unit, factor = unit_of([v for _, _, rms, _ in rows for v in rms if v is not None] + [v for e in errors for v in e])
    scaled = [(w, n, [None if v is None else factor * v for v in a], [None if v is None else factor * v for v in b])
              for w, n, a, b in rows]  # fmt: skip
    shown = [[factor * v for v in e] for e in errors]
    return {
        "unit": unit,
        "factor": factor,
        "rows": scaled,
        "check": None if not check else {"n": check["n"], "values": shown},
    }


def _rms_and_largest(rows: list[list[float | None]]) -> tuple[list[float | None], list[float | None]]:
    values = np.array([[np.nan if v is None else v for v in row] for row in rows])
    if not np.isfinite(values).all():
        return [None] * 3, [None] * 3
    return np.sqrt(np.mean(values**2, axis=0)).tolist(), values.max(axis=0).tolist()


def _worst(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Image points with the largest residuals, over their own standard deviations where these are known."""
    rows = record.get("residuals") or [
        {"photo": photo["photo"]} | row for photo in record.get("photos", []) for row in photo["points"]
    ]

    def size(row: dict[str, Any]) -> float:
        own = [abs(row[f"w_{a}"]) for a in "xy" if row.get(f"w_{a}") is not None]
        return max(own) if own else -1.0 if "w_x" in row else math.hypot(row["residual_x"], row["residual_y"])

    return sorted(rows, key=lambda row: -size(row))[:WORST]


def _heat(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Correlations of the unknowns of each photo and camera as triangles."""
    out = []
    for part in record.get("correlations", {}).get("parts", [])[:MAX_PHOTOS]:
        n = len(part["names"])
        rho = np.full((n, n), np.nan)
        for i, row in enumerate(part["triangle"]):
            rho[i, :i] = [np.nan if v is None else v for v in row]
        if n > 1:
            out.append({"of": part["of"], "width": 32 * n + 140, "drawing": heat_map(part["of"], part["names"], rho)})
    return out
