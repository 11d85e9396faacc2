"""Commands ``compare`` and ``reproduce``: compare engines and EOP sets.

Compare published and computed values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fg_orient.cli.command import (
    Overwrite,
    Scheduler,
    argument,
    command,
    command_line,
    option,
    require_project,
)
from fg_orient.cli.output import answer, say, table, tell_findings, warn_of_scheduler
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError
from fg_orient.model.names import ALL_SETS, TIME_LIMIT_S
from fg_orient.model.options import Options

#: Maximum number of printed sets, and of printed engines of each kind.
SHOWN: Final = 6
FASTEST: Final = 1
#: Short words for the status of a solution.
STATUS: Final = {"converged": "good", "not_trustworthy": "doubtful", "not_converged": "failed"}
#: Columns that together identify an engine.
KEY: Final = ("backend", "type", "solver", "optimizer", "regularisation")

if TYPE_CHECKING:
    from fg_orient.studies.reproduce.reproduction import Reproduction


@command(
    Options, only=("look_polynomial", "memory_limit_gb", "priors"),
    named={"eop_set": "--eop-sets", "cluster": "--scheduler", "time_limit_s": "--time-limit"},
)  # fmt: skip
def compare(
    options: Mapping[str, Any],
    project: Annotated[Path | None, argument("[PROJECT.toml]", "Project file; none with --scale.")] = None,
    eop_sets: Annotated[
        str, option(f"EOP sets: {ALL_SETS}, or numbers and names such as 5,13,PUA.", "SETS")
    ] = ALL_SETS,
    solvers: Annotated[str, option("all, published, or names of solvers: qr,cholesky_inverse.", "NAMES")] = "published",
    backends: Annotated[
        str, option("One or more of faithful (as published), dense, schur, explicit, graph.", "NAMES")
    ] = "faithful,dense,schur,explicit,graph",
    types: Annotated[
        str, option("Pre-adjustments as published: 1 look angles, 2 look angles and EOPs.", "1,2")
    ] = "1,2",
    regularisations: Annotated[
        str,
        option(
            "none, METHOD, METHOD:RULE or METHOD:KAPPA, or all: none,tikhonov:gcv; default: the project's.", "NAMES"
        ),
    ] = "",
    as_run: Annotated[
        bool, option("Compute the published procedure as the authors' program does.", flag="--as-run")
    ] = False,
    target: Annotated[float | None, option("Target RMSE, m; default: the predicted accuracy.", "M")] = None,
    time_limit: Annotated[float, option("Largest estimated processor time of an adjustment, s.", "S")] = TIME_LIMIT_S,
    scale: Annotated[
        bool, option("Cost against size: synthetic blocks of 10 to 1e6 image points, no project.", flag="--scale")
    ] = False,
    sizes: Annotated[str, option("With --scale: numbers of image points, such as 10,1e3,1e5.", "NUMBERS")] = "",
    workers: Annotated[int, option("Number of processes; they share the EOP sets or sizes.", "N")] = 0,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, option("Folder of the results; default: comparison, beside the project file.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compare EOP sets and engines on a block: recommendation, tables, figures and an HTML report.

    With workers, finished sets are kept until the folder is written. If the command is interrupted, the
    same command continues with them. Without matplotlib (extra "report"), no figures are written.
    """
    if scale:
        given = {"eop_sets": eop_sets != ALL_SETS, "solvers": solvers != "published", "types": types != "1,2",
                 "target": target is not None, "as_run": as_run, "project": project is not None,
                 "regularisations": bool(regularisations),
                 **{name: name in options for name in ("look_polynomial", "priors")}}  # fmt: skip
        if useless := [name for name, is_given in given.items() if is_given]:
            given_at = {"place": "PROJECT.toml"} if useless[0] == "project" else {"option": useless[0]}
            raise InputError.of("compare.with_scale", **given_at)
        _scale(sizes, out or Path("scale"), overwrite, {
            "time_limit_s": time_limit, "workers": workers, "cluster": scheduler, **options,
        })  # fmt: skip
        return
    if project is None or sizes:
        raise InputError.of("compare.no_project", place="PROJECT.toml" if project is None else "sizes")
    options = {
        "eop_sets": eop_sets, "solvers": solvers, "backends": backends, "types": types,
        "regularisations": regularisations or None, "as_run": as_run,
        "target_m": target, "time_limit_s": time_limit, "workers": workers, "cluster": scheduler, **options,
    }  # fmt: skip
    require_project(project)
    warn_of_scheduler(scheduler)
    from fg_orient.studies.comparison.folder import compare_project

    with progress_bar("reading the project") as callback:
        record = compare_project(
            project, out or project.parent / "comparison", overwrite=overwrite, options=options,
            callback=callback, command=command_line(),
        )  # fmt: skip
    answer(record, _show_comparison)


