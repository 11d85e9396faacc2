"""The SPOT-5 conditions are written a second time in numpy, as a reference for the published procedure.

Nothing of the kernels is used. All functions accept complex arguments, so that derivatives can be taken by
complex step. ``as_run`` leaves the across-track axis V/|V| x Z unnormalised and the attitude a small-angle
matrix; both are inverted by transposing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fg_orient.model.block import Block

STEP = 1e-30


def norm(v: np.ndarray) -> np.ndarray:
    """Return the length without conjugation, which is analytic."""
    return np.sqrt(np.sum(v * v, axis=-1, keepdims=True))


def frame(p: np.ndarray, v: np.ndarray, as_run: bool) -> np.ndarray:
    """Return the axes of convention B: columns X right of flight, Y forward, Z outward, (n, 3, 3)."""
    z = p / norm(p)
    if as_run:
        x = np.cross(v / norm(v), z)
    else:
        n = np.cross(v, p)
        x = n / norm(n)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def attitude(a: np.ndarray, as_run: bool) -> np.ndarray:
    """Return the matrices from payload to orbital frame of roll, pitch, yaw (n, 3).

    Rx(pitch)^T Ry(roll)^T Rz(yaw)^T, passive rotations.
    """
    roll, pitch, yaw = a[:, 0], a[:, 1], a[:, 2]
    one, nought = np.ones_like(roll), np.zeros_like(roll)
    if as_run:
        rows = [[one, -yaw, roll], [yaw, one, -pitch], [-roll, pitch, one]]
        return np.moveaxis(np.array(rows), 2, 0)
    c, s = np.cos, np.sin
    rx = np.array([[one, nought, nought], [nought, c(pitch), s(pitch)], [nought, -s(pitch), c(pitch)]])
    ry = np.array([[c(roll), nought, -s(roll)], [nought, one, nought], [s(roll), nought, c(roll)]])
    rz = np.array([[c(yaw), s(yaw), nought], [-s(yaw), c(yaw), nought], [nought, nought, one]])
    return np.einsum("jin,kjn,lkn->nil", rx, ry, rz)


def f_vector(eop: np.ndarray, ground: np.ndarray, as_run: bool) -> np.ndarray:
    """Return f = R_UY^T R_OG^T (G - P), (n, 3)."""
    w = np.einsum("nji,nj->ni", frame(eop[:, 0:3], eop[:, 3:6], as_run), ground - eop[:, 0:3])
    return np.einsum("nji,nj->ni", attitude(eop[:, 6:9], as_run), w)


def conditions(eop: np.ndarray, look: np.ndarray, ground: np.ndarray, as_run: bool) -> np.ndarray:
    """Return f_psi_y and F_psi_x (n, 2) from the nine EOPs (n, 9), look angles psi_x, psi_y (n, 2), ground (n, 3)."""
    f = f_vector(eop, ground, as_run)
    return np.stack([f[:, 0] / f[:, 2] - np.tan(look[:, 1]), f[:, 1] / f[:, 2] + np.tan(look[:, 0])], axis=1)


def back_projected(eop: np.ndarray, ground: np.ndarray, as_run: bool) -> np.ndarray:
    """Return the look angles psi_x, psi_y (n, 2) at which the conditions vanish."""
    f = f_vector(eop, ground, as_run)
    return np.arctan(np.stack([-f[:, 1] / f[:, 2], f[:, 0] / f[:, 2]], axis=1))


def ray(eop: np.ndarray, look: np.ndarray, as_run: bool, third: float = -1.0) -> np.ndarray:
    """Return the direction R_OG R_UY u1 (n, 3), unit length."""
    u1 = np.stack([-np.tan(look[:, 1]), np.tan(look[:, 0]), np.full(len(look), third)], axis=1)
    u = np.einsum("nij,njk,nk->ni", frame(eop[:, 0:3], eop[:, 3:6], as_run), attitude(eop[:, 6:9], as_run), u1)
    return u / norm(u)


def derivatives(
    eop: np.ndarray, look: np.ndarray, ground: np.ndarray, as_run: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return complex-step derivatives by the EOPs (n, 2, 9), the ground (n, 2, 3), psi_y and psi_x (n, 2, 2)."""
    out = []
    for which, width in ((0, 9), (2, 3), (1, 2)):
        columns = []
        for k in range(width):
            given = [eop, look, ground]
            given[which] = given[which] + 1j * STEP * np.eye(width)[k]
            columns.append(conditions(*given, as_run).imag / STEP)
        out.append(np.stack(columns, axis=2))
    return out[0], out[1], out[2][:, :, ::-1]


