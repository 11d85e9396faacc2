"""Make the charts and the page on the cost of engines against the size of the block."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from fg_orient.adjustment.graph_structure import Structure, explicit_structure
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.report.chart import Axis, Chart, broad, limits_of
from fg_orient.report.figures import FORMATS
from fg_orient.report.graph import matrix_chart, thinned, tree_chart
from fg_orient.report.paper import STYLE, TWO_COLUMNS, file_of, panels_of
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.studies.comparison.scale import ORDERED

#: Kinds of marks of the engines, in the order of their rows.
KINDS: Final = (*(f"series-{k}" for k in range(6)), "control", "check", "dot equal", "station")
#: Quantities of the charts: words, unit and factor.
QUANTITIES: Final = {
    "processor_s": ("processor time of an adjustment", "s", 1.0), "peak_bytes": ("rise of the memory", "MB", 1e-6),
    "factor_elements": ("elements of the factor", "", 1.0),
}  # fmt: skip
CAPTIONS: Final = {
    "time": "Processor time of an adjustment against the number of image points, all engines. A line ends where an "
            "engine was not tried because of its predicted time or memory.",
    "memory": "Rise of the resident memory in an adjustment.",
    "orderings": "Elements of the Cholesky factor of the graph with explicit points, and GTSAM's processor time for "
                 "one elimination, by elimination order.",
    "jacobian": "Blocks of the Jacobian J of a small block: rows for each image point, control point and prior; "
                "columns of the images first.",
    "matrices": "Blocks of the normal matrix N (blue) and fill of its Cholesky factor (orange) by elimination order.",
    "trees": "Elimination trees of the same block by elimination order. Each node is a clique; the root is above.",
}  # fmt: skip


def charts(record: dict[str, Any]) -> dict[str, Callable[[], Sequence[Chart | None]]]:
    """Return the charts of each figure."""
    problem = example()
    images, points = thinned(problem)
    part = explicit_structure(problem, images, points)
    return {
        "orderings": lambda: [ordering_chart(record, "nonzeros_factor"), ordering_chart(record, "processor_s")],
        "jacobian": lambda: [jacobian_chart(part)],
        "matrices": lambda: [matrix_chart(part.eliminated(part.ordering(name)), name) for name in ORDERED],
        "trees": lambda: [tree_chart(part.eliminated(part.ordering(name)), name) for name in ORDERED],
    }


def growth_files(record: dict[str, Any]) -> dict[str, bytes]:
    """Return the figures of time and memory by file name; they are as wide as two columns."""
    import matplotlib

    out: dict[str, bytes] = {}
    with matplotlib.rc_context(STYLE):
        for name, quantity in (("time", "processor_s"), ("memory", "peak_bytes")):
            if (chart := growth_chart(record, quantity)) is not None:
                figure = panels_of([chart], TWO_COLUMNS, 4.6)
                out |= {f"{name}.{kind}": file_of(figure, kind) for kind in FORMATS}
    return out


def example() -> Problem:
    """Make the small block of six images whose structure is drawn."""
    block, _ = grid_block(BlockOptions(rows=2, columns=3, points=60, check_share=0.0))
    return compile_problem(block)


def growth_chart(record: dict[str, Any], quantity: str) -> Chart | None:
    """Draw the values of all engines against the number of image points."""
    words, unit, factor = QUANTITIES[quantity]
    series: dict[str, list[tuple[float, float]]] = {}
    for row in record["rows"]:
        own = series.setdefault(row["engine"], [])
        if not row["failure"] and _positive(row[quantity]):
            own.append((row["image_points"], row[quantity] * factor))
    drawn = {name: np.array(own) for name, own in series.items() if own}
    if not drawn:
        return None
    every = np.vstack(list(drawn.values()))
    x = Axis("image points", limits_of([r["image_points"] for r in record["rows"]]), log=True)
    chart = broad(f"{words} against size", x, Axis(f"{words}, {unit}", limits_of(every[:, 1]), log=True))
    for kind, (name, values) in zip(KINDS, drawn.items(), strict=False):
        chart.add("line", kind, values[:, 0], values[:, 1])
        chart.add("dots", kind, values[:, 0], values[:, 1], label=name)
    places = [c["image_points"] for c in record["crossings"] if c["quantity"] == quantity]
    for k, place in enumerate(sorted(p for p in places if _positive(p))):
        chart.add("line", "limit", [place] * 2, chart.y.limits, label="" if k else "crossing with full matrices")
    return chart


def ordering_chart(record: dict[str, Any], quantity: str) -> Chart | None:
    """Draw the elements of the factor, or the time of an elimination, for each order."""
    found = {name: np.array([(r["image_points"], r[quantity]) for r in record["orderings"]
                             if r["ordering"] == name and _positive(r[quantity])]) for name in ORDERED}  # fmt: skip
    drawn = {name: own for name, own in found.items() if len(own)}
    if not drawn:
        return None
    every = np.vstack(list(drawn.values()))
    words = "elements of the factor" if quantity == "nonzeros_factor" else "elimination, processor s"
    x = Axis("image points", limits_of(every[:, 0]), log=True)
    chart = Chart(words, x, Axis(words, limits_of(every[:, 1]), log=True))
    for kind, (name, values) in zip(KINDS, drawn.items(), strict=False):
        chart.add("line", kind, values[:, 0], values[:, 1])
        chart.add("dots", kind, values[:, 0], values[:, 1], label=name)
    return chart


def jacobian_chart(structure: Structure) -> Chart:
    """Draw the blocks of the Jacobian: rows are factors in their order, and columns are variables."""
    ends = np.concatenate([[0], np.cumsum(structure.sizes)])
    rows = [2 if kind == "image point" else int(structure.sizes[list(own)].sum())
            for kind, own in zip(structure.kinds, structure.factors, strict=True)]  # fmt: skip
    down = np.concatenate([[0], np.cumsum(rows)])
    blocks = [(k, v) for k, own in enumerate(structure.factors) for v in own]
    at, of = (np.array(values) for values in zip(*blocks, strict=True))
    chart = Chart(
        "blocks of the Jacobian", Axis("unknowns", (0.0, float(ends[-1]))),
        Axis("observations", (0.0, float(down[-1])), down=True), width=250.0, height=420.0, legend="right",
    )  # fmt: skip
    spots = np.stack([ends[of], ends[of + 1]], axis=-1), np.stack([down[at], down[at + 1]], axis=-1)
    chart.add("blocks", "line-dot", *spots)
    return chart


def _positive(value: float | None) -> bool:
    return value is not None and math.isfinite(value) and value > 0.0


# --- page -----------------------------------------------------------------------------------------


def captions(shown: Sequence[str]) -> str:
    """Return the captions as Markdown."""
    return "\n".join(["# Cost against the size of a block", "", *(f"**{name}** {CAPTIONS[name]}\n" for name in shown)])


def page(record: dict[str, Any], figures: str = "") -> str:
    """Return the page of a run as Markdown; ``figures`` is the address of the figures' folder, with a final slash."""
    largest = max(one["image_points"] for one in record["sizes"])
    lines = [
        "# Dense and sparse from ten to a million image points", "",
        f"Run of {record['date']} on {record['processor']}, one thread of the linear algebra library: "
        f"`{record['command']}`. Other programs may have run on the machine: times are processor seconds of one "
        "adjustment without statistics, medians of up to five for short ones. Blocks are made by `fg-orient simulate "
        f"block`, from 2 to {max(one['images'] for one in record['sizes'])} images.", "",
        *_answers(record), "",
        f"![Processor time of all engines from 10 to {largest} image points]({figures}time.svg)", "",
        f"![Memory of all engines]({figures}memory.svg)", "",
        "## Processor time, s", "", *_table(record, "processor_s"), "",
        "## Rise of the resident memory, MB", "", *_table(record, "peak_bytes"), "",
        *_reasons(record), "",
        "## Exponents", "",
        "The law `y = c n^b` was fitted by least squares to the logarithms. Only sizes whose value is at least five "
        "times the smallest value are used (four sizes or more). The table gives b with its 95 % interval.", "",
        *_exponents(record), "",
        "## Elimination orders", "",
        "Graph with explicit points. Fill: elements of the factor that are zero in the normal matrix. The natural "
        "order eliminates images first: all points of an image are then linked.", "", *_orderings(record), "",
        f"![Elements of the factor and time of an elimination by order]({figures}orderings.svg)", "",
        f"![Blocks of the Jacobian of a block of six images]({figures}jacobian.svg)", "",
        f"![Normal matrix and fill by order]({figures}matrices.svg)", "",
        f"![Elimination trees by order]({figures}trees.svg)", "",
    ]  # fmt: skip
    return "\n".join(lines).rstrip("\n") + "\n"


