"""Drawings of the residuals of one image: vectors, histogram with the normal curve, Q-Q plot."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from fg_orient.model.distributions import normal_probability, normal_quantile
from fg_orient.report.panel import Panel, ticks
from fg_orient.report.scale import round_down
from fg_orient.result.record import Result

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Vectors of an image, and quantiles of a curve, that a static drawing shows.
MAX_VECTORS: Final = 400
MAX_QUANTILES: Final = 120
#: Images whose drawings the page holds: those with the largest residuals.
MAX_IMAGES: Final = 16
#: Ends of the axis of residuals in sigmas; what lies beyond is counted in words.
ENDS: Final = 5.0
#: A long residual (90 % quantile) as a share of the drawing's width; of more than a few, less.
_SHARE: Final = 0.09
_FEW: Final = 100


def residual_panels(result: Result, summaries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Drawings of the images with the largest residuals, in the order of the images.

    Parameters
    ----------
    result : Result
    summaries : list of dict
        See :meth:`fg_orient.result.record.Result.residual_summary`.

    Returns
    -------
    list of dict
        ``image``, ``drawings`` (three ``<svg>``), ``words`` on what the histogram cannot show.
    """
    worst = sorted(summaries, key=lambda row: -row["max_ratio"])[:MAX_IMAGES]
    chosen = {row["image"] for row in worst}
    names = [row["image"] for row in summaries]
    image = result.residuals.codes("image", names)
    sizes = {facts["id"]: (facts["n_lines"], facts["n_samples"]) for facts in result.record["images"]}
    return [_panels(result, name, np.flatnonzero(image == k), sizes[name])
            for k, name in enumerate(names) if name in chosen]  # fmt: skip


def _panels(result: Result, name: str, rows: Index, size: tuple[float, float]) -> dict[str, Any]:
    ratio, tested = normalised(result, rows)
    drawings = [vectors(result, name, rows, size), histogram(ratio, name, tested), quantiles(ratio, name, tested)]
    beyond = int((np.abs(ratio) > ENDS).sum())
    return {"image": name, "drawings": drawings, "words": f"{beyond} beyond ±{ENDS:g} σ" if beyond else ""}


def largest_residuals(result: Result, count: int = 20) -> dict[str, Any] | None:
    """Image points with the largest residuals over their own sigmas, largest first; None without their tests.

    Returns
    -------
    dict or None
        ``rows``: image, id and the columns of ``residuals.csv``; ``n`` tested coordinates, ``beyond`` 3 sigmas,
        ``expected`` of these if all are normal.
    """
    table = result.residuals
    ratio, tested = normalised(result, np.arange(len(table)))
    if not tested:
        return None
    size = np.nan_to_num(np.abs(ratio), nan=0.0)
    order = np.argsort(-size.max(axis=1), kind="stable")[:count]
    names = ("v_line_px", "v_sample_px", "w_line", "w_sample", "redundancy_line", "redundancy_sample", "mdb_line_px",
             "mdb_sample_px")  # fmt: skip
    values = table.numbers(*names)[order].tolist()
    rows = [{"image": table.words["image"][k], "id": table.words["id"][k], **dict(zip(names, row, strict=True))}
            for k, row in zip(order.tolist(), values, strict=True)]  # fmt: skip
    n = int(np.isfinite(ratio).sum())
    expected = 2.0 * n * float(normal_probability(-3.0))
    return {"rows": rows, "n": n, "beyond": int((size > 3.0).sum()),
            "expected": f"{expected:.1f}" if expected < 10.0 else f"{expected:.0f}"}  # fmt: skip


def normalised(result: Result, rows: Index) -> tuple[Array, bool]:
    """Residuals (n, 2) of line and sample over their own standard deviations; False: over those of the observations.

    The first, ``w = v / (sigma sqrt(r))``, are standard normal if the model holds; without redundancy numbers the
    second are all there is, and they scatter less. nan where the others do not check an observation.
    """
    table = result.residuals
    w = table.numbers("w_line", "w_sample")[rows]
    if np.isfinite(w).any():
        return w, True
    v, sigma = table.numbers("v_line_px", "v_sample_px")[rows], table.numbers("sigma_line_px", "sigma_sample_px")[rows]
    return v / sigma, False


