"""Command ``adjust``: the main job, with progress for people and one JSON object for programs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fg_orient.cli.common import (
    Debug,
    Json,
    Log,
    Overwrite,
    Quiet,
    VerticalCrs,
    number,
    outcome,
    read_dem,
    require_project,
    table,
)
from fg_orient.cli.options import flags, named_as_typed, with_options
from fg_orient.cli.output import emit, folded, note, say, tell, tell_findings
from fg_orient.cli.progress import progress
from fg_orient.model.errors import InputError, read
from fg_orient.model.names import EXIT_CODE, Status
from fg_orient.model.options import Options, Reading

#: Modules loaded before the clock starts: ``seconds`` measure the work, not Python's imports.
WORKING = ("fg_orient.run", "fg_orient.adjustment.schur", "fg_orient.report", "fg_orient.formats.schema",
           "fg_orient.formats.dimap", "fg_orient.sensors.projection", "jinja2")  # fmt: skip
#: The same, of one backend.
OF_BACKEND = {
    "graph": ("gtsam", "fg_orient.adjustment.graph", "fg_orient.quality.covariance"),
    "dense": ("fg_orient.adjustment.dense", "fg_orient.quality.covariance"),
}


@with_options(Options, Reading)
def adjust(
    project: Annotated[Path, typer.Argument(metavar="PROJECT.toml", help="Project file.", show_default=False)],
    options: Mapping[str, Any],
    parts: Annotated[int | None, typer.Option(metavar="N", help="Adjust in so many parts; default: by size.")] = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", help="Processes that work on the parts; the result is the same for any.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a running dask cluster, instead of processes.")
    ] = None,
    work_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the parts, seen by all workers of the cluster.")
    ] = None,
    dem_control: Annotated[
        Path | None, typer.Option(metavar="DEM", help="Observe heights of the tie points from this elevation model.")
    ] = None,
    dem_sigma: Annotated[
        float | None, typer.Option(metavar="METRES", help="Standard deviation of a height from --dem-control.")
    ] = None,
    dem_vertical_crs: VerticalCrs = "",
    out: Annotated[
        Path | None, typer.Option("--out", help="Result folder; default: result, beside the project file.")
    ] = None,
    overwrite: Overwrite = False,
    checkpoint_every: Annotated[
        float, typer.Option(metavar="SECONDS", help="Time between two checkpoints; 0: after each iteration.")
    ] = 60.0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the checkpoint of a run that was stopped.")
    ] = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Adjust a block: orientation, ground points, statistics, result folder and HTML report.

    Options replace those of the project file.
    """
    execution = {"parts": parts, "workers": workers, "cluster": scheduler, "work_dir": work_dir}
    with outcome(as_json, debug, quiet, log):
        require_project(project)
        load(options.get("backend"))
        from fg_orient.run import checkpoint_path, run_project

        target = out or project.parent / "result"
        if resume and not checkpoint_path(target).exists():
            note(f"no checkpoint {checkpoint_path(target).name} to resume: starting from the beginning")
        others = ("parts", "workers", "work_dir", "scheduler", "checkpoint_every")
        typed = flags(Options, Reading) | {name: f"--{name.replace('_', '-')}" for name in others}
        with named_as_typed(typed), progress() as watch:
            record = run_project(
                project, target, overwrite=overwrite, options=options, callback=watch.iteration,
                command=["fg-orient", *sys.argv[1:]], execution=execution, stage=watch.stage,
                checkpoint_every_s=checkpoint_every, resume=resume,
                dem_control=_dem_control(dem_control, dem_sigma, dem_vertical_crs),
                dem_vertical_crs=dem_vertical_crs,
            )  # fmt: skip
        for found in folded([read(one) for one in record.get("errors", [])]):
            tell("error", found)
        if as_json:
            emit(record)
        elif record["status"] == Status.RANK_DEFICIENT:
            if record["out"]:
                say(f"report of what is not determined: {Path(record['out']) / 'report.html'}")
        else:
            show(record)
        if quiet and not as_json and record["status"] != Status.CONVERGED:
            note(f"{record['status'].replace('_', ' ')}: {record['reason']}")
        raise typer.Exit(EXIT_CODE[Status(record["status"])])


def _dem_control(path: Path | None, sigma_m: float | None, vertical_crs: str) -> tuple[Any, float] | None:
    """Elevation model and sigma of its heights, if one is given."""
    if path is None and sigma_m is None:
        return None
    if path is None or sigma_m is None:
        raise InputError.of("dem_control.both", option="dem_control, dem_sigma")
    surface = read_dem(path, vertical_crs)
    return surface, sigma_m


def load(backend: str | None = None) -> None:
    """Load what an adjustment needs, before the clock starts; of the backends only the one that was asked for."""
    from importlib import import_module

    for name in (*WORKING, *OF_BACKEND.get(backend or "", ())):
        import_module(name)


def show(record: dict[str, Any]) -> None:
    """Print warnings, verdict, accuracy and where the result lies."""
    tell_findings(record, as_result=True)
    from fg_orient.report.words import orientation_words

    low, high = record["sigma0_interval_99_9"]
    say(f"{record['status'].replace('_', ' ')} after {record['iterations']} iterations: {record['n_image_points']} "
        f"image points, {record['n_unknowns']} unknowns, redundancy {record['redundancy']}")  # fmt: skip
    tested = f"99.9 % interval {number(low)} .. {number(high)}" if low is not None else "not tested"
    say(f"sigma0 {number(record['sigma0'])} ({tested}), "
        f"{orientation_words(record)}")  # fmt: skip
    for text in record["unobservable"]:
        say(f"not observable: {text}")
    rows = []
    for role in ("control", "check"):
        found = record["accuracy"][role]
        for name, key in (("RMSE", "rmse"), ("mean", "mean"), ("maximum", "max")):
            if found["n"]:
                rows.append([f"{role} {name} ({found['n']})" if key == "rmse" else f"{role} {name}",
                             *(number(found[f"{key}_{axis}_m"]) for axis in ("east", "north", "up"))])  # fmt: skip
    table("", ("points, m", "East", "North", "Up"), rows)
    beyond = record["accuracy"]["check"]["beyond_3_sigma"]
    if beyond["by_chance"] and beyond["sentence"]:
        say(beyond["sentence"])
    components = record["variance_components"]
    if components is not None:
        table(f"sigmas estimated in {components['rounds']} adjustments", ("group", "redundancy", "times given", "sd"), [
            [c["group"], number(c["redundancy"], 1), number(c["factor"]), "held" if c["held"] else number(c["sd"])]
            for c in components["components"]
        ])  # fmt: skip
    if "y_parallax" in record:
        found = record["y_parallax"]
        say(f"y-parallax of {found['n']} tie points, RMS: {number(found['rms_before_px'])} px before, "
            f"{number(found['rms_after_px'])} px after")  # fmt: skip
    if "dem_control" in record:
        found = record["dem_control"]
        rest = "" if found["at_rest"] else f"; the points do not rest: {number(found['moved_m'])} m"
        say(f"heights of {found['n']} tie points from {Path(found['dem']).name}: RMS {number(found['rms_m'])} m "
            f"above it after {found['rounds']} adjustments, {len(found['outside'])} outside{rest}")  # fmt: skip
    say(f"report: {Path(record['out']) / 'report.html'}")
