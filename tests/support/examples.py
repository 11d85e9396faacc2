"""The output of each example is compared with docs/examples.md."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from .command import Ended
from .pages import Command, check_command, commands, fences

PAGE = Path("docs") / "examples.md"
_ROUNDING = re.compile(r"[+-]?\d+(\.\d+)?e[+-]\d+")


def shown_of(repository: Path) -> dict[str, Command]:
    """Return the commands of the page with their shown output, by the name of the script."""
    blocks = [fence for fence in fences(repository / PAGE, str(PAGE)) if fence.language == "console"]
    return {Path(command.words[1]).name: command for block in blocks for command in commands(block)}


def check_shown(repository: Path, name: str, ended: Ended) -> None:
    """Check the output of an example against the page.

    Numbers with exponents depend on rounding and are not compared.
    """
    command = shown_of(repository)[name]
    masked = tuple(_ROUNDING.sub("#", line) for line in command.shown)
    assert len(masked) > 1, f"{PAGE} shows nothing of {name}"
    check_command(replace(command, shown=masked), replace(ended, stdout=_ROUNDING.sub("#", ended.stdout)))
