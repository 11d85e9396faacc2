"""Adjust a block with every EOP set, regularisation, engine and solver, one set after the other."""

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
from fg_orient.adjustment.rows import image_models
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import ALL_SETS, EOP_SETS, TIME_LIMIT_S, Progress, Role
from fg_orient.studies.comparison import model
from fg_orient.studies.comparison.advice import advise
from fg_orient.studies.comparison.engines import Adjustments
from fg_orient.studies.comparison.model import Comparison, Row
from fg_orient.studies.comparison.published_rows import Published
from fg_orient.studies.comparison.selections import SELECTIONS, regularisation_of, regularised
from fg_orient.studies.comparison.set_results import SetResult
from fg_orient.studies.comparison.work import Limits


def compare(
    block: Block,
    *,
    eop_sets: str | int | Iterable[int | str] = ALL_SETS,
    solvers: str | Iterable[str] = "all",
    backends: str | Iterable[str] = model.BACKENDS,
    types: str | int | Iterable[int | str] = model.TYPES,
    regularisations: str | Iterable[str] | None = None,
    as_run: bool = False,
    look_polynomial: int | None = None,
    target_m: float | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    workers: int = 0,
    cluster: Any = None,
    folder: str | Path | None = None,
    callback: Progress | None = None,
) -> Comparison:
    """Compare EOP sets, regularisations and engines on one block, and recommend one of each.

    Parameters
    ----------
    block : Block
        Block with control points. Check points give most information and should exist.
    eop_sets : str or iterable
        "1-20", "5,13,PUA", or numbers and names.
    solvers : str or iterable
        "all", "published", or names in the registry of ``fg_orient.adjustment.linear``,
        for "faithful" and "dense".
    backends : str or iterable
        Any of "faithful" (the published two-stage procedure, one iteration), "dense"
        (full matrices), "schur" (arrays, each method for the reduced system), "explicit"
        (GTSAM, a factor for each image point) and "graph" (GTSAM, points eliminated in
        the factors).
    types : str or iterable
        Pre-adjustments of the published procedure: 1 for look angles, 2 for look angles and EOPs.
    regularisations : str or iterable, optional
        Regularisations of the image unknowns for all engines except "faithful": "none",
        "METHOD", "METHOD:RULE" or "METHOD:NUMBER", such as "tikhonov:gcv",
        "truncated:0.1" (kappa) or "minimum_norm:1e-5" (cut of the rank), or "all". The
        default is the regularisation of the block. Parts that a word leaves out are taken
        from the options of the block.
    as_run : bool
        Whether to run the published procedure as the authors' program does.
    look_polynomial : int, optional
        Degree of the look-angle polynomial for all engines except "faithful"; default: the degree of the block.
    target_m : float, optional
        RMSE to reach. The default is the 95 % limit of the RMSE that the adjustment with
        the recommended set predicts at the check points. Without this limit, it is the
        ground sampling distance; see :func:`ground_sampling_m`.
    time_limit_s : float
        An adjustment is not tried if its predicted processor time exceeds this, s. The
        limit of the memory is an option of the block.
    workers : int
        Number of processes on this machine that share the EOP sets; 0 or 1: only this process.
    cluster : str or dask.distributed.Client, optional
        Scheduler of a running cluster; it replaces ``workers``.
    folder : path, optional
        Folder for finished sets. A comparison that is started again with this folder continues.
    callback : callable, optional
        Function that is called with (done, of, text) after each adjustment; with workers
        or a folder, after each set.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        A set, solver, backend or type is unknown; the target is not positive; there is no
        control point; or the block cannot be adjusted at all. Single adjustments that
        fail are rows with a ``failure``.
    """
    start = working_clock()
    numbers, names = SELECTIONS["eop_sets"](eop_sets), SELECTIONS["solvers"](solvers)
    engines, kinds = SELECTIONS["backends"](backends), SELECTIONS["types"](types)
    given, limit_s = SELECTIONS["target_m"](target_m), SELECTIONS["time_limit_s"](time_limit_s)
    words = SELECTIONS["regularisations"](regularisations)
    _require_control(block)
    degree = block.options.look_polynomial if look_polynomial is None else look_polynomial
    block = replace(block, options=replace(block.options, look_polynomial=degree))
    numbers, repeated = _distinct(block, numbers)
    chosen = (block.options,) if words is None else [regularised(block.options, word) for word in words]
    treated = {regularisation_of(options): None for options in chosen}
    plan = Comparison(
        block, (), (), math.nan, numbers, names, engines, kinds, as_run, 0.0,
        model.GRAPH_LABELS | {name: known_solvers()[name].label for name in names}, repeated=repeated,
        time_limit_s=limit_s, regularisations=tuple(treated),
    )  # fmt: skip
    per_set = sum(_rows_of(one, len(kinds), len(names)) * (1 if one == "faithful" else len(treated)) for one in engines)
    done, total = count(1), per_set * len(numbers)

    def of_row(row: Row) -> None:
        kind = f" type {row.type}" if row.type else ""
        what = f"set {row.eop_set} {row.eop_set_name}, {row.backend}{kind}, {row.solver}"
        words = model.regularisation_words(row.regularisation)
        if callback:
            callback(next(done), total, f"{what}, {words}" if words else what)

    def of_set(sets: int, _: int, number: int) -> None:
        if callback:
            callback(sets * per_set, total, f"set {number} {EOP_SETS[number].name}")

    alone = workers <= 1 and cluster is None and folder is None
    results = study(
        partial(_one_set, plan, of_row if alone else None), list(numbers), workers=workers, cluster=cluster,
        folder=folder, key="" if folder is None else _key(plan), callback=None if alone else of_set,
    )  # fmt: skip
    rows = [Row(**row | {"notes": tuple(row["notes"])}) for one in results for row in one["rows"]]
    sets = tuple(SetResult(**one) for part in results for one in part["sets"])
    advice = advise(sets, rows, plan.labels, priors=block.options.priors)
    target, source = _target(block, given, next((s for s in sets if s.key == advice.set_key), None))
    return replace(
        plan, seconds=working_clock() - start, sets=sets, advice=advice, target_m=target, target_from=source,
        rows=tuple(replace(row, reached=reached(row, target)) for row in rows),
        spectra=tuple(model.Spectrum(**spectrum) for one in results for spectrum in one["spectra"]),
        directions=tuple(model.Direction(**direction) for one in results for direction in one["directions"]),
        curves=tuple(model.Curve.from_dict(curve) for one in results for curve in one["curves"]),
        vectors=tuple(model.ErrorVectors.from_dict(own) for one in results for own in one["vectors"]),
    )  # fmt: skip


