"""Measure the cost of the engines for blocks from ten to a million image points.

The blocks are synthetic (``fg-orient simulate block``). The number of image points grows,
and the number of images grows more slowly. Each engine adjusts each block once. Small
blocks are adjusted several times, and the median is used. If the predicted memory or time
of an engine exceeds its limit, its row contains the reason. Elimination orders of the
graph with explicit points are compared by their fill and operations, and by GTSAM's time
for one elimination.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.explicit_optimisers import elimination_seconds
from fg_orient.adjustment.graph_structure import ORDERINGS, explicit_structure
from fg_orient.adjustment.parts.study import study
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.solve import first_sentence
from fg_orient.model.block import Block
from fg_orient.model.distributions import t_quantile
from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.model.machine import processor_name
from fg_orient.model.names import TIME_LIMIT_S, Progress
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.options import LEAST_CONTROL
from fg_orient.studies.comparison.model import GRAPH_LABELS, Key
from fg_orient.studies.comparison.solving import Engine, Engines, timed
from fg_orient.studies.comparison.work import Limits, Sparsity

#: Numbers of image points of the blocks.
SIZES: Final = (*(k * 10**e for e in range(1, 6) for k in (1, 2, 5)), 10**6)
SMALLEST, LARGEST = 10, 2_000_000
#: Solvers that are used for full matrices.
SOLVERS: Final = ("qr", "lapack_cholesky")
#: An adjustment is repeated if it takes less processor time than this, s.
SHORT_S: Final = 0.2
#: Number of repetitions.
REPEATS: Final = 5
#: Elimination orders and the largest number of image points for each. The natural order
#: (images first) links all points of an image, so that only small blocks are possible.
ORDERED: Final = {**dict.fromkeys(ORDERINGS, 30_000), "natural": 1000}
#: The time of an elimination is measured up to this number of operations.
TIMED: Final = 2e10
#: Values below this multiple of the least value are overhead and do not show the growth.
OVERHEAD: Final = 5.0
#: Minimum number of sizes for an exponent.
FEWEST: Final = 4
LABELS: Final = {**GRAPH_LABELS, "qr": "QR", "lapack_cholesky": "LAPACK Cholesky"}


def scale(
    sizes: str | Sequence[int] = SIZES,
    *,
    time_limit_s: float = TIME_LIMIT_S,
    memory_limit_gb: float | None = None,
    workers: int = 0,
    cluster: Any = None,
    folder: str | Path | None = None,
    callback: Progress | None = None,
) -> dict[str, Any]:
    """Adjust blocks of increasing size with all engines.

    Parameters
    ----------
    sizes : str or sequence of int
        Numbers of image points of the blocks: "10,100,1000", "1e4" or numbers.
    time_limit_s, memory_limit_gb : float
        An adjustment is not tried if its predicted processor time or memory exceeds these limits.
    workers : int
        Number of processes that share the sizes. The measured times then show a busy machine.
    cluster : str or dask.distributed.Client, optional
        Scheduler of a running cluster; it replaces ``workers``.
    folder : path, optional
        Folder for finished sizes. A study that is started again with this folder continues.
    callback : callable, optional
        Function that is called with (done, of, text) after each size.

    Returns
    -------
    dict
        ``sizes``, ``rows`` (one for each size and engine), ``orderings``, ``exponents``,
        ``crossings``, ``processor``.

    Raises
    ------
    InputError
        A size is not a whole number from 10 to 2 000 000, or a limit is invalid.
    """
    chosen = sizes_of(sizes)
    if not time_limit_s > 0.0:
        raise InputError.of("compare.time_limit", option="time_limit_s", value=time_limit_s)

    def report_progress(done: int, of: int, size: int) -> None:
        if callback is not None:
            callback(done, of, f"{size} image points")

    limits = Limits.of(memory_limit_gb, time_limit_s)
    results = study(
        partial(_one_size, memory_limit_gb, time_limit_s), list(chosen), workers=workers, cluster=cluster,
        folder=folder, key=f"scale {limits.seconds} {memory_limit_gb}", callback=report_progress,
    )  # fmt: skip
    rows = [row for one in results for row in one["rows"]]
    return {
        "sizes": [one["block"] for one in results], "rows": rows,
        "orderings": [row for one in results for row in one["orderings"]], "exponents": exponents(rows),
        "crossings": crossings(rows), "processor": processor_name(), "time_limit_s": time_limit_s,
        "memory_limit_gb": memory_limit_gb,
    }  # fmt: skip


def sizes_of(given: str | Sequence[int]) -> tuple[int, ...]:
    """Read a selection of sizes as whole numbers in ascending order."""
    words = given.split(",") if isinstance(given, str) else list(given)
    out = set[int]()
    for word in words:
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not (SMALLEST <= value <= LARGEST and value == int(value)):
            raise InputError.of("compare.size", option="sizes", value=word, least=SMALLEST, most=LARGEST)
        out.add(int(value))
    if not out:
        raise InputError.of("compare.nothing", option="sizes", value=given)
    return tuple(sorted(out))


def block_of(size: int) -> Block:
    """Make a block with about this number of image points: 2 images up to 1000 points, 100 from a million on."""
    side = int(min(max(round((size / 1000.0) ** (1.0 / 3.0)), 1), 10))
    rays = {1: 2.0, 2: 2.7}.get(side, 3.5)
    points = max(round(size / rays), LEAST_CONTROL)
    for _ in range(2):
        options = BlockOptions(rows=side, columns=max(side, 2), points=points, check_share=0.0)
        block, _ = grid_block(options)
        points = max(round(points * size / len(block.observations)), LEAST_CONTROL)
        if side == 1:  # each point of a pair has two rays
            break
    o = block.observations
    return replace(block, observations=o.take(o.point < size // 2)) if size < len(o) and side == 1 else block


def _one_size(memory_limit_gb: float | None, time_limit_s: float, size: int) -> dict[str, Any]:
    """Compute the rows of all engines and the elimination orders for one size."""
    block = block_of(size)
    problem = compile_problem(replace(block, options=replace(block.options, memory_limit_gb=memory_limit_gb)))
    sparsity = Sparsity(problem)
    limits = Limits.of(memory_limit_gb, time_limit_s)
    engines = Engines(problem, sparsity)
    chosen = [e for name in ("graph", "schur", "explicit", "dense") for e in engines.of(name, SOLVERS)]
    n = len(problem.observations)
    counted = {"size": size, "image_points": n, "unknowns": problem.n_unknowns, "images": problem.n_images,
               "image_unknowns": problem.n_free_unknowns}  # fmt: skip
    rows, reference = [], None
    with one_blas_thread():
        for engine in chosen:
            if engine.optimizer == "gauss-newton":
                row, state = _row(engine, problem, limits)
                reference = state if reference is None else reference
                if state is not None and reference is not None:
                    row["difference_sigmas"] = float(np.abs(state - reference).max())
                rows.append(counted | row)
        orderings = [counted | one for one in _orderings(problem)]
    return {"block": counted | {"normal_elements": sparsity.normal}, "rows": rows, "orderings": orderings}


def _row(engine: Engine, problem: Problem, limits: Limits) -> tuple[dict[str, Any], Array | None]:
    """Return the row of an engine, and the image unknowns."""
    name = Key(engine.backend, None, engine.solver, engine.optimizer).name(LABELS)
    row: dict[str, Any] = {
        "backend": engine.backend, "solver": engine.solver, "engine": name, "own_choice": bool(engine.note),
        "processor_s": math.nan, "peak_bytes": math.nan, "iterations": 0, "operations": math.nan,
        "factor_elements": math.nan, "fill": math.nan, "predicted_s": math.nan, "predicted_bytes": math.nan,
        "difference_sigmas": math.nan, "failure": engine.impossible, "left_out": bool(engine.impossible),
    }  # fmt: skip
    if engine.impossible:
        return row, None
    work = engine.work()
    row |= work.columns() | {"predicted_s": work.seconds, "predicted_bytes": work.memory}
    if reason := limits.reason(name, work):
        return row | {"failure": reason, "left_out": True}, None
    seconds, peaks = [], []
    try:
        while True:
            result, effort = timed(engine, problem)
            seconds.append(effort.processor_s)
            peaks.append(effort.peak_bytes)
            if effort.processor_s > SHORT_S or len(seconds) == REPEATS:
                break
    except FgOrientError as error:
        return row | {"failure": " | ".join(map(str, error.problems))}, None
    except RuntimeError as error:
        return row | {"failure": first_sentence(error)}, None
    row |= {"processor_s": median(seconds), "peak_bytes": median(peaks),
            "iterations": result.iterations or len(result.log)}  # fmt: skip
    if not result.converged:
        return row | {"failure": str(result.end)}, None
    return row, problem.image_vector(result.state)


def _orderings(problem: Problem) -> list[dict[str, Any]]:
    """Return elements, fill and operations of the factor of the explicit graph for each elimination order."""
    out: list[dict[str, Any]] = []
    structure = None
    for name, most in ORDERED.items():
        if len(problem.observations) > 1.2 * most:
            continue
        structure = explicit_structure(problem) if structure is None else structure
        order = structure.ordering(name)
        tree = structure.eliminated(order)
        seconds = math.nan
        if tree.operations <= TIMED:
            seconds = median(elimination_seconds(problem, order) for _ in range(3))
        out.append({"ordering": name, **tree.counts, "operations": tree.operations, "processor_s": seconds})
    return out


# --- growth ---------------------------------------------------------------------------------------


def exponents(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Estimate the exponents of time, memory and factor elements for each engine, with 95 % intervals.

    ``log y = a + b log n`` is fitted by least squares. The fit uses the sizes n whose
    value is at least :data:`OVERHEAD` times the least value, and always the four largest
    sizes. For ``unknowns_exponent``, n is the number of all unknowns.
    """
    out = []
    for engine in dict.fromkeys(row["engine"] for row in rows):
        for quantity in ("processor_s", "peak_bytes", "factor_elements"):
            own = [r for r in rows if r["engine"] == engine and not r["failure"] and r[quantity] > 0.0]
            if fitted := exponent([(r["image_points"], r[quantity]) for r in own]):
                other = exponent([(r["unknowns"], r[quantity]) for r in own])
                of_unknowns = {f"unknowns_{k}": other.get(k, math.nan) for k in ("exponent", "half_interval")}
                out.append({"engine": engine, "quantity": quantity, **fitted, **of_unknowns})
    return out


