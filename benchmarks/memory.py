"""The benchmark measures the working set of a solution: ``python -m benchmarks.memory SIZE THREADS BACKEND``.

The working set is the peak of the resident memory during the solution (structure and
iterations), minus the resident memory before the block was made, minus the arrays of the
problem: observations, records, control records, start values, known coordinates, metadata. A
small block is solved before, so that the memory for compilation and for the first calls of
the kernels is not counted.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from typing import Any

import numpy as np

from benchmarks.cases import counts, spot_block
from fg_orient.adjustment.graph import GraphBackend
from fg_orient.adjustment.loop import gauss_newton
from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.model.machine import release, reset_peak, status_bytes


def _arrays(thing: Any) -> Iterator[np.ndarray]:
    """Yield the arrays in the fields of a dataclass and of dataclasses in its fields."""
    for f in fields(thing):
        value = getattr(thing, f.name)
        if isinstance(value, np.ndarray):
            yield value
        elif is_dataclass(value):
            yield from _arrays(value)


def input_bytes(problem: Problem) -> tuple[int, int]:
    """Return the bytes of all arrays of problem, block and metadata, and of the records alone.

    Shared arrays count once.
    """
    parts = (problem, *(image.sensor.metadata for image in problem.block.images))
    found = {a.ctypes.data: a.nbytes for part in parts for a in _arrays(part)}
    return sum(found.values()), problem.records.nbytes + problem.control_records.nbytes


def solved(problem: Problem, threads: int, backend: str) -> int:
    """Solve by Gauss-Newton on the "schur" or the "graph" backend; return the iterations."""
    if backend == "schur":
        own = SchurBackend(problem, threads=threads)
        return len(gauss_newton(own, own.initial(), 50).log)
    return len(GTSAM_OPTIMIZERS["gauss-newton"](GraphBackend(problem, threads), problem.start, 50).log)


def measure(size: str, threads: int, backend: str) -> dict[str, Any]:
    """Return one record."""
    with one_blas_thread():
        solved(compile_problem(spot_block("1e3")), threads, backend)
        release()
        before_reading = status_bytes("VmRSS")
        problem = compile_problem(spot_block(size))
        release()
        whole, records = input_bytes(problem)
        before_solving = status_bytes("VmRSS")
        gc.disable()
        reset_peak()
        iterations = solved(problem, threads, backend)
        peak = status_bytes("VmHWM")
    n = counts(problem)
    return {
        "size": size, "threads": threads, "backend": backend, **asdict(n), "before_reading": before_reading,
        "before_solving": before_solving, "peak": peak, "input": whole, "records": records,
        "working_set": peak - before_reading - whole, "solve_only": peak - before_solving,
        "iterations": iterations,
    }  # fmt: skip


def measure_apart(size: str, threads: int, backend: str = "schur") -> dict[str, Any]:
    """Run :func:`measure` in a new process."""
    command = [sys.executable, "-m", "benchmarks.memory", size, str(threads), backend]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1], int(sys.argv[2]), sys.argv[3])))
