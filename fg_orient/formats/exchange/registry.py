"""The registry of formats: each module of this package adds its own, with its conventions as data.

A format is one module with a reader and a writer that calls :func:`register`. Its name in :data:`_MODULES` is all that
the rest needs: ``fg-orient convert``, the project file and the tables of the documentation go through here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Final

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.frame_model import FrameModel
from fg_orient.formats.tables import did_you_mean
from fg_orient.model.errors import Finding, InputError

#: Modules of this package that hold formats.
_MODULES: Final = (
    "asp_gcp",
    "asp_match",
    "bal",
    "bundler",
    "colmap_database",
    "colmap_text",
    "dbat",
    "geojson",
    "geopackage",
    "metashape_csv",
    "metashape_xml",
    "micmac",
    "micmac_csv",
    "odm",
    "own_csv",
    "photomodeler",
    "pix4d",
    "qgis_points",
)


class Holds(StrEnum):
    """What a file of a format can say; what it cannot is reported when it is lost."""

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
    SIGMA_UP = "a standard deviation of the height of its own"
    SIGMA_EAST_NORTH = "different standard deviations to the east and north"
    SIGMA_IMAGE = "standard deviations of image points"
    FIXED = "points without uncertainty"
    CRS = "the CRS"
    VERTICAL_CRS = "the vertical CRS"


@dataclass(frozen=True)
class Settings:
    """What a user may have to say because a file does not.

    Parameters
    ----------
    crs : str
        CRS of the coordinates, ``EPSG:n`` or ``EPSG:n+m``; "" if the file says it.
    image : str
        The image of a format that holds one image and not its name.
    sigma_axes : str
        "ecef" or "enu": axes of the standard deviations in ASP's .gcp.
    image_sizes : mapping of str to (n_lines, n_samples)
        Sizes of the images, for formats that count from another corner or from the middle.
    """

    crs: str = ""
    image: str = ""
    sigma_axes: str = "ecef"
    image_sizes: Mapping[str, tuple[int, int]] = field(default_factory=lambda: MappingProxyType({}))

    def require_images(self, names: Sequence[str], file: object) -> None:
        """Refuse sizes of images that a file does not have.

        Raises
        ------
        InputError
            Names the first one.
        """
        for name in self.image_sizes:
            if name not in names:
                known = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
                raise InputError.of("interchange.no_image", file=file, option="image_size", value=name, known=known)


Reader = Callable[[tuple[Path, ...], Settings], Survey]
#: A writer may give further losses, of which only it knows.
Writer = Callable[[Survey, tuple[Path, ...], Settings], "Sequence[Finding] | None"]
ModelReader = Callable[[tuple[Path, ...], Settings], FrameModel]
#: Gives what the format cannot hold, in words; the flag allows to overwrite.
ModelWriter = Callable[[Path, FrameModel, bool], tuple[str, ...]]


@dataclass(frozen=True)
class Format:
    """A format.

    Parameters
    ----------
    name : str
        For options and project files.
    title : str
        In words, with the program it belongs to.
    suffixes : tuple of str
        Ends of its file names, by which it is recognised if no other format has them.
    files : tuple of str
        What each of its files holds; the second is named after the first and this word.
    first_pixel : tuple of float or None
        Line and sample that the format gives the centre of the first pixel; None if it holds no image points.
    pixel_axes, ground_axes : str
        Order, direction and unit of the coordinates in words.
    holds : frozenset of Holds
        What it can say.
    needs : frozenset of Holds
        What it cannot do without, for every point with coordinates, or image point.
    read, write : callables
        Reader and writer; None where there is none.
    evidence : str
        What the reader was tried on besides our own files; "" makes the format unverified.
    crs : str
        The CRS that the format demands; "" if any will do.
    read_model, write_model : callables
        Reader and writer of a whole frame model (cameras, poses, points, image points); None where there is none.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    files: tuple[str, ...]
    first_pixel: tuple[float, float] | None
    pixel_axes: str
    ground_axes: str
    holds: frozenset[Holds]
    needs: frozenset[Holds]
    read: Reader | None
    write: Writer | None
    evidence: str = ""
    crs: str = ""
    read_model: ModelReader | None = None
    write_model: ModelWriter | None = None

    @property
    def verified(self) -> bool:
        """Tell whether a file that is not ours was read, or ours by another program."""
        return bool(self.evidence)

    def paths(self, first: Path) -> tuple[Path, ...]:
        """Names of all files of the format: ``scene.csv``, ``scene_observations.csv``."""
        others = (first.with_name(f"{first.stem}_{word}{first.suffix}") for word in self.files[1:])
        return (first, *others)


_REGISTRY: dict[str, Format] = {}


def register(format_: Format) -> Format:
    """Add a format.

    Raises
    ------
    ValueError
        Another format has its name.
    """
    if _REGISTRY.get(format_.name, format_) != format_:
        raise ValueError(f"a format named {format_.name!r} is registered already")
    _REGISTRY[format_.name] = format_
    return format_


def formats() -> dict[str, Format]:
    """All formats by name, in alphabetical order."""
    for module in _MODULES:
        import_module(f"fg_orient.formats.exchange.{module}")
    return dict(sorted(_REGISTRY.items()))


def format_named(name: str, *, place: str = "format") -> Format:
    """Find a format.

    Raises
    ------
    InputError
        There is none of this name.
    """
    known = formats()
    if name not in known:
        raise InputError.of("interchange.format", place=place, value=name, hint=did_you_mean(name, list(known)))
    return known[name]


def format_of(path: Path, *, place: str) -> Format:
    """Find the only format whose files end like this one; the longer end wins.

    Raises
    ------
    InputError
        None or several do.
    """
    name = path.name.lower()
    fit = {f: max((len(s) for s in f.suffixes if name.endswith(s)), default=0) for f in formats().values()}
    found = [f for f, length in fit.items() if length and length == max(fit.values())]
    if len(found) != 1:
        names = ", ".join(f.name for f in (found or formats().values()))
        raise InputError.of("interchange.which", file=path, place=place, value=path.suffix or path.name, known=names)
    return found[0]
