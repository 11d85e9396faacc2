"""Pools that run tasks in this process, or on the workers of a dask cluster, with identical results to the last bit.

A pool runs one function over many arguments. A sum adds the results of the parts
pairwise, in a binary tree of the part numbers. So neither the number of workers nor the
order in which tasks end changes the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, TypeVar

from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import FgOrientError, NoSolutionError

if TYPE_CHECKING:
    from fg_orient.adjustment.parts.watch import Watch

T = TypeVar("T")
#: If no result arrives within this time, s, lost tasks are searched for.
PATIENCE_S: Final = 2.0


def tree(arguments: Sequence[Any], depth: float, leaf: Callable[[Sequence[Any]], Any]) -> Any:
    """Sum ``leaf(branch)`` over the branches of a binary tree at a depth.

    A branch of one element is not divided.
    """
    if depth == 0 or len(arguments) == 1:
        return leaf(arguments)
    half = len(arguments) // 2
    return tree(arguments[:half], depth - 1, leaf) + tree(arguments[half:], depth - 1, leaf)


def branches(arguments: Sequence[Any], depth: int) -> list[Sequence[Any]]:
    """Return the branches of this tree at a depth, in order."""
    return list(tree(arguments, depth, lambda branch: [branch]))


def summed(task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
    """Sum the results of a task over its arguments, along this tree."""
    return tree(arguments, math.inf, lambda branch: task(*branch[0]))


def _summed_on_worker(task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
    """Return the sum in another process; more BLAS threads in it would change the last bits."""
    with one_blas_thread():
        return summed(task, arguments)


class Pool:
    """Pool that runs tasks in this process, one after another; ``threads`` is for the kernels of a task."""

    threads: int | None = None

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        """Return the sum of ``task(*a)`` over the arguments, in a tree by their number."""
        return summed(task, arguments)

    def each(self, task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
        """Yield number and result of each task when it has ended."""
        for k, argument in enumerate(arguments):
            yield k, task(*argument)

    def forget(self, folder: str) -> None:
        """Close the parts of a work folder."""
        tasks.forget(folder)


class Cluster(Pool):
    """Pool that runs tasks on the workers of a dask cluster.

    Parameters
    ----------
    client : dask.distributed.Client
    watch : Watch, optional
        Watch over the processes that were started for this pool.
    """

    threads: int | None = 1

    def __init__(self, client: Any, watch: Watch | None = None) -> None:
        self.client, self.watch = client, watch

    def workers(self) -> list[str]:
        """Return the addresses of the running workers, sorted."""
        return sorted(self.client.nthreads())

    def _results(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Yield the results of a task. The same worker always receives the same argument, as long as it runs.

        If a task waits for a worker that ends, and no other worker runs at that moment,
        dask never runs the task. Such tasks are submitted again for any worker.
        """
        workers: list[str | None] = [*self.workers()] or [None]
        homes = [workers[k * len(workers) // len(arguments)] for k in range(len(arguments))]
        futures = [
            self.client.submit(task, *argument, pure=False, workers=home, allow_other_workers=home is not None)
            for home, argument in zip(homes, arguments, strict=True)
        ]
        results: list[Any] = []
        while len(results) < len(futures):
            k = len(results)
            try:
                results.append(futures[k].result(timeout=PATIENCE_S))
            except TimeoutError:
                if futures[k].status == "error":
                    raise
                alive = self.workers()
                if alive and homes[k] not in (None, *alive):
                    known = {key for keys in self.client.processing().values() for key in keys}
                    if futures[k].key not in known:
                        futures[k], homes[k] = self.client.submit(task, *arguments[k], pure=False), None
        return results

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        """See :class:`Pool`; workers sum the branches of the tree, this process sums its top.

        NoSolutionError: workers fail repeatedly, or the connection to the scheduler is lost.
        """
        with _failures(self.watch):
            workers = max(len(self.workers()), 1)
            depth, parts = 0, branches(arguments, 0)
            while len(parts) < min(4 * workers, len(arguments)) and (len(parts) < workers or len(parts) % workers):
                depth += 1
                parts = branches(arguments, depth)
            sums = iter(self._results(_summed_on_worker, [(task, branch) for branch in parts]))
            return tree(arguments, depth, lambda branch: next(sums))

    def each(self, task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
        """See :class:`Pool`; it raises the same errors as :meth:`total`."""
        with _failures(self.watch):
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
        with _failures(self.watch):
            self.client.run(tasks.forget, folder, on_error="ignore")


def _distributed() -> Any:
    """Return the optional package ``distributed``, without types."""
    return import_module("distributed")


@contextmanager
def _failures(watch: Watch | None = None) -> Iterator[None]:
    """Convert exceptions of a cluster to NoSolutionError."""
    from concurrent.futures import CancelledError

    dask = _distributed()
    try:
        yield
    except FgOrientError:
        raise
    except Exception as error:
        # dask has no exception classes for these cases: an OSError without number, and a closed pool
        timed_out = isinstance(error, OSError) and error.errno is None
        closed = type(error) is RuntimeError and "closed" in str(error)
        known = dask.comm.CommClosedError, dask.CancelledError, CancelledError, TimeoutError
        if watch is not None and watch.exhausted:
            fault = "parallel.replaced", "workers", f"{watch.ended} processes"
        elif isinstance(error, dask.KilledWorker):
            fault = "parallel.killed", "workers", str(error.last_worker)
        elif timed_out or closed or isinstance(error, known):
            fault = "parallel.lost", "scheduler", type(error).__name__
        else:
            raise
        raise NoSolutionError.of(fault[0], option=fault[1], value=fault[2]) from error
