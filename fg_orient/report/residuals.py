"""Residuals of the image points: vectors in each image, histograms and normal quantiles of the normalised ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import beta_quantile, normal_quantile
from fg_orient.report import style
from fg_orient.report.figure_data import LINE_SAMPLE, Folder
from fg_orient.report.scale import round_down

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

#: More vectors than this per image are thinned evenly; the largest tenth of them stays.
MAX_VECTORS: Final = 2000
#: Length of a large residual (90 % quantile) as a share of the panel's width.
SHARE: Final = 0.09
#: Normal quantiles are drawn for so many values per curve.
MAX_QUANTILES: Final = 2000
INKS: Final = {"line": (style.BLUE, "-", "o"), "sample": (style.ORANGE, "--", "s")}


def vectors(folder: Folder, images: list[str]) -> Figure | None:
    """Draw the residual vectors of up to two images, lines downwards, at one scale."""
    with_points = [name for name in images if len(folder.rows[name])]
    if not with_points:
        return None
    records = {str(i["id"]): i for i in folder.record["images"]}
    extents = [_extent(folder, records[name]) for name in with_points]
    tall = float(np.clip(max((b - t) / (r - a) for a, r, t, b in extents), 0.5, 1.3))
    v = folder.residuals.numbers("v_sample_px", "v_line_px")
    large = float(np.quantile(np.linalg.norm(v[np.concatenate([folder.rows[n] for n in with_points])], axis=1), 0.9))
    width = style.TWO_COLUMNS if len(with_points) > 1 else style.ONE_COLUMN
    figure = style.new_figure(width, (style.ONE_COLUMN - 0.6) * tall + 0.75)
    for panel, name, extent in zip(_row(figure, len(with_points)), with_points, extents, strict=True):
        _one_image(panel, folder, name, extent, large)
    return figure


def _row(figure: Figure, count: int) -> list[Axes]:
    return list(figure.subplots(1, count, squeeze=False).ravel())


def _extent(folder: Folder, image: dict[str, object]) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of an image, px; where its points reach further, these."""
    rows = folder.rows[str(image["id"])]
    line, sample = folder.residuals.numbers("line", "sample")[rows].T
    n_lines, n_samples = float(str(image["n_lines"] or 0)), float(str(image["n_samples"] or 0))
    return (min(-0.5, float(sample.min())), max(n_samples - 0.5, float(sample.max())),
            min(-0.5, float(line.min())), max(n_lines - 0.5, float(line.max())))  # fmt: skip


def _one_image(axes: Axes, folder: Folder, name: str, extent: tuple[float, ...], large: float) -> None:
    rows, left_out = thinned(folder, name)
    table = folder.residuals
    at, v = table.numbers("sample", "line")[rows], table.numbers("v_sample_px", "v_line_px")[rows]
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[3], extent[2])
    axes.set_aspect("equal")
    axes.scatter(at[:, 0], at[:, 1], s=2.0, color=style.INK, lw=0, zorder=2)
    axes.set_xlabel("sample, px")
    axes.set_ylabel("line, px")
    axes.locator_params(nbins=5)
    more = f", {len(rows)} of {len(rows) + left_out} drawn" if left_out else ""
    axes.set_title(f"{style.cut(name)} ({len(folder.rows[name])} points{more})")
    if large <= 0.0:
        return
    arrows = axes.quiver(*at.T, v[:, 0], -v[:, 1], color=style.BLUE, angles="uv", scale=large / SHARE,
                         scale_units="width", width=0.004, zorder=3)  # fmt: skip
    length = round_down(1.6 * large)
    axes.quiverkey(arrows, 0.85, 1.03, length, f"{length:g} px", labelpos="W", coordinates="axes", color=style.INK,
                   labelcolor=style.INK, fontproperties={"size": 7}, labelsep=0.05)  # fmt: skip


def thinned(folder: Folder, name: str) -> tuple[npt.NDArray[np.intp], int]:
    """Rows of an image that are drawn, and how many are not: the largest tenth, of the others each k-th."""
    rows = folder.rows[name]
    if len(rows) <= MAX_VECTORS:
        return rows, 0
    length = np.linalg.norm(folder.residuals.numbers("v_line_px", "v_sample_px")[rows], axis=1)
    n_large = MAX_VECTORS // 10
    large = np.zeros(len(rows), bool)
    large[np.argsort(-length, kind="stable")[:n_large]] = True
    others = np.flatnonzero(~large)
    kept = others[:: math.ceil(len(others) / (MAX_VECTORS - n_large))]
    drawn = rows[np.sort(np.append(np.flatnonzero(large), kept))]
    return drawn, len(rows) - len(drawn)


