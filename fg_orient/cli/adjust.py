"""Command ``adjust``: the main job, with progress for people and one JSON object for programs."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from fg_orient.cli.common import (
    Debug,
    Extrapolate,
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
from fg_orient.cli.output import emit, folded, note, say, tell, tell_findings
from fg_orient.cli.progress import progress
from fg_orient.errors import InputError, read
from fg_orient.names import EXIT_CODE, Status

#: Modules loaded before the clock starts: ``seconds`` measure the work, not Python's imports.
WORKING = ("fg_orient.run", "fg_orient.adjustment.schur", "fg_orient.report", "fg_orient.io.schema",
           "fg_orient.io.dimap", "fg_orient.sensors.projection", "jinja2")  # fmt: skip
#: The same, of one backend.
OF_BACKEND = {
    "graph": ("gtsam", "fg_orient.adjustment.graph", "fg_orient.quality.covariance"),
    "dense": ("fg_orient.adjustment.dense", "fg_orient.quality.covariance"),
}


def adjust(
    project: Annotated[Path, typer.Argument(metavar="PROJECT.toml", help="Project file.", show_default=False)],
    backend: Annotated[
        str | None, typer.Option(help="auto, graph, schur (on arrays) or dense (full matrices).")
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Linear solver of the dense backend, such as qr or cramer_inverse."),
    ] = None,
    eop_set: Annotated[str | None, typer.Option(metavar="N|NAME", help="EOP set, 1-20 or a name such as PUA.")] = None,
    look_polynomial: Annotated[
        int | None, typer.Option(metavar="DEGREE", help="Degree of the look-angle correction polynomial, 0-5.")
    ] = None,
    no_priors: Annotated[bool, typer.Option("--no-priors", help="Orientation unknowns without prior sigmas.")] = False,
    optimizer: Annotated[
        str | None, typer.Option(help="gauss-newton, levenberg-marquardt, dogleg or native (GTSAM's own).")
    ] = None,
    loss: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Robust loss, such as huber, hampel, tukey or tls; none: least squares."),
    ] = None,
    gnc: Annotated[
        bool, typer.Option("--gnc", help="Graduated non-convexity: reach the loss tls or geman_mcclure in stages.")
    ] = False,
    inlier_probability: Annotated[
        float | None, typer.Option(metavar="P", help="Of GNC: share of good observations within its limit; 0.99.")
    ] = None,
    robust_start: Annotated[
        str | None,
        typer.Option(
            metavar="huber|lms|lts|none", help="Start of a redescending loss; lms, lts: resections by control."
        ),
    ] = None,
    robust_scale: Annotated[
        str | None, typer.Option(metavar="prior|mad", help="Unit of a loss: the sigmas, or the scale of the residuals.")
    ] = None,
    variance_components: Annotated[
        bool,
        typer.Option(
            "--variance-components", help="Estimate the sigmas of image points, positions and heights with the block."
        ),
    ] = False,
    snoop: Annotated[
        bool, typer.Option("--snoop", help="Search for gross errors: leave out the worst observation, adjust, again.")
    ] = False,
    outlier_test: Annotated[
        str | None, typer.Option(metavar="t|pope|baarda", help="Test of single observations; baarda: sigmas a priori.")
    ] = None,
    outlier_level: Annotated[
        float | None,
        typer.Option(metavar="P", help="Probability of any false alarm (see --multiple-testing); 0.05."),
    ] = None,
    multiple_testing: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="sidak, bonferroni, holm, benjamini_hochberg, or none: the level of each test."
        ),
    ] = None,
    max_iterations: Annotated[int | None, typer.Option(help="Give up after so many iterations.")] = None,
    check_points: Annotated[
        str | None, typer.Option(metavar="use|exclude", help="Let the rays of check points take part, or not.")
    ] = None,
    rpc_compensation: Annotated[
        str | None, typer.Option(metavar="KIND", help="Of RPC images: shift, shift_drift or affine.")
    ] = None,
    datum: Annotated[
        str | None,
        typer.Option(metavar="control|priors|inner|free", help="All but control: relative, no control point needed."),
    ] = None,
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
    statistics: Annotated[
        str | None,
        typer.Option(metavar="auto|full|basic", help="Reliability of every observation; auto: up to 200 000 points."),
    ] = None,
    memory_limit_gb: Annotated[
        float | None,
        typer.Option(metavar="GB", help="Refuse a run that needs more memory; default: 80 % of what is available."),
    ] = None,
    extrapolate_attitude: Extrapolate = 0.0,
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
    options = {
        "backend": backend, "solver": solver, "eop_set": eop_set, "look_polynomial": look_polynomial,
        "priors": False if no_priors else None, "optimizer": optimizer, "max_iterations": max_iterations,
        "check_points": check_points, "rpc_compensation": rpc_compensation, "datum": datum,
        "memory_limit_gb": memory_limit_gb, "statistics": statistics,
        "loss": loss, "gnc": gnc or None, "inlier_probability": inlier_probability,
        "snoop": snoop or None, "outlier_test": outlier_test, "outlier_level": outlier_level,
        "multiple_testing": multiple_testing,
        "extrapolate_attitude_s": extrapolate_attitude or None,
        "robust_start": robust_start, "robust_scale": robust_scale,
        "variance_components": ("image", "position", "height") if variance_components else None,
    }  # fmt: skip
    execution = {"parts": parts, "workers": workers, "cluster": scheduler, "work_dir": work_dir}
    with outcome(as_json, debug, quiet, log):
        require_project(project)
        load(backend)
        from fg_orient.run import checkpoint_path, run_project

        target = out or project.parent / "result"
        if resume and not checkpoint_path(target).exists():
            note(f"no checkpoint {checkpoint_path(target).name} to resume: starting from the beginning")
        named = {**options, **execution, "scheduler": scheduler, "checkpoint_every": checkpoint_every}
        with _named_as_typed(named), progress() as watch:
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


@contextlib.contextmanager
def _named_as_typed(options: Mapping[str, object]) -> Iterator[None]:
    """Name a wrong option as it is written on the command line."""
    try:
        yield
    except InputError as error:
        names = {name for name, value in options.items() if value is not None}
        raise InputError(
            *(replace(p, place=f"--{p.place.replace('_', '-')}") if not p.file and p.place in names else p
              for p in error.problems)
        ) from None  # fmt: skip


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
