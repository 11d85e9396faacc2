"""A small block, its unpartitioned solution, and one cluster of four processes for all tests."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import pytest

from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.block import Block
from fg_orient.parallel.pool import Execution, opened
from tests.support.parallel_block import block

WORKERS = 4


@pytest.fixture(scope="session")
def small() -> Block:
    """Give the block."""
    return block()


@pytest.fixture(scope="session")
def problem() -> Problem:
    """Give its problem."""
    return compile_problem(block())


@pytest.fixture(scope="package")
def client() -> Iterator[Any]:
    """Give a client of four processes on this machine."""
    pytest.importorskip("distributed")
    with warnings.catch_warnings(), opened(Execution(workers=WORKERS)) as pool:
        yield pool.client
