"""HTML report of close range: one file that needs no other files."""

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
from fg_orient.closerange.report_words import KINDS, photo_rows, problems, significant, suspects, unit_of, verdict
from fg_orient.report.page import environment
from fg_orient.report.plots import heat_map, iteration_charts, redundancy_chart

PACKAGE: Final = "fg_orient.closerange"
#: Rows of a table that the page shows; closerange.json and points.csv contain all.
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
    doubts = problems(record)
    return shell.get_template("closerange.html.j2").render(
        r=record, kind=KINDS[record["kind"]], verdict=verdict(record, doubts), problems=doubts, many=MANY,
        accuracy=_accuracy(record), suspects=suspects(record)[:WORST], **_drawings(record),
    )  # fmt: skip


def _complete(record: dict[str, Any]) -> dict[str, Any]:
    """Give every kind of record the parts that others have, empty."""
    lists = ("photos", "cameras", "points", "figures", "residuals", "observations", "distortion", "history")
    photo: dict[str, Any] = {"parameters": [], "interior": None, "observed": None}
    photos = [photo | one for one in record.get("photos", [])]
    return {name: [] for name in lists} | {"check": None} | record | {"photos": photos}


def _drawings(record: dict[str, Any]) -> dict[str, Any]:
    """Drawings and their tables; those that a kind of record does not have are empty."""
    is_surface = record["kind"] == "surface"
    farthest = sorted(record["points"], key=lambda p: -abs(p["distance_m"])) if is_surface else []
    return {
        "views": deviation_views(record) if is_surface else views_of(scene_of(record)),
        "histogram": distance_histogram(record) if is_surface else None, "deviations": farthest,
        "residuals": residual_rows(record), "panels": residual_panels(record), "max_photos": MAX_PHOTOS,
        "worst": _worst(record), "curves": distortions(record), "heat": _heat(record),
        "directions": directions_chart(record),
        "history": iteration_charts(record["history"], "m, rad or camera steps"),
        "redundancy": redundancy_chart(columns(record["residuals"], "redundancy_x", "redundancy_y"), ("x", "y")),
    }  # fmt: skip


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


def _worst(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Image points with the largest residuals, over their own standard deviations where these are known."""
    rows = record["residuals"] or photo_rows(record)

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
            rho[i, :i] = np.array(row, float)
        if n > 1:
            out.append({"of": part["of"], "width": 32 * n + 140, "drawing": heat_map(part["of"], part["names"], rho)})
    return out
