"""Common parts of all commands: options, exit codes, output as JSON or words, shared inputs."""

from __future__ import annotations

import contextlib
import functools
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import typer

from factors._preparation import on_compilation, preparing_seconds
from fg_orient.cli.log import opened, session
from fg_orient.cli.output import emit_errors, fault, flag, folded, note, tell
from fg_orient.cli.progress import COMPILING, COMPILING_IN_VAIN
from fg_orient.model.declaration import Names, Option, Three, declared, require_finite
from fg_orient.model.digits import decimal
from fg_orient.model.errors import FgOrientError, Finding, InputError, NoSolutionError, finding
from fg_orient.model.options import MAX_EXTRAPOLATION_S, Reading
from fg_orient.model.paths import path_fault

if TYPE_CHECKING:
    from fg_orient.model.block import Block, Image
    from fg_orient.sensors.surface import RasterDem

INTERRUPTED: Final = 130
#: Keyword argument of a command. It contains the declared options that the user gave, as a dict by name.
GIVEN: Final = "options"
#: For these faults of a user's own file, --debug shows the traceback.
PLUGINS: Final = ("plugin.failed", "sensor.own_reader")
#: A command prints a note if compilation takes longer than this, s.
NOTED_S: Final = 0.5
_NAMED: Final = re.compile("`([a-z_]+)`")
#: Number of lines or samples of an image: 1 to 999 999 999, because other programs store it in 32 bits.
_SIZE: Final = re.compile("0*[1-9][0-9]{0,8}")


def option(help: str, metavar: str | None = None, *, flag: str = "", **more: Any) -> Any:
    """Make an option of a command that no dataclass declares; ``flag`` is given if it is not the parameter's name."""
    return typer.Option(*filter(None, (flag,)), metavar=metavar, help=help, **more)


def argument(metavar: str, help: str) -> Any:
    """Make an argument of a command."""
    return typer.Argument(metavar=metavar, help=help, show_default=False)


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors and doubts only, no progress and no tables.")]
Log = Annotated[Path | None, option("Append each event to this file, one JSON object per line.", "FILE")]
Json = Annotated[bool, option("Print one JSON object on standard output and nothing else.", flag="--json")]
Debug = Annotated[bool, option("Show the traceback of an error of the program itself.", flag="--debug")]
#: Names of the parameters of commands that name an output.
OUTPUTS: Final = ("out", "export", "photos_out")
#: Options that every command has.
SHARED: Final = {"quiet": (Quiet, False), "log": (Log, None), "as_json": (Json, False), "debug": (Debug, False)}


class Several(NamedTuple):
    """Several options of a command with their defaults, and a function that combines them to one argument."""

    options: Mapping[str, tuple[Any, Any]]
    make: Callable[..., Any]


