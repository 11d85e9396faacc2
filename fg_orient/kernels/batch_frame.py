"""Rows of the frame equation over arrays; conventions: ``fg_orient.kernels.batch_rows``.

The camera of an image (rotation with its Jacobian, projection centre, interior orientation) is computed at the image's
first ray in the range and kept in a table, so that only the pixel and its weights are read from a record.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from factors.cameras import frame
from factors.cameras.frame import RECORD
from factors.cameras.frame_camera import CAMERA
from fg_orient.kernels.batch_rows import Index


@threaded
def frame_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Frame collinearity of members lo to hi; see :func:`fg_orient.kernels.batch_pushbroom.rows_of_form`."""
    c, bad, d = setup.shape[1], -1, np.zeros((2, frame.COLUMN.size))
    table, known = np.empty((len(wide), CAMERA.size)), np.zeros(len(wide), np.bool_)
    column, sigma = frame.columns_of(setup), setup[1].copy()
    for m in range(lo, hi):
        a = members[m]
        i, k, p = image[a], row[a], point[a]
        if not known[i]:
            known[i] = True
            table[i] = frame.camera(records[k], setup, wide[i, :c])
        observed = (
            records[k, RECORD.line], records[k, RECORD.sample], records[k, RECORD.a_line], records[k, RECORD.a_sample]
        )  # fmt: skip
        place = ground[p, 0], ground[p, 1], ground[p, 2]
        value[a, 0], value[a, 1], zero = frame.evaluated(table[i], observed, place, d, want)
        if want:
            for r in range(2):
                for j in range(c):
                    d_image[a, r, j] = d[r, column[j]] * sigma[j]
                for j in range(3):
                    d_ground[a, r, j] = d[r, frame.GROUND + j]
        if zero != 0.0 and bad < 0:
            bad = a
    return bad
