"""Weights of image points: computed rows times their roots. Arrays: ``fg_orient.kernels.batch``."""

from __future__ import annotations

from factors._compile import threaded
from factors._contract import Array


@threaded
def scale_rows(lo: int, hi: int, root: Array, value: Array, d_image: Array, d_ground: Array) -> None:
    """Multiply the rows of image points lo to hi by ``root`` (n,)."""
    for a in range(lo, hi):
        factor = root[a]
        for r in range(2):
            value[a, r] *= factor
            for k in range(3):
                d_ground[a, r, k] *= factor
            for c in range(d_image.shape[2]):
                d_image[a, r, c] *= factor
