"""Corrections of a camera along the radius, with the band of their standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.cameras import additional_parameters as brown
from factors.cameras import image_corrections as lens
from factors.cameras import image_variants as variants
from factors.cameras.extended_collinearity import CAMERA, NAMES

Array = npt.NDArray[np.float64]

#: Radii and directions at which corrections are taken.
RADII: Final = 33
DIRECTIONS: Final = 24
#: Of a camera vector: principal distance and point stand before the corrections.
_FIRST: Final = 3
#: What remains of corrections along the radius across it, as a share of the radius.
_ROUNDING: Final = 1e-13


def profile(camera: Array, rim: float, names: Sequence[str], covariance: Array) -> dict[str, Any]:
    """Radial correction over the radius, its standard deviation, and the largest correction across the radius.

    Parameters
    ----------
    camera : (40,) array
        Parameters in the order of ``factors.cameras.extended_collinearity.NAMES``.
    rim : float
        Radius of the outermost image point, image units.
    names : sequence of str
        Of the parameters that were determined.
    covariance : (k, k) array
        Of these.

    Returns
    -------
    dict
        ``radius``, ``radial``, ``sigma`` and ``across``, image units: radial part of the correction, mean over all
        directions; its standard deviation; largest part at right angles to the radius. Lists of the same length.
    """
    radius = np.linspace(0.0, rim, RADII)
    turn = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    whole = _corrections(camera, radius, along, rim)
    radial = np.einsum("rdk,dk->rd", whole, along).mean(axis=1)
    across = np.abs(whole[..., 0] * -along[:, 1] + whole[..., 1] * along[:, 0]).max(axis=1)
    across[across < _ROUNDING * rim] = 0.0
    slopes = np.zeros((RADII, len(names)))
    for j, name in enumerate(names):
        if NAMES.index(name) >= _FIRST:  # corrections are linear in their parameters
            unit = np.zeros(CAMERA.size)
            unit[CAMERA.c], unit[NAMES.index(name)] = camera[CAMERA.c], 1.0
            slopes[:, j] = np.einsum("rdk,dk->rd", _corrections(unit, radius, along, rim), along).mean(axis=1)
    variance = np.einsum("ri,ij,rj->r", slopes, covariance, slopes)
    return {"radius": radius.tolist(), "radial": radial.tolist(), "across": across.tolist(),
            "sigma": np.sqrt(np.maximum(variance, 0.0)).tolist()}  # fmt: skip


def _corrections(camera: Array, radius: Array, along: Array, rim: float) -> Array:
    """Corrections x, y (r, d, 2) at radii (r,) in directions (d, 2)."""
    at = radius[:, None, None] * along
    flat = np.ascontiguousarray(at.reshape(-1, 2))
    out = lens.ideal_points(np.ascontiguousarray(camera[CAMERA.lens]), flat) - flat
    for k, (x, y) in enumerate(flat.tolist()):
        browns, others = brown.terms(x, y, camera[CAMERA.c]), variants.terms(x, y, rim)
        for terms, part in ((browns, camera[CAMERA.brown]), (others, camera[CAMERA.variants])):
            if part.any():
                out[k] += terms @ part
    return np.asarray(out.reshape(at.shape))
