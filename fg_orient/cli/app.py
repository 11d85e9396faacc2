"""The command-line application: its commands, shell completion, usage errors and signals.

The module of a command is loaded only when the command is called.
"""

from __future__ import annotations

import contextlib
import copy
import gc
import inspect
import os
import signal
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Final, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

import fg_orient
from fg_orient.cli.command import INTERRUPTED, argument, in_short, option, outcome
from fg_orient.cli.output import emit_errors, note
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.machine import is_out_of_memory

PROGRAM: Final = "fg-orient"
#: The completion script of a shell sets this environment variable.
VARIABLE: Final = "_FG_ORIENT_COMPLETE"
#: numpy reads this environment variable when scipy is imported.
EPOCH: Final = "SOURCE_DATE_EPOCH"
#: Variable of numba that switches its compiler off.
NO_COMPILER: Final = "NUMBA_DISABLE_JIT"
SHELLS: Final = ("bash", "zsh", "fish")
#: For each command its module in this package, in the order of the help. A command is a
#: function or a group with this name, or the group ``app`` of the module.
COMMANDS: Final = {name: module for module, names in (
    ("new", "new"), ("match", "match"), ("adjust", "adjust graph"), ("studies", "compare"), ("adjust", "reduce"),
    ("results", "accuracy dsm-points"),
    ("geometry", "locate project intersect footprint"), ("convert", "convert"), ("checks", "validate"),
    ("app", "completion"), ("checks", "doctor schema"), ("results", "report replay"), ("studies", "reproduce"),
    ("simulate", "simulate"), ("rpc", "rpc"), ("convert", "camera"), ("rectify", "rectify"),
    ("closerange", "closerange"),
) for name in names.split()}  # fmt: skip
#: Thresholds of the garbage collector. With Python's default 700, 10, 10, it scans modules repeatedly during imports.
COLLECT: Final = (50_000, 20, 50)


def declared(name: str) -> Any:
    """Return the function or group that declares a command."""
    module = import_module(f"fg_orient.cli.{COMMANDS[name]}")
    return vars(module).get(name.replace("-", "_")) or module.app


def help_of(name: str) -> str | None:
    """Return the help of a command without building the command.

    The text is the same as typer's.
    """
    one = declared(name)
    text: str | None = one.info.help if isinstance(one, typer.Typer) else inspect.getdoc(one)
    return text


@cache
def built(name: str) -> Any:
    """Build a command when it is needed; typer needs 0.1 s to build all commands."""
    one, alone = declared(name), typer.Typer(add_completion=False)
    if not isinstance(one, typer.Typer):
        alone.command(name)(one)
        return typer.main.get_command(alone)
    alone.add_typer(one, name=name)
    group: Any = typer.main.get_command(alone)
    return group.commands[name]


class _Root(TyperGroup):
    """Group of all commands.

    Its help shows the help texts of the commands without building their options.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = dict.fromkeys(COMMANDS)

    def get_command(self, ctx: Any, name: str) -> Any:
        """Return the command with this name; None if it does not exist."""
        return (self.commands[name] or built(name)) if name in COMMANDS else None

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help; it uses commands that were built without options."""
        shown = copy.copy(self)
        shown.commands = {name: TyperCommand(name, help=help_of(name)) for name in COMMANDS}
        TyperGroup.format_help(shown, ctx, formatter)


app = typer.Typer(
    name=PROGRAM,
    cls=_Root,
    epilog="Exit codes: 0 good, 2 bad input, 3 no solution, 4 solution not trustworthy, 130 interrupted.",
    add_completion=False,  # the command "completion" writes the script, so that --help needs no options for it
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fg-orient {fg_orient.__version__}")
        raise typer.Exit()


def _require_environment() -> None:
    """Raise InputError for a variable of the environment with which the program cannot work."""
    epoch, interpreted = os.environ.get(EPOCH, "0"), os.environ.get(NO_COMPILER, "0")
    if not (epoch.isascii() and epoch.isdigit()):
        raise InputError.of("environment.value", place=EPOCH, value=repr(epoch), expected="seconds since 1970-01-01")
    if interpreted not in ("", "0"):  # the vector code of the kernels has no form in plain Python
        raise InputError.of("environment.value", place=NO_COMPILER, value=repr(interpreted), expected="0")


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[
        bool, option("Print the version and end.", flag="--version", callback=_show_version, is_eager=True)
    ] = False,
    plugin: Annotated[
        list[Path] | None,
        option("Load your own sensor, equation, solver or loss.", "FILE.py", envvar="FG_ORIENT_PLUGIN"),
    ] = None,
) -> None:
    """Orient optical images, from satellites to close range, by bundle adjustment on a factor graph."""
    with outcome(as_json="--json" in sys.argv):
        _require_environment()
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
    if plugin:
        from fg_orient.model.plugins import load_plugin

        with outcome(as_json="--json" in sys.argv):
            for path in plugin:
                load_plugin(path)