def vectors(result: Result, name: str, rows: Index, size: tuple[float, float]) -> Markup:
    """Residual vectors in the image, line downwards, at a scale that is written below."""
    table, (lines, samples) = result.residuals, size
    place, v = table.numbers("sample", "line"), table.numbers("v_sample_px", "v_line_px")
    shown = rows[:: max(1, math.ceil(len(rows) / MAX_VECTORS))]
    panel = Panel((0.0, float(samples)), (0.0, float(lines)), f"residual vectors of image {name}", y_down=True)
    panel.axes("sample, px", "line, px", ticks(0.0, samples, 3), ticks(0.0, lines, 4))
    lengths = np.hypot(*v[rows].T)
    long = float(np.quantile(lengths, 0.9)) if len(rows) else 0.0
    share = _SHARE * min(1.0, math.sqrt(_FEW / max(len(shown), 1)))
    unit = share * panel.width / long if long > 0.0 else 0.0  # drawing units per pixel of residual
    path = "".join(f"M{panel.px(x)} {panel.py(y)}l{unit * dx:.1f} {unit * dy:.1f}"
                   for (x, y), (dx, dy) in zip(place[shown].tolist(), v[shown].tolist(), strict=True))  # fmt: skip
    panel.dots(place[shown].tolist(), "dot-foot", 1.2)
    if path and unit:
        panel.add('<path class="residual" d="{}"/>', path)
        bar = round_down(0.25 * panel.width / unit)
        x = panel.width - panel.right - bar * unit
        panel.add('<path class="bar-line" d="M{} 8v4h{}v-4"/>', round(x, 1), round(bar * unit, 1))
        panel.text(x - 6, 14, f"{bar:g} px", "end")
    return panel.svg()


def histogram(ratio: Array, name: str, tested: bool) -> Markup:
    """Histogram of both coordinates with the normal curve they should follow."""
    values = ratio[np.isfinite(ratio)]
    n = len(values)
    width = 0.25 if n > 2000 else 0.5 if n > 60 else 1.0
    edges = np.arange(-ENDS, ENDS + width / 2, width)
    counts, _ = np.histogram(np.clip(values, -ENDS, ENDS - 1e-9), edges)
    spread = 1.0 if tested or n < 2 else float(np.std(values)) or 1.0
    x = np.linspace(-ENDS, ENDS, 81)
    curve = n * width * np.exp(-0.5 * (x / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))
    high = 1.08 * max(float(counts.max(initial=0)), float(curve.max(initial=0.0)), 1.0)
    panel = Panel((-ENDS, ENDS), (0.0, high), f"histogram of the residuals of image {name}")
    panel.axes("v / its own σ" if tested else "v / σ of the observation", f"count ({n})", [-4, -2, 0, 2, 4],
               ticks(0.0, high, 4))  # fmt: skip
    for left, count in zip(edges.tolist(), counts.tolist(), strict=False):
        if count:
            x0, x1, y = panel.px(left), panel.px(left + width), panel.py(count)
            panel.add('<path class="column" d="M{} {}V{}H{}V{}z"/>', x0, panel.py(0.0), y, x1, panel.py(0.0))
    if n:
        panel.line(list(zip(x.tolist(), curve.tolist(), strict=True)), "curve")
        panel.text(panel.width - panel.right - 4, panel.top + 16,
                   "normal, σ = 1" if tested else f"normal, σ = {spread:.2f}", "end")  # fmt: skip
    return panel.svg()


def quantiles(ratio: Array, name: str, tested: bool, axes: tuple[str, str] = ("line", "sample")) -> Markup:
    """Q-Q plot of line (dots) and sample (squares), or two other coordinates, against the normal distribution."""
    panel = Panel((-ENDS, ENDS), (-ENDS, ENDS), f"quantiles of the residuals of image {name} against the normal")
    panel.axes("quantile of the normal", "v / its own σ" if tested else "v / σ", [-4, -2, 0, 2, 4], [-4, -2, 0, 2, 4])
    panel.line([(-ENDS, -ENDS), (ENDS, ENDS)], "limit")
    for k, draw in enumerate((panel.dots, panel.squares)):
        values = np.sort(ratio[np.isfinite(ratio[:, k]), k])
        n = len(values)
        if not n:
            continue
        rank = np.unique(np.round(_spread_ranks(n)).astype(np.intp))
        expected = normal_quantile((rank + 0.5) / n)
        found = np.clip(values[rank], -ENDS, ENDS)
        draw(zip(expected.tolist(), found.tolist(), strict=True), ("line-dot", "sample-dot")[k])
    y = panel.top + 14
    panel.add('<circle class="line-dot" cx="{}" cy="{}" r="3"/>', panel.left + 12, y)
    panel.text(panel.left + 20, y + 4, axes[0])
    panel.add('<rect class="sample-dot" x="{}" y="{}" width="6" height="6"/>', panel.left + 9, y + 13)
    panel.text(panel.left + 20, y + 20, axes[1])
    return panel.svg()


def _spread_ranks(n: int) -> Array:
    """Ranks at even distances of the normal quantile, the extremes among them."""
    if n <= MAX_QUANTILES:
        return np.arange(n, dtype=float)
    end = float(normal_quantile(0.5 / n))
    share: Array = normal_probability(np.linspace(end, -end, MAX_QUANTILES))
    return np.asarray(np.clip(share * n - 0.5, 0, n - 1), float)
