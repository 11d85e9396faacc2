"""Comparison of every EOP set with every backend and solver, set by set."""

from __future__ import annotations

import functools
import hashlib
import math
import pickle
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from factors._preparation import working_clock
from fg_orient.adjustment.linear.registry import solvers as known_solvers
from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.parts.study import study
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import ALL_SETS, EOP_SETS, Progress, Role
from fg_orient.studies.comparison.engines import Adjustments, Published
from fg_orient.studies.comparison.model import (
    BACKENDS,
    GRAPH_SOLVER,
    SELECTIONS,
    TYPES,
    Comparison,
    Curve,
    Direction,
    Row,
    Spectrum,
)


def compare(
    block: Block,
    *,
    eop_sets: str | int | Iterable[int | str] = ALL_SETS,
    solvers: str | Iterable[str] = "all",
    backends: str | Iterable[str] = BACKENDS,
    types: str | int | Iterable[int | str] = TYPES,
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
    plan = _Plan(engines, names, kinds, as_run, look_polynomial, target)
    if workers <= 1 and cluster is None and folder is None:
        run = _Run(len(numbers) * plan.per_set, plan, callback)
        run.take(block, numbers)
    else:
        run = _shared(block, plan, numbers, workers, cluster, folder, callback)
    degree = block.options.look_polynomial if look_polynomial is None else look_polynomial
    return Comparison(
        block=replace(block, options=replace(block.options, look_polynomial=degree)), rows=tuple(run.rows),
        spectra=tuple(run.spectra), directions=tuple(run.directions), curves=tuple(run.curves),
        target_m=target, eop_sets=numbers, solvers=names, backends=engines, types=kinds,
        as_run=as_run, seconds=working_clock() - start,
        labels={GRAPH_SOLVER: "GTSAM"} | {name: known_solvers()[name].label for name in names},
    )  # fmt: skip


@dataclass(frozen=True)
class _Plan:
    """Adjustments of each set."""

    engines: tuple[str, ...]
    names: tuple[str, ...]
    kinds: tuple[int, ...]
    as_run: bool
    look_polynomial: int | None
    target_m: float

    @property
    def per_set(self) -> int:
        """Adjustments of one set."""
        count = {"faithful": len(self.kinds) * len(self.names), "dense": len(self.names), "graph": 1}
        return sum(count[e] for e in self.engines)


def _shared(
    block: Block, plan: _Plan, numbers: tuple[int, ...], workers: int, cluster: Any, folder: str | Path | None,
    callback: Progress | None,
) -> _Run:  # fmt: skip
    """Rows and spectra of all sets, each a case of a study."""

    def report(done: int, of: int, number: int) -> None:
        if callback:
            callback(done * plan.per_set, of * plan.per_set, f"set {number} {EOP_SETS[number].name}")

    results = study(
        partial(_one_set, block, plan), list(numbers), workers=workers, cluster=cluster, folder=folder,
        key=_key(block, plan), callback=report,
    )  # fmt: skip
    run = _Run(len(numbers) * plan.per_set, plan, None)
    for of_set in results:
        run.rows += [Row(**{**row, "notes": tuple(row["notes"])}) for row in of_set["rows"]]
        run.spectra += [Spectrum(**spectrum) for spectrum in of_set["spectra"]]
        run.directions += [Direction(**direction) for direction in of_set["directions"]]
        run.curves += [Curve.from_dict(curve) for curve in of_set["curves"]]
    return run


def _key(block: Block, plan: _Plan) -> str:
    """Digest of the inputs of the rows of a set."""
    o, known = block.observations, block.points.known
    points = block.points.ids, block.points.roles
    digest = hashlib.sha256(repr((plan, block.options, block.sources, points)).encode())
    digest.update(pickle.dumps(block.images))
    arrays = (o.line, o.sample, o.sigma_line_px, o.sigma_sample_px, known.ecef_m, known.sigma_enu_m)
    for array in (o.image, o.point, known.fixed, *arrays):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _one_set(block: Block, plan: _Plan, number: int) -> dict[str, Any]:
    """Rows and spectra of one set, as plain values for a study."""
    run = _Run(plan.per_set, plan, None)
    run.take(block, (number,))
    parts: dict[str, list[Any]] = {
        "rows": run.rows, "spectra": run.spectra, "directions": run.directions, "curves": run.curves,
    }  # fmt: skip
    return {name: [asdict(one) for one in part] for name, part in parts.items()}


class _Run:
    """Collects rows and their explanations, compares them with the target and reports progress."""

    def __init__(self, total: int, plan: _Plan, callback: Progress | None) -> None:
        self.rows: list[Row] = []
        self.spectra: list[Spectrum] = []
        self.directions: list[Direction] = []
        self.curves: list[Curve] = []
        self._total, self._plan, self._target, self._callback = total, plan, plan.target_m, callback

    def take(self, block: Block, numbers: Iterable[int]) -> None:
        """Run some sets; the graph, reference of the dense adjustments, precedes them."""
        plan = self._plan
        # each row opens the check points after its own adjustment, but their file is read only once
        block = replace(block, withheld=replace(block.withheld, reader=functools.cache(block.withheld.reader)))
        with one_blas_thread():
            published = Published(block, plan.as_run) if "faithful" in plan.engines else None
            for number in numbers:
                for kind in plan.kinds:
                    if published is None:
                        break
                    for name in plan.names:
                        self._add(published.run(number, kind, name))
                    self.spectra += published.spectra.get((number, kind), ())
                    self.curves += [published.curves[number, kind]] if (number, kind) in published.curves else []
                if set(plan.engines) & {"dense", "graph"}:
                    self._adjust(Adjustments(block, number, plan.look_polynomial))

    def _adjust(self, engine: Adjustments) -> None:
        solution, row = engine.graph() if "graph" in self._plan.engines else (None, None)
        for name in self._plan.names if "dense" in self._plan.engines else ():
            self._add(engine.dense(name, solution))
        if row:
            self._add(row)
        self.spectra += engine.spectra
        self.directions += engine.directions

    def _add(self, row: Row) -> None:
        self.rows.append(replace(row, reached=reached(row, self._target)))
        if self._callback:
            kind = f" type {row.type}" if row.type else ""
            what = f"set {row.eop_set} {EOP_SETS[row.eop_set].name}, {row.backend}{kind}, {row.solver}"
            self._callback(len(self.rows), self._total, what)


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
