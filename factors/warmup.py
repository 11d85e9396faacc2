"""Compile the kernels of pushbroom, RPC and frame images once, so that their time is not counted as work.

The first call of a numba function compiles it (10 s in all) or loads it from the cache
(0.2 s). Commands call :func:`compile_kernels` before their clocks start.
"""

from __future__ import annotations

import time

import numpy as np

from factors import (
    batch,
    batch_pairs,
    batch_points,
    batch_weights,
    ellipsoid,
    ephemeris,
    frame,
    frame_camera,
    pushbroom,
    rfm,
    rfm_equation,
    rfm_project,
    rotations,
)


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
    ellipsoid.geodetic_array(ellipsoid.intersect(p, -p / np.linalg.norm(p, axis=1, keepdims=True), np.zeros(2)))
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
    c, ground = e.record[24:].reshape(4, 20).copy(), np.zeros((2, 3))
    rfm.values(c, ground)
    rfm.denominators(c, ground)
    rfm_project.locate(c, np.ones(5), np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2)))
    rfm_project.project(c, np.ones(5), np.ones(5), np.zeros(6), *ground.T.copy())


def _compile_frame() -> None:
    e = frame.example(np.random.default_rng(0))
    x, point = e.unknowns
    for want in (False, True):
        frame.kernel(e.record, e.setup, x, point, want)
    frame.fill(e.record[None].copy(), 0, e.setup, x, point, np.empty((2, len(x) + 4)), True)
    camera = frame.camera(e.record, e.setup, x)
    frame_camera.project(camera, point[None].copy())
    frame_camera.ideal_directions(camera, np.zeros(1), np.zeros(1))


def _compile_batches() -> None:
    """Two rays of one point in two images, and their reduced system."""
    rng, one, first = np.random.default_rng(0), np.ones(2, np.int64), np.array([0, 2])
    ends, zero, left, right = np.arange(3), np.zeros(2, np.int64), np.arange(2, dtype=np.int32), np.ones(2, np.int32)
    other, counts = (np.empty(2, np.int32), np.empty(2, np.int32)), np.zeros(3, np.int64)
    value, wide, basis = np.zeros((2, 2)), np.zeros((2, 40)), np.ones((2, 1))
    for equation, example in (
        (pushbroom.LOOK_ANGLE_COLLINEARITY, pushbroom.example(rng)),
        (rfm_equation.RATIONAL_FUNCTION, rfm_equation.example(rng)),
        (frame.FRAME_BROWN_IDEAL_TO_MEASURED, frame.example(rng)),
    ):
        rows, columns = batch.batch(equation, example.setup)
        records, ground = np.stack([example.record] * 2), np.stack([example.unknowns[1]] * 2)
        d_image, d_ground = np.zeros((2, 2, columns.n_components)), rng.normal(size=(2, 2, 3))
        rows(0, 2, ends[:2], records, ends[:2], ends[:2], zero, columns.setup, 1, basis, wide, ground, value, d_image,
             d_ground, True)  # fmt: skip
    root, gradient, step = np.empty((1, 6)), np.empty((1, 3)), np.zeros((1, 3))
    components = np.full(2, columns.n_components)
    batch_points.point_blocks(0, 1, first, zero[:1], one[:1], np.zeros((2, 12)), ground, value, d_ground, 1.0, root,
                              gradient)  # fmt: skip
    rays = (ends[:2], one, components, basis)
    batch_points.back_substitute(0, 1, first, *rays, wide, value, d_image, d_ground, root, gradient, step, value)
    batch_weights.scale_rows(0, 2, np.ones(2), value, d_image, d_ground)
    batch_points.product(0, 1, first, one[:1], *rays, wide, d_image, d_ground, step, value)
    batch_pairs.count_pairs(first, ends[:2], one[:1])
    batch_pairs.list_pairs(first, ends[:2], zero[:1], left, right)
    batch_pairs.sort_pairs(left, right, True, ends[:2], counts, *other)
    sums, blocks = np.zeros((2, 1, 36)), np.zeros((2, 6, 6))
    batch_pairs.pair_blocks(0, 2, ends, left, right, ends[:2], zero, one, components, basis, d_image, d_ground, root,
                            sums)  # fmt: skip
    batch_pairs.gather_blocks(0, 2, ends, ends[:2], ends[:2], sums, np.zeros((2, 6), np.int64), np.ones((2, 6)), one,
                              one, components, blocks)  # fmt: skip
    batch_pairs.image_gradients(0, 2, ends, left, zero, one, components, basis, value, d_image, d_ground, root,
                                gradient, True, wide)  # fmt: skip
