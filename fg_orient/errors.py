"""Exceptions that carry data, built from the message catalogue.

A :class:`Problem` says what is wrong in one line: file, place in it, the value seen and
what to do. Exceptions hold one or several problems and the exit code of the command
line: 2 bad input, 3 no solution, 4 solution not trustworthy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import takewhile
from typing import Final

from fg_orient.messages import CATALOGUE


@dataclass(frozen=True)
class Problem:
    """One fault in the user's terms.

    Parameters
    ----------
    code : str
        Key of the message catalogue.
    message, remedy : str
        What is wrong and what to do about it.
    file, place, value : str
        File name, line / element / column inside it, and the offending value ("" if none).
    """

    code: str
    message: str
    file: str = ""
    place: str = ""
    value: str = ""
    remedy: str = ""

    def as_dict(self) -> dict[str, str]:
        """Give the record that ``--json`` prints."""
        return asdict(self)

    def __str__(self) -> str:
        where = ", ".join(part for part in (self.file, self.place) if part)
        seen = f" (found {self.value})" if self.value else ""
        head = f"{where}: " if where else ""
        tail = f"; {self.remedy}" if self.remedy else ""
        return " ".join(f"{head}{self.message}{seen}{tail}".split())


def problem(code: str, *, file: object = "", place: object = "", value: object = "", **fields: object) -> Problem:
    """Fill the catalogue entry ``code``.

    Raises
    ------
    KeyError
        The code is not in the catalogue.
    """
    message, remedy = CATALOGUE[code]
    known = {"file": file, "place": place, "value": value, **fields}
    text = str(value)
    seen = text if len(text) <= 80 else text[:77] + "..."
    return Problem(code, message.format(**known), str(file), str(place), seen, remedy.format(**known))


#: Faults of directions of a block, of which there may be dozens with one cause.
_DIRECTIONS: Final = ("adjust.rank_deficient", "adjust.rank_without_control")
#: Directions that one line names.
_NAMED: Final = 3


def folded(problems: Sequence[Problem]) -> list[Problem]:
    """Faults for people: directions with one cause and one remedy on one line, some of them named."""
    groups: dict[object, list[Problem]] = {}
    for k, p in enumerate(problems):
        groups.setdefault((p.file, p.message, p.remedy) if p.code in _DIRECTIONS else k, []).append(p)
    return [group[0] if len(group) == 1 else replace(group[0], place=_places(group)) for group in groups.values()]


def _places(group: Sequence[Problem]) -> str:
    """Some places, what they begin with alike said once, and how many more there are."""
    first = [p.place for p in group[:_NAMED]]
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*first, strict=False))
    alike = "".join(letters[0] for letters in same)
    start = len("".join(alike.rpartition(": ")[:2]))
    more = f" | and {len(group) - _NAMED} more (--json has all)" if len(group) > _NAMED else ""
    return first[0][:start] + " | ".join(place[start:] for place in first) + more


class FgOrientError(Exception):
    """Base of all errors of this package; ``problems`` holds one record per fault."""

    exit_code = 1

    def __init__(self, *problems: Problem) -> None:
        self.problems = problems
        super().__init__("\n".join(str(p) for p in problems))

    @classmethod
    def of(
        cls, code: str, *, file: object = "", place: object = "", value: object = "", **fields: object
    ) -> FgOrientError:
        """Build the error from one catalogue entry."""
        return cls(problem(code, file=file, place=place, value=value, **fields))


class InputError(FgOrientError):
    """The input is unusable (exit code 2)."""

    exit_code = 2


class OutOfTimeRange(InputError):
    """A line time lies outside the ephemeris or attitude list."""


class OutOfImage(InputError):
    """A pixel lies outside the image."""


class NoSolutionError(FgOrientError):
    """The adjustment has no solution (exit code 3)."""

    exit_code = 3


class RankDeficientError(NoSolutionError):
    """The normal equations are singular; the problems name the directions.

    ``rank_defect`` counts the dead directions of each image, ``counts`` holds n_observations,
    n_unknowns and redundancy, ``evidence`` what was judged: a ``fg_orient.quality.deficiency.Evidence``, or None.
    """

    def __init__(
        self, *problems: Problem, rank_defect: Mapping[str, int] | None = None,
        counts: Mapping[str, int] | None = None, evidence: object = None,
    ) -> None:  # fmt: skip
        super().__init__(*problems)
        self.rank_defect = dict(rank_defect or {})
        self.counts = dict(counts or {})
        self.evidence = evidence