def histograms(folder: Folder, images: list[str]) -> Figure | None:
    """Draw histograms of the normalised residuals of up to two images, with the standard normal density."""
    given = folder.normalised()
    with_points = [name for name in images if np.isfinite(given.values[folder.rows[name]]).any()]
    if not with_points:
        return None
    figure = style.new_figure(style.TWO_COLUMNS if len(with_points) > 1 else style.ONE_COLUMN, 2.4)
    for axes, name in zip(_row(figure, len(with_points)), with_points, strict=True):
        _histogram(axes, given.values[folder.rows[name]])
        axes.set_title(style.cut(name))
        axes.set_xlabel(given.words)
    return figure


def _histogram(axes: Axes, values: Array) -> None:
    limit = max(4.0, math.ceil(float(np.nanmax(np.abs(values)))))
    shown = min(limit, 8.0)
    edges = np.linspace(-shown, shown, 4 * int(shown) + 1)
    for k, name in enumerate(LINE_SAMPLE):
        colour, line, _ = INKS[name]
        w = values[:, k][np.isfinite(values[:, k])]
        label = f"{name}: n {len(w)}, mean {w.mean():.2f}, s {w.std():.2f}".replace("-", "−") if len(w) else name
        axes.hist(np.clip(w, -shown, shown), edges.tolist(), density=True, histtype="step", color=colour, ls=line,
                  lw=1.2, label=label)  # fmt: skip
    x = np.linspace(-shown, shown, 201)
    axes.plot(x, np.exp(-(x**2) / 2.0) / math.sqrt(2.0 * math.pi), color=style.GREY, lw=1.0, label="normal N(0, 1)")
    axes.set_ylabel("density")
    axes.set_xlim(-shown, shown)
    axes.set_ylim(0.0, axes.get_ylim()[1] * 1.35)
    axes.legend(loc="upper center", frameon=False, ncols=1)


def quantiles(folder: Folder, images: list[str]) -> Figure | None:
    """Draw the ordered normalised residuals of up to two images over normal quantiles, with a 95 % band."""
    given = folder.normalised()
    with_points = [name for name in images if np.isfinite(given.values[folder.rows[name]]).sum() > 2]
    if not with_points:
        return None
    figure = style.new_figure(style.TWO_COLUMNS if len(with_points) > 1 else style.ONE_COLUMN, 3.0)
    for axes, name in zip(_row(figure, len(with_points)), with_points, strict=True):
        _quantile_plot(axes, given.values[folder.rows[name]])
        axes.set_title(style.cut(name))
        axes.set_ylabel(given.words)
    return figure


def _quantile_plot(axes: Axes, values: Array) -> None:
    n_band = 0
    for k, name in enumerate(LINE_SAMPLE):
        w = np.sort(values[:, k][np.isfinite(values[:, k])])
        if len(w) < 2:
            continue
        x, low, high = normal_band(len(w))
        chosen = _ends_kept(len(w))
        if len(w) > n_band:
            n_band = len(w)
            axes.fill_between(x[chosen], low[chosen], high[chosen], color=style.GREY, alpha=0.25, lw=0, zorder=1,
                              label="95 % of each, if N(0, 1)" if k == 0 else None)  # fmt: skip
        colour, _, marker = INKS[name]
        axes.plot(x[chosen], w[chosen], color=colour, marker=marker, ms=2.6, mfc="none", mew=0.7, ls="", label=name)
    ends = np.array(axes.get_xlim())
    axes.plot(ends, ends, color=style.INK, lw=0.7, zorder=2)
    axes.set_xlim(*ends)
    axes.set_xlabel("quantile of N(0, 1)")
    axes.legend(loc="upper left", frameon=False)


def normal_band(n: int) -> tuple[Array, Array, Array]:
    """Medians and 95 % bounds of each of n ordered independent standard normal values, (n,) each.

    The k-th of n ordered uniform values is Beta(k, n + 1 - k) (David and Nagaraja 2003, 2.1). Each value lies inside
    with 95 %; all of them together less often, and residuals are correlated.
    """
    k = np.arange(1, n + 1)
    low, middle, high = (normal_quantile(beta_quantile(k, n + 1.0 - k, p)) for p in (0.025, 0.5, 0.975))
    return middle, low, high


def _ends_kept(n: int) -> npt.NDArray[np.intp]:
    """Places of n ordered values that are drawn: the outer ones all, of the middle each k-th."""
    if n <= MAX_QUANTILES:
        return np.arange(n)
    outer = MAX_QUANTILES // 4
    middle = np.linspace(outer, n - outer - 1, MAX_QUANTILES - 2 * outer).round().astype(np.intp)
    return np.unique(np.concatenate([np.arange(outer), middle, np.arange(n - outer, n)]))
