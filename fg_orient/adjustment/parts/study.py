"""Run a study: one function over many cases, in this process or on many workers.

The results are in the order of the cases, and they are the same for any number of
workers. If a folder is given, each result is written to a file. An interrupted study then
continues with the missing cases.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient import __version__
from fg_orient.adjustment.parts.execution import Execution, opened
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.load import load_npz
from fg_orient.model.errors import InputError

__all__ = ["study"]
#: Function that receives the number of completed cases, the number of all cases, and the case, after each case.
Progress = Callable[[int, int, Any], None]
#: Function from a case to nested dicts and lists of numbers, strings and arrays.
Task = Callable[[Any], Any]

_ARRAY: Final = "\0array"


def study(
    task: Task,
    cases: Sequence[Any],
    *,
    workers: int = 0,
    cluster: Any = None,
    folder: str | Path | None = None,
    key: str = "",
    callback: Progress | None = None,
) -> list[Any]:
    """Run a task over cases.

    Parameters
    ----------
    task : callable
        ``task(case)`` depends only on its case. It returns nested dicts and lists of
        numbers, strings and arrays; tuples become lists. With workers it is pickled: a
        function of a module, or a ``functools.partial``.
    cases : sequence
        Cases, values that JSON can represent.
    workers : int
        Processes on this machine; 0 or 1: only this process.
    cluster : str or dask.distributed.Client, optional
        Scheduler of a running cluster; replaces ``workers``.
    folder : path, optional
        Folder for the results; it is made if it is missing. Cases with a result are not run again.
    key : str
        Further inputs of the results, such as a hash of a file. Results with another key,
        or of another version of this package, are not used.
    callback : callable, optional
        Function that receives (done, of, case), first for cases with a kept result.

    Returns
    -------
    list
        One result per case, in their order.

    Raises
    ------
    InputError
        dask is missing, the scheduler does not answer, the folder cannot be written, a result cannot be read.
    NoSolutionError
        Workers fail repeatedly.
    """
    paths = [None if folder is None else Path(folder) / f"{_digest(key, case)}.npz" for case in cases]
    results: dict[int, Any] = {k: _kept(path) for k, path in enumerate(paths) if path is not None and path.is_file()}
    done = 0

    def report_progress(number: int) -> None:
        nonlocal done
        done += 1
        if callback is not None:
            callback(done, len(cases), cases[number])

    for number in results:
        report_progress(number)
    missing = [k for k in range(len(cases)) if k not in results]
    if folder is not None and missing:
        _make(Path(folder))
    with opened(Execution(workers=min(workers, len(missing)), cluster=cluster if missing else None)) as pool:
        for place, data in pool.each(_run, [(task, cases[k]) for k in missing]):
            number = missing[place]
            path = paths[number]
            if path is not None:
                write_bytes(path, data)
            results[number] = loads(data)
            report_progress(number)
    return [results[k] for k in range(len(cases))]


def _run(task: Task, case: Any) -> bytes:
    """Run one case in a worker."""
    return dumps(task(case))


def _digest(key: str, case: Any) -> str:
    return hashlib.sha256(json.dumps([__version__, key, case], sort_keys=True).encode()).hexdigest()[:32]


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError.of("output.unwritable", file=folder, value=error.strerror) from error


def _kept(path: Path) -> Any:
    try:
        return loads(path.read_bytes(), path)
    except (OSError, ValueError, KeyError) as error:
        raise InputError.of("parallel.result", file=path, value=type(error).__name__) from error


def dumps(result: Any) -> bytes:
    """Return the bytes of a result: JSON and arrays without pickle; numbers keep their last bit."""
    arrays: list[npt.NDArray[Any]] = []

    def keep(value: object) -> object:
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray) and value.dtype != object:
            arrays.append(value)
            return {_ARRAY: len(arrays) - 1}
        raise TypeError(f"a result cannot hold {type(value).__name__}")

    text = np.frombuffer(json.dumps(result, default=keep).encode(), np.uint8)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, json=text, **{f"array{k}": a for k, a in enumerate(arrays)})
    return stream.getvalue()


def loads(data: bytes, file: object = "") -> Any:
    """Read a result from the bytes of :func:`dumps`; InputError with the ``file`` if they are damaged."""
    arrays = load_npz(data, "parallel.result", file)

    def place(value: dict[str, Any]) -> Any:
        return arrays[f"array{value[_ARRAY]}"] if _ARRAY in value else value

    return json.loads(arrays["json"].tobytes(), object_hook=place)
