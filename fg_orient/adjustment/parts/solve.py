"""Adjust a problem in parts."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Final, cast

import numpy as np

from factors._contract import NotFiniteError
from fg_orient.adjustment.checkpoint import Checkpoint
from fg_orient.adjustment.loop import Callback
from fg_orient.adjustment.memory import default_parts
from fg_orient.adjustment.parts.backend import PartedBackend
from fg_orient.adjustment.parts.execution import Execution, opened, work_folder
from fg_orient.adjustment.parts.parts import part_of, part_problem, rows_of
from fg_orient.adjustment.parts.system import PartedSystem
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import replaced
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.model.errors import InputError

#: Number of ground points that is sufficient to compile every kernel of a part.
REHEARSED: Final = 2


def rehearse(problem: Problem) -> None:
    """Eliminate a few ground points in this process, so that kernels are compiled once and not by each worker."""
    points = np.flatnonzero(problem.active)[:REHEARSED]
    part = part_problem("rehearsal", part_of(problem, points, rows_of(problem, [points])[0]))
    backend = SchurBackend(part, threads=1, reduced="blocks")
    with suppress(RuntimeError, NotFiniteError):  # the system of a few points may be singular
        system = backend.linearise(backend.initial())
        system.partial(1.0)
        system.substitute(np.zeros(part.n_image_unknowns), 1.0)


def solve_in_parts(
    problem: Problem,
    execution: Execution,
    callback: Callback | None = None,
    checkpoint: Checkpoint | None = None,
    start: State | None = None,
) -> Estimate:
    """Adjust a problem in parts; processes started for it end with the adjustment.

    Parameters
    ----------
    problem : Problem
    execution : Execution
    callback : callable, optional
        Function that receives an ``IterationRecord`` after each iteration.
    checkpoint, start : optional
        See ``fg_orient.adjustment.solve.solve``.

    Raises
    ------
    InputError
        The options name another backend than the Schur complement; images share unknowns;
        more parts than points; dask is missing, the scheduler does not answer, or workers
        have no access to the work folder.
    NoSolutionError
        The equations become singular or not finite; workers fail repeatedly.
    """
    options = problem.block.options
    if options.backend not in ("auto", "schur"):
        raise InputError.of("parallel.backend", option="parts", value=options.backend)
    if problem.ties is not None:
        raise InputError.of("frame.shared_not", option="parts", value="parts", id=", ".join(problem.ties.ids))
    own = replaced(problem, "records", block=replace(problem.block, options=replace(options, backend="schur")))
    if execution.cluster is None and execution.workers > 1:
        rehearse(own)
    with opened(execution) as pool, work_folder(execution, pool) as folder:
        parts = execution.parts or default_parts(len(problem.observations))
        if checkpoint is not None:
            checkpoint.scope = f"{parts} parts"

        def backend(one: Problem) -> PartedBackend:
            return PartedBackend(one, pool, Path(mkdtemp(dir=folder)), parts, execution.kept)

        estimate = solve(own, callback, backend, checkpoint, start)
        summed = cast(PartedSystem, estimate.linear).summed()
    return replace(estimate, state=summed.state, linear=summed)
