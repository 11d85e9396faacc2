"""Maps: footprints and points with the vectors of their horizontal errors, and with bars of their Up errors.

Longitude and latitude are drawn so that a kilometre is as long East as North at the middle of the map.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.report import style
from fg_orient.report.extent import KM_PER_DEGREE, first_view
from fg_orient.report.figure_data import Folder
from fg_orient.report.scale import round_down

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Colour, marker, size and filling of the roles; ties first, so that they lie below.
ROLES: Final = {
    "tie": (style.GREY, ".", 4.0, True),
    "control": (style.BLUE, "^", 22.0, True),
    "check": (style.ORANGE, "o", 18.0, False),
}
#: More tie points than this are thinned evenly.
MAX_TIES: Final = 5000
#: Length of a large error (90 % quantile) as a share of the map's width.
SHARE: Final = 0.08
LINES: Final = ((0, (5, 3)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), "-")


def error_map(folder: Folder, *, up: bool = False) -> Figure | None:
    """Draw the map with horizontal vectors, or with bars of the Up errors; None without geographic coordinates."""
    table = folder.result.points
    place = table.numbers("lon_deg", "lat_deg")
    located = np.isfinite(place).all(axis=1)
    if not located.any():
        return None
    enu = table.numbers("difference_east_m", "difference_north_m", "difference_up_m")
    vectors = np.stack([np.zeros(len(enu)), enu[:, 2]], axis=1) if up else enu[:, :2]
    feet = _footprints(folder)
    view = first_view(place, [ring for _, ring in feet])
    figure, axes = _frame(np.vstack([place[located], *(ring for _, ring in feet)]) if view is None else view)
    if not up:
        _draw_footprints(axes, feet)
    roles = np.array(table.words["role"], dtype=str)
    for role in ROLES:
        rows = np.flatnonzero(located & (roles == role))
        if len(rows) and not (up and role == "tie"):
            _draw_role(axes, role, place, rows)
    _draw_vectors(axes, place, vectors, roles, up)
    figure.legend(loc="outside upper center", ncols=4, frameon=False, handletextpad=0.4, columnspacing=1.2)
    return figure


def has_errors(folder: Folder) -> bool:
    """Tell whether any located point has a difference of its coordinates."""
    table = folder.result.points
    known = np.isfinite(table.numbers("lon_deg", "difference_east_m")).all(axis=1)
    return bool(known.any())


def _footprints(folder: Folder) -> list[tuple[str, Array]]:
    found = (
        (str(i["id"]), np.array(i["footprint_lon_lat_deg"], float).reshape(-1, 2)) for i in folder.record["images"]
    )
    return [(name, ring) for name, ring in found if len(ring)]


def _frame(everything: Array) -> tuple[Figure, Axes]:
    """Figure of one column, or of two where the map is wide, with axes in degrees and a bar of kilometres."""
    low, high = everything.min(axis=0), everything.max(axis=0)
    shrink = max(math.cos(math.radians(float(low[1] + high[1]) / 2.0)), 0.01)
    size = np.maximum((high - low) * np.array([shrink, 1.0]), 1e-6)
    tall = float(np.clip(size[1] / size[0], 0.45, 1.6))
    figure = style.new_figure(style.ONE_COLUMN, (style.ONE_COLUMN - 0.75) * tall + 0.8)
    axes = figure.add_subplot()
    axes.set_aspect(1.0 / shrink)
    pad = 0.06 * float(size.max()) / np.array([shrink, 1.0])
    axes.set_xlim(low[0] - pad[0], high[0] + pad[0])
    axes.set_ylim(low[1] - 2.0 * pad[1], high[1] + pad[1])  # below: scales
    axes.xaxis.set_major_locator(_few())
    axes.yaxis.set_major_locator(_few())
    axes.xaxis.set_major_formatter(lambda value, _: _degrees(value, "EW"))
    axes.yaxis.set_major_formatter(lambda value, _: _degrees(value, "NS"))
    axes.set_xlabel("longitude, WGS 84")
    axes.set_ylabel("latitude, WGS 84")
    _bar_of_kilometres(axes, shrink)
    return figure, axes


def _few() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(4, steps=[1, 2, 5, 10])


def _degrees(value: float, ends: str) -> str:
    text = f"{abs(value):.4f}".rstrip("0").rstrip(".")
    return f"{text}°{ends[0] if value >= 0.0 else ends[1]}"


def _bar_of_kilometres(axes: Axes, shrink: float) -> None:
    """A line at the lower left, of a round number of kilometres."""
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    km = round_down(0.3 * (east - west) * shrink * KM_PER_DEGREE)
    at = west + 0.04 * (east - west), south + 0.045 * (north - south)
    end = at[0] + km / KM_PER_DEGREE / shrink
    axes.plot([at[0], end], [at[1], at[1]], color=style.INK, lw=1.6, solid_capstyle="butt")
    text = f"{km:g} km" if km >= 1.0 else f"{km * 1000.0:g} m"
    axes.annotate(
        text, ((at[0] + end) / 2.0, at[1]), xytext=(0, 2), textcoords="offset points", ha="center", fontsize=7
    )


def _draw_footprints(axes: Axes, feet: list[tuple[str, Array]]) -> None:
    for k, (name, ring) in enumerate(feet):
        closed = np.vstack([ring, ring[:1]])
        label = style.cut(name, 16) if len(feet) <= 4 else ("footprints" if k == 0 else None)
        axes.plot(*closed.T, color=style.INK, lw=0.7, ls=LINES[k % len(LINES)], label=label)


def _draw_role(axes: Axes, role: str, place: Array, rows: Index) -> None:
    colour, marker, size, filled = ROLES[role]
    drawn = rows[:: max(1, math.ceil(len(rows) / MAX_TIES))] if role == "tie" else rows
    label = f"{role} ({len(rows)})" if len(drawn) == len(rows) else f"{role} ({len(drawn)} of {len(rows)} drawn)"
    axes.scatter(
        place[drawn, 0], place[drawn, 1], s=size, marker=marker, lw=0.8, label=label, zorder=3,
        facecolor=colour if filled else "none", edgecolor="none" if role == "tie" else colour,
    )  # fmt: skip


def _draw_vectors(axes: Axes, place: Array, vectors: Array, roles: Any, up: bool) -> None:
    """Vectors of control and check points at one scale, with a vector of a round length beside them."""
    known = np.isfinite(place).all(axis=1) & np.isfinite(vectors).all(axis=1)
    lengths = np.linalg.norm(vectors, axis=1)
    if not (known & (lengths > 0.0)).any():
        return
    large = float(np.quantile(lengths[known & (lengths > 0.0)], 0.9))
    how: dict[str, Any] = {"angles": "uv", "scale": large / SHARE, "scale_units": "width", "zorder": 4, "width": 0.004}
    if up:  # bars, not arrows
        how |= {"width": 0.008, "headwidth": 0, "headlength": 0, "headaxislength": 0}
    arrows = None
    for role, (colour, *_) in ROLES.items():
        rows = np.flatnonzero(known & (roles == role))
        if len(rows):
            x, y, u, v = *place[rows].T, *vectors[rows].T
            arrows = axes.quiver(x, y, u, v, color=colour, **how)
    if arrows is not None:
        length = round_down(1.6 * large)
        words = f"{'Up error' if up else 'horizontal error'} {length:g} m"
        axes.quiverkey(
            arrows, 0.95 if up else 0.85, 0.05, length, words, angle=90 if up else 0, labelpos="W", color=style.INK,
            labelcolor=style.INK, fontproperties={"size": 7}, labelsep=0.05,
        )  # fmt: skip
