"""Make the report of close range, which is one HTML file without other files, and figures for papers.

The page is made only from ``closerange.json``, so that ``fg-orient report DIR`` can write it again at any time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.closerange.assessment import suspects
from fg_orient.closerange.report_maps import columns, deviation_views, distance_histogram, scene_of, views_of
from fg_orient.closerange.report_verdict import problems, verdict, with_status
from fg_orient.closerange.report_words import KINDS, photo_rows, significant, unit_of
from fg_orient.formats.atomic import Contents, write_text
from fg_orient.formats.load import foreign_bytes
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.report import figures
from fg_orient.report.chart import Axis, Chart, broad, cut, round_down
from fg_orient.report.page import environment
from fg_orient.report.plots import (
    ENDS,
    heat_map,
    histogram,
    iteration_charts,
    quantiles,
    redundancy_chart,
    thinned,
    vectors,
)
from fg_orient.report.words import printable
from fg_orient.result.manifest import MANIFEST_FILE, checked_record, is_made_by

Charts = Sequence[Chart | None]

#: Maximum number of photos and cameras on a page, and of photos on paper. Photos with the most image
#: points are shown.
MAX_PHOTOS: Final = 16
FEW_PHOTOS: Final = 6
#: Maximum number of vectors of one photo.
MAX_VECTORS: Final = 400
#: A direction with a smaller singular value, in units of one image point, is refused as not determined.
REFUSED: Final = 1e-3


def by_photo(record: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return the image points with residuals by photo, in the order of the photos."""
    out: dict[str, list[dict[str, Any]]] = {}
    for row in record.get("residuals") or photo_rows(record):
        out.setdefault(row["photo"], []).append(row)
    return out


def residual_rows(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the figures of each photo: number of points, RMS of x and y, largest residual and its point."""
    out = []
    for name, rows in by_photo(record).items():
        v, w = columns(rows, "residual_x", "residual_y"), columns(rows, "w_x", "w_y")
        worst, (rms_x, rms_y) = int(np.argmax(np.abs(v).max(axis=1))), np.sqrt(np.mean(v**2, axis=0)).tolist()
        out.append(
            {
                "photo": name,
                "n": len(rows),
                "rms_x": rms_x,
                "rms_y": rms_y,
                "largest": float(np.abs(v).max()),
                "worst": rows[worst]["id"],
                "w": float(np.nanmax(np.abs(w))) if np.isfinite(w).any() else None,
            }
        )
    return out


def residual_panels(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the charts of the photos with the largest residuals: ``photo``, ``drawings``, ``words``."""
    photos, rows = by_photo(record), residual_rows(record)
    worst = {row["photo"] for row in sorted(rows, key=lambda row: -row["largest"])[:MAX_PHOTOS]}
    down = y_down(record)
    out = []
    for name, points in photos.items():
        if name not in worst:
            continue
        drawings: list[Chart | None] = [photo_vectors(name, points, down.get(name, False))]
        ratio = columns(points, "w_x", "w_y")
        if np.isfinite(ratio).any():
            drawings += [chart(ratio, printable(name), True, ("x", "y")) for chart in (histogram, quantiles)]
        beyond = int((np.abs(ratio) > ENDS).sum())
        out.append({"photo": name, "drawings": drawings, "words": f"{beyond} beyond ±{ENDS:g} σ" if beyond else ""})
    return out


def y_down(record: dict[str, Any]) -> dict[str, bool]:
    """Return whether y points down in each photo."""
    cameras = {p["photo"]: p.get("camera") or p.get("interior") or {} for p in record.get("photos", [])}
    return {name: camera.get("y_axis") == "down" for name, camera in cameras.items()}


def photo_vectors(name: str, rows: list[dict[str, Any]], down: bool) -> Chart:
    """Return the residual vectors in a photo with one scale along both axes.

    Parameters
    ----------
    name : str
        Name of the photo.
    rows : list of dict
        Its image points.
    down : bool
        The y axis of the image points down.
    """
    place, v = columns(rows, "x", "y"), columns(rows, "residual_x", "residual_y")
    drawn = thinned(np.arange(len(rows)), v, MAX_VECTORS)
    low, high = place.min(axis=0), place.max(axis=0)
    room = np.array(Chart("").inner)
    half = 0.56 * room * float(np.maximum((high - low) / room, 1e-12).max())
    limits = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1)
    words = f"residual vectors of photo {printable(name)}"
    chart = vectors(words, place[drawn], v[drawn], limits, ("x", "y"), reference=v, down=down)
    chart.title = cut(name or "photo")
    return chart


