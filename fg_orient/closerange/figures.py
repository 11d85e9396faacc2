"""Figures of a close-range result for papers: plan, residuals, distortion, deviations as SVG and PDF with captions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.report import read_record
from fg_orient.closerange.report_maps import AXES, VIEWS, Scene, scene_of
from fg_orient.closerange.report_plots import band_factor, by_photo, y_down
from fg_orient.formats.atomic import require_free
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.report import style
from fg_orient.report.scale import thousands
from fg_orient.report.write import FIGURES, FOLDER, FORMATS, draw_figures, write_files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]
Drawn = tuple["Figure", str]

#: Photos of the figure of residuals, those with the most image points.
MAX_PHOTOS: Final = 6
#: Length of a long vector or ellipse as a share of the drawing's extent.
_SHARE: Final = 0.06


def write_figures(
    folder: str | Path, out: str | Path | None = None, *, overwrite: bool = False, progress: Progress | None = None
) -> tuple[Path, list[str]]:
    """Write the figures of a close-range folder, whole or not at all.

    Parameters
    ----------
    folder : path
        Written by a command of close range.
    out : path, optional
        Folder to come; default ``figures`` inside it.
    overwrite : bool
        Replace a folder of figures.
    progress : callable, optional
        Told after each figure.

    Returns
    -------
    path : Path
        The folder written.
    names : list of str
        Its files.

    Raises
    ------
    InputError
        The folder holds no result, matplotlib is missing, or the output may not be written.
    """
    if not style.available():
        raise InputError.of("report.no_matplotlib", option="figures")
    record = read_record(Path(folder))
    target = Path(folder) / FOLDER if out is None else Path(out)
    require_free(target, overwrite=overwrite, contents=FIGURES)
    files, told = draw_figures({name: partial(draw, record) for name, draw in PLOTS.items()}, FORMATS, progress)
    captions = ["# Figures", "", *(f"- `{name}`: {words}" for name, words in told.items())]
    return target, write_files(target, files, "\n".join(captions) + "\n", overwrite=overwrite)


def _map(record: dict[str, Any]) -> Drawn | None:
    """Plan and elevation with ellipses."""
    scene = scene_of(record)
    if record["kind"] == "surface" or not len(scene.ids):
        return None
    figure = style.new_figure(style.TWO_COLUMNS, 3.4)
    enlarged = 1.0
    for axes, (words, across, up) in zip(figure.subplots(1, 2), VIEWS[:2], strict=True):
        enlarged = _view(axes, scene, across, up)
        axes.set_title(words)
    told = (
        f"; ellipses of one standard deviation, enlarged {thousands(enlarged)} times in the right view"
        if enlarged
        else ""
    )
    return (
        figure,
        f"points (triangles: control, circles: check, dots: new) and camera stations (squares), metres{told}.",
    )


def _view(axes: Axes, scene: Scene, across: int, up: int) -> float:
    """Draw one view; the factor of its ellipses."""
    from matplotlib.patches import Ellipse

    at, roles = scene.at[:, [across, up]], np.array(scene.roles)
    flat = scene.covariance[:, [across, up]][:, :, [across, up]]
    size = np.sqrt(np.maximum(np.trace(flat, axis1=1, axis2=2), 0.0))
    size = size[np.isfinite(size) & (size > 0.0)]
    extent = float(np.ptp(at, axis=0).max()) or 1.0
    enlarged = _SHARE * extent / float(np.quantile(size, 0.9)) if len(size) else 0.0
    for place, covariance in zip(at, flat, strict=True):
        if enlarged and np.isfinite(covariance).all() and covariance.any():
            values, vectors = np.linalg.eigh(covariance)
            width, height = 2.0 * enlarged * np.sqrt(np.maximum(values, 0.0))
            turn = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
            axes.add_patch(Ellipse((float(place[0]), float(place[1])), float(width), float(height), angle=turn,
                                   facecolor="none", edgecolor=style.GREY, linewidth=0.5))  # fmt: skip
    for role, marker, colour in (("new", ".", style.GREY), ("control", "^", style.BLUE), ("check", "o", style.ORANGE)):
        rows = roles == role
        axes.plot(*at[rows].T, marker, color=colour, markersize=3, fillstyle="none" if role == "check" else "full")
    axes.plot(*scene.centres[:, [across, up]].T, "s", color=style.INK, markersize=4, fillstyle="none")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{AXES[across]}, m")
    axes.set_ylabel(f"{AXES[up]}, m")
    return enlarged


def _residuals(record: dict[str, Any]) -> Drawn | None:
    """Residual vectors of some photos at one scale."""
    photos = sorted(by_photo(record).items(), key=lambda item: -len(item[1]))[:MAX_PHOTOS]
    if not photos:
        return None
    columns, down = min(3, len(photos)), y_down(record)
    lines = -(-len(photos) // columns)
    figure = style.new_figure(style.TWO_COLUMNS, 2.3 * lines)
    grid = np.atleast_1d(figure.subplots(lines, columns)).ravel()
    rows = [_numbers(points) for _, points in photos]
    long = float(np.quantile(np.concatenate([np.hypot(*v[:, 2:].T) for v in rows]), 0.9)) or 1.0
    extent = float(max(np.ptp(v[:, :2], axis=0).max() for v in rows)) or 1.0
    for axes, (name, _), values in zip(grid, photos, rows, strict=False):
        axes.quiver(*values.T, angles="xy", scale_units="xy", scale=long / (1.5 * _SHARE * extent), width=0.004,
                    color=style.ORANGE)  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(style.cut(name or "photo"))
        if down.get(name, False):
            axes.invert_yaxis()
    for axes in grid[len(photos) :]:
        axes.set_visible(False)
    words = f"nine of ten are shorter than {long:.2g} image units."
    return figure, f"image residuals, computed minus measured, all at one scale: {words}"


def _numbers(rows: list[dict[str, Any]]) -> Array:
    return np.array([[row["x"], row["y"], row["residual_x"], row["residual_y"]] for row in rows], float)


def _distortion(record: dict[str, Any]) -> Drawn | None:
    """Radial correction of the first cameras with their bands."""
    curves = record.get("distortion", [])[:MAX_PHOTOS]
    if not curves:
        return None
    figure = style.new_figure(style.ONE_COLUMN, 2.6)
    axes = figure.subplots()
    for k, one in enumerate(curves):
        radius, radial, sigma = (np.array(one[name]) for name in ("radius", "radial", "sigma"))
        times = band_factor(radial, sigma)
        band, words = times * sigma, f"± {times:g} σ" if times > 1.0 else "± σ"
        axes.fill_between(radius, radial - band, radial + band, color=style.BLUE, alpha=0.3, linewidth=0.0, label=words)
        axes.plot(radius, radial, color=style.INK, linewidth=1.0, label="radial" if k == 0 else None)
        axes.plot(radius, one["across"], "--", color=style.ORANGE, linewidth=0.8, label="across" if k == 0 else None)
    axes.axhline(0.0, color=style.GREY, linewidth=0.6)
    axes.set_xlabel("radius, image units")
    axes.set_ylabel("correction, image units")
    axes.legend()
    return figure, "corrections along the radius with the band of their standard deviations, and the largest across it."


def _deviations(record: dict[str, Any]) -> Drawn | None:
    """Normal distances in two views, coloured by sign and size."""
    if record["kind"] != "surface":
        return None
    at = np.array([[p[f"{a}_m"] for a in "xyz"] for p in record["points"]])
    distance = 1e3 * np.array([p["distance_m"] for p in record["points"]])
    reach = float(np.abs(distance).max()) or 1.0
    figure = style.new_figure(style.TWO_COLUMNS, 3.2)
    for axes, (words, across, up) in zip(figure.subplots(1, 2), VIEWS[:2], strict=True):
        drawn = axes.scatter(at[:, across], at[:, up], c=distance, s=8.0 + 40.0 * np.abs(distance) / reach,
                             cmap="PuOr_r", vmin=-reach, vmax=reach, edgecolors=style.INK, linewidths=0.3)  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=words, xlabel=f"{AXES[across]}, m", ylabel=f"{AXES[up]}, m")
    figure.colorbar(drawn, ax=figure.axes, label="normal distance, mm", shrink=0.8)
    return figure, "normal distances of the points from the surface."


PLOTS: Final[dict[str, Callable[[dict[str, Any]], Drawn | None]]] = {
    "map": _map, "residuals": _residuals, "distortion": _distortion, "deviations": _deviations,
}  # fmt: skip
