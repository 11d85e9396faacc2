"""What all commands share: options, exit codes, JSON and tables."""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from factors._preparation import told_of_compilation
from fg_orient.cli.log import COMPILING, COMPILING_IN_VAIN, opened, session
from fg_orient.cli.output import emit_errors, fault, flag, folded, note, printable, tell
from fg_orient.cli.tables import print_table
from fg_orient.model.declaration import declared
from fg_orient.model.errors import FgOrientError, Finding, InputError, finding
from fg_orient.model.options import MAX_EXTRAPOLATION_S, Reading

if TYPE_CHECKING:
    from fg_orient.sensors.surface import RasterDem

INTERRUPTED = 130
#: Faults of a user's own file, whose traceback --debug shows.
PLUGINS = ("plugin.failed", "sensor.own_reader")

EXTRAPOLATE = declared(Reading)["extrapolate_attitude_s"]

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="No progress, no tables; errors and what makes a result doubtful stay.")
]
Log = Annotated[
    Path | None, typer.Option("--log", metavar="FILE", help="Add each event to this file, one JSON object a line.")
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error of the program itself.")]
ModelOf = Annotated[
    str, typer.Option("--model", metavar="auto|rigorous|rpc", help="Which model, of files that hold both.")
]
Result = Annotated[
    Path | None, typer.Option("--result", metavar="DIR", help="Result folder of adjust: its orientation of the image.")
]
VerticalCrs = Annotated[
    str,
    typer.Option(
        "--dem-vertical-crs",
        metavar="EPSG:N",
        help="What heights of a DEM refer to that does not say it, EPSG:5773: EGM96.",
    ),
]
Extrapolate = Annotated[
    float,
    typer.Option(
        EXTRAPOLATE.flag, metavar=EXTRAPOLATE.metavar, min=0.0, max=MAX_EXTRAPOLATION_S, help=EXTRAPOLATE.short_help
    ),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace an existing output once the new one is complete.")
]


@contextlib.contextmanager
def outcome(as_json: bool, debug: bool = False, quiet: bool = False, log: Path | None = None) -> Iterator[None]:
    """Turn exceptions into one line per problem and an exit code; keep the log.

    Raises
    ------
    typer.Exit
        With the code of the exception: 2 bad input, 3 no solution, 130 interrupted, 1 a bug.
    """
    with _explained(as_json, debug), opened(log, as_json=as_json, quiet=quiet), _explained(as_json, debug):
        with told_of_compilation(_CompilationNote()):
            yield


class _CompilationNote:
    """Says once in a command that kernels are being compiled, and whether that will be so each time."""

    def __init__(self) -> None:
        self._said = False

    def __call__(self, kernel: str) -> None:
        if self._said:
            return
        self._said = True
        from factors._compile import cache_folder

        text = COMPILING if cache_folder() is not None else COMPILING_IN_VAIN
        if session().as_json:
            session().tell("note", text=text)
        else:
            tell("note", text)


@contextlib.contextmanager
def _explained(as_json: bool, debug: bool) -> Iterator[None]:
    """Turn exceptions into one line per problem and an exit code."""
    try:
        yield
    except typer.Exit:
        raise
    except FgOrientError as error:
        if debug and any(p.code in PLUGINS for p in error.problems):
            traceback.print_exc()
        if as_json:
            emit_errors(*error.problems)
        for found in folded(error.problems):
            fault(found)
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt as stopped:
        told = [one.text(flag) for one in stopped.args if isinstance(one, Finding)]
        note("".join(told) or str(stopped) or "interrupted: nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone; nobody is left to be told
        raise typer.Exit(1) from None
    except Exception as error:
        if debug:
            traceback.print_exc()
        own = _of_a_plugin(error)
        found = own or internal(error, debug)
        if as_json:
            emit_errors(found)
        if own:
            fault(own)
            raise typer.Exit(InputError.exit_code) from None
        session().tell("error", **found.as_dict(flag))
        note(found.text(flag))
        raise typer.Exit(1) from None


def _of_a_plugin(error: Exception) -> Finding | None:
    """Describe an exception that a user's own file raised."""
    from fg_orient.model.plugins import fault_of

    return fault_of(error)


def internal(error: Exception, debug: bool) -> Finding:
    """Describe an exception that should not have happened: a fault of the program, not of the input."""
    hint = "" if debug else " (the same command with --debug shows where)"
    text = " ".join(str(error).split())[:300]
    return finding("internal", kind=type(error).__name__, text=text, hint=hint)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], *, left: int = 1) -> None:
    """Print a table of at most 80 columns, nothing under ``--quiet``; see ``tables.print_table``."""
    if not session().quiet:
        print_table(title, columns, [[printable(cell) for cell in row] for row in rows], left)


def number(value: object, digits: int = 3) -> str:
    """Write a number for people; a dash where there is none."""
    if not isinstance(value, (int, float)) or value != value:
        return "-"
    return f"{round(value, digits) + 0.0:.{digits}f}"  # no minus before a zero


def require_project(path: Path) -> None:
    """Refuse a project file that is none, before anything heavy is loaded.

    Raises
    ------
    InputError
        It does not exist, or is a folder.
    """
    if not path.is_file():
        from fg_orient.formats.project import no_project_file

        raise no_project_file(path)


def read_image(path: Path, model: str, extrapolate_s: float, result: Path | None = None, image_id: str = "") -> Any:
    """Read a sensor as the options ``--model``, ``--extrapolate-attitude`` and ``--result`` say."""
    from fg_orient.formats.sensor import read_sensor

    sensor = read_sensor(path, model=model, extrapolate_attitude_s=extrapolate_s)
    return sensor if result is None else with_result(sensor, result, image_id)


def with_result(sensor: Any, result: Path, image_id: str = "") -> Any:
    """Sensor with the orientation of a result folder."""
    from fg_orient.rectification.adjusted import read_correction
    from fg_orient.sensors.oriented import OrientedSensor

    return OrientedSensor(sensor, read_correction(result, sensor, image_id))


def read_dem(path: Path | None, vertical_crs: str) -> RasterDem | None:
    """Read a DEM as the options ``--dem`` and ``--dem-vertical-crs`` say."""
    if path is None:
        if vertical_crs:
            raise InputError.of("dem.missing", option="dem", value="none given")
        return None
    from fg_orient.sensors.surface import RasterDem

    return RasterDem(path, vertical_crs=vertical_crs)


def write_records(path: Path, columns: Sequence[str], records: Sequence[dict[str, Any]], overwrite: bool) -> None:
    """Write records as CSV, numbers to their last digit, whole or not at all.

    Raises
    ------
    InputError
        The file exists and ``overwrite`` is not given, or it cannot be written.
    """
    import csv
    import io

    from fg_orient.formats.atomic import write_text

    if path.exists() and not overwrite:
        raise InputError.of("output.exists", file=path, option="out")
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for record in records:
        values = [record[name] for name in columns]
        writer.writerow(["" if v is None or v != v else str(v).lower() if isinstance(v, bool) else v for v in values])
    write_text(path, stream.getvalue())
