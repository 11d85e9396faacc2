"""The module measures the rates of this machine and computes the least time of an iteration from them.

Bytes and flops per image point are counted by hand (+-30 %). To linearise moves 450 B and
takes 330 flop; the point blocks move 192 B. A pair of rays of one point takes 1458 flop for
its block of the reduced system (components times basis, 27 unknowns per image). The bound is
low for two reasons: the factorisation is counted at the rate of matrix products, which it
does not reach, and back-substitution, gradients and priors are not counted.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from fg_orient.kernels.vectors import LANES
from fg_orient.model.machine import processor_name

Array = npt.NDArray[np.float64]

LINEARISE_BYTES: Final = 450.0
LINEARISE_FLOP: Final = 330.0
POINT_BYTES: Final = 192.0
PAIR_FLOP: Final = 1458.0
TRIAD_LENGTH: Final = 20_000_000
PRODUCT_SIZE: Final = 1200
CHOLESKY_SIZE: Final = 2000
#: A triad moves these bytes per element: it reads two numbers and writes one.
TRIAD_BYTES: Final = 24.0


@njit(nogil=True)
def _triad(a: Array, b: Array, c: Array, factor: float) -> None:
    for i in range(len(a)):
        a[i] = b[i] + factor * c[i]


@dataclass(frozen=True)
class Hardware:
    """Rates for one or two threads: bytes/s of a triad, flop/s of matrix products and of Cholesky (one thread)."""

    triad: dict[int, float]
    product: dict[int, float]
    cholesky: float


def this_machine() -> dict[str, Any]:
    """Return the processor, the bits of its vectors, cores, Python and load."""
    return {
        "processor": processor_name(), "cores": os.cpu_count(), "vector_bits": 64 * LANES,
        "python": platform.python_version(), "load": os.getloadavg()[0],
    }  # fmt: skip


class Meter:
    """The meter measures the machine repeatedly between the timed runs."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self._arrays = [np.ones(TRIAD_LENGTH) for _ in range(3)]
        self._factors = [rng.normal(size=(PRODUCT_SIZE, PRODUCT_SIZE)) for _ in range(2)]
        self._products = [np.empty((PRODUCT_SIZE, PRODUCT_SIZE)) for _ in range(2)]
        half = rng.normal(size=(CHOLESKY_SIZE, CHOLESKY_SIZE))
        self._normal = half @ half.T + CHOLESKY_SIZE * np.eye(CHOLESKY_SIZE)
        self._pool = ThreadPoolExecutor(2)
        _triad(*(a[:2] for a in self._arrays), 2.0)

    def measure(self) -> dict[str, float]:
        """Return one record with the rates in bytes/s and flop/s."""
        out = {}
        for threads in (1, 2):
            cuts = np.linspace(0, TRIAD_LENGTH, threads + 1).astype(int)
            parts = [[a[cuts[k] : cuts[k + 1]] for a in self._arrays] for k in range(threads)]
            seconds = self._together([lambda p=p: _triad(*p, 1.5) for p in parts])
            out[f"triad_{threads}"] = TRIAD_BYTES * TRIAD_LENGTH / seconds
            seconds = self._together([lambda c=c: np.dot(*self._factors, out=c) for c in self._products[:threads]])
            out[f"product_{threads}"] = 2.0 * threads * PRODUCT_SIZE**3 / seconds
        seconds = self._together([lambda: np.linalg.cholesky(self._normal)])
        out["cholesky_1"] = CHOLESKY_SIZE**3 / 3.0 / seconds
        return out

    def _together(self, jobs: list[Callable[[], object]]) -> float:
        start = time.perf_counter()
        for future in [self._pool.submit(job) for job in jobs]:
            future.result()
        return time.perf_counter() - start


def best(records: list[dict[str, float]]) -> Hardware:
    """Return the highest rates of all records, so that other work on the machine does not raise the bound."""
    top = {name: max(r[name] for r in records) for name in records[0]}
    return Hardware({n: top[f"triad_{n}"] for n in (1, 2)}, {n: top[f"product_{n}"] for n in (1, 2)}, top["cholesky_1"])


def iteration_bound(
    machine: Hardware, threads: int, image_points: int, pairs: int, unknowns: int, half_bandwidth: int | None = None
) -> float:
    """Return the least seconds of one iteration.

    Parameters
    ----------
    machine : Hardware
    threads : int
        Number of threads, 1 or 2; the reduced system is solved by one thread.
    image_points, pairs, unknowns : int
        Numbers of image points, of pairs of rays, and of unknowns of all images.
    half_bandwidth : int, optional
        Half bandwidth of the reduced system; the factorisation of the band is counted if it takes less
        time than for the full matrix.
    """
    memory, arithmetic = machine.triad[threads], machine.product[threads]
    per_point = max(LINEARISE_BYTES / memory, LINEARISE_FLOP / arithmetic) + POINT_BYTES / memory
    flop = unknowns**3 / 3.0
    if half_bandwidth is not None:
        flop = min(flop, float(unknowns) * half_bandwidth**2)
    return image_points * per_point + pairs * PAIR_FLOP / arithmetic + flop / machine.product[1]


def pair_bound(machine: Hardware, threads: int, pairs: int) -> float:
    """Return the least seconds of the blocks of the reduced system."""
    return pairs * PAIR_FLOP / machine.product[threads]
