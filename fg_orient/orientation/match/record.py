"""Quality report of matching: the record of a run as JSON, and as a page with images."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.project import ProjectImages
from fg_orient.formats.rasters import Raster
from fg_orient.model.distributions import normal_within
from fg_orient.model.errors import Finding, as_record, finding, findings_of, sentences
from fg_orient.model.installation import stamp, versions
from fg_orient.orientation.match.features import cv2_of
from fg_orient.orientation.match.tasks import Setup
from fg_orient.orientation.match.tracks import PairResult, TiePoints
from fg_orient.report.chart import Axis, Chart, broad
from fg_orient.result.plain import dumps

#: Longest edge of an image on the page, its JPEG quality, and maximum number of images.
PICTURE_PX: Final = 640
QUALITY: Final = 70
PICTURES: Final = 12
#: The report warns if the share of rejected y-parallaxes, of wrong matches or of empty cells is above these.
REJECTED: Final = 0.05
WRONG: Final = 0.002
EMPTY: Final = 0.2
#: Colours (blue, green, red) of points with two and with more rays.
TWO_RAYS, MORE_RAYS = (0, 165, 255), (90, 220, 60)


def record_of(
    read: ProjectImages,
    setup: Setup,
    results: list[PairResult],
    failed: list[tuple[str, str, str]],
    ties: TiePoints,
    seconds: float,
    command: Sequence[str],
) -> dict[str, Any]:
    """Return the record of a run."""
    ids = [image.id for image in read.images]
    rays = np.bincount(ties.point, minlength=ties.n_points)
    pairs = [{"a": ids[r.a], "b": ids[r.b], **r.record} for r in results]
    images = [_image(ids[k], k, setup, ties, rays) for k in range(len(ids))]
    parallax = np.concatenate([r.residual_px for r in results])
    raw = np.concatenate([r.matches.parallax_px for r in results])
    record: dict[str, Any] = {
        "name": read.name,
        "n_points": ties.n_points,
        "n_image_points": len(ties.point),
        "rays": {str(k): int(n) for k, n in enumerate(np.bincount(rays)) if k > 1 and n},
        "heights_m": [setup.low_m, setup.high_m],
        "dem": Path(setup.dem).name if setup.dem else "",
        "y_parallax_before_rms_px": float(np.sqrt(np.mean(raw**2))),
        "y_parallax_after_rms_px": float(np.sqrt(np.mean(parallax**2))),
        "sigma_px": _quantiles(ties.sigma_px),
        "predicted_wrong_share": float(sum(p["predicted_wrong"] for p in pairs) / max(len(parallax), 1)),
        "images": images,
        "pairs": pairs,
        "pairs_without_matches": [{"a": a, "b": b, "reason": why} for a, b, why in failed],
        "options": asdict(setup.options),
        "seconds": seconds,
        **stamp(command),
    }
    record["versions"] |= versions(("opencv-python-headless",))
    return {**record, **as_record(_findings(record))}


def _quantiles(sigma: Array) -> dict[str, float]:
    low, middle, high = np.quantile(sigma, [0.05, 0.5, 0.95]).tolist()
    return {"quantile_5": low, "median": middle, "quantile_95": high}


def _image(name: str, k: int, setup: Setup, ties: TiePoints, rays: Any) -> dict[str, Any]:
    """Return the points of an image, and its cells that contain points."""
    place, own = setup.places[k], ties.image == k
    row = (ties.pixel[own] - [place.line, place.sample]) * setup.options.cells / [place.rows, place.columns]
    cell = np.clip(np.floor(row).astype(int), 0, setup.options.cells - 1)
    filled = len(np.unique(cell[:, 0] * setup.options.cells + cell[:, 1]))
    return {
        "id": name,
        "file": Path(place.path).name,
        "rows": place.rows,
        "columns": place.columns,
        "points": int(own.sum()),
        "mean_rays": float(rays[ties.point[own]].mean()) if own.any() else 0.0,
        "cells": setup.options.cells**2,
        "cells_with_points": filled,
    }


def _findings(record: dict[str, Any]) -> list[Finding]:
    """Return the remarks on the result."""
    found = [
        finding("match.pair_failed", place=f"{p['a']} and {p['b']}", reason=p["reason"])
        for p in record["pairs_without_matches"]
    ]
    for image in record["images"]:
        if not image["points"]:
            found.append(finding("match.image_without", place=f"image {image['id']}"))
    for p in record["pairs"]:
        rejected = p["beyond_limit"] / max(p["local_heights"], 1)
        if rejected > REJECTED:
            found.append(finding("match.many_rejected", place=f"{p['a']} and {p['b']}", share=100.0 * rejected))
        if p["predicted_wrong_share"] > WRONG:
            found.append(
                finding("match.many_wrong", place=f"{p['a']} and {p['b']}", share=100.0 * p["predicted_wrong_share"])
            )
    return found


# --- files ---------------------------------------------------------------------------------------


def write_report(
    folder: Path, record: dict[str, Any], results: list[PairResult], ties: TiePoints, setup: Setup
) -> None:
    """Write ``match.json`` and ``report.html``."""
    from fg_orient.report.page import environment

    (folder / "match.json").write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
    pictures = [
        {"id": image["id"], "data": _picture(k, ties, setup)} for k, image in enumerate(record["images"][:PICTURES])
    ]
    page = (
        environment("fg_orient.orientation.match")
        .get_template("match.html.j2")
        .render(
            r=record,
            chart=_parallax_chart(results),
            pictures=pictures,
            verdict=_verdict(record),
            problems=sentences(record),
        )
    )
    (folder / "report.html").write_text(page, encoding="utf-8")


def _verdict(record: dict[str, Any]) -> dict[str, str]:
    """Return the first lines of the page."""
    text = (
        f"{record['n_points']} tie points, {record['n_image_points']} image points. "
        f"y-parallax {record['y_parallax_before_rms_px']:.2f} px RMS with the given orientation, "
        f"{record['y_parallax_after_rms_px']:.2f} px after removal of its trend in each pair."
    )
    good = not findings_of(record)
    return {
        "kind": "good" if good else "warn",
        "text": text,
        "title": "Tie points measured" if good else "Tie points measured, with remarks",
    }


def _picture(k: int, ties: TiePoints, setup: Setup) -> str:
    """Return image k with its points, as JPEG in base64."""
    cv2 = cv2_of()
    place, raster = setup.places[k], Raster(setup.places[k])
    factor = max(1, -(-max(place.rows, place.columns) // PICTURE_PX))
    grey = raster.reduced(factor)
    valid = np.isfinite(grey)
    low, high = np.percentile(grey[valid], (1, 99)) if valid.any() else (0.0, 1.0)
    picture = np.clip((np.where(valid, grey, low) - low) * (255.0 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    rays = np.bincount(ties.point, minlength=max(ties.n_points, 1))
    own = ties.image == k
    at = (ties.pixel[own] - [place.line, place.sample] + 0.5) / factor - 0.5
    for (line, sample), count in zip(np.rint(at).astype(int).tolist(), rays[ties.point[own]].tolist(), strict=True):
        cv2.circle(colour, (sample, line), 1, MORE_RAYS if count > 2 else TWO_RAYS, -1)
    _, data = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return base64.b64encode(data.tobytes()).decode()


def _parallax_chart(results: list[PairResult]) -> Chart:
    """Return the histogram of the y-parallaxes in their standard deviations, with the normal distribution."""
    z = np.concatenate([r.residual_px / np.sqrt(r.variance_parallax) for r in results])
    edges = np.linspace(-4.0, 4.0, 41)
    counts = np.histogram(z, edges)[0]
    expected = len(z) * np.diff(0.5 * np.sign(edges) * normal_within(np.abs(edges), 1.0))
    top = 1.1 * max(float(counts.max()), float(expected.max()))
    chart = broad(
        "histogram of the y-parallaxes in their standard deviations",
        Axis("y-parallax / its standard deviation", (-4.0, 4.0)),
        Axis("points", (0.0, top)),
    )
    chart.add("bars", "series-0", edges, counts, label="measured")
    chart.add("line", "series-1", 0.5 * (edges[1:] + edges[:-1]), expected, label="normal distribution")
    return chart
