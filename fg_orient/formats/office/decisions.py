"""Statements of the user about tables of unknown form, and assumptions and questions of their reader.

The choices of a question are ranked. If the data or the names clearly support the first
choice, it is assumed. Otherwise the user decides by an option or by an answer on a
terminal. Every assumption is listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fg_orient.model.errors import Finding, InputError, finding


@dataclass(frozen=True)
class Office:
    """Statements of the user. The reader determines values that are None or "", or asks for them.

    Parameters
    ----------
    columns : mapping of str to str
        Header of the column for each key: E, N, H, lon, lat, X, Y, Z, id, image, line,
        sample, role, sE, sN, sH, sEN, sline, ssample, spx.
    crs, heights, decimal, role_column : str
        ``crs`` is ``EPSG:n[+m]``; ``heights`` is "ellipsoidal" or ``EPSG:m``; ``decimal``
        is "comma" or "point"; ``role_column`` is a header or "none".
    units : mapping of str to str
        Unit for each key, for example "ft" for H.
    first_pixel : float or None
        Coordinate of the first pixel's centre.
    images : mapping of str to str
        Image for each name in the table.
    lift_m : float
        Approximate height that must be added to the heights to make them ellipsoidal, m.
        It is used if a statement other than ``heights`` gives it.
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
        """Return the options that the user has given, by their names; they need no question."""
        return {"crs": self.crs, "decimal": self.decimal, "columns": self.columns}


@dataclass(frozen=True)
class Assumption:
    """Assumption: subject, value, reason, and the option that changes it ("" if there is no option)."""

    subject: str
    value: str
    reason: str
    option: str = ""

    def as_dict(self) -> dict[str, str]:
        """Return the assumption as a dict."""
        return {"subject": self.subject, "value": self.value, "reason": self.reason, "option": self.option}


@dataclass(frozen=True)
class Choice:
    """Possible answer: the value of the option, and its description for the user."""

    value: str
    words: str = ""
    content: Any = None


@dataclass(frozen=True)
class Question:
    """Question that an option can answer; the most likely choice is first.

    Parameters
    ----------
    option, subject : str
    choices : sequence of Choice
        Possible answers. If there are none, any text is allowed, for example numbers.
    clear : bool
        The first choice is clearly better than the others.
    reason : str
        Reason why the first choice is assumed, or why the reader cannot decide.
    example : str
        Example of a value of the option, for messages.
    """

    option: str
    subject: str
    choices: Sequence[Choice] = ()
    clear: bool = False
    reason: str = ""
    example: str = ""


@dataclass
class Decisions:
    """Given options, the function that asks the user, assumptions so far, and questions without an answer."""

    given: Mapping[str, Any] = field(default_factory=dict)
    ask: Callable[[Question], str] | None = None
    assumed: list[Assumption] = field(default_factory=list)
    unanswered: list[Finding] = field(default_factory=list)

    def note(self, subject: str, value: object, reason: str, option: str = "") -> None:
        """Add an assumption to the list, unless it is already there."""
        one = Assumption(subject, str(value), reason, option)
        if one not in self.assumed:
            self.assumed.append(one)

    def settle(self, question: Question, file: object = "", *, later: bool = False) -> Choice | None:
        """Find the answer of a question.

        If there is no answer, an error is raised. With ``later``, the question is kept
        for :meth:`require_answers` instead, and None is returned.

        Raises
        ------
        InputError
            The question has no answer.
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
        """Raise InputError with all questions that have no answer."""
        if self.unanswered:
            raise InputError(*self.unanswered)