def _key(plan: Comparison) -> str:
    """Return a hash of all inputs that determine the rows of a set."""
    block, selections = plan.block, (
        plan.solvers, plan.backends, plan.types, plan.regularisations, plan.as_run, plan.time_limit_s,
    )  # fmt: skip
    o, known = block.observations, block.points.known
    points = block.points.ids, block.points.roles
    digest = hashlib.sha256(repr((selections, block.options, block.sources, points)).encode())
    digest.update(pickle.dumps(block.images))
    arrays = (o.line, o.sample, o.sigma_line_px, o.sigma_sample_px, known.ecef_m, known.sigma_enu_m)
    for array in (o.image, o.point, known.fixed, *arrays):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _one_set(plan: Comparison, report: Callable[[Row], None] | None, number: int) -> dict[str, Any]:
    """Compute rows, spectra, directions, curves and error vectors of one set, as plain values for a study."""
    rows: list[Row] = []

    def add(row: Row) -> None:
        rows.append(row)
        if report is not None:
            report(row)

    # each row opens the check points after its own adjustment, but their file is read only once
    withheld = replace(plan.block.withheld, reader=functools.cache(plan.block.withheld.reader))
    block = replace(plan.block, withheld=withheld)
    parts: dict[str, list[Any]] = {
        "rows": rows, "spectra": [], "directions": [], "curves": [], "sets": [], "vectors": [],
    }  # fmt: skip
    limits = Limits.of(block.options.memory_limit_gb, plan.time_limit_s)
    with one_blas_thread():
        if "faithful" in plan.backends:
            published = Published(block, number, plan.as_run, limits)
            for kind, name in product(plan.types, plan.solvers):
                add(published.run(kind, name))
            parts["spectra"] += published.spectra
            parts["curves"] += published.curves
            parts["vectors"] += published.vectors
        if adjusting := [name for name in plan.backends if name != "faithful"]:
            for word in plan.regularisations:
                treated = replace(block, options=regularised(block.options, word))
                one = Adjustments(treated, number, limits)
                for engine in (engine for name in adjusting for engine in one.engines(name, plan.solvers)):
                    add(one.run(engine))
                known = {(s.system, s.scaling) for s in parts["spectra"]}
                parts["spectra"] += [s for s in one.spectra if (s.system, s.scaling) not in known]
                parts["directions"] += [] if parts["sets"] else one.directions  # equal for all regularisations
                parts["sets"].append(one.result)
    return {name: [asdict(one) for one in part] for name, part in parts.items()}


