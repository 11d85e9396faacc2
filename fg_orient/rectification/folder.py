"""Result folder of ``rectify fit``: its contents, and the record of a folder that is complete and unchanged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from fg_orient.formats.atomic import Contents
from fg_orient.model.errors import Finding, InputError
from fg_orient.result.manifest import MANIFEST_FILE, checked_record
from fg_orient.result.record import doubts_about

TRANSFORMATION_FILE: Final = "transformation.json"
RECORD_FILE: Final = "result.json"
#: Contents of the folder; transformation.json identifies it.
CONTENTS: Final = Contents(
    TRANSFORMATION_FILE,
    (TRANSFORMATION_FILE, RECORD_FILE, "points.csv", "coefficients.csv", "residuals.svg", "report.html", MANIFEST_FILE),
)


def read_record(folder: Path) -> dict[str, Any]:
    """Read the record of a fit.

    Raises
    ------
    InputError
        The record is missing or damaged; or the folder is incomplete or was changed
        (``fg_orient.result.manifest``).
    """
    if not _has_record(folder):
        raise InputError.of("rectify.result", file=folder)
    return checked_record(folder, RECORD_FILE, CONTENTS, "rectify.result")


def require_whole(folder: Path) -> None:
    """Check the folder as :func:`read_record` does; a transformation without record and manifest is not checked."""
    if _has_record(folder):
        read_record(folder)


def doubts_on_fit(model: Path) -> Sequence[Finding]:
    """Return the doubt on a fit by its folder; a transformation without record has none."""
    return doubts_about(read_record(model), model) if model.is_dir() and _has_record(model) else []


def _has_record(folder: Path) -> bool:
    return (folder / RECORD_FILE).is_file() or (folder / MANIFEST_FILE).is_file()