def _answers(record: dict[str, Any]) -> list[str]:
    """Return sentences on crossing points and on exponents of memory."""
    out = []
    for quantity, words in (("processor_s", "less time"), ("peak_bytes", "less memory")):
        parts = []
        for one in (c for c in record["crossings"] if c["quantity"] == quantity):
            if _positive(one["image_points"]):
                place = float(f"{one['image_points']:.2g}")
                parts.append(f"{one['engine']} from {place:.0f} image points on")
            else:
                parts.append(f"{one['engine']} at {'all' if one['always'] == 'sparse' else 'no'} sizes")
        if parts:
            out.append(f"- Crossing point, {words} than the better of the full matrices: {'; '.join(parts)}.")
    memory = [e for e in record["exponents"] if e["quantity"] == "peak_bytes"]
    if memory:
        for words, of in (("image points", ""), ("unknowns", "unknowns_")):
            parts = [f"{e['engine']} {e[f'{of}exponent']:.2f} ± {e[f'{of}half_interval']:.2f}" for e in memory]
            out.append(f"- Exponents of memory by the number of {words}: {'; '.join(parts)}.")
    agree = [r["difference_sigmas"] for r in record["rows"] if _positive(r["difference_sigmas"])]
    if agree:
        out.append(f"- All engines have the same solution: they differ by at most {max(agree):.0e} prior sigmas.")
    return out


