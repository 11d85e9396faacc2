"""The module makes the page docs/performance.md and its figure from the files of results alone.

python -m benchmarks.page
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any, Final

from benchmarks import snooping, whole_run, wide
from benchmarks.goals import GRAPH
from benchmarks.summary import Summary, iteration_seconds, steady_seconds
from benchmarks.table import NAMES, Rows, all_tables, goal_rows, solver_rows

ROOT: Final = Path(__file__).parents[1]
RESULTS: Final = ROOT / "benchmarks" / "results" / "fast_path.json"
#: The file has the figures of a run on a processor without vectors of 512 bits.
OTHER: Final = ROOT / "benchmarks" / "results" / "narrow_vectors.json"
SECOND: Final = "A processor with vectors of 256 bits"
PAGE: Final = ROOT / "docs" / "performance.md"
FIGURE: Final = ROOT / "docs" / "performance.svg"
#: The file has the run of GTSAM's optimisers: ``fast_path`` without --full, all pinhole problems, sizes from 1e4.
GRAPH_RESULTS: Final = ROOT / "benchmarks" / "results" / "graph.json"
#: These texts stand before the tables.
TEXTS: Final = {
    "Limits": """\
A ratio is the time of another program divided by the time of fg_orient with its default number of threads.""",
    "Targets": """\
A ratio with ">=" is a lower bound: the other program ended before it reached the common cost, and would need more
time.""",
    "All solvers": """\
Times in seconds are medians of the repeats with their quartiles. Structure is the preparation once per problem:
arrays and ordering, sparsity pattern, or the objects of the other program. The time of an iteration is the time of
the solution divided by the number of iterations; *steady* is one iteration of fg_orient on memory that was used
before. The cost excess is relative to the lowest cost of all solvers; above 1e-6 a ratio is a lower bound. pyceres
calls the same compiled function as the factors of fg_orient.""",
    "Against the hardware": """\
The bound is the time of the following operations at the highest rates of a triad and of matrix products, which
were measured between the rounds. To linearise an image point takes 450 B and 330 flop, its part of the point block
takes 192 B, and a pair of rays takes 1458 flop. The full reduced matrix is factorised at the rate of a matrix
product. The band bound uses the factorisation of the band if that is faster, with the images in the order of the
block. It is stricter than the first bound.""",
    "Stages of an iteration": """\
An iteration consists of `linearise`, `solve` and `retract`; the kernels are parts of these stages.""",
    "Before the first iteration": """\
Read: metadata, tables and project file of the block. Compile: approximate coordinates and whitened records.
Structure: sorting and indexing. The times do not include the first call of the kernels, compiled or loaded from the
cache.""",
    "Memory": """\
Bytes per image point, measured in a separate process. Working set: the peak of the resident memory in the solution
minus the memory before the block was made minus the arrays of the problem. With records: the working set plus the
records of the equations. Solve only: the peak minus the resident memory immediately before the solution.""",
}


def markdown(rows: Rows) -> str:
    """Return a Markdown table; the first column is aligned left, the others right."""
    head, *body = rows
    lines = ["| " + " | ".join(head) + " |", "|" + "|".join(["---"] + ["---:"] * (len(head) - 1)) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in body)])


def page(results: dict[str, Any]) -> str:
    """Return the text of the page."""
    m, s = results["machine"], Summary(results)
    h = s.hardware
    versions = ", ".join(f"{name} {version}" for name, version in m["versions"].items() if version)
    kind = "all sizes and peers" if m["full"] else "the reduced set"
    exponents = {name: s.exponent(name, 10_000) for name in ("schur", "schur-1", "schur-2", "graph")}
    parts = [
        "# Performance",
        f"Measured on {m['processor']} with vectors of {m['vector_bits']} bits. The figures of a second run are in the "
        f"section [{SECOND}](#{SECOND.lower().replace(' ', '-')}).",
        "<!-- Made by `python -m benchmarks.page` from benchmarks/results/fast_path.json. Do not edit. -->",
        "On this page one observation is one image point with two equations. The blocks are synthetic SPOT-like blocks "
        "with 27 unknowns per image and 2 % control points. All solvers use the same whitened equations, approximate "
        "values and priors; BLAS has one thread. The pinhole problems have nine unknowns per camera and no priors.",
        f"Run of {m['date']} ({kind}, up to {m['repeats']} repeats): {m['processor']}, {m['cores']} cores, Python "
        f"{m['python']}; {versions}. Load of the machine before the run: {m['load']:.1f}. Triad "
        f"{h.triad[1] / 1e9:.1f} GB/s with one thread, {h.triad[2] / 1e9:.1f} with two; matrix product "
        f"{h.product[1] / 1e9:.1f} and {h.product[2] / 1e9:.1f} GFlop/s; Cholesky {h.cholesky / 1e9:.1f} GFlop/s. "
        f"First calls of all kernels: {results['jit_s']:.1f} s.",
        f"![Time per image point and iteration]({FIGURE.name})",
    ]
    found = [f"{NAMES[name]} {value:.2f}" for name, value in exponents.items() if value is not None]
    if found:
        parts.append(
            "The time per iteration is proportional to a power of the number of image points. "
            f"Exponents: {'; '.join(found)}."
        )
    tables = all_tables(results)
    for heading, rows in tables.items():
        parts += [f"## {heading}", TEXTS[heading], markdown(rows)]
        if heading == "Targets":
            parts += second_run([row for name in ("Limits", heading) for row in tables[name][1:]])
    return "\n\n".join(parts + graph_run() + wide_run() + whole_runs() + snooping_runs()) + "\n"


def graph_run() -> list[str]:
    """Return the section on GTSAM's optimisers, from a separate run."""
    results = json.loads(GRAPH_RESULTS.read_text("utf-8"))
    m, s = results["machine"], Summary(results)
    text = (
        f"Run of {m['date']}: {m['processor']}, vectors of {m['vector_bits']} bits, load {m['load']:.1f}, up to "
        f"{m['repeats']} repeats. A ratio is the time of structure and solution divided by the time of our own loop "
        "with the same rule for the end. Levenberg-Marquardt is compared with our Levenberg-Marquardt, Gauss-Newton "
        "and Dogleg with our Gauss-Newton."
    )
    return ["## GTSAM's optimisers", text, markdown(goal_rows(s, GRAPH, must=True)), markdown(solver_rows(s))]


