"""Command ``compare``: dense against sparse, set by set, solver by solver, backend by backend."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome, require_project, table
from fg_orient.cli.options import flags, named_as_typed, with_options
from fg_orient.cli.output import emit, say, tell_findings
from fg_orient.cli.progress import progress_bar
from fg_orient.model.options import Options

#: Places of the library in the words of the command line.
_TYPED = {
    **flags(Options), "eop_set": "--eop-sets", "eop_sets": "--eop-sets", "cluster": "--scheduler",
    **{name: f"--{name}" for name in ("solvers", "backends", "types", "workers", "scheduler", "target")},
}  # fmt: skip


@with_options(Options, only=("look_polynomial",))
def compare(
    project: Annotated[Path, typer.Argument(metavar="PROJECT.toml", help="Project file.", show_default=False)],
    options: Mapping[str, Any],
    eop_sets: Annotated[
        str, typer.Option(metavar="SETS", help="EOP sets: 1-20, or numbers and names such as 5,13,PUA.")
    ] = "1-20",
    solvers: Annotated[
        str, typer.Option(metavar="NAMES", help="all, published, or names of solvers: qr,cholesky_inverse.")
    ] = "published",
    backends: Annotated[
        str, typer.Option(metavar="NAMES", help="Any of faithful (as published), dense, graph.")
    ] = "faithful,dense,graph",
    types: Annotated[
        str, typer.Option(metavar="1,2", help="Pre-adjustments as published: 1 look angles, 2 look angles and EOPs.")
    ] = "1,2",
    as_run: Annotated[
        bool, typer.Option("--as-run", help="The published procedure as the authors' program works.")
    ] = False,
    target: Annotated[
        float | None, typer.Option(metavar="M", help="RMSE to reach, m; default: the distance of the pixels.")
    ] = None,
    workers: Annotated[int, typer.Option(metavar="N", help="Processes that share the EOP sets.")] = 0,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a running dask cluster, instead of processes.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results; default: comparison, beside the project file.")
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Compare EOP sets, solvers and backends on a block: tables, figures and an HTML report.

    With workers, sets that are done are kept beside the folder until it is written: the same command goes on with them.
    Without matplotlib (extra "report") the tables come without figures.
    """
    options = {
        "eop_sets": eop_sets, "solvers": solvers, "backends": backends, "types": types, "as_run": as_run,
        "target_m": target, "workers": workers, "cluster": scheduler, **options,
    }  # fmt: skip
    with outcome(as_json, debug, quiet, log):
        require_project(project)
        from fg_orient.studies.comparison.folder import compare_project

        with named_as_typed(_TYPED), progress_bar("reading the project") as callback:
            record = compare_project(
                project, out or project.parent / "comparison", overwrite=overwrite, options=options,
                callback=callback, command=["fg-orient", *sys.argv[1:]],
            )  # fmt: skip
        if as_json:
            emit(record)
        else:
            show(record)


def show(record: dict[str, Any]) -> None:
    """Print warnings, the verdict, one line per solver and where the result lies."""
    tell_findings(record, as_result=True)
    say(record["verdict"]["title"])
    for text in record["verdict"]["text"]:
        say(f"- {text}")
    rows = []
    for line in record["summary"]:
        name = f"published {line['type']}" if line["backend"] == "faithful" else line["backend"]
        reached = f"{line['reached']}/{line['tried']}" if line["tried"] else "not tried"
        rows.append((name, line["label"], reached, _metres(line["worst_control_m"]), _metres(line["worst_check_m"])))
    say()
    title = f"EOP sets at the target of {record['target_m']:.3g} m"
    table(title, ("backend", "solver", "sets", "control m", "check m"), rows, left=2)
    say("control, check: the worst set with a solution, worst ECEF axis")
    say(f"report: {Path(record['out']) / 'report.html'}")


def _metres(value: float | None) -> str:
    """Write a length that may be wild."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value < 1e4 else f"{value:.0e}"
