"""Commands ``adjust``, ``reduce`` and ``graph``: adjust a project, reduce its unknowns, draw its factor graph."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fg_orient.cli.command import (
    Overwrite,
    Project,
    Scheduler,
    VerticalCrs,
    command,
    command_line,
    option,
    read_dem,
    require_project,
)
from fg_orient.cli.log import session
from fg_orient.cli.output import (
    answer,
    flag,
    folded,
    note,
    number,
    say,
    show_components,
    table,
    tell,
    tell_findings,
    warn_of_scheduler,
)
from fg_orient.cli.progress import progress, progress_bar
from fg_orient.model.errors import InputError, findings_of, read
from fg_orient.model.names import EXIT_CODE, Status
from fg_orient.model.options import Options, Reading

if TYPE_CHECKING:
    from fg_orient.orientation.reduction import Reduction

#: These modules are loaded before the time is measured. ``seconds`` then contains the work and not the imports.
WORKING = ("fg_orient.orientation.run", "fg_orient.adjustment.schur", "fg_orient.report", "fg_orient.formats.schema",
           "fg_orient.formats.metadata.dimap", "fg_orient.sensors.projection", "jinja2")  # fmt: skip
#: Names of the optimisers in printed sentences.
#: Further modules for each backend.
OF_BACKEND = {
    "graph": ("gtsam", "fg_orient.adjustment.explicit", "fg_orient.quality.covariance"),
    "dense": ("fg_orient.adjustment.dense", "fg_orient.quality.covariance"),
}


@command(Options, Reading, named={"cluster": "--scheduler", "start": "--from", "start_prior": "--from-prior"})
def adjust(
    project: Project,
    options: Mapping[str, Any],
    parts: Annotated[int | None, option("Number of parts; default: by the size of the block.", "N")] = None,
    workers: Annotated[
        int | None, option("Processes that work on the parts; the result does not depend on it.", "N")
    ] = None,
    scheduler: Scheduler = None,
    work_dir: Annotated[
        Path | None, option("Folder for the parts that all workers of the cluster can read.", "DIR")
    ] = None,
    dem_control: Annotated[
        Path | None, option("Observe heights of the tie points from this elevation model.", "DEM")
    ] = None,
    dem_sigma: Annotated[float | None, option("Standard deviation of a height from --dem-control.", "METRES")] = None,
    dem_vertical_crs: VerticalCrs = "",
    from_result: Annotated[
        Path | None, option("Start from the result folder of an earlier run.", "RESULT", flag="--from")
    ] = None,
    from_prior: Annotated[
        bool, option("Use the joint covariance of the result of --from as a prior.", flag="--from-prior")
    ] = False,
    out: Annotated[Path | None, option("Result folder; default: result, beside the project file.")] = None,
    overwrite: Overwrite = False,
    checkpoint_every: Annotated[
        float, option("Time between two checkpoints; 0: after each iteration.", "SECONDS")
    ] = 60.0,
    resume: Annotated[bool, option("Continue from the checkpoint of a run that was stopped.", flag="--resume")] = False,
) -> None:
    """Adjust a block: orientation, ground points, statistics, result folder and HTML report.

    Options replace those of the project file.
    """
    execution = {"parts": parts, "workers": workers, "cluster": scheduler, "work_dir": work_dir}
    require_project(project)
    warn_of_scheduler(scheduler)
    from fg_orient.formats.atomic import require_free
    from fg_orient.formats.project import require_files

    target = out or project.parent / "result"
    require_free(target, overwrite=overwrite)
    given = require_files(project, **options)
    load(options.get("backend"))
    from fg_orient.orientation.run import checkpoint_path, run_project

    if resume and not checkpoint_path(target).exists():
        note(f"no checkpoint {checkpoint_path(target).name} to resume: starting from the beginning")
    with progress() as watch:
        record = run_project(
            project, target, overwrite=overwrite, options=options, callback=watch.iteration,
            command=command_line(), execution=execution, stage=watch.stage,
            checkpoint_every_s=checkpoint_every, resume=resume,
            dem_control=_dem_control(dem_control, dem_sigma, dem_vertical_crs, given.memory_limit_gb),
            start=from_result, start_prior=from_prior,
        )  # fmt: skip
    for found in folded([read(one) for one in record.get("errors", [])]):
        tell("error", found)
    answer(record, show)
    raise typer.Exit(EXIT_CODE[Status(record["status"])])


def _dem_control(
    path: Path | None, sigma_m: float | None, vertical_crs: str, memory_limit_gb: float | None
) -> tuple[Any, float] | None:
    """Return the elevation model and the standard deviation of its heights, if it is given."""
    if path is None and sigma_m is None:
        return None
    if path is None or sigma_m is None:
        raise InputError.of("dem_control.both", option="dem_control, dem_sigma")
    surface = read_dem(path, vertical_crs, memory_limit_gb)
    return surface, sigma_m


def load(backend: str | None = None) -> None:
    """Load the modules of an adjustment and of its backend, before the time is measured."""
    from importlib import import_module

    for name in (*WORKING, *OF_BACKEND.get(backend or "", ())):
        import_module(name)


def show(record: dict[str, Any]) -> None:
    """Print the warnings, the assessment, the accuracy and the path of the report."""
    from fg_orient.report.words import orientation_words, regularised_words

    if session().quiet and record["status"] != Status.CONVERGED:
        note(f"{record['status'].replace('_', ' ')}{regularised_words(record)}: {_reason(record)}")
    if record["status"] == Status.RANK_DEFICIENT:
        if record["out"]:
            say(f"report of the undetermined unknowns: {Path(record['out']) / 'report.html'}")
        return
    tell_findings(record, as_result=True)
    low, high = record["sigma0_interval_99_9"]
    whose = f" of GTSAM's {record['optimizer'].title()}" if record["backend"] == "graph" else ""
    regularised = regularised_words(record)
    say(f"{record['status'].replace('_', ' ')} after {record['iterations']} iterations{whose}{regularised}")
    free = record["redundancy"]
    free = f"{free:.1f}" if isinstance(free, float) else free
    say(f"{record['n_image_points']} image points, {record['n_unknowns']} unknowns, redundancy {free}")
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
    if record["stated_sigmas"]:
        table("", ("standard deviations", "stated", "estimated / stated", "+-", "redundancy"), [
            [s["group"], "several" if s["stated"] is None else f"{number(s['stated'])} {s['unit']}",
             number(s["factor"], 2), number(s["factor_sd"], 2), number(s["redundancy"], 1)]
            for s in record["stated_sigmas"]
        ])  # fmt: skip
    show_components(record)
    if "y_parallax" in record:
        found = record["y_parallax"]
        say(f"y-parallax of {found['n']} tie points, RMS: {number(found['rms_before_px'])} px before, "
            f"{number(found['rms_after_px'])} px after")  # fmt: skip
    if "dem_control" in record:
        found = record["dem_control"]
        rest = "" if found["at_rest"] else f"; the points still move: {number(found['moved_m'])} m"
        say(f"heights of {found['n']} tie points from {Path(found['dem']).name}: RMS {number(found['rms_m'])} m "
            f"above it after {found['rounds']} adjustments, {len(found['outside'])} outside{rest}")  # fmt: skip
    say(f"report: {Path(record['out']) / 'report.html'}")
    if record["status"] != Status.CONVERGED:
        say(f"{record['status'].replace('_', ' ')}{regularised}: {_reason(record)}")


def _reason(record: dict[str, Any]) -> str:
    """Return the reason of the status, with flags instead of names of options."""
    same = (found.text(flag) for found in findings_of(record) if str(found) == record["reason"])
    return next(same, record["reason"])


@command(
    Options, only=("eop_set", "look_polynomial", "priors", "rpc_compensation"), named={"folds": "--cross-validation"}
)
def reduce(
    project: Project,
    options: Mapping[str, Any],
    direction: Annotated[
        Literal["backward", "forward"], option("Remove coefficients from all, or add them to the best small set.")
    ] = "backward",
    level: Annotated[float, option("Probability of a false choice in one step.", "P")] = 0.05,
    cross_validation: Annotated[
        str | None, option("Cross-validation: leave out control points one at a time or in K parts.", "loo|K")
    ] = None,
) -> None:
    """Reduce the unknowns of the images one at a time by F tests; with AIC, AICc, BIC and prediction errors."""
    folds = _folds(cross_validation)
    require_project(project)
    from fg_orient.formats.project import read_project
    from fg_orient.orientation.reduction import reduce_unknowns

    block = read_project(project, **options)
    with progress_bar("adjusting") as callback:
        reduction = reduce_unknowns(block, direction=direction, level=level, folds=folds, progress=callback)
    answer({"name": block.name, **reduction.as_dict()}, _show_reduction, reduction)


def _folds(text: str | None) -> int | None:
    """Convert the option to a number of parts; 0 means leave-one-out, None means no cross-validation."""
    if text is None or text == "loo":
        return None if text is None else 0
    if text.isdecimal() and int(text) >= 2:
        return int(text)
    raise InputError.of("options.value", option="cross_validation", value=text, expected="loo or a number from 2")


def _show_reduction(found: Reduction) -> None:
    """Print a line for each model, the significant unknowns and the most similar EOP set."""
    first = found.steps[0]
    columns = ["step", "u", "p", "sigma0", "AIC", "AICc", "BIC"]
    columns += ["image px", "ground m"] if first.validation else []
    sign, first_words = ("-", "all") if found.direction == "backward" else ("+", "kept")
    rows = []
    for step in found.steps:
        c, v = step.criteria, step.validation
        row = [f"{sign} {step.changed}" if step.changed else first_words, len(step.unknowns),
               number(step.test.probability if step.test else None), number(c.sigma0), number(c.aic, 1),
               number(c.aicc, 1), number(c.bic, 1)]  # fmt: skip
        rows.append(row + ([number(v.image_rms), number(v.ground_rms)] if v else []))
    table(f"{found.direction} reduction at a level of {found.level:g} per step", columns, rows)
    for test in found.steps[-1].tests[::-1]:
        say(f"{test.group}: F = {test.statistic:.1f}, p = {test.probability:.2g}")
    names = ", ".join(f'"{name}"' for name in found.unknowns)
    say(f"significant: image_unknowns = [{names}]")
    closest = found.closest_set
    if closest is not None:
        from fg_orient.model.names import EOP_SETS

        number_, less, more = closest
        differences = [*(f"without {name}" for name in less), *(f"with {name}" for name in more)]
        say(
            f"closest EOP set: {number_} {EOP_SETS[number_].name}"
            + (f", {', '.join(differences)}" if differences else "")
        )
    for criterion, words in (("aic", "AIC"), ("aicc", "AICc"), ("bic", "BIC"), *(
        (("image", "prediction in the image"), ("ground", "prediction on the ground")) if first.validation else ()
    )):  # fmt: skip
        say(f"best by {words}: {', '.join(found.best(criterion).unknowns)}")


@command(Options, Reading)
def graph(
    project: Project,
    options: Mapping[str, Any],
    out: Annotated[Path | None, option("Folder of the output; default: graph, beside the project file.", "DIR")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw the factor graph of a project, its elimination tree and normal matrix; count variables, factors and fill.

    Nothing is adjusted. Of a large block only a part is drawn, but all factors are counted. Options
    replace those of the project file.
    """
    require_project(project)
    from fg_orient.formats.project import read_project
    from fg_orient.report.graph import write_graph

    target = out or project.parent / "graph"
    with progress_bar("reading the project") as callback:
        record = write_graph(read_project(project, **options), target, overwrite=overwrite, progress=callback)
    answer(record, _show_graph)


def _show_graph(record: dict[str, Any]) -> None:
    """Print the numbers of both graphs and of the elimination orders."""
    forms = [("explicit points", record["explicit"]), ("eliminated points", record["eliminated"])]
    rows = [(name, one["image_vectors"], one["points"], one["unknowns"], one["factors"]) for name, one in forms if one]
    table("factor graph", ("form", "image vectors", "points", "unknowns", "factors"), rows)
    part = "explicit points" if record["explicit_is_whole"] else "explicit points, the drawn part"
    orderings = [
        (name, one["nonzeros_normal_matrix"], one["fill"], one["cliques"], one["largest_clique_unknowns"])
        for name, one in record["orderings"].items()
    ]  # fmt: skip
    table(f"normal matrix, {part}", ("ordering", "elements", "fill", "cliques", "largest clique"), orderings)
    say(f"drawings: {record['out']} ({len(record['files'])} files)")
