"""The equations of the authors' program where they differ from the kernel: short axis and derivatives.

The program takes ``X = V/|V| x Z`` without normalising it, and ``Y = Z x X``: both have the length
``s = sin(V, Z)``. With the orthonormal frame R, ``D = diag(s, s, 1)``, attitude U and mounting M0 its ray is
``R D U M0 u1`` and its conditions use ``f = M0^T U^T D R^T w``. For the values the kernel does: its mounting
``M = U^-1 D U M0`` gives both, as ``U M = D U M0``. The derivatives of f are taken here by complex steps, which are
exact to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.geometry import rotations

Array = npt.NDArray[np.float64]

_STEP: Final = 1e-30


@dataclass(frozen=True)
class States:
    """Corrected EOPs of n image points.

    Parameters
    ----------
    metadata_position_m, position_m : (n, 3) arrays
        Without and with corrections.
    frame_position_m, frame_velocity_m_s : (n, 3) arrays
        What the orbital frame is made of: that of DIMAP 2 files does not follow corrections.
    angles_rad : (n, 3) array
        Roll, pitch, yaw.
    mounting : (n, 9) array
        Of the kernel.
    small : bool
        Form of the attitude.
    follows : (n,) bool array
        Whether the frame follows the corrections.
    """

    metadata_position_m: Array
    position_m: Array
    frame_position_m: Array
    frame_velocity_m_s: Array
    angles_rad: Array
    mounting: Array
    small: bool
    follows: npt.NDArray[np.bool_]


def mounting(p: Array, v: Array, angles: Array, base: Array, small: bool) -> Array:
    """``M = U^-1 D U M0`` of n states: (n, 9) from (n, 3) P, V, angles and (n, 9) M0."""
    u = rotations.attitude_matrices(np.ascontiguousarray(angles), small)
    d = np.ones((len(p), 3, 1))
    d[:, :2, 0] = axis_length(p, v)
    return np.asarray((np.linalg.solve(u, d * u) @ base.reshape(-1, 3, 3)).reshape(-1, 9))


def axis_length(p: Any, v: Any) -> Any:
    """Length s = sin(V, Z) of the across-track axis (n, 1), real or complex."""
    return _length(np.cross(v, p)) / (_length(v) * _length(p))


def _length(a: Any) -> Any:
    """Length without conjugation (n, 1): analytic."""
    return np.sqrt(np.sum(a * a, axis=1, keepdims=True))


def _rotated(p: Any, v: Any, angles: Any, to_ground: Any, base: Array, small: bool, s: Any) -> Any:
    """``f = M0^T U^T D R^T w`` (n, 3); D = 1 for s = 1."""
    z = p / _length(p)
    x = np.cross(v, z)
    x = x / _length(x)
    y = np.cross(z, x)
    w = np.stack([np.sum(axis * to_ground, axis=1) for axis in (x, y, z)])
    w[:2] *= s[:, 0]
    roll, pitch, yaw = angles.T
    if small:
        u = rotations.orbital_from_body_small(roll, pitch, yaw)
    else:
        sines = [f(a) for a in (roll, pitch, yaw) for f in (np.sin, np.cos)]
        u = rotations.from_sines(*sines)
    f = np.stack(rotations.multiply_transposed(u, w), axis=1)
    return np.einsum("nji,nj->ni", base.reshape(-1, 3, 3), f)


def derivatives(
    at: States, base: Array, to_ground: Array, components: Sequence[int], *, short: bool,
    tangents: Array | None,
) -> Array:  # fmt: skip
    """Derivatives of both conditions by EOPs.

    Parameters
    ----------
    at : States
    base : (n, 9) array
        M0.
    to_ground : (n, 3) array
        Ground point minus P, ECEF.
    components : sequence of k int
        Which of the nine EOPs.
    short : bool
        Whether the axis is short and its length follows the unknowns.
    tangents : (n, 2) array or None
        Quotients f1/f3 and f2/f3 of the derivative of a quotient; None takes them from f itself.

    Returns
    -------
    (n, 2, k) array
    """
    n, k = len(to_ground), len(components)
    given = np.hstack([at.frame_position_m, at.frame_velocity_m_s, at.angles_rad, to_ground])
    moved = np.tile(given.astype(complex), (k, 1, 1))  # one copy of all points for each step
    follows = at.follows.astype(float)
    for step, component in enumerate(components):
        moved[step, :, component] += 1j * _STEP * (follows if component < 6 else 1.0)
        if component < 3:
            moved[step, :, 9 + component] -= 1j * _STEP
    p, v, angles, w = (np.ascontiguousarray(moved[:, :, 3 * c : 3 * c + 3].reshape(-1, 3)) for c in range(4))
    s = axis_length(p, v) if short else np.ones((len(p), 1))
    steps = _rotated(p, v, angles, w, np.tile(base, (k, 1)), at.small, s).reshape(k, n, 3)
    f, df = steps[-1].real, np.moveaxis(steps.imag / _STEP, 0, 2)
    q = f[:, :2] / f[:, 2:] if tangents is None else tangents
    return np.asarray((df[:, :2] - q[:, :, None] * df[:, 2:]) / f[:, 2:, None])
