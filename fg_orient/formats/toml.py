"""Reader of TOML files, with faults as input errors, and their lines for writers."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fg_orient.model.declaration import toml
from fg_orient.model.errors import FgOrientError, InputError


def no_project_file(path: Path) -> FgOrientError:
    """Error of a path that does not exist, or is a folder; then it names a project file in it."""
    if path.is_dir():
        inside = next(iter(sorted(path.glob("*.toml"))), path / "project.toml")
        return InputError.of("project.folder", file=path, inside=inside)
    return InputError.of("project.missing_file", file=path, folder="the current folder")


def parse_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises
    ------
    InputError
        It cannot be read, or is not TOML.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except (FileNotFoundError, IsADirectoryError):
        raise no_project_file(path) from None
    except OSError as error:
        raise InputError.of("project.unreadable", file=path, value=error.strerror) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = f"byte 0x{error.object[error.start]:02x}"
        raise InputError.of("project.encoding", file=path, place=f"line {line}", value=byte) from None
    try:
        return tomllib.loads(text.replace("\r\n", "\n"))
    except tomllib.TOMLDecodeError as error:
        message, _, place = str(error).rstrip(")").rpartition(" (at ")
        raise InputError.of("project.syntax", file=path, place=place, value=message or place) from None


def entries(values: Mapping[str, object]) -> list[str]:
    """Lines of a table; a value that is None is left out."""
    return [f"{name} = {toml(value)}" for name, value in values.items() if value is not None]
