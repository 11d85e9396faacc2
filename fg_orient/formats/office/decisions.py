"""Statements of the user about tables of unknown form, assumptions of their reader, and its questions.

A question has ranked choices. If the data or the names decide clearly, the first choice is assumed, and listed. Else
the user decides: by an option, or by an answer on a terminal. Every assumption is listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fg_orient.model.errors import Finding, InputError, finding


@dataclass(frozen=True)
class Office:
    """Statements of the user; the reader finds or asks values that are None or "".

    Parameters
    ----------
    columns : mapping of str to str
        Header by key: E, N, H, lon, lat, X, Y, Z, id, image, line, sample, role, sE, sN, sH, sEN, sline, ssample, spx.
    crs, heights, decimal, role_column : str
        ``EPSG:n[+m]``; "ellipsoidal" or ``EPSG:m``; "comma" or "point"; header, or "none".
    units : mapping of str to str
        Unit by key, such as H to "ft".
    first_pixel : float or None
        Coordinate of the centre of the first pixel.
    images : mapping of str to str
        Image by its name in the table.
    lift_m : float
        Approximately what makes the heights ellipsoidal, if another statement than ``heights`` says it.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    crs: str = ""
    heights: str = ""
    decimal: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    role_column: str = ""
    first_pixel: float | None = None
    images: Mapping[str, str] = field(default_factory=dict)
    lift_m: float = 0.0

    @property
    def given(self) -> dict[str, Any]:
        """Return the options that need no question, by name."""
        return {"crs": self.crs, "decimal": self.decimal, "columns": self.columns}


@dataclass(frozen=True)
class Assumption:
    """Assumption: subject, value, reason, and the option with which the user can change it ("": no option)."""

    subject: str
    value: str
    reason: str
    option: str = ""

    def as_dict(self) -> dict[str, str]:
        """Plain record."""
        return {"subject": self.subject, "value": self.value, "reason": self.reason, "option": self.option}


@dataclass(frozen=True)
class Choice:
    """An answer as it is given to the option, and in words for the user."""

    value: str
    words: str = ""
    content: Any = None


@dataclass(frozen=True)
class Question:
    """A question that an option answers; the likeliest choice is the first one.

    Parameters
    ----------
    option, subject : str
    choices : sequence of Choice
        None: any text, such as numbers.
    clear : bool
        The first choice is clearly better than the others.
    reason : str
        Why the first choice is assumed, or why nothing decides.
    example : str
        A value of the option, for messages.
    """

    option: str
    subject: str
    choices: Sequence[Choice] = ()
    clear: bool = False
    reason: str = ""
    example: str = ""


@dataclass
class Decisions:
    """Options that were given, a function that asks, assumptions so far and questions without an answer."""

    given: Mapping[str, Any] = field(default_factory=dict)
    ask: Callable[[Question], str] | None = None
    assumed: list[Assumption] = field(default_factory=list)
    unanswered: list[Finding] = field(default_factory=list)

    def note(self, subject: str, value: object, reason: str, option: str = "") -> None:
        """List an assumption once."""
        one = Assumption(subject, str(value), reason, option)
        if one not in self.assumed:
            self.assumed.append(one)

    def settle(self, question: Question, file: object = "", *, later: bool = False) -> Choice | None:
        """Choose an answer.

        A question without an answer is raised as an error, or with ``later`` kept for :meth:`require_answers` (None
        then).

        Raises
        ------
        InputError
            Nobody answers.
        """
        if question.clear:
            first = question.choices[0]
            shown = f"{first.value}, {first.words}" if first.words else first.value
            self.note(question.subject, shown, question.reason, question.option)
            return first
        if self.ask is not None:
            answer = self.ask(question)
            self.note(question.subject, answer, "answered", question.option)
            known = [one for one in question.choices if one.value == answer]
            return known[0] if known else Choice(answer)
        options = [f"{one.value} ({one.words})" if one.words else one.value for one in question.choices]
        missing = finding(
            "office.question", file=file, option=question.option, subject=question.subject, reason=question.reason,
            choices=" | ".join(options), example=question.example or (question.choices[0].value if options else ""),
        )  # fmt: skip
        if not later:
            raise InputError(*self.unanswered, missing)
        self.unanswered.append(missing)
        return None

    def require_answers(self) -> None:
        """Raise InputError with the questions that nobody answered."""
        if self.unanswered:
            raise InputError(*self.unanswered)
