"""Commands ``validate`` and ``doctor``: soundness of the input and of the installation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.command import argument, command, option
from fg_orient.cli.log import session
from fg_orient.cli.new import OFFICE
from fg_orient.cli.output import answer, emit, fault, flag, note, say, table, tell, tell_findings
from fg_orient.model.errors import FgOrientError, Finding, InputError
from fg_orient.model.machine import in_gb

if TYPE_CHECKING:
    from fg_orient.formats.registry import Format, Settings
    from fg_orient.model.block import Block


@command(several=OFFICE)
def validate(
    sources: Annotated[
        list[Path], argument("PROJECT.toml", "Project file; or, with --format, one file of points or more.")
    ],
    format_name: Annotated[
        str, option("Check files of points of another program instead.", "FORMAT", flag="--format")
    ] = "",
    crs: Annotated[str, option("Its CRS, where the file does not say it.", "EPSG:N")] = "",
    office: Any = None,
) -> None:
    """Check a project and all its files: errors (exit code 2) and remarks."""
    if format_name:
        from fg_orient.formats.registry import Settings

        _validate_points(sources, format_name, Settings(crs, office=office))
        return
    project = sources[0]
    if len(sources) > 1:
        raise InputError.of("cli.one_project", file=sources[1], place="PROJECT.toml", value=f"{len(sources)} files")
    from fg_orient.formats.project import checked_project

    block, problems = checked_project(project)
    need = None
    if block is not None:
        impossible = _impossible(block, project)
        problems += impossible
        if not impossible:
            from fg_orient.adjustment.memory import reduced

            need, _ = reduced(block)
            problems += [] if need.fits else [need.problem(str(project))]
    errors = [p for p in problems if p.severity == "failure"]
    remarks = [p for p in problems if p.severity != "failure"]
    lines = [] if errors else ["no errors"]
    if need is not None:
        limit = "" if need.allowed is None else f" of {in_gb(need.allowed)} allowed"
        parts = f" in {need.parts} parts" if need.parts else ""
        lines.insert(0, f"memory: about {need.needed / 1e9:.2g} GB{limit}, backend {need.backend}{parts}")
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


def _validate_points(paths: list[Path], format_name: str, settings: Settings) -> None:
    """Check points of another program; unverified formats are remarked.

    The files of a format with several files are one survey; otherwise each file is a survey.
    """
    from fg_orient.formats.registry import format_named

    format_ = format_named(format_name, place="<format>")
    surveys = [paths] if len(format_.files) > 1 else [[path] for path in paths]
    errors: list[Finding] = []
    remarks: list[Finding] = []
    lines, files = [], []
    for survey in surveys:
        counts, own_errors, own_remarks = _checked_points(survey, format_, settings)
        names = [str(path) for path in survey]
        files.append({"files": names, **counts, "n_errors": len(own_errors), "n_remarks": len(own_remarks)})
        if not own_errors:
            name = f"{names[0]}: " if len(surveys) > 1 else ""
            lines.append(f"{name}{counts['points']} points, {counts['image_points']} image points, no errors")
        errors += own_errors
        remarks += own_remarks
    crs_of = {file["crs"] for file in files}
    record = {"points": sum(file["points"] for file in files), "crs": crs_of.pop() if len(crs_of) == 1 else None,
              "files": files}  # fmt: skip
    _finish(record, errors, remarks, lines)


def _checked_points(
    paths: list[Path], format_: Format, settings: Settings
) -> tuple[dict[str, Any], Sequence[Finding], Sequence[Finding]]:
    """Counts, errors and remarks of one survey."""
    from fg_orient.formats.exchange.convert import read_survey

    try:
        survey, remarks = read_survey(paths, format_, settings, accept_unverified=True)
    except InputError as error:
        return {"points": 0, "image_points": 0, "crs": ""}, error.problems, ()
    counts = {"points": len(survey.ids), "image_points": len(survey.observed), "crs": survey.crs}
    return counts, (), (*survey.notes, *remarks)


def _impossible(block: Block, project: Path) -> list[Finding]:
    """Options that ``adjust`` would refuse."""
    from fg_orient.orientation.run import require_possible_options

    try:
        require_possible_options(block, project, {})
    except InputError as error:
        return list(error.problems)
    return []


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
