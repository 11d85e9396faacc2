"""Command ``completion``: the script by which a shell completes commands and options."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from fg_orient.cli.common import outcome
from fg_orient.model.errors import InputError

PROGRAM = "fg-orient"
#: Variable through which the script asks the program.
VARIABLE = "_FG_ORIENT_COMPLETE"
SHELLS = ("bash", "zsh", "fish")


def completion(
    shell: Annotated[str, typer.Argument(metavar="bash|zsh|fish", help="Shell to complete in.", show_default=False)],
) -> None:
    """Print the script that lets a shell complete commands and options.

    bash, zsh: eval "$(fg-orient completion bash)" (or zsh, after compinit) in ~/.bashrc (~/.zshrc). fish: fg-orient
    completion fish > ~/.config/fish/completions/fg-orient.fish
    """
    with outcome(as_json=False):
        if shell not in SHELLS:
            raise InputError.of("cli.shell", place="fg-orient completion", value=shell, known=", ".join(SHELLS))
        from typer._completion_shared import get_completion_script

        typer.echo(get_completion_script(prog_name=PROGRAM, complete_var=VARIABLE, shell=shell))


def prepare() -> None:
    """Let typer answer, if it is the script that asks."""
    if VARIABLE in os.environ:
        from typer._completion_classes import completion_init

        completion_init()
