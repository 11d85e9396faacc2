"""Read photo files of close range, which are TOML files; docs/closerange.md describes them.

Each photo has one ``[[photos]]`` table. The table contains either ``focal``,
``principal`` and ``y_axis``, or the ``matrix`` of a DLT with its ``origin_m``. After the
orientation, the first kind also contains ``rotation`` and ``centre_m``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from fg_orient.formats.schema import Size, Table, Text, read_toml
from fg_orient.model.errors import InputError
from fg_orient.model.names import LARGEST
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation

#: Largest allowed coefficient. A coefficient has a unit of up to m to the power of -7, so it may be very large.
_COEFFICIENT: Final = 1e30

Number = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST)]
Coefficient = Annotated[float, Field(strict=True, ge=-_COEFFICIENT, le=_COEFFICIENT)]
Two = tuple[Number, Number]
Three = tuple[Number, Number, Number]
Four = tuple[Number, Number, Number, Number]


class PhotoEntry(Table):
    """One ``[[photos]]`` table."""

    name: Text = Field(description='a name in quotes, such as "left"')
    focal: Size | None = Field(
        default=None, description="the principal distance, in the unit of the image coordinates, 1e-12 to 1e12"
    )
    principal: Two = Field(default=(0.0, 0.0), description="x and y of the principal point, at most 1e12: [0.0, 0.0]")
    y_axis: Literal["up", "down"] = Field(default="up", description='"up" or "down"')
    k1: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    k2: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    k3: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    p1: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    p2: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    affinity_a: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    affinity_b: Coefficient = Field(default=0.0, description="a number, at most 1e30")
    rotation: tuple[Three, Three, Three] | None = Field(default=None, description="three rows of three numbers")
    centre_m: Three | None = Field(default=None, description="three numbers, m, at most 1e12")
    matrix: tuple[Four, Four, Four] | None = Field(default=None, description="three rows of four numbers")
    origin_m: Three = Field(default=(0.0, 0.0, 0.0), description="three numbers, m, at most 1e12")

    @property
    def corrections(self) -> tuple[float, ...]:
        """Return the coefficients that correct measured coordinates to ideal ones.

        Their order is the order of ``factors.cameras.image_corrections``.
        """
        return (self.k1, self.k2, self.k3, self.p1, self.p2, self.affinity_a, self.affinity_b)


class PhotoFile(Table):
    """A whole photo file."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    photos: tuple[PhotoEntry, ...] = Field(min_length=1, description="at least one [[photos]] table with a name")


@dataclass(frozen=True)
class Photos:
    """Contents of a photo file.

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
        The file has faults, a name occurs twice, or a matrix is not a rotation.
    """
    entries: dict[str, PhotoEntry] = {}
    for k, entry in enumerate(read_toml(path, PhotoFile).photos):
        if entry.name in entries:
            raise InputError.of("project.image_twice", file=path, place=f"photos[{k + 1}].name", value=entry.name)
        _require_rotation(entry, f"photos[{k + 1}].rotation of {entry.name}", path)
        entries[entry.name] = entry
    return Photos(str(path), entries)


def _require_rotation(entry: PhotoEntry, place: str, path: Path) -> None:
    """Refuse a matrix that is not a rotation, with the tolerance of ``sensors.frame``."""
    if entry.rotation is None:
        return
    away = float(away_from_rotation(np.array(entry.rotation)))
    if away > ORTHONORMAL:
        raise InputError.of("closerange.camera", file=path, place=place, value=not_a_rotation(away),
                            expected="rows that are unit vectors at right angles, right-handed")  # fmt: skip
