"""Reads a result folder back: record, tables, iterations."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.errors import InputError

Array = npt.NDArray[np.float64]
Rows = tuple[dict[str, str], ...]


@dataclass(frozen=True)
class Result:
    """A result folder as read.

    Parameters
    ----------
    folder : Path
    record : dict
        ``result.json``.
    points, residuals, eop : tuple of dict
        Records of the tables, cells as text.
    iterations : tuple of dict
        ``iterations.jsonl``.
    """

    folder: Path
    record: dict[str, Any]
    points: Rows
    residuals: Rows
    eop: Rows
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
            tables[name] = read_rows(folder / name)
        name = "iterations.jsonl"
        lines = (folder / name).read_text("utf-8").splitlines()
        iterations = tuple(json.loads(line) for line in lines)
        return Result(folder, record, tables["points.csv"], tables["residuals.csv"], tables["eop.csv"], iterations)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError.of("report.damaged", file=folder / name, value=error) from None


def read_rows(path: Path) -> Rows:
    """Read a CSV table of ours; lines that start with # are comments."""
    with path.open(encoding="utf-8", newline="") as stream:
        return tuple(csv.DictReader(line for line in stream if not line.startswith("#")))


def values(rows: Rows, *columns: str) -> Array:
    """Numbers (n, k) of some columns; nan for empty cells."""
    cells = [[float(row[name]) if row[name] else math.nan for name in columns] for row in rows]
    return np.array(cells, float).reshape(len(rows), len(columns))


def residual_summary(result: Result) -> list[dict[str, Any]]:
    """Root mean square, largest residual (px) and largest v/sigma per image."""
    out = []
    images = [row["image"] for row in result.residuals]
    v = values(result.residuals, "v_line_px", "v_sample_px")
    sigma = values(result.residuals, "sigma_line_px", "sigma_sample_px")
    for image in dict.fromkeys(images):
        rows = [k for k, name in enumerate(images) if name == image]
        part = v[rows]
        worst = int(np.argmax(np.abs(part / sigma[rows]).max(axis=1)))
        out.append({
            "image": image, "n": len(rows), "rms_line_px": float(np.sqrt(np.mean(part[:, 0] ** 2))),
            "rms_sample_px": float(np.sqrt(np.mean(part[:, 1] ** 2))), "max_px": float(np.abs(part).max()),
            "max_ratio": float(np.abs(part[worst] / sigma[rows][worst]).max()),
            "worst": result.residuals[rows[worst]]["id"],
        })  # fmt: skip
    return out
