"""Constraints of project files and of the files of close range, in TOML: one ``[[constraints]]`` table for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import Field

from fg_orient.formats.schema import ConstraintEntry, Table, read_toml
from fg_orient.model.constraint import Constraint, place_of
from fg_orient.model.errors import Finding, InputError


class ConstraintFile(Table):
    """A whole file of constraints."""

    constraints: tuple[ConstraintEntry, ...] = Field(min_length=1, description="at least one [[constraints]] table")


def read_constraints(path: Path) -> tuple[Constraint, ...]:
    """Read a file of constraints.

    Raises
    ------
    InputError
        All faults of the file.
    """
    stated, faults = constraints_of(read_toml(path, ConstraintFile).constraints, str(path))
    if faults:
        raise InputError(*faults)
    return stated


def constraints_of(
    entries: Sequence[ConstraintEntry], file: str, surplus: int = 0
) -> tuple[tuple[Constraint, ...], list[Finding]]:
    """Constraints of a file, and faults with the number of their entry.

    ``surplus``: smallest number of residuals of a figure beyond its unknowns.
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
