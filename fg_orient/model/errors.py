"""Findings, and exceptions that contain them.

A :class:`Finding` records a failure, doubt, warning or note by a code with data. Its text comes from the catalogue
entry of the code (``fg_orient.model.messages``) when it is shown. In that text ``<out>`` names an option: "option out"
for callers of the library, a flag on the command line. Exceptions contain findings and the exit code of the command
line: 2 for bad input, 3 for no solution.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from decimal import ROUND_CEILING, Decimal
from functools import cache
from typing import Any, Final, Self

from fg_orient.model.messages import CATALOGUE
from fg_orient.model.messages.adjustment import figures_in_words
from fg_orient.model.messages.entry import Severity, words

#: Function that returns the name of an option as the reader writes it.
Naming = Callable[[str], str]
#: Longest value shown, characters.
_LONGEST: Final = 80
#: Severities that make a result not trustworthy.
DECISIVE: Final = ("doubt", "failure")
#: Largest number of list items kept by a finding.
_MOST: Final = 50
#: Characters shown as escapes: control characters except blanks, marks of the writing direction, lone surrogates.
_UNSHOWN: Final = re.compile("[\\x00-\\x08\\x0e-\\x1f\\x7f-\\x9f\\u202a-\\u202e\\u2066-\\u2069\\ud800-\\udfff]")
_OPTION: Final = re.compile(r"<([a-z][a-z0-9_]*)>")


def of_library(option: str) -> str:
    """Name an option for callers of the library and readers of project files."""
    return f"option {option}"


@dataclass(frozen=True)
class Finding:
    """Failure, doubt, warning or note for a user.

    Parameters
    ----------
    code : str
        Key of the catalogue entry with its text.
    severity : str
        "failure" stops the work; "doubt" makes the result not trustworthy; "warning" and "note" do neither.
    file, option, place, value : str
        File name; option that was given; line, element, point or image; offending value. Each is "" if there is none.
    data : mapping
        Plain values for the message: numbers, texts and lists of them.
    names : mapping
        Entry of the file for each option; it is shown instead of the option.
    """

    code: str
    severity: Severity = "failure"
    file: str = ""
    place: str = ""
    value: str = ""
    option: str = ""
    data: Mapping[str, Any] = field(default_factory=dict, hash=False)
    names: Mapping[str, str] = field(default_factory=dict, hash=False)

    @property
    def message(self) -> str:
        """Sentence without file, place and value."""
        return self._words(CATALOGUE[self.code].message, of_library)

    @property
    def remedy(self) -> str:
        """Remedy, "" if there is none."""
        return self._words((CATALOGUE[self.code].remedy,), of_library)

    def text(self, naming: Naming = of_library) -> str:
        """Return one line with file, place, message, value and remedy."""
        shown = self.as_dict(naming)
        where = ", ".join(part for part in (self.file, shown["place"]) if part)
        seen = f" (found {self.value})" if self.value else ""
        head = f"{where}: " if where else ""
        tail = f"; {shown['remedy']}" if shown["remedy"] else ""
        return " ".join(f"{head}{shown['message']}{seen}{tail}".split())

    def __str__(self) -> str:
        return self.text()

    def as_dict(self, naming: Naming = of_library) -> dict[str, Any]:
        """Return the record for result files and ``json`` output: the fields, ``message`` and ``remedy``."""
        record = asdict(self) | {"place": " ".join(filter(None, (self._option(naming), self.place)))}
        del record["option"], record["names"]
        message, remedy, _ = CATALOGUE[self.code]
        return record | {"message": self._words(message, naming), "remedy": self._words((remedy,), naming)}

    def _option(self, naming: Naming) -> str:
        return ", ".join(naming(name) for name in self.option.split(", ")) if self.option else ""

    def _words(self, parts: tuple[str, ...], naming: Naming) -> str:
        known = {"file": self.file, "place": self.place, "value": self.value, "option": self._option(naming)}
        data = known | dict(self.data)
        name = (lambda option: self.names.get(option, option)) if self.names else naming
        named = [_OPTION.sub(lambda found: name(found[1]), part) for part in parts]
        empty: tuple[object, ...] = ("", None, [])  # a part of the message with an empty field is not shown
        shown = named[:1] + [part for part in named[1:] if not any(data[item] in empty for item in _fields(part))]
        return "".join(_FORMAT.vformat(_agreeing(part, data), (), data) for part in shown)


class _Format(string.Formatter):
    """Formatter that writes lists as "a, b"; the format of a list limits its items, and ``!w`` names figures.

    The format ``up3`` rounds a number up to three significant digits, for a limit that the number must not exceed.
    """

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        if conversion != "w":
            return super().convert_field(value, conversion)
        return [figures_in_words.get(key, key.replace("_", " ")) for key in value]

    def format_field(self, value: Any, format_spec: str) -> str:
        if not isinstance(value, list):
            return _rounded_up(value) if format_spec == "up3" else format(value, format_spec)
        most = int(format_spec or len(value))
        return ", ".join(map(str, value[:most])) + (" ..." if len(value) > most else "")


def _rounded_up(value: float) -> str:
    """Return the smallest number of three significant digits that is not below the value."""
    exact = Decimal(value)
    if not exact.is_finite() or not exact:
        return f"{value:.3g}"
    return f"{float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - 2), ROUND_CEILING)):.3g}"


_FORMAT: Final = _Format()
#: Pattern of a number's field, its noun with "(s)", and the verb after the noun.
_COUNTED: Final = re.compile(r"(\{(\w+)[^{}]*\}(?: [a-z]+){1,5})\(s\)( (?:are|have|lie)\b)?")
_SINGULAR: Final = {"": "", " are": " is", " have": " has", " lie": " lies"}


def _agreeing(part: str, data: Mapping[str, Any]) -> str:
    """Return a part of a message in which nouns and verbs have the singular or plural that their numbers need."""

    def agree(counted: re.Match[str]) -> str:
        verb = counted[3] or ""
        return counted[1] + (_SINGULAR[verb] if str(data[counted[2]]) == "1" else f"s{verb}")

    return _COUNTED.sub(agree, part)


def finding(
    code: str, *, file: object = "", place: object = "", value: object = "", option: object = "", **data: object
) -> Finding:
    """Return a finding of this code with its data.

    Parameters
    ----------
    code : str
        Code of the catalogue; or a whole entry, ``"code (severity): sentence -> remedy"``, which is then added to the
        catalogue. A message used in one place is declared there.
    file, place, value, option : object
        See :class:`Finding`. A place that begins with an option, ``"<out>"`` or ``"<compensation> shift"``, is split.
    **data
        Values for the fields in the message.

    Raises
    ------
    KeyError
        The catalogue does not contain the code.
    ValueError
        The catalogue contains another entry for the code.
    """
    code = _entered(code) if ": " in code else code
    begin = _OPTION.match(str(place))
    if begin:
        option, place = begin[1], str(place)[begin.end() :].strip()
    text = str(value)
    seen = text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
    plain = {name: _plain(item) for name, item in data.items()}
    file, place, seen, option = (_shown(str(one)) for one in (file, place, seen, option))
    return Finding(code, CATALOGUE[code].severity, file, place, seen, option, plain)


def _shown(text: str) -> str:
    """Return the text with escapes for control characters and lone surrogates, which a terminal cannot show."""
    return _UNSHOWN.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode(), text)


@cache
def _entered(table: str) -> str:
    """Add an entry to the catalogue and return its code."""
    ((code, entry),) = words(re.sub(r" (?=(->|\+) )", "\n    ", table)).items()
    if CATALOGUE.setdefault(code, entry) != entry:
        raise ValueError(f"two entries of {code}")
    return code


def _plain(item: Any) -> Any:
    """Return the value for JSON: numbers, texts and shortened lists; convert any other value to text."""
    item = item.item() if hasattr(item, "item") and getattr(item, "ndim", 0) == 0 else item
    if isinstance(item, (list, tuple)):
        return [_plain(one) for one in item[:_MOST]]
    return item if item is None or type(item) in (bool, int, float) else _shown(str(item))


def decisive(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings that make a result not trustworthy."""
    return [one for one in findings if one.severity in DECISIVE]


