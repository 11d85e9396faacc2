"""Corrections of image coordinates: sets of camera parameters by name, and the correction along the radius."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.cameras import additional_parameters as brown
from factors.cameras import image_corrections as lens
from factors.cameras import image_variants as variants
from factors.records import Record
from fg_orient.closerange.photo import PhotoInterior
from fg_orient.model.errors import InputError

#: Camera parameters: principal distance, principal point, coefficients of the three modules.
CAMERA: Final = Record(c=1, principal="x0 y0", lens=lens.AT.size, brown=brown.AT.size, variants=variants.AT.size)
NAMES: Final = ("c", "x0", "y0", *lens.NAMES, *brown.NAMES, *variants.NAMES)
#: Number of radii and directions at which corrections are computed.
RADII: Final = 33
DIRECTIONS: Final = 24
#: First correction in a camera vector, after principal distance and principal point.
_FIRST: Final = 3
#: Rounding across the radius of corrections along it, as a share of the radius.
_ROUNDING: Final = 1e-13
#: Camera parameters of a form, by its name. dr is radial, along r; equation numbers are those of Ayhan 1996.
SETS: Final[dict[str, tuple[str, ...]]] = {
    "radial": ("k1", "k2", "k3"),  # dr = k1 r^3 + k2 r^5 + k3 r^7, eq. 71
    "radial-even": ("radial_2", "radial_4", "radial_6"),  # dr of even powers, eq. 44 as printed
    "radial-odd": ("radial_1", "k1", "k2"),  # dr of odd powers from r on, eq. 45
    "radial-full": ("radial_1", "radial_2", "k1", "radial_4", "k2", "radial_6"),  # all powers, eq. 45
    "radial-orthogonal": ("orthogonal_1", "orthogonal_2", "orthogonal_3"),  # eq. 46
    "decentring": ("p1", "p2"),  # eqs. 48, 72
    "film-affine": ("x0", "y0", "film_xx", "affinity_a", "film_yx", "affinity_b"),  # six parameters, eqs. 49, 50
    "film-turned": ("film_xx", "affinity_a", "affinity_b"),  # no fiducial marks: the turn is kappa's, eq. 51
    "film": ("affinity_a", "affinity_b"),  # one scale is the principal distance's, eqs. 53, 54
    "film-scales": ("film_xx", "affinity_b"),  # two scales, eq. 55
    "brown": brown.NAMES[:15],  # without those equivalent to k1 to k3 and the interior orientation, eq. 2
    "brown-21": brown.NAMES,
}


def camera_of(interior: PhotoInterior) -> Array:
    """Camera parameters (41,) of an interior orientation."""
    out = np.zeros(CAMERA.size)
    out[CAMERA.c], out[CAMERA.principal], out[CAMERA.lens] = interior.focal, interior.principal, interior.corrections
    return out


def parameters_of(words: Sequence[str], place: str) -> tuple[str, ...]:
    """Camera parameters for words that name a parameter or a set, each once; InputError for other words."""
    out: list[str] = []
    for word in words:
        if word not in SETS and word not in NAMES:
            known = ", ".join((*NAMES[:10], *SETS, "a1 to a21", *NAMES[31:]))
            raise InputError.of("closerange.parameter", place=place, value=word, known=known)
        out += SETS.get(word, (word,))
    return tuple(dict.fromkeys(out))


def profile(camera: Array, rim: float, names: Sequence[str], covariance: Array) -> dict[str, Array]:
    """Corrections of a camera over the radius, as arrays (33,), in image units.

    ``radius``; ``radial``: radial part of the correction, mean over all directions; ``sigma``: its standard deviation;
    ``across``: largest part at right angles to the radius.

    Parameters
    ----------
    camera : (41,) array
        Parameters in the order of :data:`NAMES`.
    rim : float
        Radius of the outermost image point, image units.
    names, covariance
        Determined parameters, and their covariance (k, k).
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
    return {"radius": radius, "radial": radial, "across": across, "sigma": np.sqrt(np.maximum(variance, 0.0))}


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
