"""Comparison of every EOP set with every backend and solver, set by set."""

from __future__ import annotations

import functools
import hashlib
import math
import pickle
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from functools import partial
from itertools import count, product
from pathlib import Path
from typing import Any

import numpy as np

from factors._preparation import working_clock
from fg_orient.adjustment.linear.registry import solvers as known_solvers
from fg_orient.adjustment.parts.study import study
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import ALL_SETS, EOP_SETS, Progress, Role
from fg_orient.studies.comparison import model
from fg_orient.studies.comparison.engines import Adjustments, Published
from fg_orient.studies.comparison.model import SELECTIONS, Comparison, Row


def compare(
    block: Block,
    *,
    eop_sets: str | int | Iterable[int | str] = ALL_SETS,
    solvers: str | Iterable[str] = "all",
    backends: str | Iterable[str] = model.BACKENDS,
    types: str | int | Iterable[int | str] = model.TYPES,
    as_run: bool = False,
    look_polynomial: int | None = None,
    target_m: float | None = None,
    workers: int = 0,
    cluster: Any = None,
    folder: str | Path | None = None,
    callback: Progress | None = None,
) -> Comparison:
    """Compare the published procedure, dense matrices and the graph on one block.

    Parameters
    ----------
    block : Block
        Block with control points; check points give the most information.
    eop_sets : str or iterable
        "1-20", "5,13,PUA", or numbers and names.
    solvers : str or iterable
        "all", "published", or names in the registry of ``fg_orient.adjustment.linear``; not for the graph.
    backends : str or iterable
        Any of "faithful" (the published two-stage procedure, one iteration), "dense"
        (``adjust(backend="dense")``: scaled, iterated, with priors) and "graph".
    types : str or iterable
        Pre-adjustments of the published procedure: 1 look angles, 2 look angles and EOPs.
    as_run : bool
        The published procedure as the authors' program works.
    look_polynomial : int, optional
        Degree of the look-angle polynomial of "dense" and "graph"; default: that of the block.
    target_m : float, optional
        RMSE to reach; default: the ground sampling distance, see :func:`ground_sampling_m`.
    workers : int
        Processes on this machine that share the EOP sets; 0 or 1: this process.
    cluster : str or dask.distributed.Client, optional
        Scheduler of a running cluster instead.
    folder : path, optional
        Folder for finished sets: a comparison that is started again with this folder continues.
    callback : callable, optional
        Called with (done, of, text) after each adjustment; with workers or a folder after each set.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        Unknown set, solver, backend or type; a target that is not positive; no control point; a block
        that cannot be adjusted at all. Adjustments that fail are rows with a ``failure``.
    """
    start = working_clock()
    numbers, names = SELECTIONS["eop_sets"](eop_sets), SELECTIONS["solvers"](solvers)
    engines, kinds = SELECTIONS["backends"](backends), SELECTIONS["types"](types)
    _require_control(block)
    target = SELECTIONS["target_m"](ground_sampling_m(block) if target_m is None else target_m)
    degree = block.options.look_polynomial if look_polynomial is None else look_polynomial
    plan = Comparison(
        replace(block, options=replace(block.options, look_polynomial=degree)), (), (), target, numbers, names, engines,
        kinds, as_run, 0.0,
        {model.GRAPH_SOLVER: "GTSAM"} | {name: known_solvers()[name].label for name in names},
    )  # fmt: skip
    per_set = sum({"faithful": len(kinds) * len(names), "dense": len(names), "graph": 1}[one] for one in engines)
    done, total = count(1), per_set * len(numbers)

    def of_row(row: Row) -> None:
        kind = f" type {row.type}" if row.type else ""
        what = f"set {row.eop_set} {row.eop_set_name}, {row.backend}{kind}, {row.solver}"
        if callback:
            callback(next(done), total, what)

    def of_set(sets: int, _: int, number: int) -> None:
        if callback:
            callback(sets * per_set, total, f"set {number} {EOP_SETS[number].name}")

    alone = workers <= 1 and cluster is None and folder is None
    results = study(
        partial(_one_set, plan, of_row if alone else None), list(numbers), workers=workers, cluster=cluster,
        folder=folder, key="" if folder is None else _key(plan), callback=None if alone else of_set,
    )  # fmt: skip
    return replace(
        plan, seconds=working_clock() - start,
        rows=tuple(Row(**row | {"notes": tuple(row["notes"])}) for one in results for row in one["rows"]),
        spectra=tuple(model.Spectrum(**spectrum) for one in results for spectrum in one["spectra"]),
        directions=tuple(model.Direction(**direction) for one in results for direction in one["directions"]),
        curves=tuple(model.Curve.from_dict(curve) for one in results for curve in one["curves"]),
    )  # fmt: skip


