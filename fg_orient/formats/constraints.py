"""Constraint files of close range: TOML, one ``[[constraints]]`` table each; docs/closerange.md describes it."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, ValidationError

from fg_orient.formats.photos import Positive, Three
from fg_orient.formats.project import parse_toml
from fg_orient.formats.schema import Text, problems_of
from fg_orient.formats.schema import _Table as Table
from fg_orient.model.errors import InputError


class ConstraintEntry(Table):
    """One ``[[constraints]]`` table."""

    kind: Text = Field(description='what it is, such as "distance" or "horizontal circle"')
    members: tuple[Text, ...] = Field(min_length=1, description='ids of points (or names of photos): ["1", "2"]')
    value_m: Positive | None = Field(default=None, description="a distance or base, m")
    sigma: Positive | None = Field(default=None, description="m (rad for angles) above 0; without it it is hard")
    observed: dict[str, tuple[Positive, Positive]] = Field(default={}, description="name = [value, sigma], m, above 0")
    axis: Text = Field(default="y", description='"x", "y" or "z"')
    offset: tuple[Three, Three, Three] | None = Field(default=None, description="three rows of three numbers")


class ConstraintFile(Table):
    """A whole constraint file."""

    constraints: tuple[ConstraintEntry, ...] = Field(min_length=1, description="at least one [[constraints]] table")


def read_constraints(path: Path) -> tuple[ConstraintEntry, ...]:
    """Read a constraint file.

    Raises
    ------
    InputError
        All faults of the file.
    """
    try:
        return ConstraintFile.model_validate(parse_toml(path)).constraints
    except ValidationError as error:
        raise InputError(*problems_of(error, str(path), ConstraintFile)) from None
