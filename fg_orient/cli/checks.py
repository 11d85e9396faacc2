"""Commands ``validate`` and ``doctor``: soundness of the input and of the installation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fg_orient.cli.common import Debug, Json, Log, Quiet, outcome, table
from fg_orient.cli.output import emit, fault, flag, note, say, tell, tell_findings
from fg_orient.model.errors import FgOrientError, Finding, InputError, Option

if TYPE_CHECKING:
    from fg_orient.adjustment.memory import Need
    from fg_orient.formats.exchange.registry import Format, Settings
    from fg_orient.model.block import Block


def validate(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="PROJECT.toml",
            help="Project file; or, with --format, one file of points or more.",
            show_default=False,
        ),
    ],
    format_name: Annotated[
        str, typer.Option("--format", metavar="FORMAT", help="Check files of points of another program instead.")
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
            _validate_points(sources, format_name, crs, as_json)
            return
        project = sources[0]
        if len(sources) > 1:
            raise InputError.of("cli.one_project", file=sources[1], place="PROJECT.toml", value=f"{len(sources)} files")
        from fg_orient.formats.validate import checked_project

        block, found = checked_project(project)
        impossible = [] if block is None else _impossible(block, project)
        found += impossible
        need = None if block is None or impossible else _memory(block)
        if block is not None and need is not None and not need.fits:
            found.append(need.problem(str(project)))
        errors = [p for p in found if p.severity == "failure"]
        remarks = [p for p in found if p.severity != "failure"]
        if as_json:
            emit({"errors": [p.as_dict(flag) for p in errors], "remarks": [p.as_dict(flag) for p in remarks],
                  "memory": None if need is None else need.as_dict()})  # fmt: skip
        for p in errors:
            fault(p)
        if not as_json:
            for p in remarks:
                tell("remark", p, as_result=True)
            if need is not None:
                limit = "" if need.allowed is None else f" of {need.allowed / 1e9:.3g} GB allowed"
                say(f"memory: about {need.needed / 1e9:.2g} GB{limit}, backend {need.backend}")
            if not errors:
                say("no errors")
        if errors:
            raise typer.Exit(InputError.exit_code)


def _validate_points(paths: list[Path], format_name: str, crs: str, as_json: bool) -> None:
    """Check points of another program; unverified formats are remarked.

    The files of a format that has several are one survey; of the others each is one.
    """
    from fg_orient.formats.exchange.registry import Settings, format_named

    found = format_named(format_name, place=Option("format"))
    together = len(found.files) > 1
    checked = [_checked_points(part, found, Settings(crs)) for part in ([paths] if together else [[p] for p in paths])]
    errors = [p for c in checked for p in c.errors]
    remarks = [p for c in checked for p in c.remarks]
    if as_json:
        crs_of = {c.crs for c in checked}
        emit({"errors": [p.as_dict(flag) for p in errors], "remarks": [p.as_dict(flag) for p in remarks],
              "points": sum(c.points for c in checked), "crs": crs_of.pop() if len(crs_of) == 1 else None,
              "files": [c.as_dict() for c in checked]})  # fmt: skip
    for p in errors:
        fault(p)
    for c in () if as_json else checked:
        for p in c.remarks:
            tell("remark", p, as_result=True)
        if not c.errors:
            where = f"{c.files[0]}: " if len(checked) > 1 else ""
            say(f"{where}{c.points} points, {c.image_points} image points, no errors")
    if errors:
        raise typer.Exit(InputError.exit_code)


@dataclass(frozen=True)
class _Checked:
    """What was found in one survey."""

    files: list[str]
    points: int = 0
    image_points: int = 0
    crs: str = ""
    remarks: tuple[Finding, ...] = ()
    errors: tuple[Finding, ...] = ()

    def as_dict(self) -> dict[str, object]:
        return {"files": self.files, "points": self.points, "image_points": self.image_points, "crs": self.crs,
                "n_errors": len(self.errors), "n_remarks": len(self.remarks)}  # fmt: skip


def _checked_points(paths: list[Path], found: Format, settings: Settings) -> _Checked:
    """Read the files of one survey."""
    from fg_orient.formats.exchange.convert import read_survey

    names = [str(p) for p in paths]
    try:
        survey, remarks = read_survey(paths, found, settings, accept_unverified=True)
    except InputError as error:
        return _Checked(names, errors=tuple(error.problems))
    return _Checked(names, len(survey.ids), len(survey.observed), survey.crs, remarks)


def _impossible(block: Block, project: Path) -> list[Finding]:
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
        from fg_orient.cli.doctor import examine

        found = examine()
        if as_json:
            emit(found)
        else:
            table("versions", ("name", "version"), [(k, v or "missing") for k, v in found["versions"].items()], left=2)
            checks = [(c["name"], "yes" if c["good"] else "NO", c["detail"]) for c in found["checks"]]
            table("checks", ("check", "good", "detail"), checks, left=3)
            tell_findings(found, as_result=True)
            for c in found["checks"]:
                if quiet and not c["good"]:
                    note(f"{c['name']}: {c['detail']}")
        if not found["good"]:
            raise typer.Exit(FgOrientError.exit_code)
