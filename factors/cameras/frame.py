"""Collinearity of a frame image with Brown's distortion from ideal to measured: the observation equation.

    r = A (pixel of the ground point - observed pixel)          (Brown 1966; maps: ``factors.cameras.frame_camera``)

Unknown 1 is the orientation of the image in prior sigmas, exterior and interior, any of them; unknown 2 the ground
point (m, local origin). The projection centre is the unknown, not the translation ``-R C``: it is what a receiver on
board measures, and a rotation does not move it. The rotation is ``exp([w]x) R_0`` with the three unknowns w about the
axes of the camera; w is the accumulated vector, not the last step's, so a state means the same all through a run.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, kernel_of, register
from factors.cameras.frame_camera import CAMERA, brown_derivatives, brown_ideal_to_measured, direction, pixel, turned
from factors.records import Record

#: Observed pixel; A, 1/px, for line and sample; the camera without corrections, its centre minus the local origin, m.
RECORD: Final = Record(line=1, sample=1, a_line=1, a_sample=1, rotation=9, centre=3, focal=1, principal=2, distortion=5)
#: Setup: codes of the unknowns, which are their places here, and their prior sigmas: rotation about the camera's X, Y,
#: Z rad, projection centre m, interior orientation px; the aspect is that of ``factors.cameras.frame_measured``, which
#: no pixel here feels.
UNKNOWN: Final = Record(
    rotation="w1 w2 w3", centre="x y z", focal=1, principal="sample line", distortion="k1 k2 k3 p1 p2", aspect=1,
)  # fmt: skip
N_UNKNOWNS: Final = UNKNOWN.size
#: Columns of derivatives: the unknowns, the ground point, and one that stays zero, for unknowns of an image that no
#: pixel feels: codes from N_UNKNOWNS on (``factors.conditions.navigation``).
COLUMN: Final = Record(**UNKNOWN.fields, ground="g1 g2 g3", silent=1)
GROUND: Final = COLUMN.ground.start


@compiled
def camera(record: Any, setup: Any, x: Any) -> Any:
    """Camera (29,) of unknowns (k,) in prior sigmas; see ``factors.cameras.frame_camera``."""
    d, out = np.zeros(N_UNKNOWNS, x.dtype), np.empty(CAMERA.size, x.dtype)
    for j in range(setup.shape[1]):
        if setup[0, j] < N_UNKNOWNS:
            d[int(setup[0, j])] += setup[1, j] * x[j]
    turned(d[UNKNOWN.rotation], record[RECORD.rotation], out)
    for k in range(UNKNOWN.aspect - UNKNOWN.centre.start):
        out[CAMERA.centre.start + k] = record[RECORD.centre.start + k] + d[UNKNOWN.centre.start + k]
    return out


@compiled
def columns_of(setup: Any) -> Any:
    """Column (k,) of each unknown among the derivatives."""
    out = setup[0].astype(np.int64)
    for j in range(len(out)):
        if out[j] >= N_UNKNOWNS:
            out[j] = COLUMN.silent
    return out


@compiled
def misclosure(record: Any, line: Any, sample: Any) -> Any:
    """Whitened computed minus observed pixel: two numbers."""
    line, sample = line - record[RECORD.line], sample - record[RECORD.sample]
    return record[RECORD.a_line] * line, record[RECORD.a_sample] * sample


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, x)
    u, v, _ = direction(c, ground[0], ground[1], ground[2])
    line, sample = pixel(c, u, v)
    return np.array(misclosure(record, line, sample))


@compiled
def sight_row(c: Any, own: float, direction: Any, u: float, v: float, weight: float, out: Array, row: int) -> float:
    """Write the derivatives of one pixel coordinate; 0 if they are finite.

    ``own`` is the coordinate of the direction (x, y, 1/Z) that the pixel coordinate follows, ``u`` and ``v`` are the
    derivatives of its measured one.
    """
    x, y, inverse = direction
    s = weight * c[CAMERA.focal]
    m0, m1 = s * u, s * v
    m2 = -(m0 * x + m1 * y)
    # a turn by the small angle e moves the point q = Z (x, y, 1) by e x q
    w0, w1, w2 = y * m2 - m1, m0 - x * m2, x * m1 - y * m0
    m0, m1, m2 = m0 * inverse, m1 * inverse, m2 * inverse
    g0 = m0 * c[CAMERA.r11] + m1 * c[CAMERA.r21] + m2 * c[CAMERA.r31]
    g1 = m0 * c[CAMERA.r12] + m1 * c[CAMERA.r22] + m2 * c[CAMERA.r32]
    g2 = m0 * c[CAMERA.r13] + m1 * c[CAMERA.r23] + m2 * c[CAMERA.r33]
    out[row, COLUMN.w1] = w0 * c[CAMERA.j11] + w1 * c[CAMERA.j21] + w2 * c[CAMERA.j31]
    out[row, COLUMN.w2] = w0 * c[CAMERA.j12] + w1 * c[CAMERA.j22] + w2 * c[CAMERA.j32]
    out[row, COLUMN.w3] = w0 * c[CAMERA.j13] + w1 * c[CAMERA.j23] + w2 * c[CAMERA.j33]
    out[row, COLUMN.x], out[row, COLUMN.y], out[row, COLUMN.z] = -g0, -g1, -g2
    out[row, COLUMN.g1], out[row, COLUMN.g2], out[row, COLUMN.g3] = g0, g1, g2
    r = x * x + y * y
    k1 = s * own * r
    out[row, UNKNOWN.k1], out[row, UNKNOWN.k2], out[row, UNKNOWN.k3] = k1, k1 * r, k1 * r * r
    return float(0.0 * ((w0 + w1) + (w2 + g0) + (g1 + g2) + k1 * r * r))


@compiled
def derivatives(c: Any, ray: Any, a_line: float, a_sample: float, out: Array) -> float:
    """Write the whitened derivatives of the residual into ``out`` (2, 19); 0 if they are finite.

    ``c`` is the camera, an array or a tuple; ``ray`` what :func:`factors.cameras.frame_camera.direction` gives;
    ``a_line`` and ``a_sample`` are the weights, 1/px. Columns: the 15 unknowns in physical units, then the ground
    point; columns 14 and 18 are left as they are.
    """
    x, y, _ = ray
    mx, my = brown_ideal_to_measured(c, x, y)
    a, b, d = brown_derivatives(c, x, y)
    zero = sight_row(c, y, ray, b, d, a_line, out, 0) + sight_row(c, x, ray, a, b, a_sample, out, 1)
    r, xy = x * x + y * y, 2.0 * x * y
    out[0, UNKNOWN.focal], out[0, UNKNOWN.sample], out[0, UNKNOWN.line] = a_line * my, 0.0, a_line
    out[1, UNKNOWN.focal], out[1, UNKNOWN.sample], out[1, UNKNOWN.line] = a_sample * mx, a_sample, 0.0
    s_line, s_sample = a_line * c[CAMERA.focal], a_sample * c[CAMERA.focal]
    out[0, UNKNOWN.p1], out[0, UNKNOWN.p2] = s_line * (r + 2.0 * y * y), s_line * xy
    out[1, UNKNOWN.p1], out[1, UNKNOWN.p2] = s_sample * xy, s_sample * (r + 2.0 * x * x)
    return float(zero)


@compiled
def spread(d: Array, setup: Array, out: Array) -> None:
    """Write the Jacobians of the unknowns in prior sigmas and of the ground point behind the values in ``out``."""
    column = columns_of(setup)
    for i in range(2):
        for j in range(len(column)):
            out[i, 1 + j] = d[i, column[j]] * setup[1, j]
        for j in range(3):
            out[i, 1 + len(column) + j] = d[i, GROUND + j]


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record, d = setup.shape[1], records[row], np.zeros((2, COLUMN.size))
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    c = camera(record, setup, x)
    ray = direction(c, ground[0], ground[1], ground[2])
    line, sample = pixel(c, ray[0], ray[1])
    out[0, 0], out[1, 0] = misclosure(record, line, sample)
    zero = 0.0 * (out[0, 0] + out[1, 0])
    if want:
        zero += derivatives(c, ray, record[RECORD.a_line], record[RECORD.a_sample], d)
        spread(d, setup, out)
    return bool(zero == 0.0)


def example(rng: np.random.Generator) -> Example:
    """Build an observation of a wide-angle camera; small and large rotation vectors occur, and subsets of unknowns."""
    start, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    start *= np.sign(np.linalg.det(start))
    centre, depth = rng.normal(scale=100.0, size=3), rng.uniform(50.0, 500.0)
    ground = centre + start.T @ (depth * np.array([*rng.uniform(-0.4, 0.4, 2), 1.0]))
    focal, principal = rng.uniform(500.0, 5e3), rng.uniform(-50.0, 50.0, 2)
    distortion, (line, sample) = rng.normal(size=5) * np.repeat([0.05, 1e-3], [3, 2]), rng.uniform(-1e3, 1e3, 2)
    a_line, a_sample = 1.0 / rng.uniform(0.2, 2.0, 2)
    record = RECORD.pack(line=line, sample=sample, a_line=a_line, a_sample=a_sample, rotation=start.ravel(),
                         centre=centre, focal=focal, principal=principal, distortion=distortion)  # fmt: skip
    sigma = np.repeat([rng.choice([1e-5, 1e-3, 0.1]), 0.3, 3.0, 2.0, 1e-2, 1e-4], [3, 3, 1, 2, 3, 2])
    codes = np.sort(rng.permutation(14)[: rng.integers(1, 15)])
    setup = np.stack([codes.astype(float), sigma[codes]])
    if rng.random() < 0.3:
        codes = np.append(codes, N_UNKNOWNS + 2)
        setup = np.column_stack([setup, [codes[-1], 1.0]])
    setup = np.ascontiguousarray(setup)
    return Example(record, setup, (rng.normal(size=len(codes)), ground + rng.normal(scale=1.0, size=3)))


FRAME_BROWN_IDEAL_TO_MEASURED = register(Equation(
    "frame_brown_ideal_to_measured", kernel_of(fill), residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Brown 1966; OpenCV and COLMAP camera models; BAL (Agarwal et al. 2010)", fill,
))  # fmt: skip
