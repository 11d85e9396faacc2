"""Compile the kernels of pushbroom, RPC and frame images once, so that their time is not counted as work.

The first call of a numba function compiles it (10 s in all) or loads it from the cache
(0.2 s). Commands call :func:`compile_kernels` before their clocks start.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from factors import (
    batch,
    batch_band,
    batch_cofactors,
    batch_effects,
    batch_gather,
    batch_ground,
    batch_matrix,
    batch_pairs,
    batch_points,
    batch_sort,
    batch_steps,
    batch_weights,
    ellipsoid,
    ephemeris,
    frame,
    frame_camera,
    frame_measured,
    pushbroom,
    rfm,
    rfm_equation,
    rfm_project,
    rotations,
)
from factors._contract import Array


def compile_kernels() -> float:
    """Call every compiled function of the path with the types it is used with; seconds it took."""
    start = time.perf_counter()
    e = pushbroom.example(np.random.default_rng(0))
    x, point = e.unknowns
    for want in (False, True):
        pushbroom.kernel(e.record, e.setup, x, point, want)
    records = np.stack([e.record, e.record])
    pushbroom.fill(records, 0, e.setup, x, point, np.empty((2, len(x) + 4)), True)
    pushbroom.conditions(records, e.setup, x, np.stack([point, point]))
    p, v = records[:, 0:3].copy(), records[:, 3:6].copy()
    rotations.orbital_frames(p, v)
    rotations.attitude_matrices(np.zeros((2, 3)), False)
    rotations.quaternion_matrices(np.ones((2, 4)))
    for heights in (np.zeros(2), _read_only(np.zeros(2))):  # one height for all rays is a view that cannot be written
        ground = ellipsoid.intersect(p, -p / np.linalg.norm(p, axis=1, keepdims=True), heights)
    for points in (ground, _read_only(ground)):
        ellipsoid.geodetic_array(points)
    ephemeris.lagrange(np.arange(4.0), np.ones((4, 6)), np.array([1.5]))
    _compile_rational_function()
    _compile_frame()
    _compile_batches()
    return time.perf_counter() - start


def _compile_rational_function() -> None:
    e = rfm_equation.example(np.random.default_rng(0))
    x, point = e.unknowns
    for want in (False, True):
        rfm_equation.kernel(e.record, e.setup, x, point, want)
    records = np.stack([e.record, e.record])
    rfm_equation.fill(records, 0, e.setup, x, point, np.empty((2, len(x) + 4)), True)
    rfm_equation.conditions(records, e.setup, x, np.stack([point, point]))
    c, ones = _read_only(e.record[24:].reshape(4, 20)), _read_only(np.ones(5))  # as a model keeps them
    ground = np.zeros((2, 3))
    rfm.values(c, ground)
    rfm.denominators(c, ground)
    rfm_project.locate(c, ones, np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2)))
    rfm_project.project(c, ones, ones, np.zeros(6), *ground.T.copy())


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Copy that may not be written to: another type for numba than an array that may."""
    out = array.copy()
    out.flags.writeable = False
    return out


def _compile_frame() -> None:
    for module in (frame_measured, frame):
        e = module.example(np.random.default_rng(0))
        x, point = e.unknowns
        for want in (False, True):
            module.kernel(e.record, e.setup, x, point, want)
        module.fill(e.record[None].copy(), 0, e.setup, x, point, np.empty((2, len(x) + 4)), True)
    camera = frame.camera(e.record, e.setup, x)
    frame_camera.project(camera, point[None].copy())
    frame_camera.ideal_directions(camera, np.zeros(1), np.zeros(1))
    own = frame_measured.example(np.random.default_rng(0))
    of_measured = frame_measured.camera(own.record, own.setup, own.unknowns[0])
    frame_measured.corrected(of_measured, np.zeros(1), np.zeros(1))
    frame_measured.pixels(of_measured, np.zeros(1), np.zeros(1))


def _compile_batches() -> None:
    """Two rays of one point in two images, and their reduced system."""
    rng, rays, zero = np.random.default_rng(0), np.arange(2, dtype=np.int32), np.zeros(2, np.int32)
    value, wide, basis = np.zeros((2, 2)), np.zeros((2, 40)), np.ones((2, 1))
    for equation, example in (
        (pushbroom.LOOK_ANGLE_COLLINEARITY, pushbroom.example(rng)),
        (rfm_equation.RATIONAL_FUNCTION, rfm_equation.example(rng)),
        (frame_measured.FRAME_BROWN_MEASURED_TO_IDEAL, frame_measured.example(rng)),
        (frame.FRAME_BROWN_IDEAL_TO_MEASURED, frame.example(rng)),
    ):
        rows, columns = batch.batch(equation, example.setup)
        records, ground = np.stack([example.record] * 2), np.stack([example.unknowns[1]] * 2)
        d_image, d_ground = np.zeros((2, 2, columns.n_components)), rng.normal(size=(2, 2, 3))
        rows(0, 2, rays, records, rays, rays, zero, columns.setup, 1, basis, wide, ground, value, d_image,
             d_ground, True)  # fmt: skip
    batch_cofactors.point_cofactors(0, 1, np.array([0, 2]), np.arange(2), np.ones(2, np.int64), d_image, d_ground,
                                    np.eye(3)[None], np.arange(4).reshape(2, 2), np.ones((4, 1, 1)),
                                    np.empty((1, 3, 3)))  # fmt: skip
    one = np.ones(2, np.int64)
    rays_of = (np.array([0, 2]), np.arange(2), one, one, d_image, d_ground, np.eye(3)[None],
               np.arange(4).reshape(2, 2))  # fmt: skip
    batch_cofactors.ray_cofactors(0, 1, *rays_of, np.ones((4, 1, 1)), np.empty((1, 3, 3)), np.empty((2, 2, 2)),
                                  np.empty((2, 3, 2)))  # fmt: skip
    batch_effects.image_effects(0, 1, *rays_of, np.ones((4, 1, 1)), np.ones((4, 1, 1)), value)
    _compile_reduction(columns.n_components, basis, value, wide, d_image, d_ground)


