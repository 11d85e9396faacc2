"""Rows of the frame equation over arrays; conventions: ``factors.batch_rows``.

What all rays of an image share (rotation with its Jacobian, projection centre, interior orientation) is computed when
the image is first met in the range and kept in a table, so that of a record only the pixel and its weights are read.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.batch_rows import Index, threaded
from factors.frame import N_UNKNOWNS, camera, derivatives
from factors.frame_camera import CAMERA_SIZE, direction, pixel


@threaded
def frame_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Frame collinearity of members lo to hi; see :func:`factors.batch_rows.pushbroom_rows`."""
    c, bad = setup.shape[1], -1
    table, known = np.empty((len(wide), CAMERA_SIZE)), np.zeros(len(wide), np.bool_)
    columns, d, cam = setup[0].astype(np.int64), np.empty((2, N_UNKNOWNS + 3)), np.empty(CAMERA_SIZE)
    for m in range(lo, hi):
        a = members[m]
        i, k = image[a], row[a]
        if not known[i]:
            known[i] = True
            table[i] = camera(records[k], setup, wide[i, :c].copy())
        for j in range(CAMERA_SIZE):
            cam[j] = table[i, j]
        x, y, depth = direction(cam, ground[point[a], 0], ground[point[a], 1], ground[point[a], 2])
        line, sample = pixel(cam, x, y)
        value[a, 0], value[a, 1] = records[k, 2] * (records[k, 0] - line), records[k, 3] * (records[k, 1] - sample)
        total = 0.0 * value[a, 0] + 0.0 * value[a, 1]
        if want:
            derivatives(cam, x, y, depth, d)
            for r in range(2):
                for j in range(c):
                    d_image[a, r, j] = -records[k, 2 + r] * d[r, columns[j]] * setup[1, j]
                    total += 0.0 * d_image[a, r, j]
                for j in range(3):
                    d_ground[a, r, j] = -records[k, 2 + r] * d[r, N_UNKNOWNS + j]
                    total += 0.0 * d_ground[a, r, j]
        if total != 0.0 and bad < 0:
            bad = a
    return bad
