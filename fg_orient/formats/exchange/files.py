"""What readers and writers of bundle files share: lines, whole numbers, folders, names that are still free."""

from __future__ import annotations

from pathlib import Path

from fg_orient.formats.tables import Faults, read_text
from fg_orient.model.errors import InputError


def read_lines(path: Path) -> list[str]:
    """Lines of a UTF-8 file, without their ends.

    Raises
    ------
    InputError
        The file does not exist, cannot be read, or is no text.
    """
    faults = Faults(path.name)
    text = read_text(path, faults)
    faults.raise_if_any()
    return (text or "").split("\n")


def whole(cell: str) -> int | None:
    """Whole number above zero of ASCII digits alone; None for others (``int`` would take 1_0)."""
    return int(cell) if cell.isascii() and cell.isdigit() and 0 < len(cell) < 19 and int(cell) > 0 else None


def require_free(*paths: Path, overwrite: bool) -> None:
    """Refuse to replace files.

    Raises
    ------
    InputError
        One exists and ``overwrite`` is False.
    """
    for path in paths:
        if path.exists() and not overwrite:
            raise InputError.of("output.exists", file=path, option="out")


def make_folder(folder: Path) -> None:
    """Make a folder that may exist.

    Raises
    ------
    InputError
        It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError.of("output.unwritable", file=folder, value=error.strerror or error) from None
