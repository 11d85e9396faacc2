"""Figures of the publications in their original arrangement, drawn from the reproduction.

Layouts show the points of our synthetic block and contain no published values. Error
vectors belong to the first seed; each panel states the RMSE of its table. The published
positions and drawings are not available. Figures that cannot be drawn are listed with the
reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import FgOrientError
from fg_orient.model.names import EOP_SETS, CellKey
from fg_orient.report.chart import SERIES, Axis, Chart, broad
from fg_orient.report.maps import KM_PER_DEGREE, shrink_at
from fg_orient.studies.error_maps import empty_map, error_map, errors_of, places_km
from fg_orient.studies.reproduce.reproduction import Reproduction, Row
from fg_orient.studies.reproduce.spot6 import NO_POINTS, control_points
from fg_orient.studies.tables_twin import POINT_SETS, twin
from fg_orient.studies.two_stage import TwoStage
from fg_orient.studies.two_stage_results import AxisErrors

#: Panels of T-Fig. 4.3: rule for kappa, and EOP set.
TIKHONOV: Final = (("hkb", 5), ("lw", 5), ("od", 5), ("od", 13), ("od", 15), ("od", 17), ("od", 19), ("od", 20))
#: Panels of T-Fig. 4.4: tables 4.28 to 4.34 each belong to one solver.
SOLVERS: Final = (
    "pivot_inverse", "gauss_inverse", "moore_penrose_inverse", "cholesky_inverse", "gauss_elimination",
    "gauss_partial_pivot_elimination", "cholesky_elimination",
)  # fmt: skip
#: EOP set of these panels, the only set that all solvers determine.
SOLVED: Final = 15
#: EOP sets of P-Fig. 7: position; velocity; attitude; position and attitude.
PAPER: Final = (1, 5, 9, 15)
OURS: Final = "Layout of our synthetic block, not of the publication's points. "


@dataclass(frozen=True)
class SourceFigure:
    """One figure of a publication.

    Parameters
    ----------
    name : str
        Number of the figure in the publication, such as "4.3".
    title, caption : str
    charts : tuple of Chart
        Panels of the figure; empty if it cannot be drawn.
    missing : str
        Reason why it cannot be drawn.
    """

    name: str
    title: str
    caption: str = ""
    charts: tuple[Chart, ...] = ()
    missing: str = ""

    @property
    def file(self) -> str:
        """File name without suffix."""
        return "fig-" + self.name.replace(".", "-").replace(" ", "-").replace(",", "")


def figures(result: Reproduction) -> tuple[SourceFigure, ...]:
    """Return the figures of a publication that belong to the chosen tables.

    Layouts are always included.
    """
    with one_blas_thread(), np.errstate(all="ignore"):  # failed adjustments overflow; nan is drawn as missing
        return tuple(_FIGURES[result.source.name](result))


# --- Terlemezoğlu 2019, Topan & Maktav 2010 -------------------------------------------------------


def _thesis(result: Reproduction) -> Iterable[SourceFigure]:
    run = _twin(result, "H-10")
    yield SourceFigure("4.2", "Control and check points, SPOT-5", OURS + "Point set H-10.", (_layout(run, "H-10"),))
    if _chosen(result, "4.25", "4.26", "4.27"):
        panels = [_of_bundle(run, number, f"tikhonov_{rule}") for rule, number in TIKHONOV]
        yield SourceFigure("4.3", "Error vectors of the Tikhonov solutions", _words(result, "4.25 to 4.27"),
                           tuple(panels))  # fmt: skip
    if _chosen(result, *(f"4.{k}" for k in range(28, 35))):
        panels = [_of_bundle(run, SOLVED, solver) for solver in SOLVERS]
        what = "The panels of the publication are not known; these are the solvers of its tables. "
        yield SourceFigure("4.4", f"Error vectors of EOP set {SOLVED} by solver", what + _words(result, "4.28 to 4.34"),
                           tuple(panels))  # fmt: skip
    yield _spot6()


def _spot6() -> SourceFigure:
    name, title = "4.5", "Control points, SPOT-6"
    points = control_points(None)
    if points is None:
        return SourceFigure(name, title, missing=NO_POINTS)
    lon, lat, _ = points.ground.T
    place = KM_PER_DEGREE * np.column_stack([shrink_at(float(lat.mean())) * (lon - lon.mean()), lat - lat.mean()])
    chart = empty_map(place, title)
    chart.add("dots", "control", *place.T, label=f"control ({len(place)})")
    return SourceFigure(name, title, "The authors' points, from their middle.", (chart,))


def _paper(result: Reproduction) -> Iterable[SourceFigure]:
    runs = {name: _twin(result, name) for name in POINT_SETS}
    yield SourceFigure("4", "Control and check points of the point sets", OURS,
                       tuple(_layout(run, name) for name, run in runs.items()))  # fmt: skip
    what = "The panels of the publication are not known; these belong to its table. "
    if _chosen(result, "1"):
        panels = [_panel(run, run.look_only(), name) for name, run in runs.items()]
        yield SourceFigure("5", "Error vectors after the adjustment of the look angles", what + _words(result, "1"),
                           tuple(panels))  # fmt: skip
        panels = [_of_bundle(run, None, "pivot_inverse", name) for name, run in runs.items()]
        yield SourceFigure("6", "Error vectors of the bundle with fixed EOPs", what + _words(result, "1"),
                           tuple(panels))  # fmt: skip
    if _chosen(result, "2"):
        panels = [_of_bundle(runs["H-20"], number, "pivot_inverse") for number in PAPER]
        yield SourceFigure("7", "Error vectors of the bundle with EOP sets, H-20", what + _words(result, "2"),
                           tuple(panels))  # fmt: skip


def _chosen(result: Reproduction, *tables: str) -> bool:
    return any(table in result.titles for table in tables)


def _words(result: Reproduction, tables: str) -> str:
    seed = result.options["seeds"][0]
    return (f"Computed minus measured, horizontal, synthetic block of seed {seed}; each panel has its own scale. "
            f"The RMSE of each panel, largest axis, is the value of seed {seed} for tables {tables}.")  # fmt: skip


def _twin(result: Reproduction, point_set: str) -> TwoStage:
    return twin(result.options["seeds"][0], point_set, as_run=result.options["as_run"])


def _of_bundle(run: TwoStage, eop_set: int | None, solver: str, title: str = "") -> Chart:
    """Return the panel of a bundle without EOP pre-adjustment (type 1)."""
    number = "" if eop_set is None else f"set {eop_set} {EOP_SETS[eop_set].name}"
    words = title or (f"{number}, {solver.replace('_', ' ')}" if solver != "pivot_inverse" else number)
    try:
        errors = run.bundle(eop_set, 1, solver).accuracy
    except FgOrientError as error:
        return Chart(words, title=words, note=str(error.problems[0].message))
    return _panel(run, errors, words)


def _layout(run: TwoStage, title: str) -> Chart:
    place = places_km(run.block)
    chart = empty_map(np.array([*place.values()]), title)
    for role, ids in (("control", run.control_ids), ("check", run.check_ids)):
        mine = np.array([place[name] for name in ids if name in place]).reshape(-1, 2)
        chart.add("dots", role, *mine.T, label=f"{role} ({len(mine)})")
    return chart


def _panel(run: TwoStage, errors: AxisErrors, title: str) -> Chart:
    """Return the horizontal error vectors, with the RMSE of each role's worst axis."""
    return error_map(places_km(run.block), errors_of(run.block, errors), title)