def by_severity(findings: Iterable[Finding]) -> list[Finding]:
    """Sort findings, the most serious first; those of one severity keep their order."""
    order = (*reversed(DECISIVE), "warning", "note")
    return sorted(findings, key=lambda one: order.index(one.severity))


def as_record(findings: Sequence[Finding]) -> dict[str, Any]:
    """Return ``findings`` and, as sentences, ``warnings`` for a result."""
    return {"warnings": [str(one) for one in findings], "findings": [one.as_dict() for one in findings]}


def judged(findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the status that follows from findings, with :func:`as_record`.

    Used for results without their own assessment.
    """
    return {"status": "not_trustworthy" if decisive(findings) else "good", **as_record(findings)}


def findings_of(record: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Return the findings of a stored result.

    In results of earlier versions, which contain sentences, the reason becomes a doubt.
    """
    if "findings" in record:
        return tuple(read(one) for one in record["findings"])
    stated = [finding("record.sentence", text=text) for text in record.get("warnings", ())]
    return tuple(replace(one, severity="doubt") if one.data["text"] == record.get("reason") else one for one in stated)


def sentences(record: Mapping[str, Any]) -> list[str]:
    """Return the findings of a result as sentences."""
    return [str(one) for one in findings_of(record)]


def read(record: Mapping[str, Any]) -> Finding:
    """Return the finding that a record describes. If the catalogue lacks its code, the text of the record is kept."""
    known = {name: record.get(name, "") for name in ("file", "place", "value")}
    severity, data = record.get("severity", "failure"), record.get("data", {})
    if record["code"] in CATALOGUE:
        message, remedy, _ = CATALOGUE[record["code"]]
        if set(data) >= {name for part in (*message, remedy) for name in _fields(part)}:
            return Finding(record["code"], severity, **known, data=data)
    text = "; ".join(filter(None, (record["message"], record["remedy"])))
    return Finding("record.sentence", severity, **known, data={"text": text})


def _fields(part: str) -> set[str]:
    """Return the names of data fields in a part of a message."""
    names = {name.partition("[")[0] for _, name, _, _ in string.Formatter().parse(part) if name}
    return names - {"file", "place", "value", "option"}


class FgOrientError(Exception):
    """Base class of all errors of this package; ``problems`` contains one finding per error."""

    exit_code = 1

    def __init__(self, *problems: Finding) -> None:
        self.problems = problems
        super().__init__("\n".join(str(p) for p in problems))

    @classmethod
    def of(cls, code: str, **fields: object) -> Self:
        """Return an error with one finding."""
        return cls(finding(code, **fields))


class InputError(FgOrientError):
    """The input is unusable (exit code 2)."""

    exit_code = 2


class OutOfTimeRange(InputError):
    """A line time is outside the ephemeris or attitude list."""


class OutOfImage(InputError):
    """A pixel is outside the image."""


class NoSolutionError(FgOrientError):
    """The adjustment has no solution (exit code 3)."""

    exit_code = 3


class RankDeficientError(NoSolutionError):
    """The normal equations are singular; the problems name the undetermined directions.

    ``rank_defect`` counts the undetermined directions of each image. ``counts`` contains n_observations, n_unknowns and
    redundancy. ``evidence`` is a ``fg_orient.quality.deficiency.Evidence`` or None.
    """

    def __init__(
        self,
        *problems: Finding,
        rank_defect: Mapping[str, int] | None = None,
        counts: Mapping[str, int] | None = None,
        evidence: object = None,
    ) -> None:
        super().__init__(*problems)
        self.rank_defect = dict(rank_defect or {})
        self.counts = dict(counts or {})
        self.evidence = evidence
