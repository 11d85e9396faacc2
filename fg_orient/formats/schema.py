"""Pydantic models of the project file and of constraint files.

Unknown keys, wrong types, nan and infinity are refused; one error lists all of them. The
``description`` of a field is its expected value in messages. The entries of options are made
from the declaration in ``fg_orient.model.options``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError, create_model
from pydantic.fields import FieldInfo

from fg_orient.formats.faults import did_you_mean
from fg_orient.formats.toml import parse_toml
from fg_orient.model import declaration as option_types
from fg_orient.model.constraint import Constraint, place_of
from fg_orient.model.declaration import Option, declared, toml
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import LARGEST, MAX_UNDULATION_M, SMALLEST
from fg_orient.model.options import Options, Reading
from fg_orient.model.paths import path_fault

Text = Annotated[str, Field(strict=True), StringConstraints(min_length=1, strip_whitespace=True)]
Positive = Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)]
#: Type of a length or standard deviation of a measurement.
Size = Annotated[float, Field(strict=True, ge=SMALLEST, le=LARGEST)]
Three = tuple[Positive, Positive, Positive]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Row = tuple[Number, Number, Number]
Switch = Annotated[bool, Field(strict=True)]
Model = TypeVar("Model", bound=BaseModel)


def _with_codes(crs: str) -> str:
    """Replace the names of a CRS by codes.

    An unknown name is not changed, and the reader refuses it.
    """
    from fg_orient.geodesy.crs import with_codes  # imported here, because it loads PROJ

    try:
        return with_codes(crs)
    except InputError:
        return crs


Crs = Annotated[Text, AfterValidator(_with_codes)]


def _possible(name: str) -> str:
    """Refuse a path that no file can have."""
    if path_fault(name) is not None:
        raise AssertionError
    return name


#: Kind of pydantic's error after AssertionError, which only :func:`_possible` raises.
_PATH: Final = "assertion_error"
FilePath = Annotated[Text, AfterValidator(_possible)]


class Table(BaseModel):
    """Table of a TOML file; unknown keys, nan and infinity are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ImageEntry(Table):
    """One ``[[images]]`` table."""

    id: Text = Field(description='a name in quotes, such as "left"')
    metadata: FilePath = Field(description="the path of the metadata file in quotes")
    held: Switch = Field(default=False, description="true or false: the orientation stays as in the metadata")
    pixels: FilePath | None = Field(default=None, description="the path of the raster with the pixels in quotes")
    pixels_origin: tuple[Number, Number] | None = Field(
        default=None, description="two numbers: line and sample of the raster's first pixel in the scene"
    )


class _Foreign(Table):
    """Entries of a table that may name a file of another program."""

    format: Text = Field(default="csv", description='the name of a format, such as "metashape-xml" (docs/formats)')
    image: str = Field(default="", description="the image of a format that contains one image without its name")
    sigma_axes: Literal["ecef", "enu"] = Field(default="ecef", description='"ecef" or "enu"')
    accept_unverified: Switch = Field(default=False, description="true or false")


class PointsEntry(_Foreign):
    """The ``[points]`` table."""

    file: FilePath | None = Field(default=None, description="the path of the point table in quotes")
    crs: Crs | None = Field(default=None, description='an EPSG code in quotes, such as "EPSG:4979"')
    sigma_m: Three | None = Field(default=None, description="three numbers above zero: East, North, Up, m")
    height_m: Number | None = Field(default=None, description="a number, m")
    geoid: FilePath | None = Field(default=None, description="the path of a geoid file in quotes")
    undulation_m: Number | None = Field(
        default=None, ge=-MAX_UNDULATION_M, le=MAX_UNDULATION_M,
        description=f"a number from {-MAX_UNDULATION_M:g} to {MAX_UNDULATION_M:g}, m",
    )  # fmt: skip
    both_heights: FilePath | None = Field(default=None, description="the path of a table of both heights in quotes")
    check: tuple[Text, ...] = Field(default=(), description='ids in quotes, such as ["7", "12"]')
    latitudinal: Switch = Field(default=False, description="true or false: observed by latitude, longitude, radius")


class ObservationsEntry(_Foreign):
    """The ``[observations]`` table."""

    file: FilePath = Field(description="the path of the observation table in quotes")
    crs: Crs | None = Field(default=None, description='an EPSG code in quotes, such as "EPSG:4979"')
    sigma_px: tuple[Positive, Positive] | None = Field(default=None, description="two numbers above zero, px")
    images: dict[str, Text] = Field(default_factory=dict, description='a table such as { "a.tif" = "left" }')


