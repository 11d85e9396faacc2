"""The application: commands by name, usage errors, signals."""

from __future__ import annotations

import gc
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated, NoReturn

import typer

import fg_orient
from fg_orient.cli import (
    accuracy,
    adjust,
    camera,
    checks,
    closerange,
    compare,
    completion,
    convert,
    geometry,
    rectify,
    reduce,
    replay,
    reports,
    reproduce,
    rpc,
    simulate,
    viewing,
)
from fg_orient.cli.common import INTERRUPTED, emit_errors, note, outcome
from fg_orient.errors import InputError

app = typer.Typer(
    name="fg-orient",
    epilog="Exit codes: 0 good, 2 bad input, 3 no solution, 4 solution not trustworthy, 130 interrupted.",
    add_completion=False,  # the command completion writes the script: two options less in every --help
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("adjust")(adjust.adjust)
app.command("compare")(compare.compare)
app.command("reduce")(reduce.reduce)
app.command("accuracy")(accuracy.accuracy)
app.command("locate")(geometry.locate)
app.command("project")(geometry.project)
app.command("intersect")(geometry.intersect)
app.command("footprint")(viewing.footprint)
app.add_typer(simulate.app, name="simulate")
app.add_typer(rpc.app, name="rpc")
app.add_typer(camera.app, name="camera")
app.add_typer(rectify.app, name="rectify")
app.add_typer(closerange.app, name="closerange")
app.command("convert")(convert.convert)
app.command("validate")(checks.validate)
app.command("completion")(completion.completion)
app.command("doctor")(checks.doctor)
app.command("report")(reports.report)
app.command("replay")(replay.replay)
app.command("reproduce")(reproduce.reproduce)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fg-orient {fg_orient.__version__}")
        raise typer.Exit()


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and end.")
    ] = False,
    plugin: Annotated[
        list[Path] | None,
        typer.Option(
            "--plugin",
            metavar="FILE.py",
            envvar="FG_ORIENT_PLUGIN",
            help="Load your own sensor, equation, solver or loss.",
        ),
    ] = None,
) -> None:
    """Orient optical images, from satellites to close range, by bundle adjustment on a factor graph."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
    if plugin:
        from fg_orient.plugins import load_plugin

        with outcome(as_json="--json" in sys.argv):
            for path in plugin:
                load_plugin(path)


def main() -> NoReturn:
    """Run the command line; the entry point of ``fg-orient``."""
    signal.signal(signal.SIGTERM, _terminate)
    completion.prepare()
    try:
        code = app(prog_name=completion.PROGRAM, standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        note("interrupted: nothing was written")
        code = INTERRUPTED
    except Exception as error:
        code = _usage_error(error)
    gc.freeze()  # otherwise the collections at the interpreter's end cost 0.5 s over numba's objects
    sys.exit(code if isinstance(code, int) else 0)


def _usage_error(error: Exception) -> int:
    """Report a wrong option or argument in one line; any other exception is not ours to catch."""
    explain = getattr(error, "format_message", None)
    if explain is None:
        raise error
    context = getattr(error, "ctx", None)
    text = explain().rstrip(".").replace("Value error, ", "")  # pydantic's prefix of what the choices of a type refuse
    found = InputError.of("cli.usage", place=context.command_path if context else "fg-orient", text=text)
    if "--json" in sys.argv:
        emit_errors(*found.problems)
    note(f"error: {found}")
    return found.exit_code


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    """End tidily on SIGTERM, so that no half-written folder stays."""
    sys.exit(128 + number)
