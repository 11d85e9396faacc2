"""Reads a result folder back: record, tables, iterations."""

from __future__ import annotations

import csv
import itertools
import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.model.names import Status

Array = npt.NDArray[np.float64]

#: Rows of a table that are text at once.
CHUNK: Final = 50_000
#: Columns of words; all others hold numbers.
WORDS: Final = frozenset((
    "id", "role", "image", "parameter", "component", "unit", "sigma_scale", "per_line_unit", "shared",
))  # fmt: skip


_ENU: Final = ("east_m", "north_m", "up_m")
#: Tables of a result and the columns that are read of each; all where none is named.
READ: Final = {
    "points.csv": (
        "id", "role", "lon_deg", "lat_deg", "x_m", "y_m", "z_m", "sigma_scale", *(f"sigma_{axis}" for axis in _ENU),
        *(f"difference_{axis}" for axis in _ENU),
    ),
    "residuals.csv": ("image", "id", "line", "sample", "v_line_px", "v_sample_px", "sigma_line_px", "sigma_sample_px"),
    "eop.csv": (),
}  # fmt: skip
#: Columns that are read where the options of the adjustment let it write them.
OPTIONAL: Final = {
    "residuals.csv": ("w_line", "w_sample", "redundancy_line", "redundancy_sample", "mdb_line_px", "mdb_sample_px"),
}  # fmt: skip


@dataclass(frozen=True)
class Columns:
    """A CSV table of ours: words as text, the rest as numbers, nan for empty cells."""

    words: dict[str, list[str]]
    figures: dict[str, Array]
    length: int

    def __len__(self) -> int:
        return self.length

    def numbers(self, *names: str) -> Array:
        """Some columns, (n, k); nan where the table has not got them."""
        return np.stack([self.figures.get(name, np.full(self.length, np.nan)) for name in names], axis=1)

    def codes(self, name: str, words: Sequence[str]) -> npt.NDArray[np.intp]:
        """Number of each cell of a column of words in a list of them."""
        place = {word: k for k, word in enumerate(words)}
        return np.fromiter(map(place.__getitem__, self.words[name]), np.intp, self.length)


@dataclass(frozen=True)
class Result:
    """A result folder as read.

    Parameters
    ----------
    folder : Path
    record : dict
        ``result.json``.
    points, residuals, eop : Columns
        The tables.
    iterations : tuple of dict
        ``iterations.jsonl``.
    cofactors : dict
        Cofactors (k, k) of each image's unknowns by image; empty in a folder without ``arrays.npz``.
    """

    folder: Path
    record: dict[str, Any]
    points: Columns
    residuals: Columns
    eop: Columns
    iterations: tuple[dict[str, Any], ...]
    cofactors: dict[str, Array] = field(default_factory=dict)


def read_record(folder: Path) -> dict[str, Any]:
    """Read ``result.json`` of a result folder.

    Raises
    ------
    InputError
        It is missing or damaged.
    """
    path = folder / "result.json"
    if not path.is_file():
        raise InputError.of("report.no_result", file=folder, place="DIR", value="no result.json")
    try:
        record = json.loads(path.read_text("utf-8"))
        if not isinstance(record, dict):
            raise ValueError("no JSON object")
    except (OSError, ValueError) as error:
        raise InputError.of("report.damaged", file=path, value=error) from None
    return record


def nothing_adjusted(record: Mapping[str, Any]) -> bool:
    """Whether a record is that of a block whose unknowns nothing determined."""
    return record.get("status") == Status.RANK_DEFICIENT


def read_result(folder: Path) -> Result:
    """Read a result folder.

    Raises
    ------
    InputError
        A file is missing or damaged, or nothing was adjusted.
    """
    record = read_record(folder)
    if nothing_adjusted(record):
        raise InputError.of("report.nothing_adjusted", file=folder, place="result.json", value=record["status"])
    name = "result.json"
    try:
        tables = {}
        for name, columns in READ.items():
            tables[name] = read_columns(folder / name, *columns, optional=OPTIONAL.get(name, ()))
        name = "iterations.jsonl"
        lines = (folder / name).read_text("utf-8").splitlines()
        iterations = tuple(json.loads(line) for line in lines)
        name = "arrays.npz"
        cofactors = _cofactors(folder / name, [str(image["id"]) for image in record["images"]])
        three = (tables["points.csv"], tables["residuals.csv"], tables["eop.csv"])
        return Result(folder, record, *three, iterations, cofactors)
    except (OSError, ValueError, KeyError, csv.Error, zipfile.BadZipFile) as error:
        raise InputError.of("report.damaged", file=folder / name, value=error) from None