# --- Ayhan 1996 -----------------------------------------------------------------------------------

_LOST: Final = "The drawing and the choice of its points are not in the text of the thesis that is public."
_MISFITS: Final = ("fxx_cm2", "fyy_cm2", "fzz_cm2")
_SURFACES: Final = ("da_cm", "db_cm", "dx0_cm", "dy0_cm", "dz0_cm")
#: Number of points in the sums of tables 5 to 12.
_TARGETS: Final = 49


def _ayhan(result: Reproduction) -> Iterable[SourceFigure]:
    yield _control_of_ayhan(result)
    yield SourceFigure("21", "21 cases of six points", missing=_LOST)
    which = "Figs. 24 to 37 belong to tables 5 to 20; which figure shows which table is not known. "
    for table in result.titles:
        of_table = [row for row in result.rows if row.table == table]
        if table in map(str, range(5, 13)):
            chart = _bars(of_table, _MISFITS, "XYZ", "RMS of the misfits, mm", lambda v: 10.0 * math.sqrt(v / _TARGETS))
        elif table in map(str, range(13, 21)):
            chart = _bars(of_table, _SURFACES, ("a", "b", "X0", "Y0", "Z0"), "difference, cm", lambda v: v)
        else:
            continue
        yield SourceFigure(f"24-37, table {table}", result.titles[table],
                           which + "Lines: printed; rings: reproduced from printed data.", (chart,))  # fmt: skip


