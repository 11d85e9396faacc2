"""Commands ``compare`` and ``reproduce``: dense against sparse, and published against reproduced values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fg_orient.cli.command import (
    Overwrite,
    Project,
    Scheduler,
    argument,
    command,
    command_line,
    option,
    require_project,
)
from fg_orient.cli.output import answer, say, table, tell_findings
from fg_orient.cli.progress import progress_bar
from fg_orient.model.names import ALL_SETS
from fg_orient.model.options import Options

if TYPE_CHECKING:
    from fg_orient.studies.reproduce.reproduction import Reproduction


@command(Options, only=("look_polynomial",), named={"eop_set": "--eop-sets", "cluster": "--scheduler"})
def compare(
    project: Project,
    options: Mapping[str, Any],
    eop_sets: Annotated[
        str, option(f"EOP sets: {ALL_SETS}, or numbers and names such as 5,13,PUA.", "SETS")
    ] = ALL_SETS,
    solvers: Annotated[str, option("all, published, or names of solvers: qr,cholesky_inverse.", "NAMES")] = "published",
    backends: Annotated[
        str, option("One or more of faithful (as published), dense, graph.", "NAMES")
    ] = "faithful,dense,graph",
    types: Annotated[
        str, option("Pre-adjustments as published: 1 look angles, 2 look angles and EOPs.", "1,2")
    ] = "1,2",
    as_run: Annotated[
        bool, option("Compute the published procedure as the authors' program does.", flag="--as-run")
    ] = False,
    target: Annotated[float | None, option("Target RMSE, m; default: the pixel size.", "M")] = None,
    workers: Annotated[int, option("Number of processes; they share the EOP sets.", "N")] = 0,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, option("Folder of the results; default: comparison, beside the project file.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compare EOP sets, solvers and backends on a block: tables, figures and an HTML report.

    With workers, finished sets are kept until the folder is written: the same command continues with them.
    Without matplotlib (extra "report") the tables come without figures.
    """
    options = {
        "eop_sets": eop_sets, "solvers": solvers, "backends": backends, "types": types, "as_run": as_run,
        "target_m": target, "workers": workers, "cluster": scheduler, **options,
    }  # fmt: skip
    require_project(project)
    from fg_orient.studies.comparison.folder import compare_project

    with progress_bar("reading the project") as callback:
        record = compare_project(
            project, out or project.parent / "comparison", overwrite=overwrite, options=options,
            callback=callback, command=command_line(),
        )  # fmt: skip
    answer(record, _show_comparison)


def _show_comparison(record: dict[str, Any]) -> None:
    """Print warnings, the assessment, one line per solver and the path of the report."""
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


@command()
def reproduce(
    source: Annotated[str, argument("SOURCE", "terlemezoglu2019, topan2010, ipbuker1994, ayhan1996.")],
    tables: Annotated[str, option("Tables and ranges, such as 4.3-4.9,4.28; default: all.", "TABLES")] = "",
    seeds: Annotated[int, option("Number of simulated twins, with the seeds 1 to N.", "N")] = 10,
    as_run: Annotated[
        bool,
        option("Compute as the authors' program does, on a twin with radial velocity and attitude.", flag="--as-run"),
    ] = False,
    claims: Annotated[bool, option("Also assess the claims about the publication.")] = True,
    published: Annotated[Path | None, option("Folder of published tables (CSV) to use instead.", "DIR")] = None,
    data: Annotated[Path | None, option("Control points of SPOT-6 (tables 4.35-4.55).", "FILE_OR_FOLDER")] = None,
    permutations: Annotated[int, option("Number of random orders of these points, with the seeds 1 to N.", "N")] = 50,
    out: Annotated[Path | None, option("Folder of the results; default: reproduced-SOURCE.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Run a published study again on the synthetic twin and compare, table by table."""
    from fg_orient.studies.reproduce.folder import reproduce_to

    with progress_bar("tables") as callback:
        found, record = reproduce_to(
            source, out, overwrite=overwrite, callback=callback, command=command_line(), tables=tables,
            n_seeds=seeds, as_run=as_run, claims=claims, published=published, data=data, permutations=permutations,
        )  # fmt: skip
    answer(record, _show_reproduction, found, Path(record["out"]))


def _show_reproduction(found: Reproduction, out: Path) -> None:
    """Print the assessments by table, the claims and the path of the report."""
    from fg_orient.studies.reproduce.folder import verdict

    words = verdict(found)
    say(words["title"])
    say(words["text"])
    say()
    rows: list[tuple[object, ...]] = []
    for name in found.titles:
        true, null = found.counts(name), found.shuffled(name)
        rows.append(_verdict_row(name, true, sum(true.values()), f"{found.gained(name):.1f}"))
        if any(null.values()):
            rows.append(_verdict_row("  shuffled", {kind: round(n, 1) for kind, n in null.items()}, "", ""))
    heads = ("table", "cells", "equal", "rounding", "differs", "gained", "others")
    table("cells by verdict", heads, rows, left=7)
    say("shuffled: printed values exchanged among cells of the same role")
    say("gained: cells that agree beyond what shuffled values give")
    judged = [
        (c.id, f"{c.passed}/{c.of}", f"{c.interval[0]:.2f}-{c.interval[1]:.2f}", "met" if c.met else "not met",
         c.reason or c.text)
        for c in found.claims
    ]  # fmt: skip
    if judged:
        table("claims", ("id", "seeds", "95 %", "", "claim"), judged, left=5)
    say(f"report: {out / 'report.html'}")


def _verdict_row(name: str, counts: Mapping[str, float], cells: object, gained: str) -> tuple[object, ...]:
    """Row of a table of verdicts; the weaker verdicts are named in the last column."""
    first, words = ("equal", "rounding", "differs"), {"not_reproducible": "not repr."}
    others = ", ".join(f"{n} {words.get(kind, kind)}" for kind, n in counts.items() if n and kind not in first)
    return name, cells, *(counts[kind] or "" for kind in first), gained, others
