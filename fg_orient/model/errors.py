"""Findings, and exceptions that carry them.

A :class:`Finding` is the record of a failure, doubt, warning or note: a code with data. Its words come from the entry
of the code (``fg_orient.model.messages``) when it is shown. ``<out>`` names an option there: "option out" for callers
of the library, a flag on the command line. Exceptions contain findings and the exit code of the command line: 2 bad
input, 3 no solution.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any, Final, Self

from fg_orient.model.messages import CATALOGUE
from fg_orient.model.messages.adjustment import figures_in_words
from fg_orient.model.messages.entry import Severity, words

#: Function that names an option as a reader writes it.
Naming = Callable[[str], str]
#: Longest value that is shown.
_LONGEST: Final = 80
#: Severities that make a result not trustworthy.
DECISIVE: Final = ("doubt", "failure")
#: Items of a list that a finding keeps.
_MOST: Final = 50
#: Control characters but for blanks, marks of the direction of writing, lone surrogates.
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
        Key of the entry with its words.
    severity : str
        "failure" stops the work, "doubt" makes the result not trustworthy, "warning" and "note" do neither.
    file, option, place, value : str
        File name, option that was given, line / element / point / image, and the offending value ("" if none).
    data : mapping
        Plain values of the message: numbers, text, lists of them.
    names : mapping
        Entries of the file by option, shown instead of the options.
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
        """One line: file, place, message, value, remedy."""
        shown = self.as_dict(naming)
        where = ", ".join(part for part in (self.file, shown["place"]) if part)
        seen = f" (found {self.value})" if self.value else ""
        head = f"{where}: " if where else ""
        tail = f"; {shown['remedy']}" if shown["remedy"] else ""
        return " ".join(f"{head}{shown['message']}{seen}{tail}".split())

    def __str__(self) -> str:
        return self.text()

    def as_dict(self, naming: Naming = of_library) -> dict[str, Any]:
        """Give the record of result files and ``json`` output: the fields, ``message`` and ``remedy``."""
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
        empty: tuple[object, ...] = ("", None, [])  # a further part with an empty field is not shown
        shown = named[:1] + [part for part in named[1:] if not any(data[item] in empty for item in _fields(part))]
        return "".join(_FORMAT.vformat(_agreeing(part, data), (), data) for part in shown)


class _Format(string.Formatter):
    """Writes lists as "a, b"; the format of a list is how many of it are named at most, ``!w`` names figures."""

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        if conversion != "w":
            return super().convert_field(value, conversion)
        return [figures_in_words.get(key, key.replace("_", " ")) for key in value]

    def format_field(self, value: Any, format_spec: str) -> str:
        if not isinstance(value, list):
            return format(value, format_spec)
        most = int(format_spec or len(value))
        return ", ".join(map(str, value[:most])) + (" ..." if len(value) > most else "")


_FORMAT: Final = _Format()
#: Field of a number, its noun with "(s)", and the verb after it.
_COUNTED: Final = re.compile(r"(\{(\w+)[^{}]*\}(?: [a-z]+){1,5})\(s\)( (?:are|have|lie)\b)?")
_SINGULAR: Final = {"": "", " are": " is", " have": " has", " lie": " lies"}


def _agreeing(part: str, data: Mapping[str, Any]) -> str:
    """Part of a message whose nouns and verbs agree with the numbers before them; the data themselves stay."""

    def agree(counted: re.Match[str]) -> str:
        verb = counted[3] or ""
        return counted[1] + (_SINGULAR[verb] if str(data[counted[2]]) == "1" else f"s{verb}")

    return _COUNTED.sub(agree, part)


def finding(
    code: str, *, file: object = "", place: object = "", value: object = "", option: object = "", **data: object
) -> Finding:
    """Finding of a code with its data.

    Parameters
    ----------
    code : str
        Code of the catalogue; or a whole entry, ``"code (severity): sentence -> remedy"``, which is added to the
        catalogue, so that a message of one place is declared there.
    file, place, value, option : object
        See :class:`Finding`. A place that begins with an option, ``"<out>"`` or ``"<compensation> shift"``, is split.
    **data
        Values for the fields of the entry.

    Raises
    ------
    KeyError
        The code is not in the catalogue.
    ValueError
        The code of a whole entry has another entry.
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
    """Text with escapes in place of what a terminal cannot show or obeys: control characters, lone surrogates."""
    return _UNSHOWN.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode(), text)


