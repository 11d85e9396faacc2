"""Read TOML files and make lines of TOML for writers; faults of a file are input errors."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

from fg_orient.formats.load import load_bytes
from fg_orient.model.declaration import toml
from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.model.limits import exceeded, limit
from fg_orient.model.paths import require_path

#: Part of a dotted key and the blanks after it. The number of parts is limited: the time
#: and memory to read a key grow with the square of this number.
_PART: Final = r"""(?<![\w"'-])(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""


def no_project_file(path: Path) -> FgOrientError:
    """Return the error for a path that does not exist or is a folder; for a folder, it names a project file in it."""
    if path.is_dir():
        inside = next(iter(sorted(path.glob("*.toml"))), path / "project.toml")
        return InputError.of("project.folder", file=path, inside=inside)
    return InputError.of("project.missing_file", file=path, folder="the current folder")


def parse_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    InputError
        The file cannot be read, is not TOML, or exceeds a limit.
    """
    require_path(path)
    if not path.is_file():
        raise no_project_file(path)
    try:
        text = load_bytes(path, "toml_bytes", "project.unreadable").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = f"byte 0x{error.object[error.start]:02x}"
        raise InputError.of("project.encoding", file=path, place=f"line {line}", value=byte) from None
    most = int(limit("toml_depth"))
    deep = re.search(rf"{_PART}(?:\.[ \t]*+{_PART}){{{most},}}", text)
    if deep:
        place = f"line {text.count(chr(10), 0, deep.start()) + 1}"
        raise exceeded("toml_depth", f"more than {most} parts", file=path, place=place, unit="levels")
    try:
        content = tomllib.loads(text.replace("\r\n", "\n"))
    except tomllib.TOMLDecodeError as error:
        message, _, place = str(error).rstrip(")").rpartition(" (at ")
        raise InputError.of("project.syntax", file=path, place=place, value=message or place) from None
    except ValueError as error:  # a number has thousands of digits
        raise InputError.of("project.syntax", file=path, value=error) from None
    except RecursionError:
        raise exceeded("toml_depth", "nested arrays or tables", file=path, unit="levels") from None
    _refuse_long(content, path)
    return content


def _refuse_long(content: dict[str, Any], path: Path) -> None:
    """Refuse whole numbers of more than 64 bits: TOML does not allow them, and a float may not represent them."""
    level: list[object] = [content]
    while level:
        for item in level:
            if type(item) is int and abs(item) >= 2**63:
                raise InputError.of("project.syntax", file=path, value=f"a whole number of {len(str(item))} digits")
        inner = (one.values() if isinstance(one, dict) else one for one in level if isinstance(one, (dict, list)))
        level = list(chain.from_iterable(inner))


def entries(values: Mapping[str, object]) -> list[str]:
    """Return the lines of a TOML table; values that are None are left out."""
    return [f"{name} = {toml(value)}" for name, value in values.items() if value is not None]
