"""Targets of many points by any of the transformations of ``cameras.plane`` and ``cameras.line_scanner``."""

from __future__ import annotations

from typing import Final

import numpy as np

from factors._contract import Array, Equation, compiled
from factors.cameras import line_scanner, plane

#: Number of each transformation in :func:`targets`.
KINDS: Final[dict[str, int]] = {
    plane.POLYNOMIAL.name: 0,
    plane.HELMERT.name: 1,
    plane.PROJECTIVE.name: 2,
    line_scanner.AFFINE_PROJECTION.name: 3,
    line_scanner.PARALLEL_PROJECTION.name: 4,
    line_scanner.LINE_SCANNER_DLT.name: 5,
}


def targets_of(equation: Equation, sources: Array, setup: Array, coefficients: Array) -> Array:
    """Target coordinates (n, 2) of source coordinates (n, 3)."""
    c = np.ascontiguousarray(coefficients, float)
    return np.asarray(targets(KINDS[equation.name], np.ascontiguousarray(sources, float), setup, c))


@compiled
def targets(kind: int, sources: Array, setup: Array, c: Array) -> Array:
    """Target coordinates (n, 2); ``kind`` is one of ``KINDS``."""
    out = np.empty((len(sources), 2))
    record = np.zeros(plane.RECORD.size)
    record[plane.RECORD.w11] = record[plane.RECORD.w22] = 1.0
    for i in range(len(sources)):
        for k in range(3):
            record[k] = sources[i, k]
        if kind == 0:
            value = plane.residual_polynomial(record, setup, c)
        elif kind == 1:
            value = plane.residual_helmert(record, setup, c)
        elif kind == 2:
            value = plane.residual_projective(record, setup, c)
        elif kind == 3:
            value = line_scanner.residual_affine(record, setup, c)
        elif kind == 4:
            value = line_scanner.residual_parallel(record, setup, c)
        else:
            value = line_scanner.residual_dlt(record, setup, c)
        out[i, 0], out[i, 1] = value[0], value[1]
    return out
