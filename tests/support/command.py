"""Commands run in this process, and how they ended."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import typer.main
from click.testing import CliRunner

from fg_orient.cli import app


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> Any:
        """Standard output as exactly one JSON object, nan refused."""

        def refuse(word: str) -> float:
            raise AssertionError(f"{word} in JSON")

        return json.loads(self.stdout, parse_constant=refuse)


Run = Callable[..., Ended]


@functools.cache
def command_line() -> Any:
    """Give the command line; typer takes 0.15 s to build it from its declarations."""
    return typer.main.get_command(app)


def in_process(*words: object) -> Ended:
    """Run a command in this process."""
    result = CliRunner().invoke(command_line(), [str(word) for word in words])
    return Ended(result.exit_code, result.stdout, result.stderr)
