"""One thread for dense linear algebra.

The matrices of this package are small: two BLAS threads take ten times the processor time of one (measured with 180
unknowns). The order of sums also changes rounding errors, so that results of singular systems would depend on the
number of cores.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """The BLAS libraries of this process; the search takes 10 ms and is made once."""
    import scipy.linalg  # noqa: F401  # scipy has a BLAS of its own, which must be loaded before it can be limited
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let numpy's and scipy's BLAS use one thread inside the block."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield
