"""Output of commands: JSON or words, tables, and findings with the flags of their options.

Tables are at most 80 characters wide. Numbers are never divided, and no column is
omitted. If a terminal is too narrow for the numbers of a row, the row is printed on
several lines, one for each column.
"""

from __future__ import annotations

import contextlib
import os
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from fg_orient.cli.log import session
from fg_orient.model.declaration import declared
from fg_orient.model.errors import Finding, InputError, finding, findings_of
from fg_orient.model.names import EXIT_CODE, Status
from fg_orient.model.options import Options, Reading

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

#: Codes of findings about directions; there may be dozens with the same cause. Below: number of directions in one line.
DIRECTIONS: Final = ("adjust.rank_deficient", "adjust.rank_without_control")
NAMED: Final = 3
#: Maximum width of a table, characters.
WIDTH: Final = 80
#: Longer words are divided in a table.
LONGEST_WORD: Final = 24


def printable(text: object) -> str:
    """Replace characters that a terminal may interpret as commands."""
    return "".join(c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in str(text))


def note(text: object) -> None:
    """Print a line on standard error that does not belong to the result."""
    typer.echo(printable(text), err=True)


def say(text: object = "") -> None:
    """Print a line of the result; with ``--quiet``, print nothing."""
    if not session().quiet:
        with printing():
            typer.echo(printable(text))


