"""Forms of radial distortion, film deformation and Brown's polynomial by name: sets of camera parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from factors.cameras import additional_parameters as brown
from factors.cameras.extended_collinearity import NAMES
from fg_orient.model.errors import InputError

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
    "brown": brown.NAMES[:15],  # without what repeats k1 to k3 and the interior orientation, eq. 2
    "brown-21": brown.NAMES,
}


def parameters_of(words: Sequence[str], place: str) -> tuple[str, ...]:
    """Camera parameters of names and of names of sets, each once, in the order given.

    Raises
    ------
    InputError
        A word is neither.
    """
    out: list[str] = []
    for word in words:
        if word not in SETS and word not in NAMES:
            known = ", ".join((*NAMES[:10], *SETS, "a1 to a21", *NAMES[31:]))
            raise InputError.of("closerange.parameter", place=place, value=word, known=known)
        out += SETS.get(word, (word,))
    return tuple(dict.fromkeys(out))