def _bars(
    rows: Sequence[Row], quantities: Sequence[str], labels: Sequence[str], words: str, scale: Callable[[float], float]
) -> Chart:
    """Return lines for the printed values over the rows of a table, and rings for the reproduced values."""
    names = list(dict.fromkeys(row.key.parameter for row in rows))
    by_key = {(row.key.parameter, row.key.quantity): row for row in rows}
    none = math.nan, math.nan
    both = np.array([[(scale(row.published), scale(row.reproduced)) if (row := by_key.get((n, q))) else none
                      for n in names] for q in quantities])  # fmt: skip
    low, high = float(np.nanmin(both)), float(np.nanmax(both))
    room = 0.08 * (high - low) or 1.0
    x = Axis("", (-0.5, len(names) - 0.5),
             names=[name.replace("collinearity", "coll.").replace("case ", "") for name in names])  # fmt: skip
    chart = broad(words, x, Axis(words, (low - room, high + room)), legend="right")
    for k, label in enumerate(labels):
        printed, ours = both[k].T
        if np.isfinite(printed).any():
            kind = f"series-{k % SERIES}"
            chart.add("line", kind, range(len(names)), printed)
            chart.add("dots", kind, range(len(names)), printed, label=label)
        at = np.flatnonzero(np.isfinite(ours))
        if len(at):
            chart.add("dots", "ring", at, ours[at])
    return chart


def _control_of_ayhan(result: Reproduction) -> SourceFigure:
    name, title = "20", "Control points"
    printed = {row.key: row.published for row in result.rows}
    at = {k: tuple(printed.get(CellKey("ek1.points", parameter=f"point {k}", quantity=f"{axis}_geodetic_m"), math.nan)
                   for axis in "xz") for k in range(1, _TARGETS + 1)}  # fmt: skip
    place = np.array([*at.values()])
    if not np.isfinite(place).all():
        return SourceFigure(name, title, missing="choose table ek1.points, which has the coordinates")
    control = {int(row.key.parameter.removeprefix("point ")) for row in result.rows if row.table == "ek2.control"}
    x, y = (Axis(f"{axis}, m", (float(v.min()) - 0.1, float(v.max()) + 0.1), about=4)
            for axis, v in zip("XZ", place.T, strict=True))  # fmt: skip
    chart = Chart(title, x, y, title="15 control points", aspect=1.0)
    chart.add("dots", "tie", *place.T, label=f"targets ({_TARGETS})")
    if control:
        chart.add("dots", "control", *np.array([at[k] for k in sorted(control)]).T, label=f"control ({len(control)})")
    return SourceFigure(name, title, "Printed coordinates of the 49 targets. " + _LOST.replace(
        "The drawing and the choice of its points", "The choice of 8, 6 and 3 control points"), (chart,))  # fmt: skip


# --- İpbüker 1994 ---------------------------------------------------------------------------------


def _ipbuker(result: Reproduction) -> Iterable[SourceFigure]:
    yield SourceFigure("7.2", "Control points of the image", OURS + (
        "15 shoreline points, as many as in the thesis, on a schematic coast in four sheets 1:25 000 with the 24 grid "
        "intersections that calibrate the sheets."), (_shore(),))  # fmt: skip


def _shore() -> Chart:
    """Return the schematic layout: sheets of 7.5' at a latitude of 41 degrees, 10.5 km by 13.9 km."""
    wide, tall, rng = 10.5, 13.9, np.random.default_rng(1994)
    chart = empty_map(np.array([[0.0, 0.0], [2.0 * wide, 2.0 * tall]]), "schematic")
    for east in (0.0, wide):
        for north in (0.0, tall):
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (wide, tall) + (east, north)
            chart.add("area", "outline", *corners.T)
    grid = np.array([(x, y) for x in (2.6, 7.9, 13.1, 18.4) for y in np.linspace(2.3, 25.5, 6)])
    chart.add("dots", "station", *grid.T, label="grid (24)")
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 15))
    shore = np.column_stack([wide + 7.0 * np.cos(angle), tall + 6.0 * np.sin(angle)])
    chart.add("dots", "control", *shore.T, label="shoreline control (15)")
    return chart


_FIGURES: Final[dict[str, Callable[[Reproduction], Iterable[SourceFigure]]]] = {
    "terlemezoglu2019": _thesis, "topan2010": _paper, "ayhan1996": _ayhan, "ipbuker1994": _ipbuker,
}  # fmt: skip
