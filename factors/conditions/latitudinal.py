"""Observation of a ground point by latitude, longitude and radius, relative to the centre of a body.

    r = (r_0 cos(lat_0) (lon - lon_0) / s_1,  r_0 (lat - lat_0) / s_2,  (r - r_0) / s_3)

This is how ISIS jigsaw weights a constrained point. The linear equation of ``factors.conditions.control`` has the same
derivatives at the observed place; the two differ by the square of the correction over the radius.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, compiled, register_condition
from factors.records import Record

#: Local origin in body-fixed axes m; observed longitude, latitude rad and radius m; standard deviations along them, m.
RECORD: Final = Record(origin="x y z", observed="lon lat radius", sigma="s1 s2 s3")


@compiled
def residual(record: Any, setup: Any, ground: Any) -> Any:
    """Return the whitened residual (3,): east, north, up; accepts complex unknowns."""
    x, y, z = ground[0] + record[RECORD.x], ground[1] + record[RECORD.y], ground[2] + record[RECORD.z]
    # angles from the observed place: small, so that no digit is lost and no angle jumps by a full turn
    sl, cl = np.sin(record[RECORD.lon]), np.cos(record[RECORD.lon])
    sb, cb = np.sin(record[RECORD.lat]), np.cos(record[RECORD.lat])
    east, out = -sl * x + cl * y, cl * x + sl * y
    flat = np.sqrt(east * east + out * out)
    up, north = cb * flat + sb * z, cb * z - sb * flat
    radius = np.sqrt(flat * flat + z * z)
    return np.array([
        record[RECORD.radius] * cb * _angle(east, out) / record[RECORD.s1],
        record[RECORD.radius] * _angle(north, up) / record[RECORD.s2],
        (radius - record[RECORD.radius]) / record[RECORD.s3],
    ])  # fmt: skip


@compiled
def _angle(y: Any, x: Any) -> Any:
    """Return the angle, rad, of a direction within a quarter turn of the x axis."""
    return np.arctan(y / x)


def jacobian(record: Array, setup: Array, value: Array, ground: Array) -> Array:
    """Return the Jacobian (3, 3) of an observed point."""
    x, y, z = ground + record[RECORD.origin]
    flat2 = x * x + y * y
    flat, radius2 = np.sqrt(flat2), x * x + y * y + z * z
    scale = record[RECORD.radius] / record[RECORD.sigma]
    return np.array([
        scale[0] * np.cos(record[RECORD.lat]) * np.array([-y, x, 0.0]) / flat2,
        scale[1] * np.array([-x * z / flat, -y * z / flat, flat]) / radius2,
        np.array([x, y, z]) / np.sqrt(radius2) / record[RECORD.s3],
    ])  # fmt: skip


LATITUDINAL_POINT = register_condition(
    "latitudinal_point", residual, jacobian, (Argument("ground", "m", is_point=True),),
    "Edmundson et al. 2012 (ISIS jigsaw), ISPRS Annals I-4, 203-208",
)  # fmt: skip