def _rotation(value: tuple[Row, Row, Row] | None) -> tuple[Row, Row, Row] | None:
    """Refuse a matrix that is not a rotation: its columns are not orthonormal, or it is a reflection."""
    if value is not None:
        from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation  # imported here, because it loads numba

        if away_from_rotation(np.array(value)) > ORTHONORMAL:
            raise ValueError
    return value


class NavigationEntry(Table):
    """The ``[navigation]`` table: positions and attitudes observed on board for frame images."""

    file: FilePath = Field(description="the path of the navigation table in quotes")
    crs: Crs = Field(description='an EPSG code in quotes, such as "EPSG:4979"')
    lever_m: Row = Field(default=(0.0, 0.0, 0.0), description="three numbers, m: receiver to projection centre")
    camera_from_body: Annotated[tuple[Row, Row, Row] | None, AfterValidator(_rotation)] = Field(
        default=None, description="three rows of three numbers, a rotation"
    )
    shift_sigma_m: Three | None = Field(default=None, description="three numbers above zero: East, North, Up, m")
    drift_sigma_m: Three | None = Field(default=None, description="three numbers above zero: East, North, Up, m")
    attitude_shift_sigma_deg: Three | None = Field(default=None, description="three numbers above zero, degrees")
    attitude_drift_sigma_deg: Three | None = Field(default=None, description="three numbers above zero, degrees")
    lever_sigma_m: Three | None = Field(default=None, description="three numbers above zero, m")
    boresight_sigma_deg: Three | None = Field(default=None, description="three numbers above zero, degrees")


class LinesEntry(Table):
    """The ``[lines]`` table: control by lines and splines."""

    file: FilePath = Field(description="the path of the table or GeoPackage of the features in quotes")
    observations: FilePath = Field(description="the path of the table of the image points on them in quotes")
    crs: Crs = Field(description='an EPSG code in quotes, such as "EPSG:4979"')


class ConstraintEntry(Table):
    """One ``[[constraints]]`` table of a project file or of a constraint file."""

    kind: Text = Field(description='the kind of the constraint, such as "distance" or "horizontal circle"')
    members: tuple[Text, ...] = Field(min_length=1, description='ids of points (or names of photos): ["1", "2"]')
    value_m: Size | None = Field(default=None, description="a distance or base, m")
    sigma: Size | None = Field(default=None, description="m (rad for angles) above 0; without it, a hard constraint")
    observed: dict[str, tuple[Size, Size]] = Field(default={}, description="name = [value, sigma], m, above 0")
    axis: Text = Field(default="y", description='"x", "y" or "z"')
    offset: tuple[Row, Row, Row] | None = Field(default=None, description="three rows of three numbers")


#: Types of options in a project file.
_TYPES: Final[dict[Any, Any]] = {
    bool: Switch, int: Annotated[int, Field(strict=True)], float: Number, str: Text, option_types.Three: Three,
    option_types.Names: tuple[Text, ...],
}  # fmt: skip


def _entry(option: Option) -> Any:
    """Return the type and default of an option in a project file.

    The declaration of the option checks the value.
    """

    def check(value: Any) -> Any:
        if not option.allows(value):
            raise ValueError
        return value

    kind = _TYPES.get(option.kind, option.kind)
    kind = kind | Text if option.named else Annotated[kind, AfterValidator(check)]
    name = f" or a name such as {toml(option.such)}" if option.named else ""
    return kind | None if option.optional else kind, Field(default=option.default, description=option.expected + name)


def options_table(table: str, *records: type) -> type[Table]:
    """Make the model of a project-file table that contains the declared options of some groups."""
    entries = {name: _entry(one) for name, one in declared(*records).items() if one.group.table == table}
    return create_model(table.title(), __base__=Table, **entries)


if TYPE_CHECKING:
    Orientation = Table
    Adjustment = Table
else:
    Orientation, Adjustment = (options_table(table, Options, Reading) for table in ("orientation", "adjustment"))


