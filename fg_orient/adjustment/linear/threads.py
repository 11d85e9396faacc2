"""One thread for dense linear algebra.

The matrices of this package are small: two BLAS threads cost ten times the processor time of one (measured, 180
unknowns). And the order of their sums decides what rounding noise looks like, so that results of singular systems would
depend on the number of cores.
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
    """The BLAS libraries of this process; finding them takes 10 ms, so it is done once."""
    import scipy.linalg  # noqa: F401  # its BLAS is another one than numpy's and must be loaded to be limited
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let numpy's and scipy's BLAS use one thread inside the block."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield
