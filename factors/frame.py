"""Collinearity of a frame image with Brown's distortion from ideal to measured: the observation equation.

    r = A (observed pixel - pixel of the ground point)          (Brown 1966; maps: ``factors.frame_camera``)

Unknown 1 is the orientation of the image in prior sigmas, exterior and interior, any of them; unknown 2 the ground
point (m, local origin). The projection centre is the unknown, not the translation ``-R C``: it is what a receiver on
board measures, and a rotation does not move it. The rotation is ``exp([w]x) R_0`` with the three unknowns w about the
axes of the camera; w is the accumulated vector, not the last step's, so a state means the same all through a run.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.frame_camera import (
    CAMERA_SIZE,
    brown_derivatives,
    brown_ideal_to_measured,
    direction,
    pixel,
    turned,
)

#: Record: observed line, sample 0:2 px; A 2:4, 1/px, for line and sample; then the camera without corrections:
#: rotation camera_from_ground 4:13 row-major, projection centre minus local origin 13:16 m, focal length, principal
#: point and distortion 16:24 as in ``factors.frame_camera``.
RECORD_SIZE: Final = 24
#: Setup: codes of the unknowns and their prior sigmas: 0-2 rotation about the camera's X, Y, Z (rad), 3-5 projection
#: centre (m), 6 focal length, 7 and 8 sample and line of the principal point (px), 9-13 k1 k2 k3 p1 p2.
N_UNKNOWNS: Final = 14


@compiled
def camera(record: Any, setup: Any, x: Any) -> Any:
    """Camera (29,) of unknowns (k,) in prior sigmas; see ``factors.frame_camera``."""
    d, out = np.zeros(N_UNKNOWNS, x.dtype), np.empty(CAMERA_SIZE, x.dtype)
    for j in range(setup.shape[1]):
        d[int(setup[0, j])] += setup[1, j] * x[j]
    turned(d, record[4:13], out)
    for k in range(11):
        out[9 + k] = record[13 + k] + d[3 + k]
    return out


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, x)
    a, b, _ = direction(c, ground[0], ground[1], ground[2])
    line, sample = pixel(c, a, b)
    return np.array([record[2] * (record[0] - line), record[3] * (record[1] - sample)])


@compiled
def conditions(records: Array, setup: Array, x: Array, ground: Array) -> Array:
    """Residuals of N observations of one image at N ground points: (N, 24), (N, 3) -> (N, 2)."""
    out = np.empty((len(records), 2))
    for i in range(len(records)):
        out[i] = residual(records[i], setup, x, ground[i])
    return out


@compiled
def derivatives(c: Array, x: float, y: float, depth: float, out: Array) -> None:
    """Derivatives of line and sample with respect to the 14 unknowns in physical units and the ground point.

    ``out`` (2, 17): line, then sample; columns are the codes of the setup, then the ground point.
    """
    f = c[12]
    a, b, d = brown_derivatives(c, x, y)
    mx, my = brown_ideal_to_measured(c, x, y)
    r, xy = x * x + y * y, x * y
    for row in range(2):
        # with respect to the point in camera axes, Z being the depth
        u, v = (b, d) if row == 0 else (a, b)
        m0, m1 = f * u / depth, f * v / depth
        m2 = -(m0 * x + m1 * y)
        # a turn by the small angle e moves the point q = depth (x, y, 1) by e x q
        w0, w1, w2 = depth * (y * m2 - m1), depth * (m0 - x * m2), depth * (x * m1 - y * m0)
        for k in range(3):
            out[row, k] = w0 * c[20 + k] + w1 * c[23 + k] + w2 * c[26 + k]
            g = m0 * c[k] + m1 * c[3 + k] + m2 * c[6 + k]
            out[row, 3 + k], out[row, N_UNKNOWNS + k] = -g, g
        own = y if row == 0 else x
        out[row, 6] = my if row == 0 else mx
        out[row, 7], out[row, 8] = float(row), 1.0 - row
        out[row, 9] = f * own * r
        out[row, 10] = out[row, 9] * r
        out[row, 11] = out[row, 10] * r
    out[0, 12], out[0, 13] = f * (r + 2.0 * y * y), 2.0 * f * xy
    out[1, 12], out[1, 13] = 2.0 * f * xy, f * (r + 2.0 * x * x)


@compiled
def fill(records: Array, row: int, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row into ``out`` (2, 1 + k + 3).

    Returns False if the sizes do not fit or a value is not finite.
    """
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    c = camera(record, setup, x)
    a, b, depth = direction(c, ground[0], ground[1], ground[2])
    line, sample = pixel(c, a, b)
    out[0, 0], out[1, 0] = record[2] * (record[0] - line), record[3] * (record[1] - sample)
    if want:
        d = np.empty((2, N_UNKNOWNS + 3))
        derivatives(c, a, b, depth, d)
        for i in range(2):
            for j in range(k):
                out[i, 1 + j] = -record[2 + i] * d[i, int(setup[0, j])] * setup[1, j]
            for j in range(3):
                out[i, 1 + k + j] = -record[2 + i] * d[i, N_UNKNOWNS + j]
    total = 0.0
    for j in range(k + 4 if want else 1):
        total += 0.0 * out[0, j] + 0.0 * out[1, j]
    return total == 0.0


@compiled
def kernel(record: Array, setup: Array, x: Array, ground: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians with respect to the image unknowns (2, k) and the ground point (2, 3)."""
    k = setup.shape[1]
    out = np.full((2, k + 4), np.nan)  # stays nan if sizes do not fit: never uninitialised memory
    fill(record.reshape((1, -1)), 0, setup, x, ground, out, want)
    if not want:
        return out[:, 0].copy(), np.empty((0, 0)), np.empty((0, 0))
    return out[:, 0].copy(), out[:, 1 : k + 1].copy(), out[:, k + 1 :].copy()


def example(rng: np.random.Generator) -> Example:
    """Build an observation of a wide-angle camera; small and large rotation vectors occur, and subsets of unknowns."""
    start, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    start *= np.sign(np.linalg.det(start))
    centre, depth = rng.normal(scale=100.0, size=3), rng.uniform(50.0, 500.0)
    ground = centre + start.T @ (depth * np.array([*rng.uniform(-0.4, 0.4, 2), 1.0]))
    interior = [rng.uniform(500.0, 5e3), *rng.uniform(-50.0, 50.0, 2), *rng.normal(scale=0.05, size=3),
                *rng.normal(scale=1e-3, size=2)]  # fmt: skip
    record = np.concatenate(
        [rng.uniform(-1e3, 1e3, 2), 1.0 / rng.uniform(0.2, 2.0, 2), start.ravel(), centre, interior]
    )
    sigma = np.repeat([rng.choice([1e-5, 1e-3, 0.1]), 0.3, 3.0, 2.0, 1e-2, 1e-4], [3, 3, 1, 2, 3, 2])
    codes = np.sort(rng.permutation(N_UNKNOWNS)[: rng.integers(1, N_UNKNOWNS + 1)])
    setup = np.ascontiguousarray(np.stack([codes.astype(float), sigma[codes]]))
    return Example(record, setup, (rng.normal(size=len(codes)), ground + rng.normal(scale=1.0, size=3)))


FRAME_BROWN_IDEAL_TO_MEASURED = register(Equation(
    "frame_brown_ideal_to_measured", kernel, residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Brown 1966; OpenCV and COLMAP camera models; BAL (Agarwal et al. 2010)", fill,
))  # fmt: skip