def measured_by(script: str, results: dict[str, Any]) -> str:
    """Return a line with the command of a separate run and its machine."""
    m = results["machine"]
    return (
        f"`python -m benchmarks.{script}` on {m['processor']}, {m['cores']} cores, vectors of {m['vector_bits']} bits, "
        f"Python {m['python']}, load {m['load']:.1f}"
    )


def wide_run() -> list[str]:
    """Return the section on wide networks, from a separate run."""
    results = json.loads(wide.RESULTS.read_text("utf-8"))
    text = (
        "Pinhole cameras see random points. Each point has four rays, each camera has nine unknowns, and there are no "
        "priors. The sizes are 340 cameras with 50 000 points, 1000 with 100 000, and 3000 with 200 000. The time of a "
        "solver includes its preparation and ends when its chi2 exceeds the lowest chi2 of all solvers by at most "
        "1e-9. Ceres uses the cost functions of COLMAP. Its conjugate gradients have the accuracy 0.01 if the name "
        "contains it, otherwise 0.1. Ceres factorises the matrix of up to 1000 cameras only: for 3000 cameras, a "
        "factor takes 6e12 operations and 6 GB in each iteration. Memory is the peak minus the memory before the "
        "solver's objects. Ratios compare processor seconds, because other programs ran on the machine. Solutions that "
        "did not reach the common chi2 were ended after 120 s or more. Grids and strips use the default backend. "
        f"Command and machine: {measured_by('wide', results)}. Each solution was a separate process."
    )
    return ["## Wide networks", text, markdown(wide.goals(results)), markdown(wide.rows(results))]


def whole_runs() -> list[str]:
    """Return the section on whole commands, from a separate run."""
    results = json.loads(whole_run.RESULTS.read_text("utf-8"))
    text = (
        "The table gives medians of the processor seconds and of the peak of the resident memory, from the start of "
        "the command `adjust` to its last file, with report. *All statistics* means redundancy numbers, reliability "
        f"and tests of all observations. Command and machine: {measured_by('whole_run', results)}."
    )
    stages = "The next table gives the shares of the stages in the wall-clock time, per cent:"
    tables = [markdown(table(results)) for table in (whole_run.rows, whole_run.stage_rows, whole_run.figures)]
    return ["## Whole runs", text, tables[0], stages, *tables[1:]]


def snooping_runs() -> list[str]:
    """Return the section on the search for gross errors, from a separate run."""
    results = json.loads(snooping.RESULTS.read_text("utf-8"))
    text = (
        "The command `adjust --snoop` was run with report on the blocks of the last section, with gross errors of 5 to "
        "50 px in random image points. The table gives medians of the processor seconds and of the peak of the "
        "resident memory. *One by one* is the same search with one gross error in each round. "
        f"Command and machine: {measured_by('snooping', results)}."
    )
    truth = (
        "The next table compares the search with the planted errors. Missed errors pass the test, mostly because they "
        "lie in the plane of the two rays of their point. The prediction follows from the non-centrality of each error "
        "in the adjustment without errors, with a 99 % interval. Correct image points of a point with an error are "
        "left out for two reasons: the data cannot show which image point is wrong, or only a single ray remains."
    )
    return ["## Snooping", text, markdown(snooping.rows(results)), truth, markdown(snooping.truth_rows(results))]


def second_run(rows: Rows) -> list[str]:
    """Return the section that compares the figures of another processor with this run."""
    other = json.loads(OTHER.read_text("utf-8"))
    measured = {row[0]: row[1] for row in rows}
    limits = {row[0]: row[2] for row in reversed(rows)}
    beside = [[name, measured[name], value, limits[name]] for name, value in other["measured"].items()]
    head = ["goal", "this run", other["short"], "limit or target"]
    return [f"## {SECOND}", other["text"], markdown([head, *beside])]


def digest(text: str) -> str:
    """Return the digest of the results that the figure contains."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def draw(results: dict[str, Any], mark: str, path: Path) -> None:
    """Draw the microseconds per image point and iteration over the number of image points, with the bound."""
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