def _grid(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *(f"| {' | '.join(row)} |" for row in rows)]


def _table(record: dict[str, Any], quantity: str) -> list[str]:
    factor, engines = QUANTITIES[quantity][2], list(dict.fromkeys(r["engine"] for r in record["rows"]))
    cells = {(r["size"], r["engine"]): _cell(r, quantity, factor) for r in record["rows"]}
    rows = [[str(one["image_points"]), str(one["unknowns"]), *(cells.get((one["size"], e), "") for e in engines)]
            for one in record["sizes"]]  # fmt: skip
    return _grid(["image points", "unknowns", *engines], rows)


def _cell(row: dict[str, Any], quantity: str, factor: float) -> str:
    if row["failure"]:
        return "not tried" if row["left_out"] else "failed"
    return f"{row[quantity] * factor:.3g}" if _positive(row[quantity]) else "–"


def _reasons(record: dict[str, Any]) -> list[str]:
    """Return the reasons of each engine for sizes without a value, with these sizes.

    Similar reasons have the text of the first one.
    """
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in record["rows"]:
        if row["failure"]:
            found.setdefault((row["engine"], re.sub(r"[0-9.e+]+", "#", row["failure"])), []).append(row)
    out = []
    for (name, _), rows in found.items():
        first, last = rows[0]["image_points"], rows[-1]["image_points"]
        out.append(f"- {name}, {first if first == last else f'{first} to {last}'} image points: {rows[0]['failure']}.")
    return out


def _exponents(record: dict[str, Any]) -> list[str]:
    engines = dict.fromkeys(e["engine"] for e in record["exponents"])
    by_key = {(e["engine"], e["quantity"]): e for e in record["exponents"]}
    rows = []
    for engine in engines:
        cells = []
        for quantity in QUANTITIES:
            e = by_key.get((engine, quantity))
            cells.append("" if e is None else f"{e['exponent']:.2f} ± {e['half_interval']:.2f} (from {e['from']:.0f})")
        rows.append([engine, *cells])
    return _grid(["engine", *(words for words, _, _ in QUANTITIES.values())], rows)


def _orderings(record: dict[str, Any]) -> list[str]:
    rows = [
        [str(r["image_points"]), r["ordering"], f"{r['nonzeros_factor']:.3g}", f"{r['fill']:.3g}",
         f"{r['operations']:.3g}", f"{r['processor_s']:.3g}" if _positive(r["processor_s"]) else "–"]
        for r in record["orderings"] if str(r["size"])[0] == "1"
    ]  # fmt: skip
    return _grid(["image points", "order", "elements of the factor", "fill", "operations", "elimination, s"], rows)
