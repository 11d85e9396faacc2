"""Observations of a frame image's unknowns: position of a receiver and attitude of an inertial unit on board.

    position:  r = W (X_obs - X_0 - dX + R^T B (l_0 + l) - S (b_0 + tau b_1))
    attitude:  r = W (log(A_obs R^T B) - s_0 - tau s_1)

R (camera from ground) and X are the rotation and projection centre of ``factors.cameras.frame``. B = exp([beta]x) B_0
is camera from body, l the lever arm from the receiver to the projection centre (body axes), S ground from the axes of
the strip, and A_obs body from ground. Shift and drift of the position are in the axes of the strip; shift and drift of
the attitude are rotations about the axes of the body. tau runs from -1 to 1 over the strip.

An image has one observation of each kind, so the kernels are plain numpy without compilation.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, register_condition
from factors.cameras import frame
from factors.cameras.frame_camera import CAMERA, turned
from factors.geometry.rotations import Vector
from factors.records import Record

#: W, R_0 and B_0, row-major; followed by X_obs - X_0 m, l_0 m and S row-major, or by A_obs row-major.
_BOTH: Final = Record(whitening=9, rotation=9, mounting=9, tau=1)
POSITION: Final = Record(**_BOTH.fields, offset=3, arm=3, strip=9)
ATTITUDE: Final = Record(**_BOTH.fields, observed=9)
#: Codes of the unknowns, after the codes of the camera: shift and drift of position and of attitude, lever, boresight.
UNKNOWN: Final = Record(**frame.UNKNOWN.fields, shift=3, drift=3, turn=3, turn_drift=3, lever=3, boresight=3)
#: Squared sine of an angle below which angle / sine is computed by series.
SMALL_SQUARED: Final = 1e-6


def _corrections(setup: Array, x: Any) -> Any:
    """Return the corrections (33,) in physical units; zero for elements that are not unknowns."""
    d = np.zeros(UNKNOWN.size, x.dtype)
    np.add.at(d, setup[0].astype(np.intp), setup[1] * x)
    return d


def _rotation(start: Array, w: Any) -> tuple[Any, Any]:
    """Return ``exp([w]x) start`` and its left Jacobian at w, both (3, 3)."""
    out = np.empty(CAMERA.size, w.dtype)
    turned(w, np.ascontiguousarray(start), out)
    return out[CAMERA.rotation].reshape(3, 3), out[CAMERA.jacobian].reshape(3, 3)


def cross(v: Vector) -> Any:
    """Return ``[v]x`` (3, 3)."""
    return np.array([[0.0 * v[0], -v[2], v[1]], [v[2], 0.0 * v[0], -v[0]], [-v[1], v[0], 0.0 * v[0]]])


def rotation_vector(m: Any) -> Any:
    """Return the logarithm (3,), rad, of a rotation (3, 3) by less than half a turn."""
    v = 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    square, cosine = v @ v, 0.5 * (np.trace(m) - 1.0)
    if square.real < SMALL_SQUARED and cosine.real > 0.0:
        return v * (1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * 15.0 / 336.0)))
    sine = np.sqrt(square)
    return v * (2.0 * np.arctan(sine / (1.0 + cosine)) / sine)


def _inverse_right_jacobian(theta: Array) -> Array:
    """Return derivative of ``log(M exp([d]x))`` by d at M = exp([theta]x) (Chirikjian 2012, eq. 10.86, inverted)."""
    t, k = float(theta @ theta), cross(theta)
    if t < SMALL_SQUARED:
        c = 1.0 / 12.0 + t * (1.0 / 720.0 + t / 30240.0)
    else:
        a = np.sqrt(t)
        c = (1.0 - 0.5 * a / np.tan(0.5 * a)) / t
    return np.asarray(np.eye(3) + 0.5 * k + c * (k @ k))


def position_residual(record: Any, setup: Any, x: Any) -> Any:
    """Return the whitened residual (3,) of a receiver's position; accepts complex unknowns."""
    d = _corrections(setup, x)
    rotation = _rotation(record[POSITION.rotation], d[UNKNOWN.rotation])[0]
    mounting = _rotation(record[POSITION.mounting], d[UNKNOWN.boresight])[0]
    arm = rotation.T @ (mounting @ (record[POSITION.arm] + d[UNKNOWN.lever]))
    wrong = record[POSITION.strip].reshape(3, 3) @ (d[UNKNOWN.shift] + record[POSITION.tau] * d[UNKNOWN.drift])
    return record[POSITION.whitening].reshape(3, 3) @ (record[POSITION.offset] - d[UNKNOWN.centre] + arm - wrong)


