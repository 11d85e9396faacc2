"""Registry of file formats. The module that reads and writes a format contains its record.

No list of formats is needed: a :class:`Format` in a module of ``formats.exchange``
(points, frame models), ``formats.rpc`` or ``formats.metadata`` (images) is found
automatically. A user's own file calls :func:`register_format`.
"""

from __future__ import annotations

import os
import re
import sys
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal

from fg_orient.formats.faults import did_you_mean
from fg_orient.model.errors import Finding, InputError

if TYPE_CHECKING:
    from fg_orient.formats.exchange.survey import Survey
    from fg_orient.formats.frame_model import FrameModel
    from fg_orient.formats.office.decisions import Office
    from fg_orient.formats.rpc.fields import Reading
    from fg_orient.sensors.rpc import RpcModel

#: Package in which the formats with these contents are searched for.
Contents = Literal["points", "rpc", "image"]
_PACKAGES: Final[dict[Contents, str]] = {
    "points": "fg_orient.formats.exchange", "rpc": "fg_orient.formats.rpc", "image": "fg_orient.formats.metadata",
}  # fmt: skip
#: The format of a file is recognised from this number of bytes at its beginning.
HEAD_BYTES: Final = 2**16
#: Beginnings and ends of instructions and comments of XML.
_ASIDES: Final = (("<?", "?>"), ("<!--", "-->"))
_ROOT: Final = re.compile(r"<([A-Za-z_][\w.-]*)")


class Holds(StrEnum):
    """Information that a format can contain. Other information is reported as lost."""

    GROUND = "ground points"
    IMAGE = "image points"
    IDS = "ids of points"
    NUMBERS = "ids that are whole numbers"
    IMAGES = "several images"
    UNMEASURED = "ground points that no image shows"
    TIES = "points without coordinates"
    BARE_TIES = "points with neither coordinates nor image points"
    ROLES = "roles"
    HEIGHTS = "heights"
    SIGMA_GROUND = "standard deviations of ground points"
    SIGMA_UP = "a separate standard deviation of the height"
    SIGMA_EAST_NORTH = "different standard deviations to the east and north"
    SIGMA_IMAGE = "standard deviations of image points"
    FIXED = "points without uncertainty"
    CRS = "the CRS"
    VERTICAL_CRS = "the vertical CRS"


