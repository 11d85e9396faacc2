"""Checkpoints: the input of the next iteration in a file, so that an interrupted run continues with identical bits.

The file contains the state, damping or radius, the stage and scale of the loss, the log,
and a fingerprint of the problem. Robust weights follow from the state. The file is
written completely or not at all.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import math
import time
import zipfile
from dataclasses import asdict, astuple, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient import __version__
from fg_orient.adjustment.loop import Carried, IterationRecord
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import some_rows
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.load import load_npz
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options

FORMAT: Final = 3
EVERY_S: Final = 60.0
RECORDS: Final = 50_000
_NUMBERS: Final = tuple(f.name for f in fields(Carried) if f.name not in ("state", "log"))
_WHOLE: Final = ("rejected", "rising", "begun_at")
#: These numbers may have no value, which is nan or inf.
_OPTIONAL: Final = ("control", "previous", "mu")
#: Squares of larger numbers overflow. No iteration writes them.
_LARGEST: Final = 1e150


class Checkpoint:
    """File from which an interrupted run continues.

    Parameters
    ----------
    path : path
        Its folder must exist when it is written.
    every_s : float
        Minimum time between two writings; 0 writes after each iteration.
    resume : bool
        Continue from the file if it exists; otherwise it is overwritten.
    scope : str
        Further inputs that change the last bits, such as the number of parts; a continued
        run must have the same inputs.

    Raises
    ------
    InputError
        ``every_s`` is negative or not finite.
    """

    def __init__(self, path: str | Path, *, every_s: float = EVERY_S, resume: bool = False, scope: str = "") -> None:
        if not (math.isfinite(every_s) and every_s >= 0.0):
            raise InputError.of("options.value", option="checkpoint_every", value=every_s, expected="seconds from 0")
        self.path, self.every_s, self.resume, self.scope = Path(path), every_s, resume, scope
        self._last = time.monotonic()
        self._pending: tuple[Problem, str, Carried[State]] | None = None
        self._of: Problem | None = None
        self._fingerprint = ""

    def keep(self, problem: Problem, backend: str, carried: Carried[State]) -> None:
        """Store the input of the next iteration; write it if ``every_s`` has passed."""
        if self._of is not problem:
            self._of, self._fingerprint = problem, ""
        self._pending = problem, backend, carried
        if time.monotonic() - self._last >= self.every_s:
            self.write()

    def write(self) -> int | None:
        """Write the last input and return its number of iterations; None if there is none.

        Raise InputError if the file cannot be written.
        """
        if self._pending is None:
            return None
        problem, backend, carried = self._pending
        self._fingerprint = self._fingerprint or fingerprint(problem, self.scope)
        stream = io.BytesIO()
        np.savez(
            stream, allow_pickle=False, format=np.array(FORMAT), fingerprint=np.array(self._fingerprint),
            backend=np.array(backend), image=carried.state.image, ground=carried.state.ground,
            numbers=np.array([float(getattr(carried, name)) for name in _NUMBERS]),
            log=np.array([astuple(r) for r in carried.log], dtype=np.float64).reshape(-1, len(fields(IterationRecord))),
        )  # fmt: skip
        write_bytes(self.path, stream.getvalue())
        self._last, self._pending = time.monotonic(), None
        return len(carried.log)

    def read(self, problem: Problem) -> tuple[str, Carried[State]] | None:
        """Return the backend and input of its next iteration; None without a file or without ``resume``.

        InputError: the file is not a checkpoint, belongs to another problem, or was changed so that no iteration can
        have written it.
        """
        self._pending = None
        if not (self.resume and self.path.exists()):
            return None
        try:
            arrays = load_npz(self.path, "checkpoint.unreadable")
            if int(arrays["format"]) != FORMAT:
                raise InputError.of("checkpoint.unreadable", file=self.path, value=f"format {arrays['format']}")
            belongs_to, backend, carried = str(arrays["fingerprint"]), str(arrays["backend"]), _carried(arrays)
        except (OSError, ValueError, TypeError, KeyError, EOFError, OverflowError, zipfile.BadZipFile) as error:
            raise InputError.of("checkpoint.unreadable", file=self.path, value=type(error).__name__) from error
        self._of, self._pending, self._fingerprint = problem, None, fingerprint(problem, self.scope)
        if belongs_to != self._fingerprint:
            raise InputError.of("checkpoint.other", file=self.path, option="resume")
        wrong = _impossible(problem, backend, carried)
        if wrong:
            raise InputError.of("checkpoint.unreadable", file=self.path, value=wrong)
        return backend, carried

    def remove(self) -> None:
        """Remove the file after the end of the run; no error if it stays, as only ``resume`` reads it."""
        self._pending = None
        with contextlib.suppress(OSError):
            self.path.unlink()


def _carried(arrays: dict[str, npt.NDArray[Any]]) -> Carried[State]:
    numbers = dict(zip(_NUMBERS, arrays["numbers"].tolist(), strict=True))
    numbers |= {name: int(numbers[name]) for name in _WHOLE}
    state = State(np.ascontiguousarray(arrays["image"]), np.ascontiguousarray(arrays["ground"]))
    names = [f.name for f in fields(IterationRecord)]
    log = [dict(zip(names, row, strict=True)) for row in arrays["log"].tolist()]
    records = (IterationRecord(**r | {"iteration": int(r["iteration"]), "accepted": bool(r["accepted"])}) for r in log)
    return Carried(state, log=tuple(records), **numbers)


def _impossible(problem: Problem, backend: str, carried: Carried[State]) -> str:
    """Return the name of a part that no iteration of this problem can have written; "" if there is none."""
    for name in ("image", "ground"):
        values, start = getattr(carried.state, name), getattr(problem.start, name)
        if values.shape != start.shape or values.dtype != start.dtype:
            return name
        if not np.all((np.abs(values) <= _LARGEST) | np.isnan(start)):
            return name
    for name in _NUMBERS:
        value, n = getattr(carried, name), len(carried.log)
        possible = 0 <= value <= n if name in _WHOLE else abs(value) <= _LARGEST
        if not possible and (name not in _OPTIONAL or math.isfinite(value)):
            return name
    if any(r.iteration != k or not 0.0 <= r.seconds <= _LARGEST for k, r in enumerate(carried.log, start=1)):
        return "log"
    return "" if backend != "auto" and declared(Options)["backend"].allows(backend) else "backend"


def fingerprint(problem: Problem, scope: str = "") -> str:
    """Return the SHA-256 of all inputs of an iteration; ``scope``: see :class:`Checkpoint`."""
    digest = hashlib.sha256(repr((__version__, scope)).encode())
    given = asdict(problem.block.options)
    options = {name: given[name] for name, one in declared(Options).items() if one.iterates}
    digest.update(repr(options).encode())
    for model in problem.models:
        digest.update(repr((model.equation.name, model.parameters.names)).encode())
        digest.update(model.parameters.setup.tobytes())
    for extra in problem.block.extra:
        digest.update(repr((extra.equation.name, extra.unknowns, extra.n_residuals)).encode())
    o = problem.observations
    for begin in range(0, len(o), RECORDS):  # in parts, because the records are the largest array
        digest.update(np.ascontiguousarray(some_rows(problem, "records", slice(begin, begin + RECORDS))).data)
    for array in (
        problem.control_records,
        problem.active,
        problem.observed,
        problem.origin_m,
        o.image,
        o.point,
        problem.start.image,
        problem.start.ground,
        *(part for extra in problem.block.extra for part in (extra.record, problem.extra_setup(extra))),
    ):
        digest.update(repr(array.shape).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
