"""Replace worker processes of this machine that end, up to a maximum number of times.

If a process ends while it works, dask starts it again, without a limit. If a worker process ends while
it starts, dask does not start it again. In both cases, tasks could wait for ever.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any, Final

#: Replacements for each worker of a run.
REPLACED: Final = 3
#: Pause between two checks of the processes, s. It is shorter than the start of a process.
PAUSE_S: Final = 0.2


class Watch:
    """Thread that replaces ended processes of a local cluster; with too many of them it closes the client.

    Parameters
    ----------
    cluster : dask.distributed.LocalCluster
    client : dask.distributed.Client
        All its waiting calls end with an exception when it is closed.
    workers : int

    Attributes
    ----------
    ended : int
        Processes that have ended.
    exhausted : bool
        Whether more processes have ended than are replaced.
    """

    def __init__(self, cluster: Any, client: Any, workers: int) -> None:
        self._cluster, self._client, self._workers = cluster, client, workers
        self._processes: set[int] = set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="workers", daemon=True)
        self.ended, self.exhausted = 0, False

    def __enter__(self) -> Watch:
        self._look()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(PAUSE_S):
            self._look()
            if self.ended > REPLACED * self._workers:
                self.exhausted = True
                with suppress(Exception):  # a closed client may raise any exception
                    self._client.close(timeout=1)
                return

    def _look(self) -> None:
        """Count the processes that have run, and start again those that dask does not restart any more."""
        with suppress(RuntimeError):  # raised if the dictionary changes at this moment
            own = dict(self._cluster.workers)
            self._processes |= {one.pid for one in own.values() if one.pid}
            self.ended = max(len(self._processes) - self._workers, 0)
            lost = [name for name, one in own.items() if one.status.name in ("closed", "failed")]
            for name in lost:
                self._cluster.workers.pop(name, None)
            if lost or len(own) < self._workers:
                self._cluster.scale(self._workers)
