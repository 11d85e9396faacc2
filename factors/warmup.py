"""Compile the kernels of pushbroom and RPC images once, so that their time is not counted as work.

The first call of a numba function compiles it (10 s in all) or loads it from the cache
(0.2 s). Commands call :func:`compile_kernels` before their clocks start.
"""

from __future__ import annotations

import time

import numpy as np

from factors import ellipsoid, ephemeris, pushbroom, rfm, rfm_equation, rfm_project, rotations


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
