"""Complete run: read a project, adjust it, and write a result folder with its provenance.

The folder is written under a hidden name and renamed at the end. Therefore failed and interrupted runs leave
no folder.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from factors._preparation import preparing_seconds, working_clock
from fg_orient.adjustment.checkpoint import EVERY_S, Checkpoint
from fg_orient.adjustment.stages import require_possible
from fg_orient.formats.atomic import require_free, staged_folder, writing
from fg_orient.formats.project import read_project
from fg_orient.formats.table_write import require_writer
from fg_orient.model.errors import InputError, NoSolutionError, RankDeficientError
from fg_orient.model.machine import return_memory
from fg_orient.orientation.orient import Stage, adjust
from fg_orient.quality.deficiency import Evidence
from fg_orient.report import write_page
from fg_orient.report.pictures import rasters_of
from fg_orient.result.manifest import write_manifest
from fg_orient.result.plain import plain
from fg_orient.result.provenance import ground_system, how_to_repeat
from fg_orient.result.record import Result, write_record
from fg_orient.result.summary import deficient_result, deficient_summary, result_of
from fg_orient.rpc.files import corrected_models

if TYPE_CHECKING:
    from fg_orient.adjustment.loop import Callback
    from fg_orient.model.block import Block
    from fg_orient.orientation.solution import Solution
    from fg_orient.sensors.correction import HeightSurface


def run_project(
    project: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    options: Mapping[str, object] | None = None,
    callback: Callback | None = None,
    command: Sequence[str] = (),
    execution: Mapping[str, Any] | None = None,
    stage: Stage | None = None,
    checkpoint_every_s: float = EVERY_S,
    resume: bool = False,
    dem_control: tuple[HeightSurface, float] | None = None,
    start: str | Path | None = None,
    start_prior: bool = False,
    check: Callable[[Block], None] | None = None,
) -> dict[str, Any]:
    """Read a project, adjust it and write the result folder.

    Parameters
    ----------
    project : path
        TOML file.
    out : path
        New result folder.
    overwrite : bool
        Replace an existing result folder when the new one is complete.
    options : mapping, optional
        Options that replace those of the project file; see ``read_project``.
    callback : callable, optional
        Function that receives an ``IterationRecord`` after each iteration.
    command : sequence of str
        The command line, for the record.
    execution : mapping, optional
        ``parts``, ``workers``, ``cluster``, ``work_dir`` of :func:`fg_orient.adjust`.
    stage : callable, optional
        Function that is called at the start of each stage with its name and the number of image points (0 before they
        are read).
    checkpoint_every_s : float
        Seconds between two checkpoints, written to a hidden file next to the result folder; 0: each iteration.
    resume : bool
        Continue from the checkpoint of an interrupted run if it exists.
    dem_control : (HeightSurface, float), optional
        Elevation model for height observations of the tie points, and their sigma (m); without checkpoint.
    start : path, optional
        Folder of an earlier result; ``start_prior``: use its covariance as a prior. See :func:`fg_orient.adjust`.
    check : callable, optional
        Function that receives the block before the adjustment; it raises InputError to reject it.

    Returns
    -------
    dict
        Record of the command ``adjust``. With status ``rank_deficient`` the folder contains the record, the approximate
        values of the points and a report of the unobservable directions.

    Raises
    ------
    InputError
        The project or the output folder is unusable, or the package that writes the tables is missing.
    """
    begin = time.perf_counter()
    require_free(Path(out), overwrite=overwrite)
    report_stage = stage or (lambda name, count: None)
    checkpoint = Checkpoint(checkpoint_path(out), every_s=checkpoint_every_s, resume=resume)
    report_stage("reading", 0)
    prepared, mark = preparing_seconds(), working_clock()
    block = read_project(project, **dict(options or {}))
    require_possible_options(block, project, options or {})
    require_writer(Path(out) / f"points.{block.options.tables}")
    if check is not None:
        check(block)
    return_memory(len(block.observations))
    read_s = working_clock() - mark
    folder, name = Path(project).parent, Path(out).name
    earlier = None if start is None else (Path(start), start_prior)
    repeat = how_to_repeat(folder, options or {}, execution or {}, dem_control, earlier)
    try:
        with staged_folder(out, overwrite=overwrite) as staging:
            how = {
                **(execution or {}),
                "callback": callback,
                "stage": stage,
                "checkpoint": checkpoint,
                "start": start,
                "start_prior": start_prior,
            }
            solution, control = _adjust(block, how, dem_control)
            mark = working_clock()
            result = result_of(solution, corrected_models(solution), folder=folder, out=name, command=command)
            result.record.update(plain(control))
            result.record["provenance"]["repeat"] = plain(repeat)
            seconds = asdict(solution.seconds) | {"read": read_s, "jit": preparing_seconds() - prepared}
            del solution
            return_memory(len(block.observations))
            seconds["record"] = working_clock() - mark
            report_stage("writing", len(block.observations))
            with writing(out):
                result.record.update(rasters_of(result, block.images, staging) | ground_system(block, staging))
                _write(staging, result, seconds, begin)
    except RankDeficientError as error:
        seconds = {"read": read_s, "total": time.perf_counter() - begin}
        if not isinstance(error.evidence, Evidence):
            return {**deficient_summary(error, block), "seconds": seconds}
        result = deficient_result(error, error.evidence.problem, folder, name, command)
        result.record["provenance"]["repeat"] = plain(repeat)
        result.record["seconds"] = seconds
        with staged_folder(out, overwrite=overwrite) as staging, writing(out):
            result.write(staging)
            write_page(staging, result)
            write_manifest(staging, result.record)
    except NoSolutionError as error:
        if not any(p.code.startswith("parallel.") for p in error.problems):
            checkpoint.remove()
            raise
        done = checkpoint.write()  # keep the checkpoint, because the workers failed and not the equations
        if done is None:
            raise
        kept = f"{done} iterations are kept"
        raise type(error)(*(replace(p, value=f"{p.value}; {kept}") for p in error.problems)) from error
    else:
        checkpoint.remove()
    return {**result.record, "out": str(out)}


def require_possible_options(block: Block, project: str | Path, given: Mapping[str, object]) -> None:
    """Raise InputError for options that exclude each other; for options not in ``given`` it names the file."""
    try:
        require_possible(block.options)
    except InputError as error:
        typed = {name for name, value in given.items() if value is not None}
        problems = [
            p if p.option in typed else replace(p, file=str(project), option="", place=f"adjustment.{p.option}")
            for p in error.problems
        ]
        raise InputError(*problems) from None


def checkpoint_path(out: str | Path) -> Path:
    """Return the checkpoint file of a run with this result folder."""
    target = Path(out).absolute()
    return target.with_name(f".{target.name[:200]}.checkpoint.npz")


def _adjust(
    block: Block, how: dict[str, Any], dem_control: tuple[HeightSurface, float] | None
) -> tuple[Solution, dict[str, Any]]:
    """Adjust the block; return the solution, and further entries of the record for heights of a DEM."""
    if dem_control is None:
        return adjust(block, **how), {}
    from fg_orient.orientation.dem_control import adjust_with_dem

    controlled = adjust_with_dem(block, *dem_control, **{**how, "checkpoint": None})
    return controlled.solution, {"dem_control": controlled.as_dict()}


def _write(folder: Path, result: Result, seconds: dict[str, float], start: float) -> None:
    """Write all files of a result and its page; the record contains the times of all phases."""
    mark = time.perf_counter()
    result.write(folder)
    result.record["seconds"] = seconds | {"write": time.perf_counter() - mark, "total": time.perf_counter() - start}
    mark = time.perf_counter()
    write_page(folder, result)
    result.record["seconds"] |= {"report": time.perf_counter() - mark, "total": time.perf_counter() - start}
    write_record(folder, result.record)
    write_manifest(folder, result.record)
