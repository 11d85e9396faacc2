"""Check the provenance in the record of a run, which another person may have written or changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints

from fg_orient.formats.schema import FilePath, Positive, Switch, validate
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError, finding
from fg_orient.model.options import Options, Reading

_STRICT: Final = Field(strict=True)
Word = Annotated[str, _STRICT]
Digest = Annotated[str, _STRICT, StringConstraints(pattern="^[0-9a-f]{64}$")]


def _declared(values: dict[str, Any]) -> dict[str, Any]:
    """Refuse a name that is not an option of a project, or a value that the option cannot have."""
    known = declared(Options, Reading)
    for name, value in values.items():
        one = known.get(name)
        if one is None or not (one.allows(value) or (one.named and isinstance(value, str))):
            raise ValueError
    return values


class _Entry(BaseModel):
    """Entry of a record; later versions may add keys."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class _File(_Entry):
    file: FilePath
    sha256: Digest


class _Dem(_File):
    sigma_m: Positive
    vertical_crs: Word


class _Start(_Entry):
    folder: FilePath
    prior: Switch
    files: dict[FilePath, Digest]


class _Repeat(_Entry):
    options: Annotated[dict[Word, Any], AfterValidator(_declared)]
    parts: Annotated[int, _STRICT, Field(gt=0)] | None
    in_parts: Switch
    dem_control: _Dem | None
    start: _Start | None = None


class _Provenance(_Entry):
    inputs: tuple[_File, ...] = Field(min_length=1)
    versions: dict[Word, Word | None] = Field(min_length=1)
    command: tuple[Word, ...] = Field(min_length=1)
    repeat: _Repeat


class _Record(_Entry):
    provenance: _Provenance


def require_repeatable(record: Mapping[str, Any], file: Path) -> None:
    """Raise InputError if a record does not contain everything that ``replay`` needs; all wrong keys are named.

    Parameters
    ----------
    record : mapping
        Content of ``result.json``.
    file : Path
        That file, for messages.
    """
    try:
        validate(dict(record), str(file), _Record)
    except InputError as error:
        problems = (finding("replay.record", file=file, place=p.place, value=p.value) for p in error.problems)
        raise InputError(*problems) from None
