"""Fenced code of Markdown pages runs in this process as a reader would run it.

A page is run from top to bottom in one folder and one Python namespace. What the languages mean:

- ``sh``: each line is a command and has to end with 0, or with N where its comment says "exit code N". The lines
  are alternatives: one may replace what another has written.
- ``console``: lines that begin with ``$ `` are commands, the lines below them occur in the output, in
  this order (blanks and the number of iterations do not count); a line ``...`` stands for any number of lines.
- ``python``: executed; names stay for the next block of the page.
- ``toml``: read; a project file is held against its schema.

Fences of other languages, and without one, are for reading only.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import runpy
import shlex
import sys
import tomllib
import traceback
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click

from .command import Ended, command_line, in_process

_FENCE = re.compile(r"^```(sh|console|python|toml)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_EXIT = re.compile(r"exit code (\d+)")
_ASSIGNED = re.compile(r"[A-Z_]+=")
_PROMPT = "$ "
#: How many iterations an adjustment takes near the limit of rounding is decided by the BLAS and the processor.
_ITERATIONS = re.compile(r"\b\d+ iterations?\b")


@dataclass(frozen=True)
class Fence:
    """One fenced block: where it begins, its language, its text."""

    page: str
    line: int
    language: str
    text: str


@dataclass(frozen=True)
class Command:
    """One command of a ``sh`` or ``console`` block, the code it has to end with, the output shown below it."""

    page: str
    text: str
    code: int
    shown: tuple[str, ...] = ()
    alternative: bool = False

    @property
    def words(self) -> list[str]:
        """Return the words of the command, without its comment and what is set before it."""
        return list(itertools.dropwhile(_ASSIGNED.match, shlex.split(self.text, comments=True)))

    @property
    def environment(self) -> dict[str, str]:
        """Return what is set for this command: ``NAME=VALUE`` before it."""
        words = itertools.takewhile(_ASSIGNED.match, shlex.split(self.text, comments=True))
        return dict(word.split("=", 1) for word in words)


def fences(path: Path, name: str) -> list[Fence]:
    """Return the blocks of a page that can be run."""
    text = path.read_text("utf-8")
    return [Fence(name, text[: m.start()].count("\n") + 2, m[1], m[2]) for m in _FENCE.finditer(text)]


def commands(fence: Fence) -> Iterator[Command]:
    """Yield the commands of a block; a backslash at the end of a line goes on in the next."""
    lines = fence.text.replace("\\\n", " ").splitlines()
    if fence.language == "sh":
        for line in lines:
            if line.strip() and not line.startswith("#"):
                yield _command(fence.page, line, alternative=True)
        return
    starts = [k for k, line in enumerate(lines) if line.startswith(_PROMPT)] + [len(lines)]
    for start, end in itertools.pairwise(starts):
        yield _command(fence.page, lines[start].removeprefix(_PROMPT), tuple(lines[start + 1 : end]))


def _command(page: str, line: str, shown: tuple[str, ...] = (), *, alternative: bool = False) -> Command:
    code = _EXIT.search(line)
    return Command(page, " ".join(line.split()), int(code[1]) if code else 0, shown, alternative)


def run_command(command: Command, repository: Path) -> Ended:
    """Run ``fg-orient ...`` or ``python examples/...`` in this process."""
    words = command.words
    if words[0] == "fg-orient":
        more = ["--overwrite"] if command.alternative and takes_overwrite(command) else []
        with patch.dict(os.environ, command.environment):
            return in_process(*words[1:], *more)
    if words[0] == "python" and words[1].startswith("examples/"):
        return run_script(repository / words[1], *words[2:])
    raise AssertionError(f"{command.page}: nothing here runs '{words[0]}'; list the command in NOT_RUN with its reason")


def run_script(path: Path, *arguments: object) -> Ended:
    """Run a script as ``python PATH ARGUMENTS`` does, in this process."""
    out, err, before = StringIO(), StringIO(), sys.argv
    sys.argv = [str(path), *map(str, arguments)]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            runpy.run_path(str(path), run_name="__main__")
        code: object = 0
    except SystemExit as end:
        code = end.code
        if isinstance(code, str):  # as the interpreter does
            err.write(f"{code}\n")
    finally:
        sys.argv = before
    return Ended(code if isinstance(code, int) else int(code is not None), out.getvalue(), err.getvalue())


def check_command(command: Command, ended: Ended) -> None:
    """Check a command's exit code and output against the page."""
    said = f"{command.page}: {command.text}\n{ended.stdout[-2000:]}{ended.stderr[-2000:]}"
    assert ended.code == command.code, f"ended with {ended.code}, not {command.code}\n{said}"
    have = iter(_plain(line) for line in (ended.stdout + ended.stderr).splitlines())
    for line in command.shown:
        want = _plain(line)
        assert not want or want == "..." or want in have, f"not in the output, or not in this order: {line!r}\n{said}"


def _plain(line: str) -> str:
    return _ITERATIONS.sub("# iterations", " ".join(line.split()))


def _leaf(command: Command) -> tuple[Any, list[str]]:
    """Return the command object of a command line and the words after its name."""
    words, leaf = command.words[1:], command_line()
    while words[:1] == ["--plugin"]:  # stands before the command
        del words[:2]
    while hasattr(leaf, "commands"):
        assert words and leaf.get_command(None, words[0]), f"{command.page}: no such command: {command.text}"
        leaf = leaf.get_command(None, words.pop(0))
    return leaf, words


def takes_overwrite(command: Command) -> bool:
    """Return whether a command has the option --overwrite and does not use it."""
    leaf, words = _leaf(command)
    return "--overwrite" not in words and any("--overwrite" in option.opts for option in leaf.params)


def parse_command(command: Command) -> None:
    """Parse the options of a command by the command line, without running it."""
    leaf, words = _leaf(command)
    context = leaf.make_context(leaf.name, [], resilient_parsing=True)
    with context.scope(), contextlib.suppress(click.exceptions.Exit):  # --help ends here
        leaf.parse_args(context, words)


def run_python(fence: Fence, names: dict[str, Any]) -> None:
    """Execute a block in the page's namespace; a failure names page and line."""
    code = compile("\n" * (fence.line - 1) + fence.text, fence.page, "exec")
    try:
        with redirect_stdout(StringIO()):
            exec(code, names)  # the page is ours
    except Exception as error:
        line = next(
            (f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == fence.page), fence.line
        )
        raise AssertionError(f"{fence.page}:{line}: {type(error).__name__}: {error}") from error


def check_toml(fence: Fence) -> None:
    """Read a TOML block; one that names images, points and observations is a project file."""
    from fg_orient.formats.schema import ProjectFile, validate

    try:
        data = tomllib.loads(fence.text)
    except tomllib.TOMLDecodeError as error:
        raise AssertionError(f"{fence.page}:{fence.line}: {error}") from error
    if {"images", "points", "observations"} <= set(data):
        validate(data, f"{fence.page}:{fence.line}", ProjectFile)


def run_page(
    page: list[Fence], names: dict[str, Any], repository: Path, take: Callable[[Command | Fence], bool]
) -> int:
    """Run the blocks of a page that ``take`` accepts, in the current folder; return the number run."""
    ran = 0
    for fence in page:
        if fence.language == "toml":
            check_toml(fence)
        elif fence.language == "python":
            if take(fence):
                run_python(fence, names)
                ran += 1
        else:
            for command in commands(fence):
                if take(command):
                    check_command(command, run_command(command, repository))
                    ran += 1
    return ran
