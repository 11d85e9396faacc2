"""Drawings of the close-range report: residuals of each photo, distortion of each camera, weak directions."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from fg_orient.closerange.report_words import significant
from fg_orient.report.panel import Panel, powers, ticks
from fg_orient.report.residual_plots import ENDS, histogram, quantiles
from fg_orient.report.scale import round_down
from fg_orient.report.words import printable

Array = npt.NDArray[np.float64]

#: Photos and cameras that are drawn; vectors of one photo.
MAX_PHOTOS: Final = 16
MAX_VECTORS: Final = 400
#: A long residual (90 % quantile) as a share of the drawing's width.
_SHARE: Final = 0.08
#: Where a direction is refused as not determined, in units of one image point.
REFUSED: Final = 1e-3


def by_photo(record: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Image points with residuals by photo, in the order of the photos."""
    if record.get("residuals"):
        out: dict[str, list[dict[str, Any]]] = {}
        for row in record["residuals"]:
            out.setdefault(row["photo"], []).append(row)
        return out
    return {photo["photo"]: photo["points"] for photo in record.get("photos", []) if photo["points"]}


def residual_rows(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Figures of each photo: number of points, RMS of x and y, largest residual and its point."""
    out = []
    for name, rows in by_photo(record).items():
        v = _columns(rows, "residual_x", "residual_y")
        worst = int(np.argmax(np.abs(v).max(axis=1)))
        w = _columns(rows, "w_x", "w_y")
        out.append({
            "photo": name, "n": len(rows), "rms_x": float(np.sqrt(np.mean(v[:, 0] ** 2))),
            "rms_y": float(np.sqrt(np.mean(v[:, 1] ** 2))), "largest": float(np.abs(v).max()),
            "worst": rows[worst]["id"], "w": float(np.nanmax(np.abs(w))) if np.isfinite(w).any() else None,
        })  # fmt: skip
    return out


def residual_panels(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Drawings of the photos with the largest residuals, in the order of the photos: ``photo``, ``drawings``."""
    photos, rows = by_photo(record), residual_rows(record)
    worst = {row["photo"] for row in sorted(rows, key=lambda row: -row["largest"])[:MAX_PHOTOS]}
    down = y_down(record)
    out = []
    for name, points in photos.items():
        if name not in worst:
            continue
        drawings = [vectors(name, points, down.get(name, False))]
        ratio = _columns(points, "w_x", "w_y")
        if np.isfinite(ratio).any():
            drawings += [histogram(ratio, printable(name), True), quantiles(ratio, printable(name), True, ("x", "y"))]
        beyond = int((np.abs(ratio) > ENDS).sum())
        words = f"{beyond} beyond ±{ENDS:g} σ" if beyond else ""
        out.append({"photo": name, "drawings": drawings, "words": words})
    return out


def y_down(record: dict[str, Any]) -> dict[str, bool]:
    """Whether y points down in each photo."""
    cameras = {p["photo"]: p.get("camera") or p.get("interior") or {} for p in record.get("photos", [])}
    return {name: camera.get("y_axis") == "down" for name, camera in cameras.items()}


def vectors(name: str, rows: list[dict[str, Any]], down: bool) -> Markup:
    """Residual vectors in the photo, at a scale that is written above."""
    place, v = _columns(rows, "x", "y"), _columns(rows, "residual_x", "residual_y")
    step = max(1, math.ceil(len(rows) / MAX_VECTORS))
    place, v = place[::step], v[::step]
    low, high = place.min(axis=0), place.max(axis=0)
    inner = Panel((0.0, 1.0), (0.0, 1.0), "")
    room = np.array([inner.width - inner.left - inner.right, inner.height - inner.top - inner.bottom])
    half = 0.56 * room * float(np.maximum((high - low) / room, 1e-12).max())  # one scale along both axes
    (left, bottom), (right, top) = (0.5 * (low + high) + sign * half for sign in (-1.0, 1.0))
    words = f"residual vectors of photo {printable(name)}"
    panel = Panel((float(left), float(right)), (float(bottom), float(top)), words, y_down=down)
    panel.axes("x", "y", ticks(*panel.x, 4), ticks(*panel.y, 4))
    lengths = np.hypot(*v.T)
    long = float(np.quantile(lengths, 0.9)) if len(lengths) else 0.0
    unit = _SHARE * panel.width / long if long > 0.0 else 0.0
    sign = 1.0 if down else -1.0
    path = "".join(f"M{panel.px(x)} {panel.py(y)}l{unit * dx:.1f} {sign * unit * dy:.1f}"
                   for (x, y), (dx, dy) in zip(place.tolist(), v.tolist(), strict=True))  # fmt: skip
    panel.dots(place.tolist(), "dot-foot", 1.2)
    if unit:
        panel.add('<path class="residual" d="{}"/>', path)
        bar = round_down(0.25 * panel.width / unit)
        x = panel.width - panel.right - bar * unit
        panel.add('<path class="bar-line" d="M{} 8v4h{}v-4"/>', round(x, 1), round(bar * unit, 1))
        panel.text(x - 6, 14, significant(bar, 1), "end")
    return panel.svg()


def _columns(rows: list[dict[str, Any]], *names: str) -> Array:
    """Numbers (n, k) of rows; nan where there is none."""
    values = [[np.nan if row.get(name) is None else row[name] for name in names] for row in rows]
    return np.array(values, float).reshape(len(rows), len(names))


def distortions(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Curves of the cameras: ``photos``, ``determined``, ``drawing``, and ``edge``, what they are at the rim."""
    out = []
    for one in record.get("distortion", [])[:MAX_PHOTOS]:
        names = ", ".join(one["photos"][:4]) + (", ..." if len(one["photos"]) > 4 else "")
        out.append({
            "photos": names, "n": len(one["photos"]), "determined": one["determined"],
            "drawing": distortion(one, names),
            "edge": {"radius": one["radius"][-1], "radial": one["radial"][-1], "sigma": one["sigma"][-1],
                     "across": one["across"][-1]},
        })  # fmt: skip
    return out


def band_factor(radial: Array, sigma: Array) -> float:
    """How many times a band is drawn wider than it is, so that it is seen beside the curve; 1 where it is anyway."""
    reach, widest = float(np.abs(radial).max()), float(sigma.max())
    return round_down(0.08 * reach / widest) if 0.0 < widest < 0.04 * reach else 1.0


def distortion(one: dict[str, Any], names: str) -> Markup:
    """Radial correction over the radius with a band of one standard deviation, enlarged where it would not be seen."""
    radius, radial, sigma, across = (np.array(one[k]) for k in ("radius", "radial", "sigma", "across"))
    times = band_factor(radial, sigma)
    band = times * sigma
    low, high = float((radial - band).min()), float(max((radial + band).max(), across.max()))
    margin = 0.06 * max(high - low, 1e-12)
    panel = Panel((0.0, float(radius[-1])), (min(low, 0.0) - margin, max(high, 0.0) + margin),
                  f"distortion of {printable(names)}: radial correction over the radius", width=560.0, height=300.0,
                  left=74.0)  # fmt: skip
    panel.axes("radius from the principal point, image units", "correction, image units", ticks(*panel.x, 6),
               ticks(*panel.y, 5))  # fmt: skip
    panel.line([(0.0, 0.0), (float(radius[-1]), 0.0)], "zero")
    if band.any():
        edge = [*zip(radius, radial + band, strict=True), *zip(radius[::-1], (radial - band)[::-1], strict=True)]
        path = "L".join(f"{panel.px(float(x))} {panel.py(float(y))}" for x, y in edge)
        panel.add('<path class="band" d="M{}z"/>', path)
    panel.line(list(zip(radius.tolist(), radial.tolist(), strict=True)), "curve")
    if across.any():
        panel.line(list(zip(radius.tolist(), across.tolist(), strict=True)), "across")
    x, y = panel.left + 14, panel.top + 16
    told = [("curve", "radial, mean of all directions")]
    told += [("band", f"± {times:g} σ" if times > 1.0 else "± σ")] * bool(band.any())
    told += [("across", "across the radius, largest")] * bool(across.any())
    below = radial[-1] > 0.0  # the legend stands where the curve is not
    y = y if below else panel.height - panel.bottom - 18.0 * len(told)
    for kind, words in told:
        shape = '<rect class="band" x="{}" y="{}" width="22" height="10"/>' if kind == "band" else \
            f'<path class="{kind}" d="M{{}} {{}}h22"/>'  # fmt: skip
        panel.add(shape, x, y - 9 if kind == "band" else y - 4)
        panel.text(x + 30, y, words)
        y += 18.0
    return panel.svg("panel broad")


def directions_chart(record: dict[str, Any]) -> Markup:
    """Singular values of the orientation on a logarithmic axis, with the limit of what is refused; empty without."""
    values = np.array(record.get("directions", {}).get("singular_values", []), float)
    values = values[np.isfinite(values) & (values > 0.0)]
    if not len(values):
        return Markup("")
    low = min(math.floor(math.log10(values.min())), -3) - 0.2
    high = max(math.ceil(math.log10(values.max())), 0) + 0.2
    panel = Panel((1.0, float(max(len(values), 2))), (low, high), "singular values of the orientation, weakest first",
                  width=560.0, height=260.0, log_y=True)  # fmt: skip
    panel.axes("direction, weakest first", "singular value", [k for k in ticks(*panel.x, 8) if k == round(k)],
               powers(low, high), lambda v: f"{v:g}")  # fmt: skip
    panel.line([(panel.x[0], REFUSED), (panel.x[1], REFUSED)], "limit")
    panel.text(panel.left + 8, panel.py(REFUSED) - 5, "refused below")
    panel.dots([(k, float(v)) for k, v in enumerate(values.tolist(), start=1)], "line-dot", 2.6)
    return panel.svg("panel broad")