def _rows_of(backend: str, types: int, solvers: int) -> int:
    """Return the number of rows of a backend for one set."""
    n = len(model.OPTIMIZERS)
    reduced = n + len(model.REDUCED_LABELS) - 1
    return {"faithful": types * solvers, "dense": solvers, "schur": reduced, "explicit": n + 1}.get(backend, n)


def _distinct(block: Block, numbers: tuple[int, ...]) -> tuple[tuple[int, ...], dict[int, int]]:
    """Return sets that differ in an unknown of an image; and the other sets with the set that they repeat.

    Images without EOP unknowns (RPC, frames), and images with explicitly named unknowns,
    have the same unknowns with all sets.
    """
    first: dict[tuple[tuple[str, ...], ...], int] = {}
    repeated = {}
    for number in numbers:
        options = replace(block.options, eop_set=number)
        names = tuple(tuple(one.parameters.names) for one in image_models(block.images, options))
        if first.setdefault(names, number) != number:
            repeated[number] = first[names]
    return tuple(n for n in numbers if n not in repeated), repeated


def _target(block: Block, given: float | None, best: SetResult | None) -> tuple[float, str]:
    """Return the RMSE to reach, m, and its source: "given", "predicted" or "pixel"."""
    if given is not None:
        return given, "given"
    if best is not None and math.isfinite(best.limit_m):
        return best.limit_m, "predicted"
    return ground_sampling_m(block), "pixel"


def reached(row: Row, target_m: float) -> bool:
    """Return whether control and check points reach the target.

    A role without points is ignored.
    """
    values = [v for v in (row.control_rmse_m, row.check_rmse_m) if not math.isnan(v)]
    return not row.failure and bool(values) and all(v <= target_m for v in values)


def ground_sampling_m(block: Block) -> float:
    """Return the smallest distance on the ellipsoid between neighbouring pixels at the image centres, m."""
    distances = []
    for image in block.images:
        sensor = image.sensor
        line, sample = (sensor.n_lines - 1) / 2.0, (sensor.n_samples - 1) / 2.0
        lines, samples = np.array([line, line + 1.0, line]), np.array([sample, sample, sample + 1.0])
        ground = sensor.locate(lines, samples, height_m=0.0)
        distances += np.linalg.norm(ground[1:] - ground[0], axis=1).tolist()
    return float(min(distances))


def _require_control(block: Block) -> None:
    """Raise InputError if no control point is measured, because the block then has no datum."""
    control = block.points.where(Role.CONTROL)
    if not np.isin(control, block.observations.point).any():
        raise InputError.of("block.no_control", file=block.name, place="points", value=f"{len(control)} measured")