@contextlib.contextmanager
def printing() -> Iterator[None]:
    """Raise InputError if the block cannot write to standard output, for instance because the disk is full."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError.of("output.unwritable", file="standard output", value=error.strerror) from error


def verdict(text: object, *, good: bool) -> None:
    """Print the assessment of the command; with ``--quiet``, print it only if it is bad."""
    if session().quiet and not good:
        note(text)
    else:
        say(text)


def flag(option: str) -> str:
    """Return an option as it is written on the command line."""
    name, space, rest = option.partition(" ")
    one = declared(Options, Reading).get(name)
    typed = session().flags.get(name) or (one.flag if one else f"--{name.replace('_', '-')}")
    return f"{typed}{space}{rest}"


def tell(kind: str, found: Finding | str, *, as_result: bool = False) -> None:
    """Log an event (error, doubt, warning, note, remark, lost) and print it after the name of its kind.

    With ``--quiet``, notes are not printed.
    """
    text = found if isinstance(found, str) else found.text(flag)
    session().tell(kind, text=text)
    if not (session().quiet and kind == "note"):
        (say if as_result else note)(f"{kind}: {text}")


def warn_of_scheduler(address: str | None) -> None:
    """Warn if the scheduler of a cluster does not require certificates."""
    if address is not None and not address.startswith("tls://"):
        tell("warning", finding(
            "parallel.open (warning): everyone who reaches this scheduler or its workers can run code there -> start "
            "them with certificates and give the address tls://..., see docs/parallel.md",
            option="cluster", value=address,
        ))  # fmt: skip


def tell_findings(record: Mapping[str, Any], *, as_result: bool = False) -> None:
    """Log and print all findings of a result."""
    for found in findings_of(record):
        tell(found.severity, found, as_result=as_result)


def fault(found: Finding) -> None:
    """Log an error of the input or the solution, and print it on standard error."""
    session().tell("error", **found.as_dict(flag))
    typer.echo(printable(f"error: {found.text(flag)}"), err=True)


def folded(problems: Sequence[Finding]) -> list[Finding]:
    """Combine directions with the same cause and remedy to one line with some of their names."""
    groups: dict[object, list[Finding]] = {}
    for k, p in enumerate(problems):
        groups.setdefault((p.file, p.message, p.remedy) if p.code in DIRECTIONS else k, []).append(p)
    return [group[0] if len(group) == 1 else replace(group[0], place=_places(group)) for group in groups.values()]


def _places(group: Sequence[Finding]) -> str:
    """List the first places with their common beginning only once, and give the number of the others."""
    first = [p.place for p in group[:NAMED]]
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*first, strict=False))
    alike = "".join(letters[0] for letters in same)
    start = len("".join(alike.rpartition(": ")[:2]))
    more = f" | and {len(group) - NAMED} more (--json has all)" if len(group) > NAMED else ""
    return first[0][:start] + " | ".join(place[start:] for place in first) + more


def emit(record: object) -> None:
    """Print one JSON object; nan is printed as null."""
    from fg_orient.result.plain import dumps

    for found in findings_of(record) if isinstance(record, dict) else ():
        session().tell("warning", text=found.text(flag))
    with printing():
        typer.echo(dumps(record, indent=1))


def emit_errors(*problems: Finding) -> None:
    """Print the errors as JSON, if standard output can be written."""
    with contextlib.suppress(InputError):
        emit({"errors": [p.as_dict(flag) for p in problems]})


def answer(record: Any, show: Callable[..., None], *shown: Any) -> None:
    """Print a result, as JSON with ``--json``, otherwise in words by ``show(*shown)``.

    ``shown`` is usually the record of the result.
    """
    if session().as_json:
        emit(record)
    else:
        show(*(shown or (record,)))


def answer_with_status(record: Any, show: Callable[..., None], *shown: Any) -> None:
    """Print a result as :func:`answer` does, its findings first and its status last; end with the exit code of it."""
    if session().as_json:
        emit(record)
    else:
        tell_findings(record)
        show(*(shown or (record,)))
        _say_status(record)
    end_if(is_doubtful(record))


def is_doubtful(record: Mapping[str, Any]) -> bool:
    """Return whether the status of a result is "not trustworthy"."""
    return bool(record["status"] == Status.NOT_TRUSTWORTHY)


def end_if(doubtful: object) -> None:
    """End the command with exit code 4 if there is a doubt on what it printed."""
    if doubtful:
        raise typer.Exit(EXIT_CODE[Status.NOT_TRUSTWORTHY])


def _say_status(record: dict[str, Any]) -> None:
    """Print the status of a result, with its most serious finding if it is not trustworthy."""
    good = not is_doubtful(record)
    status = record["status"].replace("_", " ")
    if good or session().quiet:  # with --quiet the findings were printed just before
        verdict(status, good=good)
    else:
        say(f"{status}: {findings_of(record)[0].text(flag)}")


def number(value: object, digits: int = 3) -> str:
    """Format a number for printing; a missing number is a dash."""
    if not isinstance(value, (int, float)) or value != value:
        return "-"
    return f"{round(value, digits) + 0.0:.{digits}f}"  # adding 0.0 removes the minus sign of a zero


def write_records(path: Path, columns: Sequence[str], records: Sequence[dict[str, Any]], overwrite: bool) -> None:
    """Write records as a table with all digits, completely or not at all.

    InputError: the file must not be overwritten, or it cannot be written.
    """
    from fg_orient.formats.atomic import outputs
    from fg_orient.formats.table_write import save_table
    from fg_orient.result.plain import table_of_rows

    rows = ([record[name] for name in columns] for record in records)
    with outputs(path, overwrite=overwrite):
        save_table(path, table_of_rows(columns, rows).columns)


# --- tables ----------------------------------------------------------------------------------------------------------


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], *, left: int = 1) -> None:
    """Print a table; with ``--quiet``, print nothing.

    The first ``left`` columns contain text and are aligned to the left. The other columns contain numbers.
    """
    if session().quiet:
        return
    from rich.console import Console
    from rich.text import Text

    cells = [[printable(cell) for cell in row] for row in rows]
    # plain: not even bold text
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    console = Console(file=sys.stdout, highlight=False, color_system=None if plain else "auto")
    console.width = min(WIDTH, console.width)
    least = [_least(name, [row[k] for row in cells], text=k < left) for k, name in enumerate(columns)]
    around = 3 * len(columns) + 1  # a blank on both sides of a cell, dividers and edges
    with printing():
        if title:
            console.print(Text(title, style="bold"))
        if sum(least) + around <= console.width:
            console.print(_table(columns, cells, left, least))
        else:
            _print_records(console, columns, cells)


def show_components(record: dict[str, Any]) -> None:
    """Print a table of the variance components of a record, if there are any."""
    components = record["variance_components"]
    if components is not None:
        table(f"sigmas estimated in {components['rounds']} adjustments", ("group", "redundancy", "times given", "sd"), [
            [c["group"], number(c["redundancy"], 1), number(c["factor"]), "held" if c["held"] else number(c["sd"])]
            for c in components["components"]
        ])  # fmt: skip


def _least(name: str, cells: Sequence[str], *, text: bool) -> int:
    """Return the minimum width of a column.

    Numbers are not divided, and text is divided between words.
    """
    from rich.cells import cell_len

    if not text:
        return max(map(cell_len, (name, *cells)))
    return max((min(cell_len(word), LONGEST_WORD) for cell in (name, *cells) for word in cell.split()), default=1)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], left: int, least: Sequence[int]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    out = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for k, (name, width) in enumerate(zip(columns, least, strict=True)):
        text = k < left
        out.add_column(
            Text(name), justify="left" if text else "right", overflow="fold", no_wrap=not text, min_width=width
        )
    for row in rows:
        out.add_row(*map(Text, row))
    return out


def _print_records(console: Console, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print each row on several lines: the first cell, then name and value of each other cell."""
    from rich.text import Text

    lines = []
    names = max(map(len, columns[1:]), default=0)
    for row in rows:
        lines += [Text(""), Text(f"{columns[0]} {row[0]}".strip())]
        for name, cell in zip(columns[1:], row[1:], strict=True):
            begin = f"  {name:<{names}}  "
            wrapped = textwrap.wrap(cell, max(console.width - len(begin), 1), break_long_words=False)
            lines += [
                Text(begin + part if not k else " " * len(begin) + part) for k, part in enumerate(wrapped or [""])
            ]
    for line in lines:
        console.print(line, soft_wrap=True)
    console.print()
