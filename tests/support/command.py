"""Commands run in this process; the result has output and exit code."""

from __future__ import annotations

import contextlib
import functools
import gc
import io
import json
import math
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest.mock import patch

import typer.main
from click.testing import CliRunner

from fg_orient.cli import app, main
from fg_orient.cli import command as cli_command


@dataclass(frozen=True)
class Ended:
    """The end of a command: exit code and output."""

    code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> Any:
        """Return the standard output as exactly one JSON object, nan refused."""

        def refuse(word: str) -> float:
            raise AssertionError(f"{word} in JSON")

        return json.loads(self.stdout, parse_constant=refuse)


Run = Callable[..., Ended]


@functools.cache
def command_line() -> Any:
    """Return the command line; typer takes 0.15 s to build it from its declarations."""
    return typer.main.get_command(app)


def in_process(*words: object) -> Ended:
    """Run a command in this process; without the note on compilation, which a slow machine prints."""
    with patch.object(cli_command, "NOTED_S", math.inf):
        result = CliRunner().invoke(command_line(), [str(word) for word in words])
    kept = os.environ.get("FG_ORIENT_RECORDS")  # for the schemas: tests/support/json_schemas.py
    if kept and "--json" in words:
        one = json.dumps({"words": [str(word) for word in words], "out": result.stdout})
        Path(kept, f"{sha256(one.encode()).hexdigest()}.json").write_text(one, "utf-8")
    return Ended(result.exit_code, result.stdout, result.stderr)


def entry_point(*words: object, **environment: str) -> Ended:
    """Run the entry point of ``fg-orient`` in this process, with what it does around a command: usage errors."""
    out, err, code = io.StringIO(), io.StringIO(), None
    before = signal.getsignal(signal.SIGTERM)
    with (
        patch.object(sys, "argv", ["fg-orient", *map(str, words)]), patch.dict(os.environ, environment),
        patch.object(gc, "freeze"), patch.object(cli_command, "NOTED_S", math.inf),
        contextlib.redirect_stdout(out), contextlib.redirect_stderr(err),
    ):  # fmt: skip
        try:
            main()
        except SystemExit as end:
            code = end.code
        finally:
            signal.signal(signal.SIGTERM, before)
    return Ended(code if isinstance(code, int) else int(code is not None), out.getvalue(), err.getvalue())
