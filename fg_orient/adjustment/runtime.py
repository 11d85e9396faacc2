"""Control the threads during an adjustment.

Kernels release the interpreter lock and run in parallel in a few permanent threads. Dense
linear algebra runs in one thread (:func:`one_blas_thread`). The matrices of this package
are small: two BLAS threads take ten times the processor time of one (measured with 180
unknowns). The order of sums also changes rounding errors; results of singular systems
would then depend on the number of cores. Only factors of large reduced systems take more
threads (``schur_reduced.LapackReduced``).
"""

from __future__ import annotations

import math
import os
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.machine import reserve_blas

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Index = npt.NDArray[np.int64]


#: The synchronisation of a thread at a stage takes 50 us. In this time, this number of
#: image points is processed. With t threads, a stage of n image points takes n / t + t
#: times this number. With 2000 image points, two threads take as long as one (measured).
PER_THREAD: Final = 1000


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads_for(image_points: int) -> int:
    """Return the number of threads with the shortest time, at most the number of processors; see :data:`PER_THREAD`.

    Thread t saves time above t (t - 1) :data:`PER_THREAD` image points.
    """
    return min(processors(), (1 + math.isqrt(1 + 4 * image_points // PER_THREAD)) // 2)


class Workers:
    """Threads that divide the range of a kernel among them.

    Results do not depend on the number of threads.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._mates: tuple[_Mate, ...] = ()
        self._process = 0

    def run(self, kernel: Callable[..., Any], cuts: int | Index, *arguments: Any, start: int = 0) -> list[Any]:
        """Call ``kernel(lo, hi, *arguments)`` for each part; return results in the order of the parts.

        ``cuts`` is the length of the range, or the running sum of the cost of its items;
        ``start`` its first item.
        """
        bounds = [start + cut for cut in self._bounds(cuts)]
        if self.threads == 1:
            return [kernel(*bounds, *arguments)]
        mates = self._others()
        asked = 0
        try:
            for mate, lo, hi in zip(mates, bounds[1:], bounds[2:], strict=False):
                mate.inbox.put((kernel, lo, hi, arguments))
                asked += 1
            own = kernel(bounds[0], bounds[1], *arguments)
        finally:
            others = self._results(mates[:asked])  # these threads write to the arrays of the caller
        for _, error in others:
            if error is not None:
                raise error
        return [own, *(result for result, _ in others)]

    def _results(self, mates: tuple[_Mate, ...]) -> list[tuple[Any, BaseException | None]]:
        """Wait for all threads.

        After an interrupt they are replaced, because their results would arrive later.
        """
        try:
            return [mate.outbox.get() for mate in mates]
        except BaseException:
            self._mates = ()
            raise

    def _others(self) -> tuple[_Mate, ...]:
        """Return further permanent threads, because starting a thread takes 0.1 to 0.5 ms.

        A forked process starts new threads.
        """
        if not self._mates or self._process != os.getpid():
            self._mates, self._process = tuple(_Mate() for _ in range(self.threads - 1)), os.getpid()
            for mate in self._mates:
                weakref.finalize(self, mate.inbox.put, None)
        return self._mates

    def _bounds(self, cuts: int | Index) -> list[int]:
        """Return the ends of the parts; the first is 0."""
        last = cuts if isinstance(cuts, int) else len(cuts) - 1  # items without cost may be at the end
        if self.threads == 1:
            return [0, last]
        if isinstance(cuts, int):
            return [round(k * last / self.threads) for k in range(self.threads + 1)]
        shares = np.arange(1, self.threads) / self.threads
        inner: list[int] = np.searchsorted(cuts, cuts[0] + shares * (cuts[-1] - cuts[0])).tolist()
        return [0, *inner, last]


class _Mate:
    """One thread that runs the tasks of its inbox until None, and returns (result, error).

    Two queues cost a few microseconds per call; futures of a pool cost several times as much.
    """

    def __init__(self) -> None:
        self.inbox: SimpleQueue[tuple[Callable[..., Any], int, int, tuple[Any, ...]] | None] = SimpleQueue()
        self.outbox: SimpleQueue[tuple[Any, BaseException | None]] = SimpleQueue()
        threading.Thread(target=_work, args=(self.inbox, self.outbox), daemon=True).start()


def _work(inbox: SimpleQueue[Any], outbox: SimpleQueue[Any]) -> None:
    """Run the loop of a thread.

    The thread has references to the queues only, so that it ends when its owner is deleted.
    """
    while (task := inbox.get()) is not None:
        kernel, lo, hi, arguments = task
        try:
            outbox.put((kernel(lo, hi, *arguments), None))
        except BaseException as error:
            outbox.put((None, error))
        del task, kernel, arguments


@cache
def _libraries() -> ThreadpoolController:
    """Return the BLAS libraries of this process; the search takes 10 ms and is made only once."""
    import scipy.linalg  # noqa: F401  # scipy has a separate BLAS, which must be loaded before it can be limited
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def blas_threads(count: int) -> Iterator[None]:
    """Set the number of threads of numpy's and scipy's BLAS inside the block."""
    with _libraries().limit(limits=count, user_api="blas"):
        reserve_blas()
        yield


def one_blas_thread() -> AbstractContextManager[None]:
    """Let numpy's and scipy's BLAS use one thread inside the block."""
    return blas_threads(1)
