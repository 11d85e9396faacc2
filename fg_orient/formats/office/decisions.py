"""What a reader of unknown tables assumes, and what it has to ask.

A question has ranked choices. If the data or the names decide clearly, the first choice is assumed, and listed. Else
the user decides: by an option, or by an answer on a terminal. Nothing is assumed without being listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fg_orient.model.errors import Finding, InputError, finding


@dataclass(frozen=True)
class Assumption:
    """What was assumed: subject, value, reason, and the option by which the user decides otherwise ("": none)."""

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

        A question that nobody answers is raised, or with ``later`` kept for :meth:`require_answers` (None then).

        Raises
        ------
        InputError
            Nobody answers.
        """
        if question.clear:
            first = question.choices[0]
            self.note(question.subject, first.words or first.value, question.reason, question.option)
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
