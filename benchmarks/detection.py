"""The study of mistakes compares exit codes and the first named cause with the power that theory predicts.

    python -m benchmarks.detection [--runs N] [--workers N] [--blocks ...] [--minutes N]

writes results/detection.json.
``python -m benchmarks.detection_page`` writes docs/detection.md from this file. ``benchmarks.mistakes``
defines blocks, mistakes and sizes. A cell is a mistake of one size in one block. Each run
draws a perfect block (``benchmarks.drawn``), plants the mistake and adjusts with default
options. Runs in the file are not repeated.

The power is predicted from the linear model at the truth. The residuals are
``-R (e + delta)``, where delta is the error that the mistake makes in the observations. They
are drawn 2000 times, and all doubts of docs/verdict.md are computed from their formulas.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import fg_orient as fg
from benchmarks.drawn import Drawn, Source
from benchmarks.linear_doubts import LinearBlock
from benchmarks.mistakes import BLOCKS, MISTAKES, Mistake, base
from fg_orient.formats.atomic import write_bytes
from fg_orient.model.block import Block
from fg_orient.model.errors import DECISIVE, FgOrientError
from fg_orient.orientation.confirmation import CAUSES

Array = npt.NDArray[np.float64]
RESULTS: Final = Path(__file__).parent / "results" / "detection.json"
RUNS: Final = 200
DRAWS: Final = 2000
#: The file is written after this number of cells.
PART: Final = 27
Key = tuple[str, int, int]


@lru_cache(maxsize=3)
def source(block: str) -> Source:
    """Return the source of the draws of a block."""
    return Source(*base(block))


def generator(key: Key, run: int) -> np.random.Generator:
    """Return the random generator of a run of a cell."""
    return np.random.default_rng([list(BLOCKS).index(key[0]), key[1], key[2], run])


def planted(key: Key, run: int, noise: float = 1.0) -> tuple[Drawn, Block]:
    """Return a drawn block without and with the mistake. The mistake is in the same points in all runs."""
    mistake = MISTAKES[key[1]]
    drawn = source(key[0]).draw(generator(key, run), noise=noise)
    return drawn, mistake.change(drawn, mistake.sizes[key[2]], np.random.default_rng([key[1], 17]))


def named(findings: Iterable[Any]) -> str:
    """Return what a user reads first about the cause: the likely cause, else the gross error, else the first doubt."""
    doubts = [f for f in findings if f.severity in DECISIVE or f.code in CAUSES]
    for one in doubts:
        if one.code in CAUSES:
            return one.message
    for one in doubts:
        if one.code == "verdict.gross_error":
            return f"gross error: {one.place}"
    return doubts[0].code if doubts else ""


def run_of(key: Key, run: int) -> tuple[int, str]:
    """Return the exit code of a run and the text that is named first."""
    _, block = planted(key, run)
    try:
        solution = fg.adjust(block)
    except FgOrientError as error:
        mixed = [p for p in error.problems if p.code in CAUSES]
        return error.exit_code, mixed[0].message if mixed else f"refused: {error.problems[0].code}"
    code = {"converged": 0, "not_trustworthy": 4}.get(str(solution.status), 3)
    return code, named(solution.findings)


def is_named(mistake: Mistake, text: str) -> bool:
    """Return whether the text names the mistake or its class."""
    return any(part in text for part in mistake.named)


def predicted(key: Key) -> tuple[float, float]:
    """Return the power predicted by the linear model at the truth, and the square root of the non-centrality."""
    drawn, block = planted(key, 0, noise=0.0)
    linear = linear_block(block, drawn)
    return linear.power(block, drawn, DRAWS, generator(key, 0)), linear.noncentrality(block, drawn)


def linear_block(block: Block, drawn: Drawn) -> LinearBlock:
    """Return the linear model at the truth with the stated sigmas of the block with the mistake."""
    clean = replace(
        drawn.block,
        observations=replace(
            drawn.block.observations, sigma_line_px=block.observations.sigma_line_px,
            sigma_sample_px=block.observations.sigma_sample_px,
        ),
        points=replace(drawn.block.points, known=replace(
            drawn.block.points.known, sigma_enu_m=block.points.known.sigma_enu_m)),
    )  # fmt: skip
    return LinearBlock.of(clean, drawn)


def cell(key: Key, known: dict[str, Any] | None, runs: int) -> dict[str, Any]:
    """Return the record of a cell with this number of runs, including the known runs."""
    start = time.perf_counter()
    record = known or {"block": key[0], "mistake": key[1], "size": key[2], "codes": [], "named": [], "seconds": 0.0}
    if "predicted" not in record:
        power, root = predicted(key)
        record |= {"predicted": round(power, 4), "root_noncentrality": round(min(root, 1e6), 2)}
    texts = list(record.get("texts", []))
    for run in range(len(record["codes"]), runs):
        code, text = run_of(key, run)
        record["codes"].append(code)
        record["named"].append(int(is_named(MISTAKES[key[1]], text)))
        texts.append(text[:120])
    record["texts"] = texts
    record["seconds"] = round(record["seconds"] + time.perf_counter() - start, 2)
    return record


def cells(blocks: Iterable[str]) -> Iterator[Key]:
    """Return all cells."""
    for m in range(len(MISTAKES)):
        for block in blocks:
            for size in range(3):
                yield block, m, size


def loaded() -> dict[Key, dict[str, Any]]:
    """Return the cells of the file of results."""
    if not RESULTS.exists():
        return {}
    records = json.loads(RESULTS.read_text("utf-8"))["cells"]
    return {(r["block"], r["mistake"], r["size"]): r for r in records}


def store(records: dict[Key, dict[str, Any]]) -> None:
    """Write the file of results."""
    ordered = sorted(records.values(), key=lambda r: (r["mistake"], list(BLOCKS).index(r["block"]), r["size"]))
    lines = ",\n".join(json.dumps(r) for r in ordered)
    write_bytes(RESULTS, f'{{"cells": [\n{lines}\n]}}\n'.encode())


def main() -> None:
    """Make the runs that are missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--blocks", nargs="+", default=list(BLOCKS), choices=list(BLOCKS))
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after this time, between two runs")
    given = parser.parse_args()
    if given.workers == 1:
        every(given, map)
        return
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        every(given, pool.map)


def every(given: argparse.Namespace, mapped: Callable[..., Iterable[dict[str, Any]]]) -> None:
    """Run all cells in rounds: first a few runs of each cell, then more."""
    records, start = loaded(), time.perf_counter()
    for runs in sorted({min(2, given.runs), *range(4, given.runs, 4), given.runs}):
        todo = [k for k in cells(given.blocks) if len(records.get(k, {}).get("codes", ())) < runs]
        for part in (todo[n : n + PART] for n in range(0, len(todo), PART)):
            if time.perf_counter() - start > 60.0 * given.minutes:
                return
            known = [records.get(k) for k in part]
            for key, record in zip(part, mapped(cell, part, known, [runs] * len(part)), strict=True):
                records[key] = record
            store(records)
            sys.stdout.write(f"{runs} runs: {MISTAKES[part[-1][1]].what}, {time.perf_counter() - start:.0f} s\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
