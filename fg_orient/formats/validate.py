"""Checks a project before a run: everything that is wrong, then everything worth a remark."""

from __future__ import annotations

from pathlib import Path

from fg_orient.formats.project import read_project_with_remarks
from fg_orient.model.block import Block
from fg_orient.model.errors import Finding, InputError


def validate_project(path: str | Path, **overrides: object) -> list[Finding]:
    """Read a project with all its files and list what is found; see :func:`checked_project`."""
    return checked_project(path, **overrides)[1]


def checked_project(path: str | Path, **overrides: object) -> tuple[Block | None, list[Finding]]:
    """Read a project with all its files and list what is found.

    Parameters
    ----------
    path : str or Path
        The project file.
    **overrides
        Options as for :func:`fg_orient.formats.project.read_project`.

    Returns
    -------
    block : Block or None
        None with errors.
    problems : list of Finding
        Either failures, with which ``adjust`` would refuse the project, or notes; empty if all is well.
    """
    try:
        block, remarks = read_project_with_remarks(path, **overrides)
    except InputError as error:
        return None, list(error.problems)
    return block, list(remarks)
