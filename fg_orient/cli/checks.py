"""Commands ``validate`` and ``doctor``: soundness of the input and of the installation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fg_orient.cli.common import Debug, Json, Log, Quiet, emit, fault, note, outcome, say, table
from fg_orient.errors import FgOrientError, InputError

if TYPE_CHECKING:
    from fg_orient.adjustment.memory import Need
    from fg_orient.block import Block
    from fg_orient.errors import Problem


def validate(
    project: Annotated[
        Path,
        typer.Argument(metavar="PROJECT.toml", help="Project file; or, with --format, points.", show_default=False),
    ],
    format_name: Annotated[
        str, typer.Option("--format", metavar="FORMAT", help="Check a file of points of another program instead.")
    ] = "",
    crs: Annotated[str, typer.Option(metavar="EPSG:N", help="Its CRS, where the file does not say it.")] = "",
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Check a project and all its files: errors (exit code 2) and remarks."""
    with outcome(as_json, debug, quiet, log):
        if format_name:
            _validate_points(project, format_name, crs, as_json)
            return
        from fg_orient.io.validate import checked_project, is_remark

        block, found = checked_project(project)
        impossible = [] if block is None else _impossible(block, project)
        found += impossible
        need = None if block is None or impossible else _memory(block)
        if block is not None and need is not None and not need.fits:
            found.append(need.problem(str(project)))
        errors = [p for p in found if not is_remark(p)]
        remarks = [p for p in found if is_remark(p)]
        if as_json:
            emit({"errors": [p.as_dict() for p in errors], "remarks": [p.as_dict() for p in remarks],
                  "memory": None if need is None else need.as_dict()})  # fmt: skip
        for p in errors:
            fault(p)
        if not as_json:
            for p in remarks:
                say(f"remark: {p}")
            if need is not None:
                limit = "" if need.allowed is None else f" of {need.allowed / 1e9:.3g} GB allowed"
                say(f"memory: about {need.needed / 1e9:.2g} GB{limit}, backend {need.backend}")
            if not errors:
                say("no errors")
        if errors:
            raise typer.Exit(InputError.exit_code)


def _validate_points(path: Path, format_name: str, crs: str, as_json: bool) -> None:
    """Check points of another program; unverified formats are remarked."""
    from fg_orient.interchange.convert import read_survey
    from fg_orient.interchange.registry import Settings, format_named

    found = format_named(format_name, place="--format")
    survey, remarks = read_survey([path], found, Settings(crs), accept_unverified=True)
    if as_json:
        emit({"errors": [], "remarks": [p.as_dict() for p in remarks], "points": len(survey.ids), "crs": survey.crs})
        return
    for p in remarks:
        say(f"remark: {p}")
    say(f"{len(survey.ids)} points, {len(survey.observed)} image points, no errors")


def _impossible(block: Block, project: Path) -> list[Problem]:
    """Options that ``adjust`` would refuse."""
    from fg_orient.run import require_possible_options

    try:
        require_possible_options(block, project, {})
    except InputError as error:
        return list(error.problems)
    return []


def _memory(block: Block) -> Need:
    from fg_orient.adjustment.memory import need_of

    return need_of(block)


def doctor(quiet: Quiet = False, log: Log = None, as_json: Json = False, debug: Debug = False) -> None:
    """Show versions, look for traps of the installation and adjust a small block of its own.

    Exit code 1 if the installation is broken.
    """
    with outcome(as_json, debug, quiet, log):
        from fg_orient.doctor import examine

        found = examine()
        if as_json:
            emit(found)
        else:
            table("versions", ("name", "version"), [(k, v or "missing") for k, v in found["versions"].items()], left=2)
            checks = [(c["name"], "yes" if c["good"] else "NO", c["detail"]) for c in found["checks"]]
            table("checks", ("check", "good", "detail"), checks, left=3)
            for text in found["warnings"]:
                say(f"warning: {text}")
            for c in found["checks"]:
                if quiet and not c["good"]:
                    note(f"{c['name']}: {c['detail']}")
        if not found["good"]:
            raise typer.Exit(FgOrientError.exit_code)
