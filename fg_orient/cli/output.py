"""What commands print: results, findings with the flags of their options, JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

import typer

from fg_orient.cli.log import session
from fg_orient.model.declaration import declared
from fg_orient.model.errors import Finding, findings_of
from fg_orient.model.options import Options, Reading

#: Directions of a block, of which there may be dozens with one cause, and how many of them one line names.
DIRECTIONS = ("adjust.rank_deficient", "adjust.rank_without_control")
NAMED = 3


def printable(text: object) -> str:
    """Replace characters that a terminal could take as commands."""
    return "".join(c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in str(text))


def note(text: object) -> None:
    """Say something beside the result: on standard error."""
    typer.echo(printable(text), err=True)


def say(text: object = "") -> None:
    """Print a line of the result for people; nothing under ``--quiet``."""
    if not session().quiet:
        typer.echo(printable(text))


def verdict(text: object, *, good: bool) -> None:
    """Say how it ended; what is not good also under ``--quiet``."""
    if session().quiet and not good:
        note(text)
    else:
        say(text)


def flag(option: str) -> str:
    """Name an option as it is written on the command line."""
    name, space, rest = option.partition(" ")
    one = declared(Options, Reading).get(name)
    return f"{one.flag if one else '--' + name.replace('_', '-')}{space}{rest}"


def tell(kind: str, found: Finding | str, *, as_result: bool = False) -> None:
    """Log an event (error, warning, note, remark, lost) and print it behind its kind; no notes under ``--quiet``."""
    text = found if isinstance(found, str) else found.text(flag)
    session().tell(kind, text=text)
    if not (session().quiet and kind == "note"):
        (say if as_result else note)(f"{kind}: {text}")


def tell_findings(record: Mapping[str, Any], *, as_result: bool = False) -> None:
    """Log and print the findings of a result."""
    for found in findings_of(record):
        tell("note" if found.severity == "note" else "warning", found, as_result=as_result)


def fault(found: Finding) -> None:
    """Say what is wrong with the input or the solution: on standard error."""
    session().tell("error", **found.as_dict(flag))
    typer.echo(printable(f"error: {found.text(flag)}"), err=True)


def folded(problems: Sequence[Finding]) -> list[Finding]:
    """Faults for people: directions with one cause and one remedy on one line, some of them named."""
    groups: dict[object, list[Finding]] = {}
    for k, p in enumerate(problems):
        groups.setdefault((p.file, p.message, p.remedy) if p.code in DIRECTIONS else k, []).append(p)
    return [group[0] if len(group) == 1 else replace(group[0], place=_places(group)) for group in groups.values()]


def _places(group: Sequence[Finding]) -> str:
    """Some places, what they begin with alike said once, and how many more there are."""
    first = [p.place for p in group[:NAMED]]
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*first, strict=False))
    alike = "".join(letters[0] for letters in same)
    start = len("".join(alike.rpartition(": ")[:2]))
    more = f" | and {len(group) - NAMED} more (--json has all)" if len(group) > NAMED else ""
    return first[0][:start] + " | ".join(place[start:] for place in first) + more


def emit(record: object) -> None:
    """Print one JSON object, nan as null."""
    from fg_orient.run.json import dumps

    for found in findings_of(record) if isinstance(record, dict) else ():
        session().tell("warning", text=found.text(flag))
    typer.echo(dumps(record, indent=1))


def emit_errors(*problems: Finding) -> None:
    """Print the errors as JSON."""
    emit({"errors": [p.as_dict(flag) for p in problems]})