def _compile_reduction(
    n_components: int, basis: Array, value: Array, wide: Array, d_image: Array, d_ground: Array
) -> None:
    """One point in two images: a piece of one point, a chunk, three slots and blocks."""
    two, image = np.arange(2), np.arange(2, dtype=np.int32)
    order, first, free = image.copy(), np.array([0, 2], np.int32), np.ones(1, np.int8)
    of_image, of_point = _read_only(two), _read_only(two * 0)  # as a block keeps them
    key, code, start = np.empty(2, np.int64), np.empty(2, np.int64), np.empty(3, np.int32)
    batch_sort.sort_by(of_image, image, np.empty(3, np.int64), order)
    batch_sort.signatures(order, of_point, of_image, free, 2, key, code, start)
    batch_sort.arrange(two[:1], start, order, of_image, of_point, image.copy(), image, image.copy(), first)
    pieces, chunks = np.zeros((1, 5), np.int64), np.zeros(2, np.int64)
    batch_sort.cut_pieces(first, image, free, 512, pieces, chunks)
    batch_sort.list_entries(pieces, chunks, image, free, 2, np.empty(3, np.int64), np.empty(3, np.int64))
    root, gradient, step, scaled, squares = (
        np.zeros((1, 6)),
        np.zeros((1, 3)),
        np.zeros((1, 3)),
        np.zeros((2, 8)),
        np.zeros(1),
    )
    number, one, components = np.zeros(1, np.int32), np.ones(2, np.int64), np.full(2, n_components)
    batch_points.point_blocks(0, 1, first, number, free, np.zeros((1, 12)), step, 1.0, 0, value, d_ground, root,
                              gradient, scaled)  # fmt: skip
    rays = (image, one, components, basis)
    places = np.array([0, 1], np.int32)
    batch_steps.back_substitute(0, 1, places, first, *rays, wide, 0, value, d_image, d_ground, root, gradient, step,
                                 squares)  # fmt: skip
    batch_weights.scale_rows(0, 2, np.ones(2), value, d_image, d_ground)
    batch_ground.move(number, step, np.zeros((1, 3)))
    for control in (np.zeros((1, 12)), _read_only(np.zeros((1, 12)))):  # as a loss weighs them, as a block keeps them
        batch_ground.control_squares(np.zeros((1, 3)), control, np.zeros(1, np.int64), squares)
    batch_steps.product(0, 1, places, first, free, *rays, wide, 0, 1.0, value, d_image, d_ground, step, squares)
    slots, begin, own = np.arange(3, dtype=np.int32), np.array([0, 3]), np.array([1, 0, 1], np.int32)
    sums, gradients = np.zeros((3, 1, n_components**2 + 8)), np.zeros((3, 1, n_components + 8))
    pairs = (chunks, pieces, slots, begin, *rays, 0)
    batch_pairs.pair_blocks(0, 1, *pairs, d_image, scaled, sums, gradients)
    batch_pairs.image_gradients(0, 1, *pairs, value, d_image, gradients)
    to, row, column = np.arange(4), np.array([0, 0, 1]), np.array([0, 1, 1])
    wide_place, scale = np.zeros((2, 1), np.int64), np.ones((2, 1))
    batch_gather.gather_blocks(0, 3, to, slots, own, row, column, sums, wide_place, scale, one, one, components,
                               np.zeros((3, 1, 1)))  # fmt: skip
    batch_gather.gather_gradients(
        to, slots, own, row, column, gradients, wide_place, scale, one, components, np.zeros(2)
    )
    batch_gather.widen(np.zeros((2, 1)), wide_place, scale, one, wide)
    blocks, place, ones = np.ones((3, 1, 1)), np.arange(2), np.ones(2)
    batch_matrix.fill_diagonal(row, column, place, one, blocks, ones)
    batch_band.factorise_band(np.eye(batch_band.TILE, batch_band.MARGIN + 1), 0)
    for banded in (False, True):
        batch_matrix.fill_lower(row, column, place, one, blocks, ones, banded, np.zeros((2, 2)), ones)


if __name__ == "__main__":
    compile_kernels()
