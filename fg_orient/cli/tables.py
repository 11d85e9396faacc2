"""Tables for people: at most 80 columns wide, no number broken, no column lost.

Where a terminal is too narrow for the numbers of a row, each row becomes a few lines, one for each column.
"""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

#: Widest table.
WIDTH: Final = 80
#: Words of text are folded where they are longer than this.
LONGEST_WORD: Final = 24


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> None:
    """Print a table; the first ``left`` columns hold text and are aligned to the left, the others hold numbers."""
    from rich.console import Console
    from rich.text import Text

    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"  # not even bold
    console = Console(file=sys.stdout, highlight=False, color_system=None if plain else "auto")
    console.width = min(WIDTH, console.width)
    least = [_least(name, [row[k] for row in rows], text=k < left) for k, name in enumerate(columns)]
    around = 3 * len(columns) + 1  # a space to both sides, a divider, the edges
    if title:
        console.print(Text(title, style="bold"))
    if sum(least) + around <= console.width:
        console.print(_table(columns, rows, left, least))
    else:
        _print_records(console, columns, rows)


def _least(name: str, cells: Sequence[str], *, text: bool) -> int:
    """Least width of a column: whole numbers; of text, its words."""
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
    """Print each row on lines of its own: its first cell, then name and value of the others."""
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
