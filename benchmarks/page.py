"""The page docs/performance.md and its figure, from the results file and nothing else.

python -m benchmarks.page
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any, Final

from benchmarks.summary import Summary, iteration_seconds, steady_seconds
from benchmarks.table import NAMES, Rows, all_tables

ROOT: Final = Path(__file__).parents[1]
RESULTS: Final = ROOT / "benchmarks" / "results" / "fast_path.json"
#: Figures of a run on a processor without vectors of 512 bits.
OTHER: Final = ROOT / "benchmarks" / "results" / "narrow_vectors.json"
SECOND: Final = "A processor with vectors of 256 bits"
PAGE: Final = ROOT / "docs" / "performance.md"
FIGURE: Final = ROOT / "docs" / "performance.svg"
#: Words before a table.
TEXTS: Final = {
    "What must hold": "Ratios are peer over ours, with the threads that our backend takes by itself.",
    "What is wished for": """\
A ratio with ">=" is a lower bound: the peer ended before it had reached the common cost, so its time is the least
that it would need.""",
    "All solvers": """\
Seconds are medians of the repeats with their quartiles. Structure is what is made once per problem: arrays and
ordering, sparsity pattern, or the peer's own objects. An iteration is the solution over its iterations; *steady* is one
iteration of ours on memory that was used before. The cost excess is relative to the lowest cost that any solver found;
above 1e-6 a ratio is a lower bound. pyceres calls the same compiled function as our factors.""",
    "Against the hardware": """\
The bound charges, at the highest rates of a triad and of matrix products measured between the rounds: 450 B and 330
flop to linearise an image point, 192 B for its part of the point block, 1458 flop per pair of rays, and the
factorisation of the full reduced matrix at the rate of a matrix product. The band bound charges the factorisation of
its band instead, where that is less, with the images in the order of the block: harder than the first.""",
    "Stages of an iteration": "`linearise`, `solve` and `retract` make the iteration; kernels are parts of them.",
    "Before the first iteration": """\
Reading is metadata, tables and project file of the block; compiling gives start coordinates and whitened records; the
structure sorts and indexes them. The first call of the kernels, compiled or loaded from the cache, is apart.""",
    "Memory": """\
Bytes per image point, measured in a process of its own: the peak of the resident memory in the solution minus that
before the block was made minus the arrays of the problem (working set); the same with the records of the equations
counted; the peak minus the resident memory right before the solution.""",
}


def markdown(rows: Rows) -> str:
    """A table; first column left, the others right."""
    head, *body = rows
    lines = ["| " + " | ".join(head) + " |", "|" + "|".join(["---"] + ["---:"] * (len(head) - 1)) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in body)])


def page(results: dict[str, Any]) -> str:
    """The text of the page."""
    m, s = results["machine"], Summary(results)
    h = s.hardware
    versions = ", ".join(f"{name} {version}" for name, version in m["versions"].items() if version)
    kind = "all sizes and peers" if m["full"] else "the reduced set"
    exponents = {name: s.exponent(name, 10_000) for name in ("schur", "schur-1", "schur-2", "graph")}
    parts = [
        "# Performance",
        f"Measured on {m['processor']} with vectors of {m['vector_bits']} bits; a run on a processor with narrower "
        f"ones stands beside it: [{SECOND}](#{SECOND.lower().replace(' ', '-')}).",
        "<!-- Made by `python -m benchmarks.page` from benchmarks/results/fast_path.json. Do not edit. -->",
        "One observation here is one image point, two equations. Synthetic SPOT-like blocks with 27 unknowns per "
        "image, 2 % control points; all solvers get the same whitened equations, start values and priors; BLAS has one "
        "thread. The pinhole problems have nine unknowns per camera and no priors.",
        f"Run of {m['date']} ({kind}, up to {m['repeats']} repeats): {m['processor']}, {m['cores']} cores, Python "
        f"{m['python']}; {versions}. Load of the machine before the run: {m['load']:.1f}. Triad "
        f"{h.triad[1] / 1e9:.1f} GB/s with one thread, {h.triad[2] / 1e9:.1f} with two; matrix product "
        f"{h.product[1] / 1e9:.1f} and {h.product[2] / 1e9:.1f} GFlop/s; Cholesky {h.cholesky / 1e9:.1f} GFlop/s. "
        f"First calls of all kernels: {results['jit_s']:.1f} s.",
        f"![Time per image point and iteration]({FIGURE.name})",
    ]
    found = [f"{NAMES[name]} {value:.2f}" for name, value in exponents.items() if value is not None]
    if found:
        parts.append(f"Time per iteration grows with the number of image points to the power: {'; '.join(found)}.")
    tables = all_tables(results)
    for heading, rows in tables.items():
        parts += [f"## {heading}", TEXTS[heading], markdown(rows)]
        if heading == "What is wished for":
            parts += second_run([row for name in ("What must hold", heading) for row in tables[name][1:]])
    return "\n\n".join(parts) + "\n"


def second_run(rows: Rows) -> list[str]:
    """Section with the figures of another processor beside those of this run."""
    other = json.loads(OTHER.read_text("utf-8"))
    measured = {row[0]: row[1] for row in rows}
    limits = {row[0]: row[2] for row in reversed(rows)}
    beside = [[name, measured[name], value, limits[name]] for name, value in other["measured"].items()]
    head = ["goal", "this run", other["short"], "limit or target"]
    return [f"## {SECOND}", other["text"], markdown([head, *beside])]


def digest(text: str) -> str:
    """What ties the figure to the results."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def draw(results: dict[str, Any], mark: str, path: Path) -> None:
    """Microseconds per image point and iteration over the number of image points, with the bound."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    s = Summary(results)
    mpl.rcParams |= {"svg.hashsalt": mark, "svg.fonttype": "none"}
    figure, axes = plt.subplots(figsize=(9.0, 4.5), layout="constrained")
    sizes = s.sizes("spot")
    names = dict.fromkeys(name for size in sizes for name in s.solvers("spot", size))
    for name in names:
        points = []
        for size in sizes:
            records = s.records("spot", size, name)
            if records and records[0]["iterations"]:
                of = steady_seconds if name.startswith("schur") else iteration_seconds
                value = s.per_point_us("spot", size, name, of)
                assert value is not None
                points.append((records[0]["n_image_points"], value))
        if points:
            n, values = zip(*points, strict=True)
            spread = [[v.median - v.low for v in values], [v.high - v.median for v in values]]
            axes.errorbar(
                n, [v.median for v in values], yerr=spread, marker="o", capsize=2, label=NAMES.get(name, name)
            )
    bounds = [(s.records("spot", size, "schur-2")[0]["n_image_points"], s.bound_seconds(size, 2, banded=False))
              for size in sizes if s.records("spot", size, "schur-2")]  # fmt: skip
    axes.plot([n for n, _ in bounds], [b / n * 1e6 for n, b in bounds if b], "k:", label="hardware bound, 2 threads")
    axes.set(xscale="log", yscale="log", xlabel="image points", ylabel="µs per image point and iteration")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="small")
    figure.savefig(path, metadata={"Date": None, "Description": f"results {mark}"})
    plt.close(figure)


def write_page() -> None:
    """Write the page and its figure."""
    text = RESULTS.read_text("utf-8")
    results = json.loads(text)
    PAGE.write_text(page(results), "utf-8")
    draw(results, digest(text), FIGURE)


if __name__ == "__main__":
    write_page()
    sys.exit(0)
