"""Reads a result folder back: record, tables, iterations."""

from __future__ import annotations

import csv
import itertools
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.errors import InputError

Array = npt.NDArray[np.float64]

#: Rows of a table that are text at once.
CHUNK: Final = 50_000
#: Columns of words; all others hold numbers.
WORDS: Final = frozenset((
    "id", "role", "image", "parameter", "component", "unit", "sigma_scale", "per_line_unit",
))  # fmt: skip


@dataclass(frozen=True)
class Columns:
    """A CSV table of ours: words as text, the rest as numbers, nan for empty cells."""

    words: dict[str, list[str]]
    figures: dict[str, Array]
    length: int

    def __len__(self) -> int:
        return self.length

    def numbers(self, *names: str) -> Array:
        """Some columns, (n, k)."""
        return np.stack([self.figures[name] for name in names], axis=1)


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
    """

    folder: Path
    record: dict[str, Any]
    points: Columns
    residuals: Columns
    eop: Columns
    iterations: tuple[dict[str, Any], ...]


def read_result(folder: Path) -> Result:
    """Read a result folder.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    if not (folder / "result.json").is_file():
        raise InputError.of("report.no_result", file=folder, place="DIR", value="no result.json")
    name = "result.json"
    try:
        record = json.loads((folder / name).read_text("utf-8"))
        tables = {}
        for name in ("points.csv", "residuals.csv", "eop.csv"):
            tables[name] = read_columns(folder / name)
        name = "iterations.jsonl"
        lines = (folder / name).read_text("utf-8").splitlines()
        iterations = tuple(json.loads(line) for line in lines)
        return Result(folder, record, tables["points.csv"], tables["residuals.csv"], tables["eop.csv"], iterations)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError.of("report.damaged", file=folder / name, value=error) from None


def read_columns(path: Path) -> Columns:
    """Read a CSV table of ours; lines that start with # are comments.

    Raises
    ------
    ValueError
        Rows of different lengths, or a cell that is no number.
    """
    words: dict[str, list[str]] = {}
    figures: dict[str, list[Array]] = {}
    with path.open(encoding="utf-8", newline="") as stream:
        rows = csv.reader(line for line in stream if not line.startswith("#"))
        names = next(rows, [])
        for name in names:
            (words if name in WORDS else figures)[name] = []
        length = 0
        while part := list(itertools.islice(rows, CHUNK)):
            length += len(part)
            for name, cells in zip(names, zip(*part, strict=True), strict=True):
                if name in words:
                    words[name] += cells
                else:
                    figures[name].append(np.array([float(cell) if cell else math.nan for cell in cells]))
    return Columns(words, {name: np.concatenate([np.zeros(0), *parts]) for name, parts in figures.items()}, length)


def residual_summary(result: Result) -> list[dict[str, Any]]:
    """Root mean square, largest residual (px) and largest v/sigma per image."""
    table = result.residuals
    v, sigma = table.numbers("v_line_px", "v_sample_px"), table.numbers("sigma_line_px", "sigma_sample_px")
    place = {image: k for k, image in enumerate(dict.fromkeys(table.words["image"]))}
    image = np.fromiter(map(place.__getitem__, table.words["image"]), np.intp, len(table))
    out = []
    for name, k in place.items():
        rows = np.flatnonzero(image == k)
        part, ratio = v[rows], np.abs(v[rows] / sigma[rows]).max(axis=1)
        worst = int(np.argmax(ratio))
        out.append({
            "image": name, "n": len(rows), "rms_line_px": float(np.sqrt(np.mean(part[:, 0] ** 2))),
            "rms_sample_px": float(np.sqrt(np.mean(part[:, 1] ** 2))), "max_px": float(np.abs(part).max()),
            "max_ratio": float(ratio[worst]), "worst": table.words["id"][int(rows[worst])],
        })  # fmt: skip
    return out
