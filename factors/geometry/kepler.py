"""Orbital frames of convention A, by position and velocity and by Kepler angles.

Convention A: X forward, Y along the orbit normal (left of flight), Z outward. Convention B of
``factors.geometry.rotations`` (X right, Y forward) is ``A K`` with :data:`B_FROM_A` transposed. Attitude of convention
A: ``Rx(roll) Ry(pitch) Rz(yaw)``, active and right-handed.

Source: Terlemezoğlu 2019, eqs. 2.7-2.21 as corrected: columns, four-quadrant angles, inertial velocity.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors._contract import Array

#: Axes of convention B from those of convention A: X_B = -Y_A, Y_B = X_A.
B_FROM_A: Final = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def kepler_angles(position_m: Array, velocity_m_s: Array) -> Array:
    """Inclination, node and argument of latitude (N, 3) rad of N states; ``velocity_m_s`` inertial, in the same axes.

    Source: eqs. 2.11-2.16; node and argument of latitude by atan2, so that descending passes are correct.
    """
    c = np.cross(position_m, velocity_m_s)
    inclination = np.arccos(c[:, 2] / np.linalg.norm(c, axis=1))
    node = np.arctan2(c[:, 0], -c[:, 1])
    x, y, z = position_m.T
    latitude = np.arctan2(z / np.sin(inclination), x * np.cos(node) + y * np.sin(node))
    return np.stack([inclination, node, latitude], axis=1)


def frames_from_kepler(angles_rad: Array) -> Array:
    """Orbital frames (N, 3, 3) of inclination, node and argument of latitude (N, 3): eq. 2.18."""
    ci, co, cw = np.cos(angles_rad).T
    si, so, sw = np.sin(angles_rad).T
    rows = [
        [-co * sw - so * ci * cw, so * si, co * cw - so * ci * sw],
        [-so * sw + co * ci * cw, -co * si, so * cw + co * ci * sw],
        [si * cw, ci, si * sw],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


def frames_from_state(position_m: Array, velocity_m_s: Array) -> Array:
    """Orbital frames (N, 3, 3) of positions and velocities (N, 3): eqs. 2.19-2.21.

    With the Earth-fixed velocity the frame follows the ground track, with the inertial velocity the orbit: the two
    frames differ by 3 degrees of yaw.
    """
    z = position_m / np.linalg.norm(position_m, axis=1, keepdims=True)
    y = np.cross(z, velocity_m_s)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=2)


def attitude_matrices(angles_rad: Array) -> Array:
    """Payload to orbital frame (N, 3, 3) of roll, pitch, yaw (N, 3) in convention A: eq. 2.9 as corrected."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles_rad).T, np.sin(angles_rad).T
    rows = [
        [cp * cy, -cp * sy, sp],
        [cr * sy + sr * sp * cy, cr * cy - sr * sp * sy, -sr * cp],
        [sr * sy - cr * sp * cy, cr * sp * sy + sr * cy, cr * cp],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))
