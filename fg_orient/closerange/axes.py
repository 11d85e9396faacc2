"""Rotations as Ayhan 1996 writes them, and as aerial photogrammetry does, from and to the camera axes used here.

The thesis multiplies the triple (X, Z, Y): X right, Z up, Y away from the camera. With X right, Y forward, Z up this
triple is left-handed, so its angles turn the other way than those of an aerial omega, phi, kappa. Here all rotations
lead from ground axes to camera axes X right, Y down, Z along the view (``sensors.frame``).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: (X, Z, Y) from (X, Y, Z).
_ORDER: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
#: Camera axes from image axes x right, z up, c along the view.
_DOWN: Final = np.diag([1.0, -1.0, 1.0])
#: Camera axes from photogrammetric ones: X right, Y up, view along -Z.
_BACK: Final = np.diag([1.0, -1.0, -1.0])


def ayhan_matrix(omega: float, psi: float, kappa: float) -> Array:
    """M = M_kappa M_psi M_omega (3, 3) of Ayhan 1996, eqs. 56-59, on the triple (X, Z, Y); angles in rad."""
    return _from_angles(omega, psi, kappa)


def rotation_from_ayhan(omega: float, psi: float, kappa: float) -> Array:
    """Camera axes from ground axes (3, 3) of the angles of Ayhan 1996, rad."""
    return np.asarray(_DOWN @ ayhan_matrix(omega, psi, kappa) @ _ORDER)


def ayhan_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Angles omega, psi, kappa of Ayhan 1996, rad, of camera axes from ground axes."""
    return _angles(_DOWN @ rotation @ _ORDER)


def rotation_from_aerial(omega: float, phi: float, kappa: float) -> Array:
    """Camera axes from ground axes (3, 3) of aerial angles, rad; camera X right, Y up, view along -Z."""
    return np.asarray(_BACK @ _from_angles(omega, phi, kappa))


def aerial_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Aerial angles omega, phi, kappa, rad: first about X, then the turned Y, then the turned Z."""
    return _angles(_BACK @ rotation)


def _from_angles(omega: float, phi: float, kappa: float) -> Array:
    so, co, sp, cp, sk, ck = (f(a) for a in (omega, phi, kappa) for f in (np.sin, np.cos))
    return np.array([
        [cp * ck, so * sp * ck + co * sk, -co * sp * ck + so * sk],
        [-cp * sk, -so * sp * sk + co * ck, co * sp * sk + so * ck],
        [sp, -so * cp, co * cp],
    ])  # fmt: skip


def _angles(m: Array) -> tuple[float, float, float]:
    return (
        float(np.arctan2(-m[2, 1], m[2, 2])), float(np.arcsin(np.clip(m[2, 0], -1.0, 1.0))),
        float(np.arctan2(-m[1, 0], m[0, 0])),
    )  # fmt: skip