def _show_comparison(record: dict[str, Any]) -> None:
    """Print warnings, the recommendation, the best sets, and the engines of the recommended set."""
    tell_findings(record, as_result=True)
    say(record["verdict"]["title"])
    for text in record["verdict"]["text"]:
        say(f"- {text}")
    chosen = (record["advice"] or {}).get("eop_set")
    if chosen is None:
        of_engines = ("engine", "sets", "control m", "check m")
        _show_table(f"sets at the target of {record['target_m']:.3g} m", of_engines, _published_rows(record))
    else:
        own = chosen, record["advice"]["regularisation"]
        sets = sorted(record["sets"], key=lambda s: (
            (s["eop_set"], s["regularisation"]) != own, s["check_rmse_3d_m"] or math.inf
        ))  # fmt: skip
        heads = ("set", "unknowns", "check m", "ratio", "sigma0", "AICc", "BIC", "status")
        shown = [_set_row(one) for one in sets[:SHOWN]]
        _show_table(f"EOP sets, the recommended one first: {len(shown)} of {len(sets)}", heads, shown)
        say("check: 3-D RMSE at check points; ratio: their errors divided by the predicted errors")
        if any(s["regularisation"] != "none" for s in record["sets"]):
            say("regularised estimates are biased: they have no ratio and no AICc")
        measures = ("engine", "processor s", "memory MB", "forward error", "differs m")
        _show_table(
            f"engines with set {_set_name(*own)}, the fastest of each kind", measures, _engine_rows(record, *own)
        )
    say(f"report: {Path(record['out']) / 'report.html'}")


def _scale(sizes: str, out: Path, overwrite: bool, options: dict[str, Any]) -> None:
    """Run the study of block sizes and print its result."""
    from fg_orient.studies.comparison.scale_folder import scale_to

    chosen = {"sizes": sizes} if sizes else {}
    with progress_bar("sizes") as callback:
        record = scale_to(
            out, overwrite=overwrite, options=chosen | options, callback=callback, command=command_line()
        )  # fmt: skip
    answer(record, _show_scale)


def _show_scale(record: dict[str, Any]) -> None:
    """Print the crossing points, the exponents and the path of the page."""
    rows: list[tuple[object, ...]] = []
    by_engine: dict[str, dict[str, str]] = {}
    for one in record["exponents"]:
        text = f"{one['exponent']:.2f} +- {one['half_interval']:.2f}"
        by_engine.setdefault(one["engine"], {})[one["quantity"]] = text
    crossing = {c["engine"]: c for c in record["crossings"] if c["quantity"] == "processor_s"}
    for row in {r["engine"]: r for r in record["rows"]}.values():
        engine, own = row["engine"], by_engine.get(row["engine"], {})
        place = crossing.get(engine)
        below = "" if place is None else _number(place["image_points"]) if place["image_points"] else place["always"]
        solved = [r["image_points"] for r in record["rows"] if r["engine"] == engine and not r["failure"]]
        rows.append((engine, max(solved, default="-"), own.get("processor_s", "-"), own.get("peak_bytes", "-"), below))
    _show_table("engines", ("engine", "largest", "exponent time", "memory", "crossing"), rows)
    say("largest, crossing: image points; above the crossing the engine takes less time than full matrices")
    say(f"page: {Path(record['out']) / 'scale.md'}")


