"""Finished tasks stored on disk, so that an interrupted run can continue.

Each finished task is one file of arrays in a hidden folder beside the project file. The folder belongs to a run with
the same project file, rasters (size and time), options and version. Other runs do not use its files.
"""

from __future__ import annotations

import hashlib
import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fg_orient import __version__
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.formats.atomic import write_bytes, writing
from fg_orient.formats.load import load_npz
from fg_orient.model.errors import InputError, finding
from fg_orient.model.names import Progress
from fg_orient.orientation.match.blocks import Counts, Matches
from fg_orient.orientation.match.coarse import Coarse
from fg_orient.orientation.match.consistency import Trend
from fg_orient.orientation.match.tasks import Setup, coarse_task

Arrays = dict[str, Any]
NAMES = tuple(Matches.__dataclass_fields__)


class Store:
    """Results of the tasks of a run.

    Parameters
    ----------
    project : Path
    setup : Setup
    resume : bool
        Use the results of an interrupted run; otherwise they are removed.
    """

    def __init__(self, project: Path, setup: Setup, *, resume: bool) -> None:
        words = [__version__, repr(setup), project.read_bytes().hex()]
        words += [f"{s.st_size} {s.st_mtime_ns}" for s in (Path(place.path).stat() for place in setup.places)]
        digest = hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]
        self._all = project.with_name(f".{project.stem}.match")
        self._folder = self._all / digest
        if not resume:
            self.remove()

    def each(
        self,
        pool: Pool,
        task: Callable[..., Any],
        arguments: list[tuple[Any, ...]],
        name: str,
        progress: Progress | None,
    ) -> list[Any]:
        """Return the results of a task in the order of its arguments; finished results are read from files."""
        pack, unpack = (_coarse_arrays, _coarse) if task is coarse_task else (_cell_arrays, _cell)
        files = [self._folder / f"{name}-{k:06d}.npz" for k in range(len(arguments))]
        found: dict[int, Any] = {}
        for k, file in enumerate(files):
            arrays = _read(file)
            if arrays is not None:
                found[k] = unpack(arrays)
        open_ = [k for k in range(len(arguments)) if k not in found]
        if open_:
            with writing(self._folder):
                self._folder.mkdir(parents=True, exist_ok=True)
        try:
            for number, result in pool.each(task, [arguments[k] for k in open_]):
                stream = io.BytesIO()
                np.savez(stream, allow_pickle=False, **pack(result))
                write_bytes(files[open_[number]], stream.getvalue(), durable=False)
                found[open_[number]] = result
                if progress is not None:
                    progress(len(found), len(arguments), f"matching {name}")
        except KeyboardInterrupt:
            stopped = finding("match.interrupted", done=len(found), total=len(arguments), name=name)
            raise KeyboardInterrupt(stopped) from None
        return [found[k] for k in range(len(arguments))]

    def remove(self) -> None:
        """Remove all results."""
        shutil.rmtree(self._all, ignore_errors=True)


def _read(file: Path) -> Arrays | None:
    """Return the arrays of a file; None if it is missing or damaged, so that its task is run again."""
    try:
        return load_npz(file, "checkpoint.unreadable")
    except InputError:
        return None


def _coarse_arrays(result: tuple[Coarse, float]) -> Arrays:
    coarse, sigma = result
    out: Arrays = {
        "pixel": coarse.pixel,
        "t": coarse.t,
        "half_px": coarse.half_px,
        "factor": coarse.factor,
        "candidates": coarse.candidates,
        "reason": np.array(coarse.reason),
        "sigma": sigma,
    }
    if coarse.trend is not None:
        out |= {f"trend_{name}": getattr(coarse.trend, name) for name in Trend.__dataclass_fields__}
    return out


def _coarse(arrays: Arrays) -> tuple[Coarse, float]:
    trend = None
    if "trend_origin" in arrays:
        origin, scale, coefficients = (arrays[f"trend_{name}"] for name in ("origin", "scale", "coefficients"))
        trend = Trend(origin, scale, coefficients, float(arrays["trend_scatter_px"]))
    return Coarse(
        arrays["pixel"],
        arrays["t"],
        float(arrays["half_px"]),
        int(arrays["factor"]),
        trend,
        int(arrays["candidates"]),
        str(arrays["reason"]),
    ), float(arrays["sigma"])


def _cell_arrays(result: list[tuple[Matches, Counts]]) -> Arrays:
    out: Arrays = {"n": len(result)}
    for k, (matches, counts) in enumerate(result):
        out |= {f"{name}_{k}": getattr(matches, name) for name in NAMES} | {f"counts_{k}": np.array(counts)}
    return out


def _cell(arrays: Arrays) -> list[tuple[Matches, Counts]]:
    return [
        (Matches(*(arrays[f"{name}_{k}"] for name in NAMES)), Counts(*arrays[f"counts_{k}"].tolist()))
        for k in range(int(arrays["n"]))
    ]