class ProjectFile(Table):
    """A whole project file."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    name: Text = Field(description='a name in quotes, such as name = "zonguldak"')
    body: Text | Three | None = Field(default=None, description='a name such as "Moon", or three radii in m')
    images: tuple[ImageEntry, ...] = Field(
        min_length=1, description="at least one [[images]] table with id and metadata"
    )
    points: PointsEntry = Field(default_factory=PointsEntry, description="a table [points] with file and crs")
    observations: ObservationsEntry = Field(description="a table [observations] with file")
    navigation: NavigationEntry | None = Field(default=None, description="a table [navigation] with file and crs")
    lines: LinesEntry | None = Field(default=None, description="a table [lines] with file, observations and crs")
    constraints: tuple[ConstraintEntry, ...] = Field(default=(), description="[[constraints]] tables with kind")
    orientation: Orientation = Field(default_factory=Orientation, description="a table [orientation]")
    adjustment: Adjustment = Field(default_factory=Adjustment, description="a table [adjustment]")

    def values_of(self, record: type) -> dict[str, Any]:
        """Return the values of those options that a dataclass declares."""
        values = {**dict(self.orientation), **dict(self.adjustment)}
        return {name: values[name] for name in declared(record)}


def read_toml(path: str | Path, model: type[Model]) -> Model:
    """Read a TOML file and check it with a pydantic model.

    Raises
    ------
    InputError
        The file cannot be read, or it has faults; all are listed.
    """
    return validate(parse_toml(Path(path)), str(path), model)


def validate(content: dict[str, Any], file: str, model: type[Model]) -> Model:
    """Check a parsed TOML file with a pydantic model.

    Raises
    ------
    InputError
        The file has faults; all are listed with place and remedy.
    """
    try:
        return model.model_validate(content)
    except ValidationError as caught:
        error = caught
    places: dict[str, Finding] = {}
    details = error.errors(include_url=False, include_context=False)
    for detail in details:
        loc = detail["loc"]
        if detail["type"] == "too_short" and any(o["loc"][: len(loc)] == loc and o["loc"] != loc for o in details):
            continue  # pydantic calls an array too short if its items have errors
        fault = _problem(detail["type"], loc, detail["input"], file, model)
        places.setdefault(fault.place, fault)  # pydantic reports a fault for each member of a union
    raise InputError(*places.values())


def _problem(kind: str, loc: tuple[int | str, ...], value: object, file: str, root: type[BaseModel]) -> Finding:
    path, field, siblings = _walk(loc, root)
    if kind == "extra_forbidden":
        hint = did_you_mean(path.rpartition(".")[2], siblings)
        return finding("project.unknown_key", file=file, place=path, value=value, hint=hint)
    if kind == _PATH and (fault := path_fault(str(value))) is not None:
        return finding(fault.code, file=file, place=path, value=value, **fault.data)
    expected = field.description if field is not None else "a value of the right type"
    if path == "schema" and kind != "missing":
        return finding("project.schema", file=file, place=path, value=value)
    if kind == "missing":
        return finding("project.missing", file=file, place=path, expected=expected)
    return finding("project.value", file=file, place=path, value=repr(value), expected=expected)


def _walk(loc: tuple[int | str, ...], root: type[BaseModel]) -> tuple[str, FieldInfo | None, list[str]]:
    """Return a path such as ``images[1].metadata``, the definition of the field, and the names in its table."""
    path, field, siblings = "", None, list[str]()
    table: type[BaseModel] | None = root
    for step in loc:
        if isinstance(step, int):
            path += f"[{step + 1}]"
        elif table is None:
            break  # the name of a union member, not a key
        else:
            path += f".{step}" if path else step
            siblings = [info.alias or name for name, info in table.model_fields.items()]
            field = next((info for name, info in table.model_fields.items() if step in (name, info.alias)), None)
            table = _table_of(field)
    return path, field, siblings


def _table_of(field: FieldInfo | None) -> type[BaseModel] | None:
    """Return the model of a field or of the items of its array; None for a plain value."""
    annotation = field.annotation if field is not None else None
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


# --- files of constraints ---------------------------------------------------------------------------


class ConstraintFile(Table):
    """Whole constraint file."""

    constraints: tuple[ConstraintEntry, ...] = Field(min_length=1, description="at least one [[constraints]] table")


def read_constraints(path: Path) -> tuple[Constraint, ...]:
    """Read a constraint file.

    Raises
    ------
    InputError
        The file has faults; all are listed.
    """
    stated, faults = constraints_of(read_toml(path, ConstraintFile).constraints, str(path))
    if faults:
        raise InputError(*faults)
    return stated


def constraints_of(
    entries: Sequence[ConstraintEntry], file: str, surplus: int = 0
) -> tuple[tuple[Constraint, ...], list[Finding]]:
    """Return the constraints of a file, and the faults with the numbers of their entries.

    ``surplus`` is the smallest allowed difference between the number of residuals and the
    number of unknowns of a figure.
    """
    stated, faults = list[Constraint](), list[Finding]()
    for k, e in enumerate(entries):
        turn = np.eye(3) if e.offset is None else np.array(e.offset)
        try:
            one = Constraint(e.kind, e.members, e.value_m, e.sigma, e.observed, e.axis, turn)
            one.require_surplus(surplus)
            stated.append(one)
        except InputError as error:
            faults += [replace(p, file=file, place=f"{place_of(k)}, {p.place}") for p in error.problems]
    return tuple(stated), faults