def completion(
    shell: Annotated[str, argument("bash|zsh|fish", "Shell to complete in.")],
) -> None:
    """Print the script that lets a shell complete commands and options.

    bash, zsh: eval "$(fg-orient completion bash)" (or zsh, after compinit) in ~/.bashrc
    (~/.zshrc). fish: fg-orient completion fish >
    ~/.config/fish/completions/fg-orient.fish
    """
    with outcome(as_json=False):
        if shell not in SHELLS:
            raise InputError.of("cli.shell", place="fg-orient completion", value=shell, known=", ".join(SHELLS))
        from typer._completion_shared import get_completion_script

        typer.echo(get_completion_script(prog_name=PROGRAM, complete_var=VARIABLE, shell=shell))


def main() -> NoReturn:
    """Run the command line; this is the entry point of ``fg-orient``."""
    _replace_closed_streams()
    gc.set_threshold(*COLLECT)
    signal.signal(signal.SIGTERM, _terminate)
    if VARIABLE in os.environ:  # the completion script of a shell has called the program
        from typer._completion_classes import completion_init

        completion_init()
    if {"-h", "--help"} & set(sys.argv[1:]):
        _fold_help()
    try:
        code = app(prog_name=PROGRAM, standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        note("interrupted: nothing was written")
        code = INTERRUPTED
    except OSError as error:  # of standard output: commands convert all others
        code = _unwritable(error)
    except Exception as error:
        code = _usage_error(error)
    code = _flushed(code)
    gc.freeze()  # otherwise garbage collection of numba's objects takes 0.5 s when the interpreter ends
    sys.exit(code if isinstance(code, int) else 0)


def _fold_help() -> None:
    """Let the help break words that are longer than their column; typer cuts them, and has no setting for this."""
    from rich.columns import Columns
    from rich.table import Table
    from rich.text import Text
    from typer import rich_utils

    class FoldedTable(Table):
        def add_row(self, *cells: Any, **settings: Any) -> None:
            super().add_row(*cells, **settings)
            for column in self.columns:
                column.overflow = "fold"

    class FoldedColumns(Columns):
        def __init__(self, cells: Any = None, *arguments: Any, **settings: Any) -> None:
            super().__init__(cells, *arguments, **settings)
            for cell in self.renderables:
                if isinstance(cell, Text):
                    cell.overflow = "fold"

    vars(rich_utils).update(Table=FoldedTable, Columns=FoldedColumns)


def _replace_closed_streams() -> None:
    """Replace missing streams of the process: an empty input, and outputs that nobody reads."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))


def _flushed(code: object) -> object:
    """Write the remaining text to standard output; return the exit code, which changes if this fails."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        return code
    except OSError as error:
        return _unwritable(error, told=code not in (0, None))
    return code


def _unwritable(error: OSError, *, told: bool = False) -> int:
    """Report that standard output cannot be written, unless a line has already reported this.

    The interpreter would report it again at the end; therefore its output is discarded.
    """
    problem = InputError.of("output.unwritable", file="standard output", value=error.strerror or type(error).__name__)
    if not told:
        with contextlib.suppress(OSError):
            note(f"error: {problem}")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return problem.exit_code


def _usage_error(error: Exception) -> int:
    """Report a wrong option or argument, or too little memory, in one line.

    Raise other exceptions again.
    """
    explain = getattr(error, "format_message", None)
    if (
        VARIABLE in os.environ and isinstance(error, KeyError) and "COMP_WORDS" in error.args
    ):  # typer looks up the words of the shell
        wrong = InputError.of("environment.value", place=VARIABLE, value=os.environ[VARIABLE],
                              expected="the value of a completion script, and the words of its shell")  # fmt: skip
        note(f"error: {wrong}")
        return wrong.exit_code
    if explain is None:
        if not is_out_of_memory(error):
            raise error
        try:
            note(f"error: {NoSolutionError.of('program.memory', value=in_short(error))}")
        except Exception:  # there is not even enough memory for the message
            os.write(2, b"error: the memory is not sufficient, and nothing was written\n")
        return NoSolutionError.exit_code
    context = getattr(error, "ctx", None)
    text = (
        explain().rstrip(".").replace("Value error, ", "")
    )  # pydantic's message begins like this if a value is not among the choices
    usage = InputError.of("cli.usage", place=context.command_path if context else PROGRAM, text=text)
    if "--json" in sys.argv:
        emit_errors(*usage.problems)
    note(f"error: {usage}")
    return usage.exit_code


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    """Exit when SIGTERM is received, so that temporary folders are removed."""
    sys.exit(128 + number)
