"""The outputs of two trees are compared file by file and value by value."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
#: Places of a record that differ from run to run: times, memory, versions and where things lie.
OTHER_EACH_TIME = re.compile(
    r"(^|/)(seconds|processor_s|peak_bytes|provenance|memory|us_per_observation_iteration|ended|out|time|started|elapsed_s|date)(/|$|_)"
)
#: Lines of pages and texts that hold such values.
OTHER_LINES = re.compile(r"(?i)seconds|duration|\d\d:\d\d|generated|class=.id|fg_orient \d|memory|µs|us per")
PICTURES = {".png", ".pdf", ".gpkg", ".tif"}

Value = float | str


@dataclass
class Signs:
    """Patterns of case, file and column that change on purpose; ``turns``: the sign; ``redrawn``: anything."""

    rows: list[tuple[str, str, str, str]] = field(default_factory=list)

    @classmethod
    def read(cls, file: Path | None) -> Signs:
        """Read lines of three patterns and the kind of change; ``#`` begins a comment."""
        lines = file.read_text("utf-8").splitlines() if file else []
        kept = [line.split("#")[0].split() for line in lines]
        return cls([(a, b, c, kind) for a, b, c, kind in filter(None, kept)])

    def change(self, case: str, file: str, column: str) -> str:
        """Return how the values of a column change on purpose; "" where they do not."""
        return next((
            kind for a, b, c, kind in self.rows
            if fnmatchcase(case, a) and fnmatchcase(file, b) and fnmatchcase(column, c)
        ), "")  # fmt: skip


@dataclass(frozen=True)
class Difference:
    """A file, or a value of it, has changed; ``size`` is relative to the largest value of its column."""

    case: str
    file: str
    place: str
    before: object
    after: object
    size: float = np.inf

    def __str__(self) -> str:
        return f"{self.case}/{self.file}: {self.place}: {self.before} -> {self.after} ({self.size:.1e})"


def compare(before: Path, after: Path, within: float, signs: Signs) -> Iterator[Difference]:
    """Yield every difference between two folders of :func:`tests.golden.keep.keep`."""
    for name in sorted({path.relative_to(root) for root in (before, after) for path in root.rglob("*")}):
        one, other = before / name, after / name
        if one.is_dir() or other.is_dir():
            continue
        case, file = name.parts[0], "/".join(name.parts[1:])
        if not (one.exists() and other.exists()):
            yield Difference(case, file, "file", one.exists(), other.exists())
        elif one.read_bytes() != other.read_bytes():
            yield from _different(case, file, one, other, within, signs)


def _different(case: str, file: str, one: Path, other: Path, within: float, signs: Signs) -> Iterator[Difference]:
    if one.suffix in PICTURES:
        yield Difference(case, file, "bytes", one.stat().st_size, other.stat().st_size)
        return
    old, new = columns(one), columns(other)
    for column in sorted({*old, *new}):
        values = old.get(column, []), new.get(column, [])
        change = signs.change(case, file, column)
        if change == "redrawn":
            continue
        if len(values[0]) != len(values[1]):
            yield Difference(case, file, column, f"{len(values[0])} values", f"{len(values[1])} values")
            continue
        numbers = [abs(v) for v in values[0] if isinstance(v, float) and np.isfinite(v)]
        scale = max(numbers, default=0.0) or 1.0
        for k, (a, b) in enumerate(zip(*values, strict=True)):
            if isinstance(a, float) and isinstance(b, float):
                was = -a if change == "turns" else a
                size = 0.0 if was == b or (a != a and b != b) else abs(was - b) / scale
                if not size <= within:
                    yield Difference(case, file, f"{column}[{k}]", a, b, size)
            elif a != b:
                yield Difference(case, file, f"{column}[{k}]", a, b)


def columns(path: Path) -> dict[str, list[Value]]:
    """Return the values of a file by the name of their column, key or line."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return {name: [_value(v) for v in np.ravel(arrays[name])] for name in arrays.files}
    text = path.read_text("utf-8", errors="replace")
    if path.suffix == ".csv":
        return _table(text)
    if path.suffix in (".json", ".geojson", ".jsonl", ".stdout"):
        try:
            return _leaves([json.loads(line) for line in (text.splitlines() if path.suffix == ".jsonl" else [text])])
        except ValueError:
            pass
    return _lines(text)


def _table(text: str) -> dict[str, list[Value]]:
    lines = text.splitlines()
    out = {"#": list[Value](line for line in lines if line.startswith("#"))}
    rows = csv.DictReader(line for line in lines if line and not line.startswith("#"))
    for row in rows:
        for name, word in row.items():
            out.setdefault(str(name), []).append(_value(word or ""))
    return out


def _leaves(tree: Any, place: str = "") -> dict[str, list[Value]]:
    """Return the values of a record by their keys, with those of one key in a list as one entry."""
    out = dict[str, list[Value]]()
    if OTHER_EACH_TIME.search(place):
        return out
    items = tree.items() if isinstance(tree, dict) else (("*", v) for v in tree) if isinstance(tree, list) else None
    if items is None:
        return {place: [_value(tree)]}
    for key, value in items:
        for name, values in _leaves(value, f"{place}/{key}").items():
            out.setdefault(name, []).extend(values)
    return out


def _lines(text: str) -> dict[str, list[Value]]:
    """Return the numbers and words of a page or text, line by line."""
    out = dict[str, list[Value]]()
    for line in text.splitlines():
        if OTHER_LINES.search(line):
            continue
        words = NUMBER.sub("0", line)
        out.setdefault(f"line {words[:60]!r}", []).extend([words, *(float(n) for n in NUMBER.findall(line))])
    return out


def _value(word: object) -> Value:
    if isinstance(word, bool | None):
        return str(word)
    try:
        return float(word)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(word)
