"""Photo files of close range: TOML with cameras, oriented or not.

One ``[[photos]]`` table per photo: either ``focal`` with ``principal`` and ``y_axis`` (and, once it is oriented,
``rotation`` and ``centre_m``), or the ``matrix`` of a DLT with its ``origin_m``; docs/closerange.md describes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from fg_orient.errors import InputError, problem
from fg_orient.io.project import parse_toml
from fg_orient.io.schema import Text, problems_of
from fg_orient.io.schema import _Table as Table

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Two = tuple[Number, Number]
Three = tuple[Number, Number, Number]
Four = tuple[Number, Number, Number, Number]


class PhotoEntry(Table):
    """One ``[[photos]]`` table."""

    name: Text = Field(description='a name in quotes, such as "left"')
    focal: Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)] | None = Field(
        default=None, description="the principal distance, in the unit of the image coordinates, above 0"
    )
    principal: Two = Field(default=(0.0, 0.0), description="x and y of the principal point: [0.0, 0.0]")
    y_axis: Literal["up", "down"] = Field(default="up", description='"up" or "down"')
    k1: Number = Field(default=0.0, description="a number")
    k2: Number = Field(default=0.0, description="a number")
    k3: Number = Field(default=0.0, description="a number")
    p1: Number = Field(default=0.0, description="a number")
    p2: Number = Field(default=0.0, description="a number")
    affinity_a: Number = Field(default=0.0, description="a number")
    affinity_b: Number = Field(default=0.0, description="a number")
    rotation: tuple[Three, Three, Three] | None = Field(default=None, description="three rows of three numbers")
    centre_m: Three | None = Field(default=None, description="three numbers, m")
    matrix: tuple[Four, Four, Four] | None = Field(default=None, description="three rows of four numbers")
    origin_m: Three = Field(default=(0.0, 0.0, 0.0), description="three numbers, m")

    @property
    def corrections(self) -> tuple[float, ...]:
        """Coefficients from measured to ideal coordinates, in the order of ``factors.image_corrections``."""
        return (self.k1, self.k2, self.k3, self.p1, self.p2, self.affinity_a, self.affinity_b)


class PhotoFile(Table):
    """A whole photo file."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    photos: tuple[PhotoEntry, ...] = Field(min_length=1, description="at least one [[photos]] table with a name")


@dataclass(frozen=True)
class Photos:
    """What a photo file says.

    Parameters
    ----------
    file : str
    entries : dict of str to PhotoEntry
        By name, in the order of the file.
    """

    file: str
    entries: dict[str, PhotoEntry]


def read_photos(path: Path) -> Photos:
    """Read a photo file.

    Raises
    ------
    InputError
        All faults of the file; a name that occurs twice.
    """
    try:
        found = PhotoFile.model_validate(parse_toml(path))
    except ValidationError as error:
        raise InputError(*problems_of(error, str(path), PhotoFile)) from None
    entries: dict[str, PhotoEntry] = {}
    for k, entry in enumerate(found.photos):
        if entry.name in entries:
            raise InputError(problem("project.image_twice", file=path, place=f"photos[{k + 1}].name", value=entry.name))
        entries[entry.name] = entry
    return Photos(str(path), entries)