#: Contents of files with tie points only.
TIES_ONLY: Final = frozenset({Holds.IMAGE, Holds.IMAGES, Holds.TIES})
#: Contents of tables with ground points and image points.
POINTS_AND_MARKS: Final = TIES_ONLY | {
    Holds.GROUND, Holds.IDS, Holds.UNMEASURED, Holds.HEIGHTS, Holds.SIGMA_GROUND, Holds.SIGMA_UP
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """Values that a file does not contain and that the user gives.

    Parameters
    ----------
    crs : str
        CRS of the coordinates, ``EPSG:n`` or ``EPSG:n+m``; "" if the file states it.
    image : str
        Name of the image, for formats that contain one image without its name.
    sigma_axes : str
        "ecef" or "enu": axes of the standard deviations in .gcp files of ASP.
    image_sizes : mapping of str to (n_lines, n_samples)
        Sizes of the images, for formats with the origin in another corner or in the middle.
    incomplete : bool
        Our own tables may lack roles, heights and standard deviations; the user gives them.
    office : Office, optional
        Statements of the user about tables of unknown form.
    sensors : mapping of str to Sensor
        Sensors of the images into which the points of such tables are projected.
    """

    crs: str = ""
    image: str = ""
    sigma_axes: str = "ecef"
    image_sizes: Mapping[str, tuple[int, int]] = field(default_factory=lambda: MappingProxyType({}))
    incomplete: bool = False
    office: Office | None = None
    sensors: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def require_images(self, names: Sequence[str], file: object) -> None:
        """Raise InputError if ``image_sizes`` names an image that the file does not contain."""
        for name in self.image_sizes:
            if name not in names:
                known = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
                raise InputError.of("interchange.no_image", file=file, option="image_size", value=name, known=known)


@dataclass(frozen=True, kw_only=True)
class Format:
    """Record of a file format in the registry.

    Parameters
    ----------
    name : str
        Unique name for options and project files.
    title : str
        Title in words, with the name of the program.
    help : str
        Description of the files. Default: the docstring of the module that contains its functions.
    suffixes : tuple of str
        Lower-case suffixes of its file names. They identify the format if no other format has them.
    sniff : callable, optional
        ``sniff(path, head)`` returns whether a file has this format. ``head`` is the text of
        its first 64 kB, one character for each byte, or "" if the file does not exist. The
        function must not raise exceptions. If it is None, the suffix is sufficient.
    files : tuple of str
        Contents of each file. The name of a second file is the name of the first one and this word.
    first_pixel : tuple of float or None
        Line and sample of the centre of the first pixel in this format; None if it contains no image points.
    pixel_axes, ground_axes : str
        Order, direction and unit of the coordinates in words.
    holds : frozenset of Holds
        Information that the format can contain.
    needs : frozenset of Holds
        Information that the format requires for every image point, or for every point with coordinates.
    evidence : str
        Files of other programs with which the reader was tested; "" makes the format unverified.
    crs : str
        CRS that the format requires; "" if any CRS is allowed.
    read, write : callables, optional
        Reader and writer of points. The reader takes files and settings and returns a
        survey. The writer takes a survey, files and settings and returns a list of
        further information that is lost.
    read_model, write_model : callables, optional
        Reader and writer of a whole frame model. The writer takes the path, the model and
        whether to overwrite. It returns the lost information in words.
    read_rpc, write_rpc : callables, optional
        The reader takes the path and a ``Reading`` and returns an ``RpcModel``. The writer
        takes the path and the model.
    read_image : callable, optional
        The reader takes the path and returns the sensor of the image. It receives the keyword
        ``extrapolate_attitude_s`` only if ``extrapolates`` is true, and ``light`` only if
        ``chooses_light`` is true.
    write_image : callable, optional
        The writer takes the path, the sensor and its correction or None. It returns a
        record of the differences between the file and the image. If ``in_bands``, its
        fourth argument is the first column of a band and the column after its last one.
    extrapolates : bool
        Whether ``read_image`` accepts the keyword ``extrapolate_attitude_s``.
    in_bands : bool
        Whether ``write_image`` also writes a band of the columns of a pushbroom image.
    chooses_light : bool
        Whether ``read_image`` accepts the keyword ``light``: names of effects on light
        (``fg_orient.sensors.light_sizes``).
    beside_rpc : bool
        Whether its files may also contain an RPC; the user selects it with the model "rpc".
    """

    name: str
    title: str
    help: str = ""
    suffixes: tuple[str, ...] = ()
    sniff: Callable[[Path, str], bool] | None = None
    files: tuple[str, ...] = ("points",)
    first_pixel: tuple[float, float] | None = None
    pixel_axes: str = "none"
    ground_axes: str = "none"
    holds: frozenset[Holds] = frozenset()
    needs: frozenset[Holds] = frozenset()
    evidence: str = ""
    crs: str = ""
    read: Callable[[tuple[Path, ...], Settings], Survey] | None = None
    write: Callable[[Survey, tuple[Path, ...], Settings], Sequence[Finding] | None] | None = None
    read_model: Callable[[tuple[Path, ...], Settings], FrameModel] | None = None
    write_model: Callable[[Path, FrameModel, bool], tuple[str, ...]] | None = None
    read_rpc: Callable[[Path, Reading], RpcModel] | None = None
    write_rpc: Callable[[Path, RpcModel], None] | None = None
    read_image: Callable[..., Any] | None = None
    write_image: Callable[..., dict[str, Any]] | None = None
    in_bands: bool = False
    extrapolates: bool = False
    chooses_light: bool = False
    beside_rpc: bool = False

    @property
    def verified(self) -> bool:
        """Return whether the reader was tested with another program's file, or another program has read our file."""
        return bool(self.evidence)

    @property
    def contents(self) -> frozenset[Contents]:
        """Return the contents of its files."""
        points = self.read or self.write or self.read_model or self.write_model
        given: dict[Contents, object] = {
            "points": points, "rpc": self.read_rpc or self.write_rpc, "image": self.read_image,
        }  # fmt: skip
        return frozenset(kind for kind, function in given.items() if function)

    def paths(self, first: Path) -> tuple[Path, ...]:
        """Return the names of all files of the format, for example ``scene.csv`` and ``scene_observations.csv``."""
        others = (first.with_name(f"{first.stem}_{word}{first.suffix}") for word in self.files[1:])
        return (first, *others)


_REGISTRY: dict[str, Format] = {}
#: Names of the fields that are functions. They are computed once, because they are used thousands of times.
_FUNCTIONS: Final = tuple(f.name for f in fields(Format) if f.name.startswith(("read", "write")))


def register_format(format_: Format) -> Format:
    """Add a format to the registry.

    Raises
    ------
    ValueError
        Another format has the same name.
    """
    format_ = replace(format_, help=format_.help or sys.modules[_sources(format_)[0][0]].__doc__ or "")
    present = _REGISTRY.get(format_.name, format_)
    if (present.title, _sources(present)) != (format_.title, _sources(format_)):
        raise ValueError(f"a format named {format_.name!r} is registered already")
    _REGISTRY[format_.name] = format_
    return format_


def _sources(format_: Format) -> list[tuple[str, str]]:
    """Return the module and name of each function.

    These names are unchanged if a user's file is loaded again.
    """
    values = (getattr(format_, name) for name in _FUNCTIONS)
    return [(value.__module__, value.__qualname__) for value in values if value is not None]


def formats(contents: Contents = "points") -> dict[str, Format]:
    """Return all formats with these contents by name, in alphabetical order."""
    return dict(sorted((f.name, f) for f in _each(contents)))


def _each(contents: Contents) -> Iterator[Format]:
    """Yield the formats with these contents: formats of the user first, then ours.

    Each module is imported just before its formats are yielded.
    """
    seen: set[str] = set()
    package = import_module(_PACKAGES[contents])
    for module in ("", *sorted(info.name for info in iter_modules(package.__path__))):
        for value in vars(import_module(f"{package.__name__}.{module}")).values() if module else ():
            if isinstance(value, Format):
                register_format(value)
        for name, one in list(_REGISTRY.items()):
            own = not _sources(one)[0][0].startswith("fg_orient.")
            if contents in one.contents and name not in seen and (module or own):
                seen.add(name)
                yield one


def format_named(name: str, contents: Contents = "points", *, place: object = "format") -> Format:
    """Return the format with this name; raise InputError if it is unknown."""
    known = formats(contents)
    if name not in known:
        raise InputError.of("interchange.format", place=place, value=name, hint=did_you_mean(name, list(known)))
    return known[name]


def format_of(path: Path, *, place: object) -> Format:
    """Return the format of points that has the suffix of the file; the longest matching suffix decides.

    InputError: no format or several formats have this suffix.
    """
    name, known = path.name.lower(), formats()
    fit = {f: max((len(s) for s in f.suffixes if name.endswith(s)), default=0) for f in known.values()}
    longest = [f for f, length in fit.items() if length and length == max(fit.values())]
    if len(longest) != 1:
        names = ", ".join(f.name for f in (longest or known.values()))
        raise InputError.of("interchange.which", file=path, place=place, value=path.suffix or path.name, known=names)
    return longest[0]


def format_claiming(path: Path, contents: Contents) -> Format | None:
    """Return the first format that recognises a file, else None.

    Raise InputError if the file cannot be read.
    """
    head = read_bytes(path, HEAD_BYTES).removeprefix(BOM_UTF8).decode("latin-1") if path.is_file() else ""
    for one in _each(contents):
        if one.sniff(path, head) if one.sniff else path.name.lower().endswith(one.suffixes):
            return one
    return None


# --- recognition by content ----------------------------------------------------------------------


def read_bytes(path: str | os.PathLike[str], size: int, code: str = "rpc.unreadable") -> bytes:
    """Read the first bytes of a file; ``code`` is the code of the message if this fails.

    Raises
    ------
    InputError
        The file does not exist or cannot be read.
    """
    file = os.fspath(path)
    try:
        if not Path(path).exists():
            raise InputError.of("xml.missing_file", file=file, base=Path.cwd())
        if not Path(path).is_file():
            raise InputError.of("xml.not_a_file", file=file)
        with Path(path).open("rb") as stream:
            return stream.read(size)
    except OSError as error:
        raise InputError.of(code, file=file, value=error.strerror) from error


def xml_root(head: str) -> str:
    """Return the name of the root element of an XML file; "" if the file is not XML."""
    if not head.lstrip().startswith("<"):
        return ""
    at = head.find("<")
    while at >= 0:
        for begin, end in _ASIDES:
            if head.startswith(begin, at):
                at = head.find(end, at + len(begin))
                break
        else:
            match = _ROOT.match(head, at)
            if match:
                return match[1]
        at = head.find("<", at + 1) if at >= 0 else -1
    return ""


def has_line(pattern: str) -> Callable[[Path, str], bool]:
    """Make the ``sniff`` function of a text format: it looks for a line that begins with the pattern after blanks."""
    compiled = re.compile(rf"^[^\S\n]*+{pattern}", re.MULTILINE)
    return lambda _, head: "\0" not in head and compiled.search(head) is not None
