"""Parts and workers of a block or study, with the processes and the work folder."""

from __future__ import annotations

import contextlib
import logging
import tempfile
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.parts.pool import Cluster, Pool
from fg_orient.adjustment.parts.watch import Watch
from fg_orient.formats.atomic import writing
from fg_orient.formats.staging import scratch_folder
from fg_orient.model.errors import InputError, NoSolutionError, finding

#: Seconds to wait for the answer of a scheduler.
CONNECT_S: Final = 10.0
#: Maximum number of attempts to start the processes of a run. An attempt fails if one process ends while it starts.
STARTS: Final = 5
#: Maximum number of workers started on one machine.
MAX_WORKERS: Final = 256


@dataclass(frozen=True)
class Execution:
    """Parts of a block and workers of a block or study.

    Parameters
    ----------
    parts : int or None
        Number of parts of the ground points; None: chosen by the size of the block.
    workers : int
        Number of processes on this machine; 0 or 1: only this process.
    cluster : str, dask.distributed.Client or None
        Address of the scheduler of a running cluster, or a client of it; replaces ``workers``.
    work_dir : path or None
        Folder that all workers can access; a temporary folder is made in it. Default: the
        system's folder for temporary files, to which other machines have no access.
    kept : int or None
        Number of parts that stay open in a process; None: all. The program chooses it by
        the memory (``adjustment.memory``).

    Raises
    ------
    InputError
        A value is invalid.
    """

    parts: int | None = None
    workers: int = 0
    cluster: Any = None
    work_dir: str | Path | None = None
    kept: int | None = None

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


@contextmanager
def opened(execution: Execution) -> Iterator[Pool]:
    """Open the pool of an execution; processes started here end with it.

    InputError: dask is missing, or the scheduler does not answer.
    """
    if execution.cluster is None and execution.workers <= 1:
        yield Pool()
        return
    if find_spec("distributed") is None or (execution.cluster is None and find_spec("cryptography") is None):
        raise InputError.of("parallel.dask", option="cluster" if execution.cluster is not None else "workers")
    if execution.cluster is not None and not isinstance(execution.cluster, str):
        yield Cluster(execution.cluster)
        return
    if execution.cluster is None:
        with _local(execution.workers) as pool:
            yield pool
        return
    with _connected(execution.cluster) as client:
        yield Cluster(client)


def _connected(address: str) -> Any:
    """Return the client of a running scheduler; InputError if it does not answer."""
    try:
        return import_module("distributed").Client(address, timeout=CONNECT_S, set_as_default=False)
    except TypeError as error:  # dask raises this if its configuration does not name a certificate
        raise InputError(
            finding(
                "parallel.certificate (failure): dask's configuration names no certificate for this scheduler -> set "
                "distributed.comm.tls (ca-file, client.cert, client.key), see docs/parallel.md",
                option="scheduler",
                value=address,
            )
        ) from error
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError.of("parallel.unreachable", option="scheduler", value=address) from error


@contextmanager
def _local(workers: int) -> Iterator[Cluster]:
    """Open a pool of processes on this machine with one thread each; ended processes are replaced (:class:`Watch`).

    The processes listen on the loopback address. A key and a certificate are made for
    this run and kept in memory. Only this client and its workers have them. This is
    necessary, because dask runs the code that it receives, and every user of a machine
    can reach its ports. dask does not limit the memory of the processes: the memory of a
    block is estimated before, and a worker that dask pauses would never continue.
    """
    import dask.config

    distributed = import_module("distributed")
    with (
        scratch_folder(Path(tempfile.gettempdir())) as scratch,
        dask.config.set({"distributed.scheduler.work-stealing": False}),
        _started(distributed, workers, scratch) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        Watch(cluster, client, workers) as watch,
    ):
        yield Cluster(client, watch)


def _started(distributed: Any, workers: int, scratch: Path) -> Any:
    """Start the processes of a cluster. If a process ends while it starts, start all processes again.

    NoSolutionError is raised if the start failed ``STARTS`` times.
    """
    one = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    for tried in range(1, STARTS + 1):
        try:
            return distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
                host="127.0.0.1", protocol="tls://", security=distributed.Security.temporary(),
                scheduler_kwargs={"dashboard": False}, memory_limit=0, env=one,
                silence_logs=logging.CRITICAL, local_directory=str(scratch),
            )  # fmt: skip
        except (RuntimeError, OSError, TimeoutError, CancelledError) as error:
            if tried == STARTS:
                why = " ".join(str(error.__cause__ or error).split())[:200] or type(error).__name__
                raise NoSolutionError.of("parallel.start", option="workers", value=why, count=STARTS) from error
    raise AssertionError


@contextmanager
def work_folder(execution: Execution, pool: Pool) -> Iterator[Path]:
    """Give a new folder inside the work folder, and remove it at the end.

    Raise InputError if it cannot be created.
    """
    parent = Path(execution.work_dir or tempfile.gettempdir()).absolute()
    with contextlib.ExitStack() as stack:
        with writing(execution.work_dir or parent, option=""):
            folder = stack.enter_context(scratch_folder(parent))
        try:
            yield folder
        finally:
            try:
                pool.forget(str(folder))
            finally:
                tasks.forget(str(folder))