def command(
    *records: type,
    only: Collection[str] = (),
    named: Mapping[str, str] | None = None,
    defaults: Mapping[str, Any] | None = None,
    several: Mapping[str, Several] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command: add the shared options, the exit codes, and the options that dataclasses declare.

    Parameters
    ----------
    *records : type
        Dataclasses that declare options.
    only : collection of str
        Names of the declared options to add; default: all.
    named : mapping, optional
        Flags by the names of the library's arguments, if the two differ.
    defaults : mapping, optional
        Defaults of this command for its help, if they differ from the declared defaults.
    several : mapping, optional
        Parameters of the function that several options together give. These options are last.
    """
    own, joined = defaults or {}, several or {}
    options = [replace(one, default=own.get(name, one.default))
               for name, one in declared(*records).items() if not only or name in only]  # fmt: skip
    flags = {one.name: one.flag for one in options} | dict(named or {})

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(function, eval_str=True)

        @functools.wraps(function)
        def run(**values: Any) -> None:
            quiet, log, as_json, debug = (values.pop(name) for name in SHARED)
            if options:
                given = {one.name: _value(one, values) for one in options}
                values[GIVEN] = {name: value for name, value in given.items() if value is not None}
            with outcome(as_json, debug, quiet, log, flags):
                _require_paths(values, log)
                require_finite(values)
                for name, one in joined.items():
                    values[name] = one.make(**{part: values.pop(part) for part in one.options})
                function(**values)

        made: list[inspect.Parameter] = []
        for name, own in signature.parameters.items():
            made += [p for one in options for p in _parameters(one)] if name == GIVEN else [own] * (name not in joined)
        for shared in (*(one.options for one in joined.values()), SHARED):
            made += [_keyword(name, kind, default) for name, (kind, default) in shared.items()]
        run.__signature__ = signature.replace(parameters=made)  # type: ignore[attr-defined]
        return run

    return decorate


def _require_paths(values: Mapping[str, Any], log: Path | None) -> None:
    """Raise InputError if no file can have a path, or an output is an input, one of its files or another output."""
    named = [
        (name, path) for name, value in {**values, "log": log}.items()
        for path in (value if isinstance(value, list | tuple) else [value]) if isinstance(path, Path)
    ]  # fmt: skip
    faults = [fault for name, path in named if name != "log" and (fault := path_fault(path)) is not None]
    if faults:
        raise InputError(*faults)
    for k, (name, out) in enumerate(named):
        others = [path for other, (_, path) in enumerate(named) if other != k]
        if name in OUTPUTS and any(_would_replace(out, path) for path in others):
            raise InputError.of("output.is_input", file=out, option=name)


def _would_replace(out: Path, path: Path) -> bool:
    """Return whether an output is an input file, or a file of an input folder that is a result of ``adjust``."""
    with contextlib.suppress(OSError, ValueError):  # ValueError: the output is outside the folder
        if out.is_dir() or not out.exists():
            return False
        if not path.is_dir():
            return out.samefile(path)
        from fg_orient.formats.atomic import RESULT

        name = out.resolve().relative_to(path.resolve())
        return (path / RESULT.mark).is_file() and any(name.match(one) for one in RESULT.names)
    return False


@contextlib.contextmanager
def outcome(
    as_json: bool, debug: bool = False, quiet: bool = False, log: Path | None = None,
    flags: Mapping[str, str] | None = None,
) -> Iterator[None]:  # fmt: skip
    """Write the log; convert an exception to one line for each problem and ``typer.Exit``.

    Exit codes are 2 for bad input, 3 for no solution, 130 after an interruption, 1 for an error of the program.
    """
    with (
        _explained(as_json, debug), opened(log, as_json=as_json, quiet=quiet, flags=flags), _explained(as_json, debug),
        on_compilation(_CompilationNote()),
    ):  # fmt: skip
        yield


class _CompilationNote:
    """Prints once for each command that kernels are compiled, if this takes longer than ``NOTED_S``."""

    def __init__(self) -> None:
        self._begin, self._noted = preparing_seconds(), False

    def __call__(self, kernel: str) -> None:
        if self._noted or preparing_seconds() - self._begin < NOTED_S:
            return
        self._noted = True
        from factors._compile import cache_folder

        text = COMPILING if cache_folder() is not None else COMPILING_IN_VAIN
        if session().as_json:
            session().tell("note", text=text)
        else:
            tell("note", text)


@contextlib.contextmanager
def _explained(as_json: bool, debug: bool) -> Iterator[None]:
    """Convert an exception to one line for each problem and an exit code."""
    try:
        yield
    except typer.Exit:
        raise
    except FgOrientError as error:
        if debug and any(p.code in PLUGINS for p in error.problems):
            traceback.print_exc()
        if as_json:
            emit_errors(*error.problems)
        for problem in folded(error.problems):
            fault(problem)
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt as stopped:
        texts = [one.text(flag) for one in stopped.args if isinstance(one, Finding)]
        note("".join(texts) or str(stopped) or "interrupted: nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        sys.stderr.close()  # the program that reads our output has ended
        raise typer.Exit(1) from None
    except Exception as error:
        from fg_orient.model.machine import is_out_of_memory
        from fg_orient.model.plugins import fault_of

        if debug:
            traceback.print_exc()
        if is_out_of_memory(error):
            short = finding("program.memory", value=in_short(error))
            if as_json:
                emit_errors(short)
            fault(short)
            raise typer.Exit(NoSolutionError.exit_code) from None
        own = fault_of(error)
        problem = own or internal(error, debug)
        if as_json:
            emit_errors(problem)
        if own:
            fault(own)
            raise typer.Exit(InputError.exit_code) from None
        session().tell("error", **problem.as_dict(flag))
        note(problem.text(flag))
        raise typer.Exit(1) from None


def in_short(error: BaseException) -> str:
    """Return the text of an exception in one line of at most 300 characters.

    If it has no text, return its type.
    """
    return " ".join(str(error).split())[:300] or type(error).__name__


def internal(error: Exception, debug: bool) -> Finding:
    """Make the finding for an error of the program itself."""
    hint = "" if debug else " (the same command with --debug shows where)"
    text = " ".join(str(error).split())[:300]
    return finding("internal", kind=type(error).__name__, text=text, hint=hint)


def _parameters(option: Option) -> Iterator[inspect.Parameter]:
    """Return the parameters of a command for an option.

    Their default None means that the user did not give it.
    """
    kind: Any = option.kind if option.kind in (int, float) and not option.named else str
    kind = list[str] if option.kind is Names else kind  # one list, or the option several times
    name, flag = option.name, option.flag
    if option.kind is bool:
        yield _parameter(option, name, bool, f"{flag}/--no-{flag[2:]}")
    elif option.usual:
        yield _parameter(option, _usual(option), bool, flag)
        yield _parameter(
            option,
            name,
            kind,
            f"{flag}-of",
            help=f"The same for the named groups only, such as {','.join(option.usual[:2])}.",
        )
    else:
        yield _parameter(option, name, kind, flag)


def _parameter(option: Option, name: str, kind: Any, flag: str, help: str = "") -> inspect.Parameter:
    info = typer.Option(
        flag, metavar=None if kind is bool else option.metavar, help=help or _help(option), show_default=False,
        rich_help_panel=option.group.title,
    )  # fmt: skip
    return _keyword(name, Annotated[kind | None, info], None)


def _keyword(name: str, kind: Any, default: object) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=kind)


def _help(option: Option) -> str:
    """Return the first sentence of the help with options as flags, and the default as the user types it."""
    own = {option.name: option.flag}
    text = _NAMED.sub(lambda match: own.get(match[1]) or flag(match[1]), option.short_help)
    default = ",".join(map(str, option.default)) if option.kind is Three else option.default_text
    if option.kind is bool:
        default = option.flag if option.default else ""
    return f"{text[:-1]}; default: {default}." if default else text


def _usual(option: Option) -> str:
    """Return the name of the parameter that applies an option to its usual names only."""
    return f"usual_{option.name}"


def _value(option: Option, values: dict[str, Any]) -> Any:
    """Take an option out of the arguments of a command and return its value; None if the user did not give it."""
    value, usual = values.pop(option.name), values.pop(_usual(option), None)
    if value is None:
        return option.usual if usual else None
    if option.kind not in (Names, Three):
        return value
    text = value if isinstance(value, str) else ",".join(value)
    parts = tuple(part.strip() for part in text.split(",") if part.strip())
    try:
        return parts if option.kind is Names else tuple(map(decimal, parts))
    except ValueError:
        return parts  # the parts are not numbers; the later check of all values reports this


LIGHT = declared(Reading)["light"]
EXTRAPOLATE = declared(Reading)["extrapolate_attitude_s"]
ModelOf = Annotated[str, option("Model to use if the file contains both.", "auto|rigorous|rpc")]
Result = Annotated[Path | None, option("Result folder of adjust with the orientation of the image.", "DIR")]
Dem = Annotated[
    Path | None, option("DEM, a raster that GDAL reads; heights are ellipsoidal unless it states a vertical CRS.")
]
VerticalCrs = Annotated[
    str, option("Vertical CRS of a DEM without one, such as EGM96, or a geoid file.", "EPSG:N|NAME|FILE")
]
Extrapolate = Annotated[
    float,
    option(EXTRAPOLATE.short_help, EXTRAPOLATE.metavar, flag=EXTRAPOLATE.flag, min=0.0, max=MAX_EXTRAPOLATION_S),
]
Light = Annotated[str, option(LIGHT.short_help, LIGHT.metavar, flag=LIGHT.flag)]
Project = Annotated[Path, argument("PROJECT.toml", "Project file.")]
Scheduler = Annotated[str | None, option("Scheduler of a running dask cluster, instead of processes.", "ADDRESS")]
ImageSize = Annotated[
    list[str] | None, option("Size of an image, for formats that need it; may be repeated.", "NAME=LINES,SAMPLES")
]
#: Options for values that point files of other programs and offices may not contain.
SigmaGround = Annotated[
    tuple[float, float, float] | None,
    option("Standard deviations of ground points that have none, m.", "EAST NORTH UP"),
]
SigmaImage = Annotated[
    tuple[float, float] | None, option("Standard deviations of image points that have none, pixels.", "LINE SAMPLE")
]
Height = Annotated[float | None, option("Height of points that have none, m.")]
CheckIds = Annotated[list[str] | None, option("Id of a point that becomes a check point; may be repeated.", "ID")]
Overwrite = Annotated[bool, option("Replace an existing output once the new one is complete.", flag="--overwrite")]


def command_line() -> list[str]:
    """Return the words of this command line for the record of a result, with escapes for bytes that are not UTF-8."""
    return ["fg-orient", *(word.encode(errors="backslashreplace").decode() for word in sys.argv[1:])]


def image_sizes(words: list[str] | None) -> dict[str, tuple[int, int]]:
    """Read image sizes (lines, samples) by name; raise InputError for other texts."""
    sizes = {}
    for word in words or []:
        name, _, size = word.rpartition("=")
        parts = size.split(",")
        if not name or len(parts) != 2 or not all(map(_SIZE.fullmatch, parts)):
            raise InputError.of("interchange.image_size", option="image_size", value=word)
        sizes[name] = int(parts[0]), int(parts[1])
    return sizes


def require_project(path: Path) -> None:
    """Raise InputError if the project file does not exist or is a folder.

    Call this before large modules are loaded.
    """
    if not path.is_file():
        from fg_orient.formats.toml import no_project_file

        raise no_project_file(path)


def effects_of(text: str) -> tuple[str, ...]:
    """Return the names of effects on light from ``--light``."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


class Sensors(NamedTuple):
    """Reads sensors with the options ``--model``, ``--extrapolate-attitude``, ``--light`` and ``--result``."""

    model: str
    extrapolate_attitude: float
    light: str
    result: Path | None

    def read(self, path: Path) -> Any:
        """Read the sensor of a metadata file."""
        from fg_orient.formats.sensor import read_sensor

        sensor = read_sensor(
            path, model=self.model, extrapolate_attitude_s=self.extrapolate_attitude, light=effects_of(self.light)
        )
        return self._oriented(sensor)

    def project(self, path: Path) -> Block:
        """Read a project with these options."""
        from fg_orient.formats.project import read_project

        block = read_project(path, **self._overrides())
        return replace(block, images=self._all_oriented(block.images))

    def images(self, path: Path) -> tuple[Image, ...]:
        """Read the images of a project with these options; the project may have no image points yet."""
        from fg_orient.formats.project import has_observations, read_images

        if has_observations(path):
            return self.project(path).images
        return self._all_oriented(read_images(path, **self._overrides()).images)

    def _overrides(self) -> dict[str, object]:
        return {"extrapolate_attitude_s": self.extrapolate_attitude or None, "light": effects_of(self.light) or None}

    def _all_oriented(self, images: tuple[Image, ...]) -> tuple[Image, ...]:
        return tuple(replace(image, sensor=self._oriented(image.sensor, image.id)) for image in images)

    def _oriented(self, sensor: Any, image_id: str = "") -> Any:
        """Return the sensor with the orientation from the result folder, if this folder is given."""
        if self.result is None:
            return sensor
        from fg_orient.rectification.ortho_models import read_orientation
        from fg_orient.sensors.base import OrientedSensor

        return OrientedSensor(sensor, *read_orientation(self.result, sensor, image_id))


#: These options replace the parameter ``sensors`` of a command.
SENSORS = {"sensors": Several(
    {"model": (ModelOf, "auto"), "extrapolate_attitude": (Extrapolate, 0.0), "light": (Light, ""),
     "result": (Result, None)}, Sensors
)}  # fmt: skip


def read_dem(path: Path | None, vertical_crs: str, memory_limit_gb: float | None = None) -> RasterDem | None:
    """Open a DEM with the options ``--dem`` and ``--dem-vertical-crs``; its caches follow the memory limit."""
    if path is None:
        if vertical_crs:
            raise InputError.of("dem.missing", option="dem", value="none given")
        return None
    return open_dem(path, vertical_crs, memory_limit_gb)


def open_dem(path: Path, vertical_crs: str = "", memory_limit_gb: float | None = None) -> RasterDem:
    """Open a DEM; when heights are read that are impossible on land, a warning is printed."""
    from fg_orient.sensors.surface import RasterDem

    warn = functools.partial(tell, "warning")
    return RasterDem(path, vertical_crs=vertical_crs, warn=warn, memory_limit_gb=memory_limit_gb)