def distortions(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the distortion curves of the cameras; ``edge`` contains their values at the largest radius."""
    out = []
    for one in record.get("distortion", [])[:MAX_PHOTOS]:
        names = ", ".join(one["photos"][:4]) + (", ..." if len(one["photos"]) > 4 else "")
        edge = {name: one[name][-1] for name in ("radius", "radial", "sigma", "across")}
        out.append(
            {
                "photos": names,
                "n": len(one["photos"]),
                "determined": one["determined"],
                "drawing": distortion(one, names),
                "edge": edge,
            }
        )
    return out


def band_factor(radial: Array, sigma: Array) -> float:
    """Return the factor by which a band is enlarged to be visible along the curve; 1 if it is visible unchanged."""
    reach, widest = float(np.abs(radial).max()), float(sigma.max())
    return round_down(0.08 * reach / widest) if 0.0 < widest < 0.04 * reach else 1.0


def distortion(one: dict[str, Any], names: str) -> Chart:
    """Draw the radial correction over the radius with a band of one standard deviation, enlarged if it is invisible."""
    radius, radial, sigma, across = (np.array(one[k]) for k in ("radius", "radial", "sigma", "across"))
    times = band_factor(radial, sigma)
    low, high = radial - times * sigma, radial + times * sigma
    ends = min(float(low.min()), 0.0), max(float(high.max()), float(across.max()), 0.0)
    margin = 0.06 * max(ends[1] - ends[0], 1e-12)
    chart = broad(
        f"distortion of {printable(names)}: radial correction over the radius",
        Axis("radius from the principal point, image units", (0.0, float(radius[-1])), about=6),
        Axis("correction, image units", (ends[0] - margin, ends[1] + margin)),
        300.0,
        left=74.0,
        title=cut(names),
        legend="top" if radial[-1] > 0.0 else "bottom",
    )
    chart.across("zero", 0.0)
    if sigma.any():
        words = f"± {times:g} σ" if times > 1.0 else "± σ"
        chart.add("area", "band", np.append(radius, radius[::-1]), np.append(high, low[::-1]), label=words)
    chart.add("line", "curve", radius, radial, label="radial, mean of all directions")
    if across.any():
        chart.add("line", "across", radius, across, label="across the radius, largest")
    return chart


def directions_chart(record: dict[str, Any]) -> Chart | None:
    """Return the singular values of the orientation, weakest first, with the limit of refused directions."""
    values = np.array(record.get("directions", {}).get("singular_values", []), float)
    values = values[np.isfinite(values) & (values > 0.0)]
    if not len(values):
        return None
    low = 10.0 ** (min(math.floor(math.log10(values.min())), -3) - 0.2)
    high = 10.0 ** (max(math.ceil(math.log10(values.max())), 0) + 0.2)
    chart = broad(
        "singular values of the orientation, weakest first",
        Axis("direction, weakest first", (1.0, float(max(len(values), 2))), about=8, whole=True),
        Axis(f"singular value, refused below {REFUSED:g}", (low, high), log=True),
        260.0,
    )
    chart.across("limit", REFUSED)
    chart.add("dots", "line-dot", np.arange(1, len(values) + 1), values)
    return chart


# --- figures for papers ----------------------------------------------------------------------------


def _views(record: dict[str, Any], *, of_surface: bool) -> Charts:
    if (record["kind"] == "surface") != of_surface:
        return []
    return [chart for _, chart in (deviation_views(record) if of_surface else views_of(scene_of(record)))][:2]


def _photos(record: dict[str, Any]) -> Charts:
    photos = sorted(by_photo(record).items(), key=lambda item: -len(item[1]))[:FEW_PHOTOS]
    return [photo_vectors(name, rows, y_down(record).get(name, False)) for name, rows in photos]


PLOTS: Final[dict[str, tuple[Callable[[dict[str, Any]], Charts], str]]] = {
    "map": (partial(_views, of_surface=False),
            "points (triangles: control, circles: check, dots: new) with ellipses of one standard deviation, and "
            "camera stations (squares); the bars are the scales of the object and of the errors."),
    "residuals": (_photos, "image residuals, computed minus measured; the bar above each photo is their scale."),
    "distortion": (lambda record: [one["drawing"] for one in distortions(record)[:FEW_PHOTOS]],
                   "corrections along the radius with the band of their standard deviations, and the largest across."),
    "deviations": (partial(_views, of_surface=True), "normal distances of the points from the surface."),
}  # fmt: skip


#: Record file that identifies a folder of close range, and its page.
RECORD_FILE: Final = "closerange.json"
REPORT_FILE: Final = "report.html"
CONTENTS: Final = Contents(
    RECORD_FILE,
    (RECORD_FILE, "points.csv", "photos.toml", REPORT_FILE, MANIFEST_FILE, "figures/*.svg", "figures/*.pdf",
     "figures/captions.md"),
)  # fmt: skip
PACKAGE: Final = "fg_orient.closerange"
#: Rows of a table that the page shows; closerange.json and points.csv contain all.
MANY: Final = 200
#: Number of largest residuals that are listed, and of photos whose correlations are drawn.
WORST: Final = 20


def is_closerange(folder: Path) -> bool:
    """Return whether a folder contains a result of close range."""
    return is_made_by(folder, CONTENTS)


def read_record(folder: Path) -> dict[str, Any]:
    """Return the record of a folder, and check that all its files belong to its run (:mod:`fg_orient.result.manifest`).

    Raise InputError if it is missing or damaged, or of a version that has no report.
    """
    record = checked_record(folder, RECORD_FILE, CONTENTS, "report.damaged")
    if "report" not in record:
        raise InputError.of("report.damaged", file=folder / RECORD_FILE, value="written by an earlier version")
    return record


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` of a close-range folder completely or not at all.

    Return the path of the file.
    """
    path, record = Path(folder) / REPORT_FILE, read_record(Path(folder))
    with foreign_bytes("report.damaged", Path(folder) / RECORD_FILE):
        page = render(record)
    write_text(path, page)
    return path


def write_figures(
    folder: str | Path, out: str | Path | None = None, *, overwrite: bool = False, progress: Progress | None = None
) -> tuple[Path, list[str]]:
    """Write the figures of a close-range folder.

    See :func:`fg_orient.report.figures.write_figures`.
    """
    figures.require_matplotlib()
    record = _used(read_record(Path(folder)))

    def captions(drawn: Collection[str]) -> str:
        return "\n".join(["# Figures", "", *(f"- `{name}`: {PLOTS[name][1]}" for name in drawn), ""])

    charts = {name: partial(draw, record) for name, (draw, _) in PLOTS.items()}
    return figures.draw_figures(
        charts, captions, out or Path(folder) / figures.FOLDER, overwrite=overwrite, progress=progress
    )


def render(record: dict[str, Any]) -> str:
    """Return the HTML text of a record.

    Parameters
    ----------
    record : dict
        Record of ``dlt``, ``resect``, ``intersect``, ``bundle`` or ``surface``.
    """
    record = with_status(_used(record))
    lists = ("photos", "cameras", "points", "figures", "residuals", "observations", "distortion", "history")
    photo: dict[str, Any] = {"parameters": [], "interior": None, "observed": None}
    photos = [photo | one for one in record.get("photos", [])]
    # parts of other kinds of records are empty
    record = {name: [] for name in lists} | {"check": None, "significance": None} | record | {"photos": photos}
    shell = environment(PACKAGE)
    shell.filters |= {"significant": significant}
    is_surface, points = record["kind"] == "surface", record["points"]
    return shell.get_template("closerange.html.j2").render(
        r=record,
        kind=KINDS[record["kind"]],
        verdict=verdict(record),
        problems=problems(record),
        many=MANY,
        accuracy=_accuracy(record),
        suspects=suspects(record)[:WORST],
        views=deviation_views(record) if is_surface else views_of(scene_of(record)),
        histogram=distance_histogram(record) if is_surface else None,
        deviations=sorted(points, key=lambda p: -abs(p["distance_m"])) if is_surface else [],
        residuals=residual_rows(record),
        panels=residual_panels(record),
        max_photos=MAX_PHOTOS,
        worst=_worst(record),
        curves=distortions(record),
        heat=_heat(record),
        directions=directions_chart(record),
        history=iteration_charts(record["history"], "m, rad or camera steps"),
        redundancy=redundancy_chart(columns(record["residuals"], "redundancy_x", "redundancy_y"), ("x", "y")),
    )


def _accuracy(record: dict[str, Any]) -> dict[str, Any]:
    """Return mean errors of new points, control points and stations, and RMS at check points, in one unit."""
    points = record["points"] if record["kind"] in ("bundle", "intersection") else []
    spreads = {
        words: columns([p for p in points if p.get("role", "new") == role], *(f"sigma_{a}_m" for a in "xyz"))
        for role, words in (
            ("check", "check points, standard deviations"),
            ("new", "new points"),
            ("control", "control points"),
        )
    }
    spreads["camera stations"] = scene_of(record).station_sigma if record["photos"] else np.zeros((0, 3))
    rows = [
        (words, len(v), np.sqrt(np.mean(v**2, axis=0)), v.max(axis=0))
        for words, v in spreads.items()
        if np.isfinite(v[:, 0]).any()
    ]
    check = record["check"]
    errors = np.array([check[k] for k in ("rms_mm", "mean_mm", "worst_mm")] if check else []) / 1e3
    unit, factor = unit_of([*(v for _, _, rms, _ in rows for v in rms), *errors.ravel()])
    return {
        "unit": unit,
        "factor": factor,
        "rows": [(w, n, factor * rms, factor * top) for w, n, rms, top in rows],
        "check": {"n": check["n"], "values": factor * errors} if check else None,
    }


def _used(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record without image points that a search for gross errors rejected."""
    return record | {"residuals": [row for row in record.get("residuals", []) if row.get("weight") != 0.0]}


def _worst(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the image points with the largest residuals.

    Residuals are divided by their standard deviations if these are known.
    """
    rows = record["residuals"] or photo_rows(record)

    def size(row: dict[str, Any]) -> float:
        own = [abs(row[f"w_{a}"]) for a in "xy" if row.get(f"w_{a}") is not None]
        unchecked = "w_x" in row and record.get("loss", "none") == "none"
        return max(own) if own else -1.0 if unchecked else math.hypot(row["residual_x"], row["residual_y"])

    return sorted(rows, key=lambda row: -size(row))[:WORST]


def _heat(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the correlations of the unknowns of each photo and camera as triangles."""
    out = []
    for part in record.get("correlations", {}).get("parts", [])[:MAX_PHOTOS]:
        n = len(part["names"])
        rho = np.full((n, n), np.nan)
        for i, row in enumerate(part["triangle"]):
            rho[i, :i] = np.array(row, float)
        if n > 1:
            out.append({"of": part["of"], "width": 32 * n + 140, "drawing": heat_map(part["of"], part["names"], rho)})
    return out