def published_derivatives(eop: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the written-out derivatives of F by the nine EOPs.

    The frame is orthonormal, the attitude of small angles.
    """
    p, v, d = eop[:, 0:3], eop[:, 3:6], ground - eop[:, 0:3]
    u, r = attitude(eop[:, 6:9], True), frame(p, v, False)
    x, z, n = r[:, :, 0], r[:, :, 2], np.cross(v, p)
    f = np.einsum("nji,nkj,nk->ni", u, r, d)
    out = np.empty((len(eop), 2, 9))
    turn = np.zeros((3, 3, 3))
    turn[0, 0, 2] = turn[1, 2, 1] = turn[2, 1, 0] = 1.0
    turn -= np.swapaxes(turn, 1, 2)  # d R_UY / d roll, pitch, yaw
    for k in range(9):
        e = np.eye(3)[k % 3]
        if k < 6:
            dp, dv = (e, np.zeros(3)) if k < 3 else (np.zeros(3), e)
            dz = (dp - z * (z @ dp)[:, None]) / norm(p)
            dn = np.cross(dv, p) + np.cross(v, dp)
            dx = (dn - x * np.sum(x * dn, axis=1, keepdims=True)) / norm(n)
            dy = np.cross(dz, x) + np.cross(z, dx)
            moved = np.stack([np.sum(a * d, axis=1) for a in (dx, dy, dz)], axis=1) - np.einsum("nji,j->ni", r, dp)
            df = np.einsum("nji,nj->ni", u, moved)
        else:
            df = np.einsum("ji,nkj,nk->ni", turn[k - 6], r, d)
        out[:, :, k] = (df[:, :2] * f[:, 2:] - f[:, :2] * df[:, 2:]) / f[:, 2:] ** 2
    return out


def file_eop(block: Block, image: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of an image and its nine EOPs there (n, 9).

    They are parabolas of the line through the metadata at these lines.
    """
    rows = np.flatnonzero(block.observations.image == image)
    line = block.observations.line[rows]
    states = block.images[image].sensor.states(line)
    values = np.hstack([states.position_m, states.velocity_m_s, states.angles_rad])
    offset = values.mean(axis=0)  # in metres the orbit radius would reduce the digits of the fit
    centred = (line - line.mean()) / np.ptp(line)
    return rows, offset + np.polynomial.polynomial.polyvander(centred, 2) @ np.linalg.lstsq(
        np.polynomial.polynomial.polyvander(centred, 2), values - offset, rcond=None
    )[0]


def all_eop(block: Block) -> np.ndarray:
    """Return the nine EOPs of every image point (n, 9)."""
    out = np.empty((len(block.observations), 9))
    for image in range(len(block.images)):
        rows, values = file_eop(block, image)
        out[rows] = values
    return out


def coefficient_columns(d_eop: np.ndarray, line: np.ndarray, codes: Sequence[int]) -> np.ndarray:
    """Return A (n, 2, k) of the coefficients per line from the derivatives (n, 2, 9)."""
    return np.stack([d_eop[:, :, code // 3] * (line ** (code % 3))[:, None] for code in codes], axis=2)


def two_rays(p1: np.ndarray, u1: np.ndarray, p2: np.ndarray, u2: np.ndarray) -> np.ndarray:
    """Return the foot on the first ray by [u1, -u2] s = P2 - P1 by least squares, point by point."""
    out = np.empty_like(p1)
    for k in range(len(p1)):
        s = np.linalg.lstsq(np.stack([u1[k], -u2[k]], axis=1), p2[k] - p1[k], rcond=None)[0]
        out[k] = p1[k] + s[0] * u1[k]
    return out
