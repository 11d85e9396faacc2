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
#: centre (m), 6 focal length, 7 and 8 sample and line of the principal point (px), 9-13 k1 k2 k3 p1 p2; 14 the aspect
#: of ``factors.frame_measured``, which no pixel here feels.
N_UNKNOWNS: Final = 15
#: Column of the ground point behind those of the unknowns; and one that stays zero, for unknowns of an image that no
#: pixel feels: codes from N_UNKNOWNS on (``factors.navigation``).
GROUND: Final = N_UNKNOWNS
SILENT: Final = GROUND + 3
N_COLUMNS: Final = SILENT + 1


@compiled
def camera(record: Any, setup: Any, x: Any) -> Any:
    """Camera (29,) of unknowns (k,) in prior sigmas; see ``factors.frame_camera``."""
    d, out = np.zeros(N_UNKNOWNS, x.dtype), np.empty(CAMERA_SIZE, x.dtype)
    for j in range(setup.shape[1]):
        if setup[0, j] < N_UNKNOWNS:
            d[int(setup[0, j])] += setup[1, j] * x[j]
    turned(d, record[4:13], out)
    for k in range(11):
        out[9 + k] = record[13 + k] + d[3 + k]
    return out


@compiled
def columns_of(setup: Any) -> Any:
    """Column (k,) of each unknown among the derivatives."""
    out = setup[0].astype(np.int64)
    for j in range(len(out)):
        if out[j] >= N_UNKNOWNS:
            out[j] = SILENT
    return out


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, x)
    u, v, _ = direction(c, ground[0], ground[1], ground[2])
    line, sample = pixel(c, u, v)
    return np.array([record[2] * (record[0] - line), record[3] * (record[1] - sample)])


@compiled
def sight_row(c: Any, own: float, direction: Any, u: float, v: float, weight: float, out: Array, row: int) -> float:
    """Write the derivatives of one pixel coordinate; 0 if they are finite.

    ``own`` is the coordinate of the direction (x, y, 1/Z) that the pixel coordinate follows, ``u`` and ``v`` are the
    derivatives of its measured one.
    """
    x, y, inverse = direction
    s = weight * c[12]
    m0, m1 = s * u, s * v
    m2 = -(m0 * x + m1 * y)
    # a turn by the small angle e moves the point q = Z (x, y, 1) by e x q
    w0, w1, w2 = y * m2 - m1, m0 - x * m2, x * m1 - y * m0
    m0, m1, m2 = m0 * inverse, m1 * inverse, m2 * inverse
    g0, g1, g2 = (
        m0 * c[0] + m1 * c[3] + m2 * c[6], m0 * c[1] + m1 * c[4] + m2 * c[7], m0 * c[2] + m1 * c[5] + m2 * c[8],
    )  # fmt: skip
    out[row, 0] = w0 * c[20] + w1 * c[23] + w2 * c[26]
    out[row, 1] = w0 * c[21] + w1 * c[24] + w2 * c[27]
    out[row, 2] = w0 * c[22] + w1 * c[25] + w2 * c[28]
    out[row, 3], out[row, 4], out[row, 5] = -g0, -g1, -g2
    out[row, GROUND], out[row, GROUND + 1], out[row, GROUND + 2] = g0, g1, g2
    r = x * x + y * y
    k1 = s * own * r
    out[row, 9], out[row, 10], out[row, 11] = k1, k1 * r, k1 * r * r
    return float(0.0 * ((w0 + w1) + (w2 + g0) + (g1 + g2) + k1 * r * r))


@compiled
def derivatives(c: Any, ray: Any, a_line: float, a_sample: float, out: Array) -> float:
    """Write the whitened derivatives of the residual into ``out`` (2, 19); 0 if they are finite.

    ``c`` is the camera, an array or a tuple; ``ray`` what :func:`factors.frame_camera.direction` gives; ``a_line`` and
    ``a_sample`` are the weights, 1/px. Columns: the 15 unknowns in physical units, then the ground point;
    columns 14 and 18 are left as they are.
    """
    x, y, _ = ray
    mx, my = brown_ideal_to_measured(c, x, y)
    a, b, d = brown_derivatives(c, x, y)
    zero = sight_row(c, y, ray, b, d, -a_line, out, 0) + sight_row(c, x, ray, a, b, -a_sample, out, 1)
    r, xy = x * x + y * y, 2.0 * x * y
    out[0, 6], out[0, 7], out[0, 8] = -a_line * my, 0.0, -a_line
    out[1, 6], out[1, 7], out[1, 8] = -a_sample * mx, -a_sample, 0.0
    s_line, s_sample = -a_line * c[12], -a_sample * c[12]
    out[0, 12], out[0, 13] = s_line * (r + 2.0 * y * y), s_line * xy
    out[1, 12], out[1, 13] = s_sample * xy, s_sample * (r + 2.0 * x * x)
    return float(zero)


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row into ``out`` (2, 1 + k + 3).

    Returns False if the sizes do not fit or a value is not finite.
    """
    k, record, d = setup.shape[1], records[row], np.zeros((2, N_COLUMNS))
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    c = camera(record, setup, x)
    ray = direction(c, ground[0], ground[1], ground[2])
    line, sample = pixel(c, ray[0], ray[1])
    out[0, 0], out[1, 0] = record[2] * (record[0] - line), record[3] * (record[1] - sample)
    zero = 0.0 * (out[0, 0] + out[1, 0])
    if want:
        zero += derivatives(c, ray, record[2], record[3], d)
        column = columns_of(setup)
        for i in range(2):
            for j in range(k):
                out[i, 1 + j] = d[i, column[j]] * setup[1, j]
            for j in range(3):
                out[i, 1 + k + j] = d[i, GROUND + j]
    return bool(zero == 0.0)


@compiled
def kernel(record: Array, setup: Array, x: Array, ground: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians with respect to the image unknowns (2, k) and the ground point (2, 3)."""
    k = setup.shape[1]
    out = np.full((2, k + 4), np.nan)  # stays nan if sizes do not fit: never uninitialised memory
    fill(record.reshape((1, -1)), np.int64(0), setup, x, ground, out, want)  # a literal 0 compiles fill once more
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
    codes = np.sort(rng.permutation(14)[: rng.integers(1, 15)])
    setup = np.stack([codes.astype(float), sigma[codes]])
    if rng.random() < 0.3:
        codes = np.append(codes, N_UNKNOWNS + 2)
        setup = np.column_stack([setup, [codes[-1], 1.0]])
    setup = np.ascontiguousarray(setup)
    return Example(record, setup, (rng.normal(size=len(codes)), ground + rng.normal(scale=1.0, size=3)))


FRAME_BROWN_IDEAL_TO_MEASURED = register(Equation(
    "frame_brown_ideal_to_measured", kernel, residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Brown 1966; OpenCV and COLMAP camera models; BAL (Agarwal et al. 2010)", fill,
))  # fmt: skip
