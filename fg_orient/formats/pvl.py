"""Read Parameter Value Language (PVL): labels and control networks of ISIS.

A file contains statements ``name = value``. Objects and groups contain further
statements: ``Object = NAME .. End_Object``. A value is a word, a quoted text or a list in
parentheses. Units in angle brackets are not interpreted. Upper and lower case of a name are not
distinguished. Networks have millions of lines. The existing Python package reads single characters and
is too slow for them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.load import load_bytes
from fg_orient.model.errors import InputError
from fg_orient.model.limits import within_memory

#: Possessive: comments and values that do not end would be divided in all possible ways.
_STATEMENT: Final = re.compile(
    r"""(?:\s|\#[^\n]*+|(?>/\*.*?\*/)|;)*+                 # blanks and comments
        (?P<name>(?!/\*)[^\s=;#]+)
        (?:[^\S\n]*=\s*(?P<value>"[^"]*+"|'[^']*+'|\((?:[^()"]|"[^"]*+"|\([^()]*+\))*+\)|\{[^{}]*+\}
            |(?!["'({])[^\s;]+(?:(?<=-)\n[^\S\n]*[^\s;=]+(?![^\S\n]*=))*)        # long words go on after a hyphen
        (?:[^\S\n]*<[^<>\n]*+>)?)?""",
    re.VERBOSE | re.DOTALL,
)
#: Maximum number of bytes of Python objects for each statement.
_OBJECTS: Final = 1500
#: A long word continues in the next line after a hyphen.
_BROKEN: Final = re.compile(r"-\n\s*")


@dataclass(eq=False)
class Pvl:
    """Object or group of a file, or the whole file.

    Parameters
    ----------
    file, kind, name : str
        ``kind`` is "object", "group" or "file".
    line : int
        Number of its first line.
    values : dict
        Text and line of each statement, by name in lower case.
    parts : list of Pvl
        Objects and groups that it contains.
    """

    file: str
    kind: str = "file"
    name: str = ""
    line: int = 1
    values: dict[str, tuple[str, int]] = field(default_factory=dict)
    parts: list[Pvl] = field(default_factory=list)

    def every(self, name: str) -> Iterator[Pvl]:
        """Return all objects and groups with a name, at any depth."""
        for part in self.parts:
            if part.name.lower() == name.lower():
                yield part
            yield from part.every(name)

    def has(self, name: str) -> bool:
        """Return whether there is a statement with this name."""
        return name.lower() in self.values

    def text(self, name: str, default: str | None = None) -> str:
        """Return a value without quotes.

        Raise InputError if it is missing and no default is given.
        """
        if name.lower() not in self.values:
            if default is None:
                raise InputError.of("pvl.missing", file=self.file, place=f"line {self.line}, {self.name}", value=name)
            return default
        return _BROKEN.sub("", self.values[name.lower()][0]).strip("\"'")

    def is_true(self, name: str) -> bool:
        """Return whether a value is true; a missing value is False."""
        return self.text(name, "").lower() in ("true", "yes", "1")

    def numbers(self, name: str, count: int) -> Array:
        """Return a list of ``count`` finite numbers; raise InputError for any other value."""
        text = self.text(name)
        items = text.strip("(){}").split(",") if text.startswith(("(", "{")) else [text]
        try:
            out = np.array([float(item.partition("<")[0]) for item in items])  # <unit>
        except ValueError:
            out = np.full(count, np.nan)
        if len(out) != count or not np.isfinite(out).all():
            raise InputError.of("pvl.numbers", file=self.file, place=f"line {self.values[name.lower()][1]}, {name}",
                                value=" ".join(text.split())[:60], count=count)  # fmt: skip
        return out

    def number(self, name: str) -> float:
        """Return one finite number."""
        return float(self.numbers(name, 1)[0])


def read_pvl(path: Path) -> Pvl:
    """Read a PVL file, or the PVL label at the beginning of an ISIS cube.

    Raises
    ------
    InputError
        The file cannot be read, a value is incomplete, or the end of an object is missing.
    """
    data = load_bytes(path, "pvl_bytes")
    within_memory(data.count(b"=") * _OBJECTS, len(data), file=path)
    text = data.decode("latin-1").replace("\r\n", "\n")
    root = Pvl(str(path))
    stack, at, line, ended = [root], 0, 1, False
    while not ended and (found := _STATEMENT.match(text, at)):
        name, value = found["name"], found["value"]
        line += text.count("\n", at, found.start("name"))
        at = found.start("name")
        word = name.lower().replace("_", "")
        if word in ("endobject", "endgroup"):  # with or without the name of the object
            if len(stack) == 1 or not word.endswith(stack[-1].kind):
                raise InputError.of("pvl.end", file=path, place=f"line {line}", value=name)
            stack.pop()
        elif value is None:
            if word == "end":
                ended = True
            else:
                raise InputError.of("pvl.statement", file=path, place=f"line {line}", value=name[:60])
        elif word in ("object", "beginobject", "group", "begingroup"):
            part = Pvl(str(path), word.removeprefix("begin"), value.strip("\"'"), line)
            stack[-1].parts.append(part)
            stack.append(part)
        else:
            stack[-1].values[name.lower()] = (value, line)
        line += text.count("\n", at, found.end())
        at = found.end()
    if len(stack) > 1:
        last = stack[-1]
        raise InputError.of("pvl.open", file=path, place=f"line {last.line}", value=f"{last.kind} {last.name}")
    if not root.parts and not root.values:
        raise InputError.of("pvl.empty", file=path)
    return root
