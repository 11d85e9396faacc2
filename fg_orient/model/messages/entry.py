"""Entries of the catalogue: message, remedy and severity of a code."""

from __future__ import annotations

from typing import Literal, NamedTuple, cast

Severity = Literal["note", "warning", "doubt", "failure"]


class Entry(NamedTuple):
    """Text of a code: format strings for its data.

    ``message`` has one or more parts. A part with an empty field is left out, except the first.
    """

    message: tuple[str, ...]
    remedy: str = ""
    severity: Severity = "failure"


def words(table: str) -> dict[str, Entry]:
    """Read a table of the catalogue.

    An entry begins with ``code: message`` or ``code (severity): message``. In the indented lines that follow, further
    parts of the message begin with ``+`` and the remedy with ``->``. An entry without severity is a failure.
    Consecutive failures without a remedy share the remedy of the last one.
    """
    found: list[list[str]] = []
    for line in table.split("\n"):
        text = line.strip()
        if line[:1] not in (" ", ""):
            found.append([text])
        elif text.startswith(("+ ", "-> ")):
            found[-1].append(text)
        elif text:
            found[-1][-1] += f" {text}"
    entries: dict[str, Entry] = {}
    remedy = ""
    for head, *rest in reversed(found):
        name, _, message = head.partition(": ")
        code, _, severity = name.partition(" ")
        parts = [text[2:] for text in rest if text.startswith("+ ")]
        own = "".join(text[3:] for text in rest if text.startswith("-> "))
        remedy = own if own or severity else remedy
        entries[code] = Entry((message, *parts), remedy, cast(Severity, severity.strip("()") or "failure"))
    return entries
