"""The 20 terms of a cubic rational function and the orders in which files and papers list them.

Coefficients move between orders by exponent triple (longitude, latitude, height), never by index:
RPC00B is the order inside, RPC00A that of older NITF files, T 2.54 the published one (Terlemezoğlu
2019, eq. 2.54, with X = longitude, Y = latitude).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Array
from factors.records import Record

#: Terms in RPC00B order: products of longitude x, latitude y and height z.
TERM: Final = Record(terms="one x y z xy xz yz xx yy zz xyz xxx xyy xzz xxy yyy yzz xxz yyz zzz")
N_TERMS: Final = TERM.size


def _triples(words: str) -> tuple[tuple[int, int, int], ...]:
    return tuple((int(w[0]), int(w[1]), int(w[2])) for w in words.split())


#: Order name -> exponents of (longitude, latitude, height), term by term.
EXPONENTS: Final[dict[str, tuple[tuple[int, int, int], ...]]] = {
    "RPC00B": _triples("000 100 010 001 110 101 011 200 020 002 111 300 120 102 210 030 012 201 021 003"),
    "RPC00A": _triples("000 100 010 001 110 101 011 111 200 020 002 300 210 201 120 030 021 102 012 003"),
    "T2.54": _triples("000 100 010 001 110 011 101 200 020 002 111 030 210 012 120 300 102 021 201 003"),
}


def permutation(source: str, target: str) -> npt.NDArray[np.intp]:
    """Give ``p`` with ``coefficients_target = coefficients_source[p]``: (20,).

    Raises
    ------
    KeyError
        No such order.
    """
    position = {triple: k for k, triple in enumerate(EXPONENTS[source])}
    return np.array([position[triple] for triple in EXPONENTS[target]], dtype=np.intp)


def degree_mask(degree: int) -> npt.NDArray[np.bool_]:
    """Terms of total degree <= ``degree`` in RPC00B order: (20,); 4, 10, 20 of them for 1, 2, 3."""
    return np.array([sum(triple) <= degree for triple in EXPONENTS["RPC00B"]])


def terms(ground: Array) -> Array:
    """Monomials of N normalised ground points in RPC00B order: (N, 3) -> (N, 20)."""
    power = np.asarray(ground, float)[:, :, None] ** np.arange(4)  # (N, 3, 4): each power once
    return np.ascontiguousarray(power[:, np.arange(3), np.array(EXPONENTS["RPC00B"])].prod(axis=2))
