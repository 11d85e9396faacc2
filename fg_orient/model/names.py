"""Enumerations, field names and the one signature shared by all floors."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

#: Told how many steps of long work are done, of how many, and which one this was.
Progress = Callable[[int, int, str], None]


class Role(StrEnum):
    """Role of a ground point in the adjustment."""

    CONTROL = "control"
    CHECK = "check"
    TIE = "tie"


class Status(StrEnum):
    """How an adjustment ended."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    RANK_DEFICIENT = "rank_deficient"
    NOT_TRUSTWORTHY = "not_trustworthy"


EXIT_CODE: dict[Status, int] = {
    Status.CONVERGED: 0,
    Status.NOT_CONVERGED: 3,
    Status.RANK_DEFICIENT: 3,
    Status.NOT_TRUSTWORTHY: 4,
}