def _key(plan: Comparison) -> str:
    """Digest of the inputs of the rows of a set."""
    block, selections = plan.block, (plan.solvers, plan.backends, plan.types, plan.as_run, plan.target_m)
    o, known = block.observations, block.points.known
    points = block.points.ids, block.points.roles
    digest = hashlib.sha256(repr((selections, block.options, block.sources, points)).encode())
    digest.update(pickle.dumps(block.images))
    arrays = (o.line, o.sample, o.sigma_line_px, o.sigma_sample_px, known.ecef_m, known.sigma_enu_m)
    for array in (o.image, o.point, known.fixed, *arrays):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _one_set(plan: Comparison, report: Callable[[Row], None] | None, number: int) -> dict[str, Any]:
    """Rows, spectra, directions and curves of one set, as plain values for a study."""
    rows: list[Row] = []

    def add(row: Row) -> None:
        rows.append(replace(row, reached=reached(row, plan.target_m)))
        if report is not None:
            report(row)

    # each row opens the check points after its own adjustment, but their file is read only once
    withheld = replace(plan.block.withheld, reader=functools.cache(plan.block.withheld.reader))
    block = replace(plan.block, withheld=withheld)
    parts: dict[str, list[Any]] = {"rows": rows, "spectra": [], "directions": [], "curves": []}
    with one_blas_thread():
        if "faithful" in plan.backends:
            published = Published(block, number, plan.as_run)
            for kind, name in product(plan.types, plan.solvers):
                add(published.run(kind, name))
            parts["spectra"] += published.spectra
            parts["curves"] += published.curves
        if set(plan.backends) & {"dense", "graph"}:
            engine = Adjustments(block, number)
            # the graph is the reference of the dense adjustments and precedes them
            solution, row = engine.graph() if "graph" in plan.backends else (None, None)
            for name in plan.solvers if "dense" in plan.backends else ():
                add(engine.dense(name, solution))
            if row is not None:
                add(row)
            parts["spectra"] += engine.spectra
            parts["directions"] += engine.directions
    return {name: [asdict(one) for one in part] for name, part in parts.items()}


def reached(row: Row, target_m: float) -> bool:
    """True if control and check points are at the target; a role without points does not count."""
    values = [v for v in (row.control_rmse_m, row.check_rmse_m) if not math.isnan(v)]
    return not row.failure and bool(values) and all(v <= target_m for v in values)


def ground_sampling_m(block: Block) -> float:
    """Smallest distance on the ellipsoid between neighbouring pixels at the centres of the images, m."""
    distances = []
    for image in block.images:
        sensor = image.sensor
        line, sample = (sensor.n_lines - 1) / 2.0, (sensor.n_samples - 1) / 2.0
        lines, samples = np.array([line, line + 1.0, line]), np.array([sample, sample, sample + 1.0])
        ground = sensor.locate(lines, samples, height_m=0.0)
        distances += np.linalg.norm(ground[1:] - ground[0], axis=1).tolist()
    return float(min(distances))


def _require_control(block: Block) -> None:
    """Raise InputError if no control point is measured: the block has no datum."""
    control = block.points.where(Role.CONTROL)
    if not np.isin(control, block.observations.point).any():
        raise InputError.of("block.no_control", file=block.name, place="points", value=f"{len(control)} measured")
