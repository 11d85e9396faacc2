"""Commands ``validate`` and ``doctor``: soundness of the input and of the installation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.command import argument, command, option
from fg_orient.cli.log import session
from fg_orient.cli.output import answer, emit, fault, flag, note, say, table, tell, tell_findings
from fg_orient.model.errors import FgOrientError, Finding, InputError

if TYPE_CHECKING:
    from fg_orient.adjustment.memory import Need
    from fg_orient.formats.registry import Format, Settings
    from fg_orient.model.block import Block


@command()
def validate(
    sources: Annotated[
        list[Path], argument("PROJECT.toml", "Project file; or, with --format, one file of points or more.")
    ],
    format_name: Annotated[
        str, option("Check files of points of another program instead.", "FORMAT", flag="--format")
    ] = "",
    crs: Annotated[str, option("Its CRS, where the file does not say it.", "EPSG:N")] = "",
) -> None:
    """Check a project and all its files: errors (exit code 2) and remarks."""
    if format_name:
        _validate_points(sources, format_name, crs)
        return
    project = sources[0]
    if len(sources) > 1:
        raise InputError.of("cli.one_project", file=sources[1], place="PROJECT.toml", value=f"{len(sources)} files")
    from fg_orient.formats.project import checked_project

    block, problems = checked_project(project)
    impossible = [] if block is None else _impossible(block, project)
    problems += impossible
    need = None if block is None or impossible else _memory(block)
    if block is not None and need is not None and not need.fits:
        problems.append(need.problem(str(project)))
    errors = [p for p in problems if p.severity == "failure"]
    remarks = [p for p in problems if p.severity != "failure"]
    lines = [] if errors else ["no errors"]
    if need is not None:
        limit = "" if need.allowed is None else f" of {need.allowed / 1e9:.3g} GB allowed"
        lines.insert(0, f"memory: about {need.needed / 1e9:.2g} GB{limit}, backend {need.backend}")
    _finish({"memory": None if need is None else need.as_dict()}, errors, remarks, lines)


def _finish(record: dict[str, Any], errors: list[Finding], remarks: list[Finding], lines: list[str]) -> None:
    """Print errors and remarks with the record or the lines; errors end the command."""
    as_json = session().as_json
    if as_json:
        emit({"errors": [p.as_dict(flag) for p in errors], "remarks": [p.as_dict(flag) for p in remarks], **record})
    for p in errors:
        fault(p)
    if not as_json:
        for p in remarks:
            tell("remark", p, as_result=True)
        for line in lines:
            say(line)
    if errors:
        raise typer.Exit(InputError.exit_code)


def _validate_points(paths: list[Path], format_name: str, crs: str) -> None:
    """Check points of another program; unverified formats are remarked.

    The files of a format that has several are one survey; of the others each is one.
    """
    from fg_orient.formats.registry import Settings, format_named

    format_ = format_named(format_name, place="<format>")
    surveys = [paths] if len(format_.files) > 1 else [[path] for path in paths]
    checked = [_checked_points(files, format_, Settings(crs)) for files in surveys]
    crs_of = {c.crs for c in checked}
    record = {"points": sum(c.points for c in checked), "crs": crs_of.pop() if len(crs_of) == 1 else None,
              "files": [c.as_dict() for c in checked]}  # fmt: skip
    lines = [
        f"{c.files[0] + ': ' if len(checked) > 1 else ''}{c.points} points, {c.image_points} image points, no errors"
        for c in checked if not c.errors
    ]  # fmt: skip
    _finish(record, [p for c in checked for p in c.errors], [p for c in checked for p in c.remarks], lines)


@dataclass(frozen=True)
class _Checked:
    """Errors and remarks of one survey."""

    files: list[str]
    points: int = 0
    image_points: int = 0
    crs: str = ""
    remarks: tuple[Finding, ...] = ()
    errors: tuple[Finding, ...] = ()

    def as_dict(self) -> dict[str, object]:
        return {"files": self.files, "points": self.points, "image_points": self.image_points, "crs": self.crs,
                "n_errors": len(self.errors), "n_remarks": len(self.remarks)}  # fmt: skip


def _checked_points(paths: list[Path], format_: Format, settings: Settings) -> _Checked:
    """Read the files of one survey."""
    from fg_orient.formats.exchange.convert import read_survey

    names = [str(p) for p in paths]
    try:
        survey, remarks = read_survey(paths, format_, settings, accept_unverified=True)
    except InputError as error:
        return _Checked(names, errors=tuple(error.problems))
    return _Checked(names, len(survey.ids), len(survey.observed), survey.crs, remarks)


def _impossible(block: Block, project: Path) -> list[Finding]:
    """Options that ``adjust`` would refuse."""
    from fg_orient.orientation.run import require_possible_options

    try:
        require_possible_options(block, project, {})
    except InputError as error:
        return list(error.problems)
    return []


def _memory(block: Block) -> Need:
    from fg_orient.adjustment.memory import need_of

    return need_of(block)


@command()
def doctor() -> None:
    """Show versions, check the installation and adjust a small block of its own.

    Exit code 1 if the installation is broken.
    """
    from fg_orient.cli.doctor import examine

    record = examine()
    answer(record, _show_examination)
    if not record["good"]:
        raise typer.Exit(FgOrientError.exit_code)


def _show_examination(record: dict[str, Any]) -> None:
    table("versions", ("name", "version"), [(k, v or "missing") for k, v in record["versions"].items()], left=2)
    checks = [(c["name"], "yes" if c["good"] else "NO", c["detail"]) for c in record["checks"]]
    table("checks", ("check", "good", "detail"), checks, left=3)
    tell_findings(record, as_result=True)
    for c in record["checks"]:
        if session().quiet and not c["good"]:
            note(f"{c['name']}: {c['detail']}")