def exponent(points: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Return the exponent b of values y(n), half of its 95 % interval, y(1), and the range of n.

    The result is empty if y hardly grows.
    """
    points = sorted(points)
    grown = [k for k, (_, y) in enumerate(points) if y >= OVERHEAD * min(y for _, y in points)]
    if not grown or len(points) < FEWEST:
        return {}
    begin = min(grown[0], len(points) - FEWEST)
    x, y = np.log(np.array(points[begin:], float)).T
    design = np.stack([np.ones_like(x), x], axis=1)
    (a, b), *_ = np.linalg.lstsq(design, y)
    freedom = len(x) - 2
    variance = float(np.sum((y - a - b * x) ** 2)) / freedom
    half = float(t_quantile(freedom, 0.975)) * math.sqrt(variance / float(np.sum((x - x.mean()) ** 2)))
    return {"exponent": float(b), "half_interval": half, "at_one": math.exp(float(a)), "sizes": len(x),
            "from": float(points[begin][0]), "to": float(points[-1][0])}  # fmt: skip


def crossings(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the crossing points, where a sparse engine begins to need less time, or memory, than full matrices.

    A crossing point is a number of image points. It is interpolated between two sizes on
    logarithmic scales. The fastest solver of full matrices is the reference.
    ``image_points`` is nan if the engine needs less at all sizes, or more at all common
    sizes; ``always`` states which of the two.
    """
    out = []
    for quantity in ("processor_s", "peak_bytes"):
        dense: dict[int, float] = {}
        for r in rows:
            if r["backend"] == "dense" and not r["failure"] and r[quantity] > 0.0:
                dense[r["image_points"]] = min(r[quantity], dense.get(r["image_points"], math.inf))
        for engine in dict.fromkeys(r["engine"] for r in rows if r["backend"] != "dense"):
            own = {r["image_points"]: r[quantity] for r in rows if r["engine"] == engine and not r["failure"]}
            common = sorted(n for n in dense if own.get(n, 0.0) > 0.0)
            if common:
                gap = [math.log(own[n] / dense[n]) for n in common]
                out.append({"engine": engine, "quantity": quantity, **_crossing(common, gap)})
    return out


def _crossing(sizes: Sequence[int], gap: Sequence[float]) -> dict[str, Any]:
    """Return where the logarithm of a ratio last changes from positive to negative."""
    if gap[-1] >= 0.0:
        return {"image_points": math.nan, "always": "dense"}
    above = [k for k, value in enumerate(gap) if value >= 0.0]
    if not above:
        return {"image_points": math.nan, "always": "sparse"}
    k = above[-1]
    x, share = np.log(np.array(sizes[k : k + 2], float)), gap[k] / (gap[k] - gap[k + 1])
    return {"image_points": float(np.exp(x[0] + share * (x[1] - x[0]))), "always": ""}
