"""Rows of the two frame equations over arrays; conventions: ``fg_orient.kernels.batch_rows``.

What all rays of an image share (rotation with its Jacobian, projection centre, interior orientation) is computed when
the image is first met in the range and kept in a table, so that of a record only the pixel and its weights are read.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from factors.cameras import frame, frame_measured
from factors.cameras.frame import RECORD
from factors.cameras.frame_camera import CAMERA, direction, pixel, row_of
from fg_orient.kernels.batch_rows import Index


@threaded
def rows_of_model(
    measured: Any, lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index,
    setup: Array, n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array,
    d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Frame collinearity of members lo to hi; see :func:`fg_orient.kernels.batch_pushbroom.rows_of_form`.

    ``measured`` is True where the observations are corrected, None where the computed pixel is: only one of the two
    branches is compiled.
    """
    c, bad = setup.shape[1], -1
    size = CAMERA.size if measured is None else frame_measured.CAMERA.size
    table, known = np.empty((len(wide), size)), np.zeros(len(wide), np.bool_)
    column, sigma, d = frame.columns_of(setup), setup[1].copy(), np.zeros((2, frame.COLUMN.size))
    for m in range(lo, hi):
        a = members[m]
        i, k, p = image[a], row[a], point[a]
        if not known[i]:
            known[i] = True
            x = wide[i, :c]
            if measured is None:
                new = frame.camera(records[k], setup, x)
            else:
                new = frame_measured.camera(records[k], setup, x)
            for j in range(len(new)):
                table[i, j] = new[j]
        o_line, o_sample = records[k, RECORD.line], records[k, RECORD.sample]
        a_line, a_sample = records[k, RECORD.a_line], records[k, RECORD.a_sample]
        if measured is None:
            camera = row_of(table, i)
            ray = direction(camera, ground[p, 0], ground[p, 1], ground[p, 2])
            line, sample = pixel(camera, ray[0], ray[1])
            line, sample = line - o_line, sample - o_sample
        else:
            cam = table[i]
            ray = direction(cam, ground[p, 0], ground[p, 1], ground[p, 2])
            line, sample = frame_measured.difference(cam, o_line, o_sample, ray[0], ray[1])
        v_line, v_sample = a_line * line, a_sample * sample
        value[a, 0], value[a, 1] = v_line, v_sample
        zero = 0.0 * (v_line + v_sample)
        if want:
            if measured is None:
                zero += frame.derivatives(camera, ray, a_line, a_sample, d)
            else:
                zero += frame_measured.derivatives(cam, ray, o_line, o_sample, a_line, a_sample, d)
            for r in range(2):
                for j in range(c):
                    d_image[a, r, j] = d[r, column[j]] * sigma[j]
                for j in range(3):
                    d_ground[a, r, j] = d[r, frame.GROUND + j]
        if zero != 0.0 and bad < 0:
            bad = a
    return bad


def frame_rows(*arguments: Any) -> int:
    """See :func:`rows_of_model`: distortion from ideal to measured."""
    return rows_of_model(None, *arguments)


def measured_frame_rows(*arguments: Any) -> int:
    """See :func:`rows_of_model`: distortion from measured to ideal."""
    return rows_of_model(True, *arguments)