def _cofactors(path: Path, images: Sequence[str]) -> dict[str, Array]:
    """Cofactors of the images' unknowns by image, in the order of the record; none where there is no such file."""
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as arrays:
        counts, stacked = arrays["n_parameters"].tolist(), np.asarray(arrays["image_cofactors"], float)
    return {image: q[:n, :n] for image, n, q in zip(images, counts, stacked, strict=True)}


def read_columns(path: Path, *wanted: str, optional: Sequence[str] = ()) -> Columns:
    """Read a CSV table of ours, or some columns of it; lines that start with # are comments.

    Parameters
    ----------
    path : Path
    *wanted : str
        Columns that must be there; all columns are read where none is named.
    optional : sequence of str
        Columns that are read besides, where they are there.

    Raises
    ------
    ValueError
        Rows of different lengths, a cell that is no number, or a column that is not there.
    """
    words: dict[str, list[str]] = {}
    figures: dict[str, list[Array]] = {}
    length = 0
    with path.open(encoding="utf-8", newline="") as stream:
        lines = (line for line in stream if not line.startswith("#"))
        names = next(csv.reader(lines), [])
        if missing := set(wanted) - set(names):
            raise ValueError(f"no column {min(missing)}")
        chosen = [k for k, name in enumerate(names) if name in wanted or name in optional or not wanted]
        while part := list(itertools.islice(lines, CHUNK)):
            cells = _split(part, len(names))
            length += len(cells) // len(names)
            for k in chosen:
                column = cells[k :: len(names)]
                if names[k] in WORDS:
                    words.setdefault(names[k], []).extend(column)
                else:
                    numbers = np.array([float(cell) if cell else math.nan for cell in column])
                    figures.setdefault(names[k], []).append(numbers)
    for k in chosen:
        (words if names[k] in WORDS else figures).setdefault(names[k], [])
    return Columns(words, {name: np.concatenate([np.zeros(0), *parts]) for name, parts in figures.items()}, length)


def _split(lines: list[str], width: int) -> list[str]:
    """Cells of lines, one after the other."""
    text = "".join(lines)
    if '"' in text:
        rows = list(csv.reader(lines))
    elif all(line.count(",") == width - 1 for line in lines):
        return text.rstrip("\r\n").replace("\r\n", ",").replace("\n", ",").split(",")
    else:
        rows = [line.split(",") for line in lines]
    if any(len(row) != width for row in rows):
        raise ValueError(f"a line without {width} cells")
    return [cell for row in rows for cell in row]


def residual_summary(result: Result) -> list[dict[str, Any]]:
    """Root mean square, largest residual (px) and largest v/sigma per image."""
    table = result.residuals
    v, sigma = table.numbers("v_line_px", "v_sample_px"), table.numbers("sigma_line_px", "sigma_sample_px")
    names = list(dict.fromkeys(table.words["image"]))
    image = table.codes("image", names)
    out = []
    for k, name in enumerate(names):
        rows = np.flatnonzero(image == k)
        part, ratio = v[rows], np.abs(v[rows] / sigma[rows]).max(axis=1)
        worst = int(np.argmax(ratio))
        out.append({
            "image": name, "n": len(rows), "rms_line_px": float(np.sqrt(np.mean(part[:, 0] ** 2))),
            "rms_sample_px": float(np.sqrt(np.mean(part[:, 1] ** 2))), "max_px": float(np.abs(part).max()),
            "max_ratio": float(ratio[worst]), "worst": table.words["id"][int(rows[worst])],
        })  # fmt: skip
    return out
