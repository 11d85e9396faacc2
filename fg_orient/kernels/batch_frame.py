"""Rows of the two frame equations over arrays; conventions: ``fg_orient.kernels.batch_rows``.

What all rays of an image share (rotation with its Jacobian, projection centre, interior orientation) is computed when
the image is first met in the range and kept in a table, so that of a record only the pixel and its weights are read.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from factors.cameras import frame, frame_measured
from factors.cameras.frame import RECORD
from factors.cameras.frame_camera import CAMERA, direction, pixel, row_of
from fg_orient.kernels.batch_rows import Index


@threaded
def frame_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Frame collinearity of members lo to hi; see :func:`fg_orient.kernels.batch_pushbroom.rows_of_form`."""
    c, bad = setup.shape[1], -1
    table, known = np.empty((len(wide), CAMERA.size)), np.zeros(len(wide), np.bool_)
    column, sigma, d = frame.columns_of(setup), setup[1].copy(), np.zeros((2, frame.COLUMN.size))
    for m in range(lo, hi):
        a = members[m]
        i, k, p = image[a], row[a], point[a]
        if not known[i]:
            known[i] = True
            new = frame.camera(records[k], setup, wide[i, :c])
            for j in range(len(new)):
                table[i, j] = new[j]
        cam = row_of(table, i)
        ray = direction(cam, ground[p, 0], ground[p, 1], ground[p, 2])
        line, sample = pixel(cam, ray[0], ray[1])
        a_line, a_sample = records[k, RECORD.a_line], records[k, RECORD.a_sample]
        v_line, v_sample = a_line * (records[k, RECORD.line] - line), a_sample * (records[k, RECORD.sample] - sample)
        value[a, 0], value[a, 1] = v_line, v_sample
        zero = 0.0 * (v_line + v_sample)
        if want:
            zero += frame.derivatives(cam, ray, a_line, a_sample, d)
            for j in range(c):
                d_image[a, 0, j] = d[0, column[j]] * sigma[j]
                d_image[a, 1, j] = d[1, column[j]] * sigma[j]
            for j in range(3):
                d_ground[a, 0, j] = d[0, frame.GROUND + j]
                d_ground[a, 1, j] = d[1, frame.GROUND + j]
        if zero != 0.0 and bad < 0:
            bad = a
    return bad


@threaded
def measured_frame_rows(
    lo: int, hi: int, members: Index, records: Array, row: Index, image: Index, point: Index, setup: Array,
    n_basis: int, basis: Array, wide: Array, ground: Array, value: Array, d_image: Array, d_ground: Array, want: bool,
) -> int:  # fmt: skip
    """Frame collinearity with corrected observations of members lo to hi; see :func:`frame_rows`."""
    c, bad = setup.shape[1], -1
    table, known = np.empty((len(wide), frame_measured.CAMERA.size)), np.zeros(len(wide), np.bool_)
    column, sigma, d = frame.columns_of(setup), setup[1].copy(), np.zeros((2, frame.COLUMN.size))
    for m in range(lo, hi):
        a = members[m]
        i, k, p = image[a], row[a], point[a]
        if not known[i]:
            known[i] = True
            new = frame_measured.camera(records[k], setup, wide[i, :c])
            for j in range(len(new)):
                table[i, j] = new[j]
        cam, o_line, o_sample = table[i], records[k, RECORD.line], records[k, RECORD.sample]
        a_line, a_sample = records[k, RECORD.a_line], records[k, RECORD.a_sample]
        ray = direction(cam, ground[p, 0], ground[p, 1], ground[p, 2])
        line, sample = frame_measured.difference(cam, o_line, o_sample, ray[0], ray[1])
        value[a, 0], value[a, 1] = a_line * line, a_sample * sample
        zero = 0.0 * (value[a, 0] + value[a, 1])
        if want:
            zero += frame_measured.derivatives(cam, ray, o_line, o_sample, a_line, a_sample, d)
            for j in range(c):
                d_image[a, 0, j] = d[0, column[j]] * sigma[j]
                d_image[a, 1, j] = d[1, column[j]] * sigma[j]
            for j in range(3):
                d_ground[a, 0, j] = d[0, frame.GROUND + j]
                d_ground[a, 1, j] = d[1, frame.GROUND + j]
        if zero != 0.0 and bad < 0:
            bad = a
    return bad
