"""What all commands share: options, exit codes, JSON and tables."""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.errors import FgOrientError, InputError, Problem

if TYPE_CHECKING:
    from fg_orient.sensors.surface import RasterDem

#: Widest table for people.
WIDTH = 80
INTERRUPTED = 130

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]
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
        "--extrapolate-attitude",
        metavar="SECONDS",
        min=0.0,
        max=5.0,
        help="Hold the last rate where attitudes do not cover the image.",
    ),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace an existing output once the new one is complete.")
]


def printable(text: object) -> str:
    """Replace characters that a terminal could take as commands."""
    return "".join(c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in str(text))


def note(text: object) -> None:
    """Say something beside the result: on standard error."""
    typer.echo(printable(text), err=True)


def say(text: object = "") -> None:
    """Print a line of the result for people."""
    typer.echo(printable(text))


def emit(record: object) -> None:
    """Print one JSON object, nan as null."""
    from fg_orient.run.json import dumps

    typer.echo(dumps(record, indent=1))


def emit_errors(*problems: Problem) -> None:
    """Print the errors as JSON."""
    emit({"errors": [p.as_dict() for p in problems]})


@contextlib.contextmanager
def outcome(as_json: bool, debug: bool = False) -> Iterator[None]:
    """Turn exceptions into one line per problem and an exit code.

    Raises
    ------
    typer.Exit
        With the code of the exception: 2 bad input, 3 no solution, 130 interrupted, 1 a bug.
    """
    try:
        yield
    except typer.Exit:
        raise
    except FgOrientError as error:
        if as_json:
            emit_errors(*error.problems)
        for found in error.problems:
            note(f"error: {found}")
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt as stopped:
        note(str(stopped) or "interrupted: nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone; nobody is left to be told
        raise typer.Exit(1) from None
    except Exception as error:
        if debug:
            traceback.print_exc()
        found = internal(error, debug)
        if as_json:
            emit_errors(found)
        note(found)
        raise typer.Exit(1) from None


def internal(error: Exception, debug: bool) -> Problem:
    """Describe an exception that should not have happened: a fault of the program, not of the input."""
    hint = "" if debug else " (the same command with --debug shows where)"
    text = f"error of the program: {type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return Problem("internal", text, remedy=f"please report it{hint}")


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], *, left: int = 1) -> None:
    """Print a table of at most 80 columns; the first ``left`` columns are aligned to the left."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    out = Table(title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1))
    for k, name in enumerate(columns):
        out.add_column(name, justify="left" if k < left else "right", overflow="fold")
    for row in rows:
        out.add_row(*(Text(printable(cell)) for cell in row))
    console = Console(file=sys.stdout, width=min(WIDTH, Console().width), highlight=False)
    console.print(out)


@contextlib.contextmanager
def progress_bar(first: str, silent: bool) -> Iterator[Callable[[int, int, str], None] | None]:
    """Show a bar on the terminal, if standard error is one; ``first`` stands beside it until the first step is done."""
    if silent or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}", markup=False)
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(first, total=None)

        def update(done: int, total: int, text: str) -> None:
            bar.update(task, completed=done, total=total, description=text)

        yield update


def number(value: object, digits: int = 3) -> str:
    """Write a number for people; a dash where there is none."""
    return "-" if not isinstance(value, (int, float)) or value != value else f"{value:.{digits}f}"


def read_image(path: Path, model: str, extrapolate_s: float, result: Path | None = None, image_id: str = "") -> Any:
    """Read a sensor as the options ``--model``, ``--extrapolate-attitude`` and ``--result`` say."""
    from fg_orient.io.sensor import read_sensor

    sensor = read_sensor(path, model=model, extrapolate_attitude_s=extrapolate_s)
    return sensor if result is None else with_result(sensor, result, image_id)


def with_result(sensor: Any, result: Path, image_id: str = "") -> Any:
    """Sensor with the orientation of a result folder."""
    from fg_orient.raster.adjusted import read_correction
    from fg_orient.sensors.oriented import OrientedSensor

    return OrientedSensor(sensor, read_correction(result, sensor, image_id))


def read_dem(path: Path | None, vertical_crs: str) -> RasterDem | None:
    """Read a DEM as the options ``--dem`` and ``--dem-vertical-crs`` say."""
    if path is None:
        if vertical_crs:
            raise InputError.of("dem.missing", place="--dem", value="none given")
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

    from fg_orient.io.atomic import write_text

    if path.exists() and not overwrite:
        raise InputError.of("output.exists", file=path, place="--out")
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for record in records:
        values = [record[name] for name in columns]
        writer.writerow(["" if v is None or v != v else str(v).lower() if isinstance(v, bool) else v for v in values])
    write_text(path, stream.getvalue())
