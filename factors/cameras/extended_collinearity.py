"""``frame_extended`` with five vectors of unknowns, for self-calibrating bundles of close range.

    e = (c X/Z - x' - dx,  s c Y/Z - y' - dy) Z^p,    (X, Y, Z) = R (P - O),    x' = x - x0,  y' = y - y0

(Ayhan 1996, eqs. 76-77; misprinted derivatives are corrected.) Unknowns: an image's own camera parameters, parameters
shared with other images (photo-variant and block-invariant calibration), the rotation vector w of R = exp([w]x) R_0 in
rad, the projection centre O and the point P, m. x is the sample, y the line; the polynomial leads from measured to
ideal coordinates. With p = 1 the value is F of the thesis with the other sign.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, register
from factors.cameras import additional_parameters as brown
from factors.cameras import frame_extended
from factors.cameras import image_corrections as lens
from factors.cameras import image_variants as variants
from factors.cameras.frame_corrections import FURTHER
from factors.cameras.frame_extended import FRAME_EXTENDED, RECORD, UNKNOWN
from factors.records import Record

#: Camera parameters by code: principal distance, principal point, coefficients of the three modules.
CAMERA: Final = Record(c=1, principal="x0 y0", lens=lens.AT.size, brown=brown.AT.size, variants=variants.AT.size)
NAMES: Final = ("c", "x0", "y0", *lens.NAMES, *brown.NAMES, *variants.NAMES)
#: Their names in ``frame_extended``, where they differ.
_OTHERWISE: Final = {"c": "focal", "x0": "sample", "y0": "line", "p1": "p2", "p2": "p1"}
#: Their codes in ``frame_extended``.
CODES: Final = np.array([getattr(UNKNOWN, _OTHERWISE.get(name, name)) for name in NAMES], np.intp)


def image_record(camera: Array, **constants: Any) -> Array:
    """Record of ``frame_extended`` of camera parameters (40,), and of its constants without those of the camera."""
    known = np.zeros(UNKNOWN.size)
    known[CODES] = camera
    parts = ("focal", "principal", "distortion", "aspect", *FURTHER.fields)
    return RECORD.pack(
        **{name: known[getattr(UNKNOWN, name)] for name in parts}, **constants, centre=np.zeros(3), unit=1.0,
        is_fisheye=0.0,
    )  # fmt: skip


def image_setup(camera: Array, steps: Array) -> Array:
    """Setup (2, k + 6) of k own and shared parameters, own ones first, by their codes ``camera`` and steps."""
    place = np.arange(UNKNOWN.w1, UNKNOWN.z + 1)
    codes = np.concatenate([CODES[np.asarray(camera, np.intp)], place]).astype(float)
    return np.ascontiguousarray(np.stack([codes, np.concatenate([steps, np.ones(len(place))])]))


def residual(record: Any, setup: Any, own: Any, shared: Any, w: Any, centre: Any, point: Any) -> Any:
    """Whitened residual (2,), x and y; accepts complex unknowns."""
    return frame_extended.residual(record, setup, np.concatenate([own, shared, w, centre]), point)[::-1]


def kernel(
    record: Array, setup: Array, own: Array, shared: Array, w: Array, centre: Array, point: Array, want: bool
) -> tuple[Array, ...]:
    """Residual (2,), x and y; Jacobians (2, k) of own and shared parameters, rotation, centre and point."""
    sizes = np.cumsum([len(own), len(shared), len(w), len(centre)])
    value, image, ground = FRAME_EXTENDED.kernel(record, setup, np.concatenate([own, shared, w, centre]), point, want)
    if not want:
        return value[::-1].copy(), *(np.empty((0, 0)) for _ in range(5))
    blocks = (*np.split(image, sizes[:-1], axis=1), ground)
    return value[::-1].copy(), *(np.ascontiguousarray(block[::-1]) for block in blocks)


EXTENDED_COLLINEARITY = register(Equation(
    "extended_collinearity_measured_to_ideal", kernel, residual,
    (Argument("own camera", "steps"), Argument("shared camera", "steps"), Argument("rotation", "rad"),
     Argument("centre", "m", is_point=True), Argument("point", "m", is_point=True)),
    FRAME_EXTENDED.source,
))  # fmt: skip