def _show_table(title: str, heads: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    """Print a table after an empty line, if it has rows."""
    if rows:
        say()
        table(title, heads, rows, left=1)


def _set_row(one: dict[str, Any]) -> tuple[object, ...]:
    numbers = (_number(one[name]) for name in ("prediction_factor", "sigma0", "aicc", "bic"))
    status = "no solution" if one["failure"] else STATUS.get(one["status"], one["status"])
    name = _set_name(f"{one['eop_set']} {one['name']}", one["regularisation"])
    return name, one["image_unknowns"], _metres(one["check_rmse_3d_m"]), *numbers, status


def _set_name(name: object, regularisation: str) -> str:
    """Return the name of a set with its regularisation."""
    return f"{name}" if regularisation == "none" else f"{name} {regularisation}"


def _engine_rows(record: dict[str, Any], eop_set: int, regularisation: str) -> list[tuple[object, ...]]:
    """Return rows with the fastest engines of each backend for a set.

    A backend without a solution has one row.
    """
    names = {tuple(s[k] for k in KEY): s["name"] for s in record["summary"]}
    own = [r for r in record["rows"] if (r["eop_set"], r["regularisation"]) == (eop_set, regularisation)]
    out: list[tuple[object, ...]] = []
    for backend in dict.fromkeys(r["backend"] for r in reversed(own)):
        of_backend = [r for r in own if r["backend"] == backend]
        solved = sorted((r for r in of_backend if not r["failure"]), key=lambda r: r["processor_s"])
        for r in solved[:FASTEST] or of_backend[:1]:
            name = names[tuple(r[k] for k in KEY)]
            if r["failure"]:
                out.append((name, "not tried" if r["left_out"] else "failed", "", "", ""))
                continue
            memory = None if r["peak_bytes"] is None else r["peak_bytes"] / 1e6
            errors = ("-" if r[k] is None else f"{r[k]:.0e}" for k in ("forward_error", "difference_m"))
            out.append((name, _number(r["processor_s"]), _number(memory), *errors))
    return out


def _published_rows(record: dict[str, Any]) -> list[tuple[object, ...]]:
    """Return rows with the sets that reach the target, for each engine."""
    return [
        (line["name"], f"{line['reached']}/{line['tried']}" if line["tried"] else "not tried",
         _metres(line["worst_control_m"]), _metres(line["worst_check_m"]))
        for line in record["summary"]
    ]  # fmt: skip


def _number(value: float | None) -> str:
    """Format a number with three digits; a missing number is a dash."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"


def _metres(value: float | None) -> str:
    """Format a length that may be extremely large."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value < 1e4 else f"{value:.0e}"


@command()
def reproduce(
    source: Annotated[str, argument("SOURCE", "terlemezoglu2019, topan2010, ipbuker1994, ayhan1996.")],
    tables: Annotated[str, option("Tables and ranges, such as 4.3-4.9,4.28; default: all.", "TABLES")] = "",
    seeds: Annotated[int, option("Number of simulated blocks, with the seeds 1 to N.", "N")] = 10,
    as_run: Annotated[
        bool,
        option("Compute as the authors' program does, on blocks with radial velocity and attitude.", flag="--as-run"),
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
    """Print the assessments of each table, the claims and the path of the report."""
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
    say("gained: agreeing cells minus those that agree with shuffled values")
    judged = [
        (c.id, f"{c.passed}/{c.of}", f"{c.interval[0]:.2f}-{c.interval[1]:.2f}", "met" if c.met else "not met",
         c.reason or c.text)
        for c in found.claims
    ]  # fmt: skip
    if judged:
        table("claims", ("id", "seeds", "95 %", "", "claim"), judged, left=5)
    say(f"report: {out / 'report.html'}")


def _verdict_row(name: str, counts: Mapping[str, float], cells: object, gained: str) -> tuple[object, ...]:
    """Return a row of the table of assessments; its last column names the weaker assessments."""
    first, words = ("equal", "rounding", "differs"), {"not_reproducible": "not repr."}
    others = ", ".join(f"{n} {words.get(kind, kind)}" for kind, n in counts.items() if n and kind not in first)
    return name, cells, *(counts[kind] or "" for kind in first), gained, others
