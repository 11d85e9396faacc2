"""The project file's content as pydantic models: the border where TOML becomes options.

Unknown keys, wrong types, nan and infinity are refused, all at once. ``description`` of a
field is what an error message tells the user to give. Bounds and defaults of options are
those of :class:`fg_orient.block.Options`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError
from pydantic.fields import FieldInfo

from fg_orient.errors import Finding, finding
from fg_orient.io.tables import did_you_mean
from fg_orient.options import (
    CURVE_RANGE,
    EXPECTED,
    ITERATION_RANGE,
    LOOK_DEGREE_RANGE,
    CheckPoints,
    Datum,
    MultipleTesting,
    Options,
    OutlierTest,
    RobustScale,
    RobustStart,
    RpcCompensation,
    StatisticsChoice,
)
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation
from fg_orient.sensors.pushbroom import MAX_EXTRAPOLATION_S

Text = Annotated[str, Field(strict=True), StringConstraints(min_length=1, strip_whitespace=True)]
Positive = Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)]
Three = tuple[Positive, Positive, Positive]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Row = tuple[Number, Number, Number]
Switch = Annotated[bool, Field(strict=True)]


def _intervals(value: int) -> int:
    """Refuse fewer intervals than a curve needs."""
    if 0 < value < CURVE_RANGE[0]:
        raise ValueError
    return value


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ImageEntry(_Table):
    """One ``[[images]]`` table."""

    id: Text = Field(description='a name in quotes, such as "left"')
    metadata: Text = Field(description="the path of the metadata file in quotes")


class _Foreign(_Table):
    """What a table says of a file of another program."""

    format: Text = Field(default="csv", description='the name of a format, such as "metashape-xml" (docs/formats)')
    image: str = Field(default="", description="the image of a format that holds one image and not its name")
    sigma_axes: Literal["ecef", "enu"] = Field(default="ecef", description='"ecef" or "enu"')
    accept_unverified: Switch = Field(default=False, description="true or false")


class PointsEntry(_Foreign):
    """The ``[points]`` table."""

    file: Text = Field(description="the path of the point table in quotes")
    crs: Text | None = Field(default=None, description='an EPSG code in quotes, such as "EPSG:4979"')
    sigma_m: Three | None = Field(default=None, description="three numbers above zero: East, North, Up, m")
    height_m: Number | None = Field(default=None, description="a number, m")
    check: tuple[Text, ...] = Field(default=(), description='ids in quotes, such as ["7", "12"]')


class ObservationsEntry(_Foreign):
    """The ``[observations]`` table."""

    file: Text = Field(description="the path of the observation table in quotes")
    crs: Text | None = Field(default=None, description='an EPSG code in quotes, such as "EPSG:4979"')
    sigma_px: tuple[Positive, Positive] | None = Field(default=None, description="two numbers above zero, px")
    images: dict[str, Text] = Field(default_factory=dict, description='a table such as { "a.tif" = "left" }')


def _rotation(value: tuple[Row, Row, Row] | None) -> tuple[Row, Row, Row] | None:
    """Refuse a matrix that turns nothing: columns that are not orthonormal, or a reflection."""
    if value is not None and away_from_rotation(np.array(value)) > ORTHONORMAL:
        raise ValueError
    return value


class NavigationEntry(_Table):
    """The ``[navigation]`` table: what a receiver and an inertial unit observed on board of frame images."""

    file: Text = Field(description="the path of the navigation table in quotes")
    crs: Text = Field(description='an EPSG code in quotes, such as "EPSG:4979"')
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


class Orientation(_Table):
    """The ``[orientation]`` table: which unknowns an image has and their prior sigmas."""

    eop_set: Annotated[int, Field(strict=True)] | Text = Field(
        default=Options.eop_set, description=EXPECTED["eop_set"] + ' or a name such as "PUA"'
    )
    look_polynomial: Annotated[int, Field(strict=True, ge=LOOK_DEGREE_RANGE[0], le=LOOK_DEGREE_RANGE[1])] | None = (
        Field(default=Options.look_polynomial, description=EXPECTED["look_polynomial"])
    )
    priors: Switch = Field(default=Options.priors, description=EXPECTED["priors"])
    position_sigma_m: Three = Field(default=Options.position_sigma_m, description=EXPECTED["position_sigma_m"])
    velocity_sigma_m_s: Three = Field(default=Options.velocity_sigma_m_s, description=EXPECTED["velocity_sigma_m_s"])
    attitude_sigma_rad: Three = Field(default=Options.attitude_sigma_rad, description=EXPECTED["attitude_sigma_rad"])
    look_sigma_rad: Positive = Field(default=Options.look_sigma_rad, description=EXPECTED["look_sigma_rad"])
    look_shared: Switch = Field(default=Options.look_shared, description=EXPECTED["look_shared"])
    curve_intervals: Annotated[int, Field(strict=True, ge=0, le=CURVE_RANGE[1]), AfterValidator(_intervals)] = Field(
        default=Options.curve_intervals, description=EXPECTED["curve_intervals"]
    )
    curve_position_sigma_m: Positive = Field(
        default=Options.curve_position_sigma_m, description=EXPECTED["curve_position_sigma_m"]
    )
    curve_attitude_sigma_rad: Positive = Field(
        default=Options.curve_attitude_sigma_rad, description=EXPECTED["curve_attitude_sigma_rad"]
    )
    rpc_compensation: RpcCompensation = Field(
        default=Options.rpc_compensation, description=EXPECTED["rpc_compensation"]
    )
    rpc_shift_sigma_px: Positive = Field(default=Options.rpc_shift_sigma_px, description=EXPECTED["rpc_shift_sigma_px"])
    rpc_linear_sigma_px: Positive = Field(
        default=Options.rpc_linear_sigma_px, description=EXPECTED["rpc_linear_sigma_px"]
    )
    image_unknowns: tuple[Text, ...] = Field(default=Options.image_unknowns, description=EXPECTED["image_unknowns"])
    extrapolate_attitude_s: Annotated[
        float, Field(strict=True, ge=0.0, le=MAX_EXTRAPOLATION_S, allow_inf_nan=False)
    ] = Field(default=0.0, description=f"seconds, 0 to {MAX_EXTRAPOLATION_S:g}")
    small_angle: Switch = Field(default=Options.small_angle, description=EXPECTED["small_angle"])


class Adjustment(_Table):
    """The ``[adjustment]`` table: how the block is solved."""

    backend: Literal["auto", "graph", "schur", "dense"] = Field(
        default="auto", description='"auto", "graph", "schur" or "dense"'
    )
    solver: Text | None = Field(default=Options.solver, description=EXPECTED["solver"])
    optimizer: Literal["gauss-newton", "levenberg-marquardt", "dogleg", "native"] = Field(
        default="gauss-newton", description='"gauss-newton", "levenberg-marquardt", "dogleg" or "native"'
    )
    loss: Text = Field(default=Options.loss, description=EXPECTED["loss"])
    gnc: Switch = Field(default=Options.gnc, description=EXPECTED["gnc"])
    inlier_probability: Annotated[Positive, Field(lt=1.0)] = Field(
        default=Options.inlier_probability, description=EXPECTED["inlier_probability"]
    )
    robust_start: RobustStart = Field(default=Options.robust_start, description=EXPECTED["robust_start"])
    robust_scale: RobustScale = Field(default=Options.robust_scale, description=EXPECTED["robust_scale"])
    snoop: Switch = Field(default=Options.snoop, description=EXPECTED["snoop"])
    outlier_test: OutlierTest = Field(default=Options.outlier_test, description=EXPECTED["outlier_test"])
    outlier_level: Annotated[Positive, Field(lt=1.0)] = Field(
        default=Options.outlier_level, description=EXPECTED["outlier_level"]
    )
    multiple_testing: MultipleTesting = Field(
        default=Options.multiple_testing, description=EXPECTED["multiple_testing"]
    )
    variance_components: tuple[Text, ...] = Field(
        default=Options.variance_components, description=EXPECTED["variance_components"]
    )
    max_iterations: Annotated[int, Field(strict=True, ge=ITERATION_RANGE[0], le=ITERATION_RANGE[1])] = Field(
        default=Options.max_iterations, description=EXPECTED["max_iterations"]
    )
    check_points: CheckPoints = Field(default=Options.check_points, description=EXPECTED["check_points"])
    datum: Datum = Field(default=Options.datum, description=EXPECTED["datum"])
    statistics: StatisticsChoice = Field(default=Options.statistics, description=EXPECTED["statistics"])
    memory_limit_gb: Positive | None = Field(default=Options.memory_limit_gb, description=EXPECTED["memory_limit_gb"])
    points_seen_once: Literal["error", "drop"] = Field(default="error", description='"error" or "drop"')


class ProjectFile(_Table):
    """A whole project file."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    name: Text = Field(description='a name in quotes, such as name = "zonguldak"')
    images: tuple[ImageEntry, ...] = Field(
        min_length=1, description="at least one [[images]] table with id and metadata"
    )
    points: PointsEntry = Field(description="a table [points] with file and crs")
    observations: ObservationsEntry = Field(description="a table [observations] with file")
    navigation: NavigationEntry | None = Field(default=None, description="a table [navigation] with file and crs")
    orientation: Orientation = Field(default_factory=Orientation, description="a table [orientation]")
    adjustment: Adjustment = Field(default_factory=Adjustment, description="a table [adjustment]")


