"""Fixtures are a small block, its solution in one part, and clusters of processes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from fg_orient.adjustment.parts.execution import Execution, opened
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.model.block import Block
from tests.support.parallel_block import block


@pytest.fixture(scope="session")
def small() -> Block:
    """Return the block."""
    return block()


@pytest.fixture(scope="session")
def problem() -> Problem:
    """Return the problem of the block."""
    return compile_problem(block())


@contextmanager
def processes(count: int) -> Iterator[Any]:
    """Yield a client of processes on this machine."""
    pytest.importorskip("distributed")
    with warnings.catch_warnings(), opened(Execution(workers=count)) as pool:
        yield pool.client


@contextmanager
def certificate_of(client: Any) -> Iterator[str]:
    """Yield the address of a client's scheduler; meanwhile dask's configuration, which all clients share, names it."""
    import dask.config

    own = client.security
    parts = {"ca-file": own.tls_ca_file, "client.cert": own.tls_client_cert, "client.key": own.tls_client_key}
    with dask.config.set({f"distributed.comm.tls.{name}": text for name, text in parts.items()}):
        yield client.scheduler.address


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Yield a client of two processes; they take 2 s each to start, so all fast tests with it are in test_workers."""
    with processes(2) as found:
        yield found


@pytest.fixture(scope="module")
def four() -> Iterator[Any]:
    """Yield a client of four processes, for the slow tests."""
    with processes(4) as found:
        yield found
