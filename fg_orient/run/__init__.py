"""Runs: a project in, a result folder out, with its provenance.

The folder is filled under a hidden name and renamed at the end, so that a run that fails
or is interrupted leaves nothing behind.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from factors._preparation import preparing_seconds, working_clock
from fg_orient.adjustment.checkpoint import EVERY_S, Checkpoint
from fg_orient.adjustment.solve import require_possible
from fg_orient.formats.folder import RESULT, require_free, staged_folder, writing
from fg_orient.formats.project import read_project
from fg_orient.model.errors import InputError, NoSolutionError, RankDeficientError
from fg_orient.orientation.orient import Stage, adjust
from fg_orient.quality.deficiency import Evidence
from fg_orient.run.deficient import spectra, write_deficient
from fg_orient.run.json import dumps, plain
from fg_orient.run.provenance import how_to_repeat, provenance
from fg_orient.run.rpc import corrected_models, fitted_notes, write_corrected_rpc
from fg_orient.run.summary import deficient_summary, summary
from fg_orient.run.tables import write_tables

if TYPE_CHECKING:
    from fg_orient.adjustment.loop import Callback, IterationRecord
    from fg_orient.adjustment.problem import Problem
    from fg_orient.model.block import Block
    from fg_orient.orientation.solution import Solution
    from fg_orient.rpc.corrected import Corrected
    from fg_orient.sensors.correction import HeightSurface

SCHEMA_VERSION: Final = 1
#: The file by which a result folder is known.
RESULT_FILE: Final = RESULT.mark


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
    dem_vertical_crs: str = "",
    check: Callable[[Block], None] | None = None,
) -> dict[str, Any]:
    """Read a project, adjust it and write the result folder.

    Parameters
    ----------
    project : path
        The TOML file.
    out : path
        Result folder to come.
    overwrite : bool
        Replace an existing result folder, once the new one is complete.
    options : mapping, optional
        Options that replace those of the project file; see ``read_project``.
    callback : callable, optional
        Called with an ``IterationRecord`` after each iteration.
    command : sequence of str
        The command line, for the record.
    execution : mapping, optional
        ``parts``, ``workers``, ``cluster``, ``work_dir`` of :func:`fg_orient.adjust`.
    stage : callable, optional
        Called with the name of each stage as it begins, and the number of image points (0 before they are read).
    checkpoint_every_s : float
        Seconds between two writings of the checkpoint, a hidden file beside the result folder; 0: each iteration.
    resume : bool
        Go on from the checkpoint of a run that was stopped, if there is one.
    dem_control : (HeightSurface, float), optional
        Elevation model from which heights of the tie points are observed, and their sigma (m); without checkpoint.
    dem_vertical_crs : str
        What the caller said its heights refer to, for the record.
    check : callable, optional
        Called with the block before it is adjusted; refuses it by an ``InputError``.

    Returns
    -------
    dict
        The record of the command ``adjust``. With status ``rank_deficient`` the folder holds the record, the start
        values of the points and a report of what is not determined.

    Raises
    ------
    InputError
        The project or the output folder is unusable.
    """
    start = time.perf_counter()
    require_free(Path(out), overwrite=overwrite)
    tell, checkpoint = (
        stage or (lambda name, count: None),
        Checkpoint(checkpoint_path(out), every_s=checkpoint_every_s, resume=resume),
    )
    tell("reading", 0)
    prepared, mark = preparing_seconds(), working_clock()
    block = read_project(project, **dict(options or {}))
    require_possible_options(block, project, options or {})
    if check is not None:
        check(block)
    read_s = working_clock() - mark
    try:
        with staged_folder(out, overwrite=overwrite) as folder:
            how = {**(execution or {}), "stage": stage, "checkpoint": checkpoint}
            solution, control = _adjust_and_log(block, folder, callback, Path(out), how, dem_control)
            mark = working_clock()
            models = corrected_models(solution)
            record = {**_record(solution, models, Path(project), Path(out), command), **control}
            record["provenance"]["repeat"] = how_to_repeat(
                Path(project).parent, options or {}, execution or {}, dem_control, dem_vertical_crs
            )
            phases = asdict(solution.seconds) | {"read": read_s, "jit": preparing_seconds() - prepared}
            phases["record"] = working_clock() - mark
            tell("writing", len(block.observations))
            with writing(out):
                _write(folder, solution, models, record, phases, start)
    except RankDeficientError as error:
        record = deficient_summary(error, block)
        record["seconds"] = {"read": read_s, "total": time.perf_counter() - start}
        if not isinstance(error.evidence, Evidence):
            return record
        about = _about(error.evidence.problem, Path(project), Path(out), command)
        about["provenance"]["repeat"] = how_to_repeat(
            Path(project).parent, options or {}, execution or {}, dem_control, dem_vertical_crs
        )
        record = {"schema": SCHEMA_VERSION, "name": block.name, **record, **about, **spectra(error.evidence)}
        with staged_folder(out, overwrite=overwrite) as folder, writing(out):
            write_deficient(folder, error.evidence.problem, record)
        return {**record, "out": str(out)}
    except NoSolutionError as error:
        if any(p.code.startswith("parallel.") for p in error.problems):
            checkpoint.write()  # the workers failed, not the equations
        else:
            checkpoint.remove()
        raise
    checkpoint.remove()
    return {**record, "out": str(out)}


def require_possible_options(block: Block, project: str | Path, given: Mapping[str, object]) -> None:
    """Refuse options that do not go together; those of the project file, not among the ``given``, with its name.

    Raises
    ------
    InputError
    """
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
    """Checkpoint of a run that writes this result folder."""
    target = Path(out).absolute()
    return target.with_name(f".{target.name[:200]}.checkpoint.npz")


def _adjust_and_log(
    block: Block, folder: Path, callback: Callback | None, out: Path, how: dict[str, Any],
    dem_control: tuple[HeightSurface, float] | None,
) -> tuple[Solution, dict[str, Any]]:  # fmt: skip
    """Adjust; each iteration is on disk as soon as it is done, those of a backend that gave up are not kept.

    Returns the solution and what the DEM adds to the record.
    """
    with (folder / "iterations.jsonl").open("w", encoding="utf-8") as stream:

        def note(record: IterationRecord) -> None:
            with writing(out):
                if record.iteration == 1:
                    stream.seek(0)
                    stream.truncate()
                stream.write(dumps(asdict(record)) + "\n")
                stream.flush()
            if callback is not None:
                callback(record)

        if dem_control is None:
            return adjust(block, callback=note, **how), {}
        from fg_orient.orientation.dem_control import adjust_with_dem

        found = adjust_with_dem(block, *dem_control, callback=note, **{**how, "checkpoint": None})
        return found.solution, {"dem_control": found.as_dict()}


def _record(
    solution: Solution, models: dict[str, Corrected], project: Path, out: Path, command: Sequence[str]
) -> dict[str, Any]:
    """Everything of ``result.json`` but the times."""
    view, about = solution.block_view, _about(solution.problem, project, out, command)
    record: dict[str, Any] = plain(summary(solution))
    return {
        "schema": SCHEMA_VERSION,
        "name": solution.block.name,
        **record,
        "out": about["out"],
        "notes": [*about["notes"], *map(str, fitted_notes(models))],
        "images": about["images"],
        "observability": plain([o.as_dict() for o in solution.observability]),
        "block_observability": plain(None if view is None else view.as_dict()),
        "provenance": about["provenance"],
    }


def _about(problem: Problem, project: Path, out: Path, command: Sequence[str]) -> dict[str, Any]:
    """What a record says of the block that it was made from."""
    folder, block = project.parent, problem.block
    return {
        "out": out.name,
        "notes": [
            str(replace(note, file=note.file.removeprefix(f"{folder.absolute()}/").removeprefix(f"{folder}/")))
            for note in block.notes
        ],
        "images": [
            {"id": image.id, "file": Path(image.sensor.file).name, "n_lines": image.sensor.n_lines,
             "n_samples": image.sensor.n_samples, "notes": list(map(str, image.sensor.notes)),
             "footprint_lon_lat_deg": image.sensor.footprint().tolist(), **model.facts()}
            for image, model in zip(block.images, problem.models, strict=True)
        ],
        "provenance": provenance(block, folder, command),
    }  # fmt: skip


def _write(
    folder: Path, solution: Solution, models: dict[str, Corrected], record: dict[str, Any], phases: dict[str, float],
    start: float,
) -> None:  # fmt: skip
    """Write tables, report and, last, the record with the times of all phases."""
    mark = time.perf_counter()
    from fg_orient.report import write_report

    write_tables(folder, solution)
    write_corrected_rpc(folder / "rpc", models)
    phases["write"] = time.perf_counter() - mark
    record["seconds"] = {**phases, "total": time.perf_counter() - start}
    (folder / RESULT_FILE).write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
    mark = time.perf_counter()
    write_report(folder)
    record["seconds"] |= {"report": time.perf_counter() - mark, "total": time.perf_counter() - start}
    (folder / RESULT_FILE).write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
