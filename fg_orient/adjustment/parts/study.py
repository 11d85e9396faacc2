"""Tasks run in this process, or on the workers of a dask cluster, with the same results bit by bit; studies.

A pool runs one function over many arguments. Sums follow a binary tree of the numbers of the parts: neither the number
of workers nor the order in which tasks end changes the last bit.

A study runs one function over many cases. Its results are in the order of the cases and the same for any number of
workers. With a folder each result is written to a file: an interrupted study continues with the missing cases.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import math
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, TypeVar
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from fg_orient import __version__
from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.formats.atomic import write_bytes
from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError

__all__ = ["study"]

T = TypeVar("T")

#: Seconds to wait for the answer of a scheduler.
CONNECT_S: Final = 10.0
#: Maximum number of workers started on one machine.
MAX_WORKERS: Final = 256


@dataclass(frozen=True)
class Execution:
    """Parts of a block and workers of a block or study.

    Parameters
    ----------
    parts : int or None
        Parts of the ground points; None: by the size of the block.
    workers : int
        Processes on this machine; 0 or 1: only this process.
    cluster : str, dask.distributed.Client or None
        Address of the scheduler of a running cluster, or a client of it; replaces ``workers``.
    work_dir : path or None
        Folder accessible to all workers; a temporary folder is made in it. Default: the system's folder for temporary
        files, to which other machines have no access.

    Raises
    ------
    InputError
        An invalid value.
    """

    parts: int | None = None
    workers: int = 0
    cluster: Any = None
    work_dir: str | Path | None = None

    def __post_init__(self) -> None:
        _require_kind("parts", self.parts, int, type(None))
        _require_kind("workers", self.workers, int)
        _require_kind("work_dir", self.work_dir, str, Path, type(None))
        if not (self.cluster is None or isinstance(self.cluster, str) or hasattr(self.cluster, "submit")):
            raise InputError.of("parallel.kind", option="cluster", value=self.cluster, expected="address or client")
        if self.parts is not None and self.parts < 1:
            raise InputError.of("parallel.number", option="parts", value=self.parts, low=1, high="the ground points")
        if not 0 <= self.workers <= MAX_WORKERS:
            raise InputError.of("parallel.number", option="workers", value=self.workers, low=0, high=MAX_WORKERS)


def _require_kind(option: str, value: Any, *kinds: type) -> None:
    if isinstance(value, bool) or not isinstance(value, kinds):
        expected = " or ".join("nothing" if kind is type(None) else kind.__name__ for kind in kinds)
        raise InputError.of("parallel.kind", option=option, value=repr(value), expected=expected)


def tree(arguments: Sequence[Any], depth: float, leaf: Callable[[Sequence[Any]], Any]) -> Any:
    """Sum of ``leaf(branch)`` over the branches of a binary tree at a depth; a branch of one is not divided."""
    if depth == 0 or len(arguments) == 1:
        return leaf(arguments)
    half = len(arguments) // 2
    return tree(arguments[:half], depth - 1, leaf) + tree(arguments[half:], depth - 1, leaf)


def branches(arguments: Sequence[Any], depth: int) -> list[Sequence[Any]]:
    """Branches of this tree at a depth, in order."""
    return list(tree(arguments, depth, lambda branch: [branch]))


def summed(task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
    """Sum of a task over arguments, in this tree."""
    return tree(arguments, math.inf, lambda branch: task(*branch[0]))


def _summed_on_worker(task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
    """Sum in another process, whose BLAS may use more threads, which would change last bits."""
    with one_blas_thread():
        return summed(task, arguments)


class Pool:
    """Runs tasks in this process, one after another; ``threads`` is for the kernels of a task."""

    threads: int | None = None

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        """Sum of ``task(*a)`` over the arguments, in a tree by their number."""
        return summed(task, arguments)

    def each(self, task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
        """Number and result of each task when it has ended."""
        for k, argument in enumerate(arguments):
            yield k, task(*argument)

    def forget(self, folder: str) -> None:
        """Close the parts of a work folder."""
        tasks.forget(folder)


class Cluster(Pool):
    """Runs tasks on the workers of a dask cluster.

    Parameters
    ----------
    client : dask.distributed.Client
    """

    threads: int | None = 1

    def __init__(self, client: Any) -> None:
        self.client = client

    def workers(self) -> list[str]:
        """Addresses of the running workers, sorted."""
        return sorted(self.client.nthreads())

    def _submit(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Futures; an argument goes to the same worker each time, as long as this worker runs."""
        workers: list[str | None] = [*self.workers()] or [None]
        homes = [workers[k * len(workers) // len(arguments)] for k in range(len(arguments))]
        return [
            self.client.submit(task, *argument, pure=False, workers=home, allow_other_workers=home is not None)
            for home, argument in zip(homes, arguments, strict=True)
        ]

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        """See :class:`Pool`; workers sum the branches of the tree, this process sums its top.

        NoSolutionError: workers fail repeatedly, or the connection to the scheduler is lost.
        """
        with _failures():
            workers = max(len(self.workers()), 1)
            depth, parts = 0, branches(arguments, 0)
            while len(parts) < min(4 * workers, len(arguments)) and (len(parts) < workers or len(parts) % workers):
                depth += 1
                parts = branches(arguments, depth)
            sums = iter(self.client.gather(self._submit(_summed_on_worker, [(task, branch) for branch in parts])))
            return tree(arguments, depth, lambda branch: next(sums))

    def each(self, task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
        """See :class:`Pool`; raises as :meth:`total`."""
        with _failures():
            futures = [self.client.submit(task, *argument, pure=False) for argument in arguments]
            number = {future.key: k for k, future in enumerate(futures)}
            try:
                for future in _distributed().as_completed(futures, loop=self.client.loop):
                    yield number[future.key], future.result()
                    future.release()
            finally:
                self.client.cancel(futures)

    def forget(self, folder: str) -> None:
        """See :class:`Pool`."""
        with _failures():
            self.client.run(tasks.forget, folder, on_error="ignore")


def _distributed() -> Any:
    """The optional package ``distributed``, without types."""
    return import_module("distributed")


@contextmanager
def _failures() -> Iterator[None]:
    """Convert exceptions of a cluster to NoSolutionError."""
    from concurrent.futures import CancelledError

    dask = _distributed()
    try:
        yield
    except FgOrientError:
        raise
    except dask.KilledWorker as error:
        raise NoSolutionError.of("parallel.killed", option="workers", value=str(error.last_worker)) from error
    except (dask.comm.CommClosedError, dask.CancelledError, CancelledError, TimeoutError) as error:
        raise NoSolutionError.of("parallel.lost", option="scheduler", value=type(error).__name__) from error
    except (OSError, RuntimeError) as error:
        # dask has no classes for these: an OSError without number, or a pool that is closed
        timed_out = isinstance(error, OSError) and error.errno is None
        closed = type(error) is RuntimeError and "closed" in str(error)
        if not (timed_out or closed):
            raise
        raise NoSolutionError.of("parallel.lost", option="scheduler", value=type(error).__name__) from error


@contextmanager
def opened(execution: Execution) -> Iterator[Pool]:
    """Pool of an execution; processes started here end with it.

    InputError: dask is missing, or the scheduler does not answer.
    """
    if execution.cluster is None and execution.workers <= 1:
        yield Pool()
        return
    if find_spec("distributed") is None:
        raise InputError.of("parallel.dask", option="cluster" if execution.cluster is not None else "workers")
    if execution.cluster is not None and not isinstance(execution.cluster, str):
        yield Cluster(execution.cluster)
        return
    with _local(execution.workers) if execution.cluster is None else _connected(execution.cluster) as client:
        yield Cluster(client)


def _connected(address: str) -> Any:
    """Client of a running scheduler; InputError if it does not answer."""
    try:
        return _distributed().Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError.of("parallel.unreachable", option="scheduler", value=address) from error


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    """Client of processes on this machine, one thread each.

    dask does not limit their memory: the need of a block is estimated before, and a paused worker would never continue.
    """
    import dask.config

    distributed = _distributed()
    one = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    with (
        tempfile.TemporaryDirectory(prefix="fg-orient-", ignore_cleanup_errors=True) as scratch,
        dask.config.set({"distributed.scheduler.work-stealing": False}),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False}, memory_limit=0, env=one,
            silence_logs=logging.CRITICAL, local_directory=scratch,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


@contextmanager
def work_folder(execution: Execution, pool: Pool) -> Iterator[Path]:
    """New folder inside the work folder, removed at the end; InputError if it cannot be made."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="fg-orient-", dir=execution.work_dir)).absolute()
    except OSError as error:
        raise InputError.of("output.unwritable", file=execution.work_dir, value=error.strerror) from error
    try:
        yield folder
    finally:
        try:
            pool.forget(str(folder))
        finally:
            tasks.forget(str(folder))
            shutil.rmtree(folder, ignore_errors=True)


#: Called after each case with the number of completed cases, the number of all cases, and the case.
Progress = Callable[[int, int, Any], None]
#: From a case to nested dicts and lists of numbers, strings and arrays.
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
        ``task(case)`` depends only on its case. It returns nested dicts and lists of numbers, strings and arrays;
        tuples become lists. With workers it is pickled: a function of a module, or a ``functools.partial``.
    cases : sequence
        Values of JSON.
    workers : int
        Processes on this machine; 0 or 1: only this process.
    cluster : str or dask.distributed.Client, optional
        Scheduler of a running cluster; replaces ``workers``.
    folder : path, optional
        Folder for the results; it is made if it is missing. Cases with a result are not run again.
    key : str
        Further inputs of the results, such as a hash of a file: results with another key, or of another version of this
        package, are not used.
    callback : callable, optional
        Called with (done, of, case), first for cases with a kept result.

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
        return loads(path.read_bytes())
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError.of("parallel.result", file=path, value=type(error).__name__) from error


def dumps(result: Any) -> bytes:
    """Bytes of a result: JSON and arrays without pickle; numbers keep their last bit."""
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


def loads(data: bytes) -> Any:
    """Inverse of :func:`dumps`."""
    with np.load(io.BytesIO(data), allow_pickle=False) as content:
        arrays = dict(content)

    def place(value: dict[str, Any]) -> Any:
        return arrays[f"array{value[_ARRAY]}"] if _ARRAY in value else value

    return json.loads(arrays["json"].tobytes(), object_hook=place)