@cache
def _entered(table: str) -> str:
    """Add an entry to the catalogue and give its code."""
    ((code, entry),) = words(re.sub(r" (?=(->|\+) )", "\n    ", table)).items()
    if CATALOGUE.setdefault(code, entry) != entry:
        raise ValueError(f"two entries of {code}")
    return code


def _plain(item: Any) -> Any:
    """Value for JSON: numbers, text, shortened lists of them; any other value as text."""
    item = item.item() if hasattr(item, "item") and getattr(item, "ndim", 0) == 0 else item
    if isinstance(item, (list, tuple)):
        return [_plain(one) for one in item[:_MOST]]
    return item if item is None or type(item) in (bool, int, float) else _shown(str(item))


def as_record(findings: Sequence[Finding]) -> dict[str, Any]:
    """Keys ``findings`` and, as sentences, ``warnings`` of a result."""
    return {"warnings": [str(one) for one in findings], "findings": [one.as_dict() for one in findings]}


def judged(findings: Sequence[Finding]) -> dict[str, Any]:
    """Status that follows from findings, and :func:`as_record`: for results without another assessment."""
    doubtful = any(one.severity in DECISIVE for one in findings)
    return {"status": "not_trustworthy" if doubtful else "good", **as_record(findings)}


def findings_of(record: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Findings of a result. An earlier version has sentences; there the reason of the assessment is a doubt."""
    if "findings" in record:
        return tuple(read(one) for one in record["findings"])
    stated = [finding("record.sentence", text=text) for text in record.get("warnings", ())]
    return tuple(replace(one, severity="doubt") if one.data["text"] == record.get("reason") else one for one in stated)


def sentences(record: Mapping[str, Any]) -> list[str]:
    """Findings of a result in words."""
    return [str(one) for one in findings_of(record)]


def read(record: Mapping[str, Any]) -> Finding:
    """Finding of a record; a code without an entry here keeps the words of the record."""
    known = {name: record.get(name, "") for name in ("file", "place", "value")}
    severity, data = record.get("severity", "failure"), record.get("data", {})
    if record["code"] in CATALOGUE:
        message, remedy, _ = CATALOGUE[record["code"]]
        if set(data) >= {name for part in (*message, remedy) for name in _fields(part)}:
            return Finding(record["code"], severity, **known, data=data)
    text = "; ".join(filter(None, (record["message"], record["remedy"])))
    return Finding("record.sentence", severity, **known, data={"text": text})


def _fields(part: str) -> set[str]:
    """Names of the data in a part of a message."""
    names = {name.partition("[")[0] for _, name, _, _ in string.Formatter().parse(part) if name}
    return names - {"file", "place", "value", "option"}


class FgOrientError(Exception):
    """Base of all errors of this package; ``problems`` holds one finding per error."""

    exit_code = 1

    def __init__(self, *problems: Finding) -> None:
        self.problems = problems
        super().__init__("\n".join(str(p) for p in problems))

    @classmethod
    def of(cls, code: str, **fields: object) -> Self:
        """Build the error from one finding."""
        return cls(finding(code, **fields))


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

    ``rank_defect`` counts the undetermined directions of each image, ``counts`` holds n_observations, n_unknowns and
    redundancy, ``evidence`` is a ``fg_orient.quality.deficiency.Evidence`` or None.
    """

    def __init__(
        self, *problems: Finding, rank_defect: Mapping[str, int] | None = None,
        counts: Mapping[str, int] | None = None, evidence: object = None,
    ) -> None:  # fmt: skip
        super().__init__(*problems)
        self.rank_defect = dict(rank_defect or {})
        self.counts = dict(counts or {})
        self.evidence = evidence