def validate(content: dict[str, Any], file: str) -> ProjectFile | tuple[Finding, ...]:
    """Check the parsed TOML; give the project, or every fault with its place and remedy."""
    try:
        return ProjectFile.model_validate(content)
    except ValidationError as error:
        return problems_of(error, file, ProjectFile)


def problems_of(error: ValidationError, file: str, root: type[BaseModel]) -> tuple[Finding, ...]:
    """Every fault of a file that should have been a ``root``, with its place and remedy."""
    places: dict[str, Finding] = {}
    details = error.errors(include_url=False, include_context=False)
    for detail in details:
        if detail["type"] == "too_short" and any(_inside(other["loc"], detail["loc"]) for other in details):
            continue  # an array counts as short of those of its items that have faults of their own
        found = _problem(detail["type"], detail["loc"], detail["input"], file, root)
        places.setdefault(found.place, found)  # a union reports one fault per member
    return tuple(places.values())


def _inside(loc: tuple[int | str, ...], outer: tuple[int | str, ...]) -> bool:
    """Whether a place lies inside another one."""
    return len(loc) > len(outer) and loc[: len(outer)] == outer


def _problem(kind: str, loc: tuple[int | str, ...], value: object, file: str, root: type[BaseModel]) -> Finding:
    path, field, siblings = _walk(loc, root)
    if kind == "extra_forbidden" and path == "constraints":
        return finding("project.constraints", file=file, place=path)
    if kind == "extra_forbidden":
        hint = did_you_mean(path.rpartition(".")[2], siblings)
        return finding("project.unknown_key", file=file, place=path, value=value, hint=hint)
    expected = field.description if field is not None else "a value of the right type"
    if path == "schema" and kind != "missing":
        return finding("project.schema", file=file, place=path, value=value)
    if kind == "missing":
        return finding("project.missing", file=file, place=path, expected=expected)
    return finding("project.value", file=file, place=path, value=repr(value), expected=expected)


def _walk(loc: tuple[int | str, ...], root: type[BaseModel]) -> tuple[str, FieldInfo | None, list[str]]:
    """Path such as ``images[1].metadata``, the field's definition and the names beside it."""
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
    """Model that a field holds, directly or as the items of an array; None for a plain value."""
    annotation = field.annotation if field is not None else None
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None