def position_jacobian(record: Array, setup: Array, value: Array, x: Array) -> Array:
    """Return the Jacobian (3, k)."""
    d, out = _corrections(setup, x), np.zeros((3, UNKNOWN.size))
    rotation, by_w = _rotation(record[POSITION.rotation], d[UNKNOWN.rotation])
    mounting, by_beta = _rotation(record[POSITION.mounting], d[UNKNOWN.boresight])
    across = rotation.T @ cross(mounting @ (record[POSITION.arm] + d[UNKNOWN.lever]))
    axes = record[POSITION.strip].reshape(3, 3)
    out[:, UNKNOWN.rotation], out[:, UNKNOWN.centre] = across @ by_w, -np.eye(3)
    out[:, UNKNOWN.shift], out[:, UNKNOWN.drift] = -axes, -record[POSITION.tau] * axes
    out[:, UNKNOWN.lever], out[:, UNKNOWN.boresight] = rotation.T @ mounting, -across @ by_beta
    return _chosen(record, setup, out)


def attitude_residual(record: Any, setup: Any, x: Any) -> Any:
    """Return the whitened residual (3,) of an inertial unit's attitude; accepts complex unknowns."""
    d = _corrections(setup, x)
    rotation = _rotation(record[ATTITUDE.rotation], d[UNKNOWN.rotation])[0]
    mounting = _rotation(record[ATTITUDE.mounting], d[UNKNOWN.boresight])[0]
    theta = rotation_vector(record[ATTITUDE.observed].reshape(3, 3) @ rotation.T @ mounting)
    wrong = d[UNKNOWN.turn] + record[ATTITUDE.tau] * d[UNKNOWN.turn_drift]
    return record[ATTITUDE.whitening].reshape(3, 3) @ (theta - wrong)


def attitude_jacobian(record: Array, setup: Array, value: Array, x: Array) -> Array:
    """Return the Jacobian (3, k)."""
    d, out = _corrections(setup, x), np.zeros((3, UNKNOWN.size))
    rotation, by_w = _rotation(record[ATTITUDE.rotation], d[UNKNOWN.rotation])
    mounting, by_beta = _rotation(record[ATTITUDE.mounting], d[UNKNOWN.boresight])
    theta = rotation_vector(record[ATTITUDE.observed].reshape(3, 3) @ rotation.T @ mounting)
    inner = _inverse_right_jacobian(theta) @ mounting.T
    out[:, UNKNOWN.rotation], out[:, UNKNOWN.boresight] = -inner @ by_w, inner @ by_beta
    out[:, UNKNOWN.turn], out[:, UNKNOWN.turn_drift] = -np.eye(3), -record[ATTITUDE.tau] * np.eye(3)
    return _chosen(record, setup, out)


def _chosen(record: Array, setup: Array, out: Array) -> Array:
    """Return the whitened columns (3, k) of the image's unknowns, in prior sigmas."""
    return np.ascontiguousarray(record[_BOTH.whitening].reshape(3, 3) @ out[:, setup[0].astype(np.intp)] * setup[1])


ANTENNA_POSITION = register_condition(
    "antenna_position",
    position_residual,
    position_jacobian,
    (Argument("image", "prior sigma"),),
    "Terlemezoğlu 2019, eq. 2.2; shift and drift: Ackermann 1994",
    n_constants=POSITION.size,
)
INERTIAL_ATTITUDE = register_condition(
    "inertial_attitude",
    attitude_residual,
    attitude_jacobian,
    (Argument("image", "prior sigma"),),
    "Terlemezoğlu 2019, eq. 2.2, as a rotation vector",
    n_constants=ATTITUDE.size,
)
