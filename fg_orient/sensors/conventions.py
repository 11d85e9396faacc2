"""Conventions of other programs for interior orientation and distortion, and conversion of their values.

A :class:`Convention` declares how the values of a program give the parameters of
``factors.cameras.frame_extended``::

    ours = sign theirs unit + origin     focal length and principal point (px)
    ours = sign theirs + offset          coefficients in the unit of the convention; with "/f" theirs is first divided
                                         by the focal length in px
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL
from fg_orient.sensors.frame_unknowns import FURTHER, UNKNOWNS
from fg_orient.sensors.interior import Interior

#: Names of the parameters of a camera.
OURS: Final = (*UNKNOWNS[6:], *FURTHER)
_AT: Final = {name: k for k, name in enumerate(OURS)}
#: Names of parameters in pixels: focal length, sample and line of the principal point.
LENGTHS: Final = ("focal", "principal_sample", "principal_line")
#: For each coefficient of the corrections D: its power of the unit of length.
POWER: Final = {
    "k1": 2, "k2": 4, "k3": 6, "p1": 1, "p2": 1, "radial_9": 8, "affinity_a": 0, "affinity_b": 0, "film_xx": 0,
    "film_yx": 0,
}  # fmt: skip
_TERM: Final = re.compile(r"(\w+)(?:=(-?)(\w+?)(/f)?([+-]1)?)?")


class Image(NamedTuple):
    """Image of a camera: size (px), pixels per mm, balancing radius (mm).

    Unknown or unused values are 0.
    """

    n_lines: int = 0
    n_samples: int = 0
    mm_px: float = 0.0
    r0_mm: float = 0.0


@dataclass(frozen=True)
class Convention:
    """Convention of a program for the interior orientation.

    Parameters
    ----------
    title : str
    terms : str
        Terms in the order of the program, such as ``ours``, ``ours=theirs`` or
        ``ours=-theirs/f+1``; see the module.
    evidence : str
        How the signs were checked: with independent code, with published results, or only
        by the source of the formula.
    direction : str
        Direction of the polynomial.
    in_mm : bool
        True: lengths are in mm, and coefficients are in powers of mm. False: lengths are in px.
    from_middle : bool
        True if the principal point is relative to the middle of the image.
    first_pixel : float
        Coordinate of the first pixel's centre, px.
    is_fisheye, is_balanced : bool
        True for a fisheye lens; true if the radial terms are zero at the radius R0.
    absent : str
        Names of parameters of the program that have no counterpart here; they must be 0.
    """

    title: str
    terms: str
    evidence: str
    direction: str = IDEAL_TO_MEASURED
    in_mm: bool = False
    from_middle: bool = False
    first_pixel: float = 0.0
    is_fisheye: bool = False
    is_balanced: bool = False
    absent: str = ""

    @cached_property
    def parsed(self) -> tuple[tuple[int, float, bool, float], ...]:
        """Return, for each term, its place in :data:`OURS`, its sign, whether it is divided by f, and its offset."""
        rows = [_TERM.fullmatch(term) for term in self.terms.split()]
        return tuple((_AT[m[1]], -1.0 if m[2] else 1.0, bool(m[4]), float(m[5] or 0.0)) for m in rows if m)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of the values in the order of the program."""
        rows = [_TERM.fullmatch(term) for term in self.terms.split()]
        return (*(m[3] or m[1] for m in rows if m), *self.absent.split())

    @cached_property
    def ours(self) -> tuple[str, ...]:
        """Return the parameters of :data:`OURS` that the convention has."""
        return tuple(OURS[at] for at, *_ in self.parsed)

    def is_of(self, interior: Interior) -> bool:
        """Return whether the convention and a camera have the same direction and projection."""
        return (interior.model, interior.is_fisheye) == (self.direction, self.is_fisheye)

    def has(self, used: Mask) -> bool:
        """Return whether the convention has all parameters that a mask (len(OURS),) marks as used."""
        return {OURS[k] for k in np.flatnonzero(used)} <= set(self.ours)

    def unit_px(self, image: Image) -> float:
        """Return the unit of lengths, px."""
        return image.mm_px if self.in_mm else 1.0

    def _lengths(self, image: Image) -> tuple[float, dict[int, float]]:
        """Return the unit of lengths (px), and the origin (px) of each place in :data:`OURS`."""
        middle = [0.5 * (n - 1) if self.from_middle else -self.first_pixel for n in (image.n_samples, image.n_lines)]
        return self.unit_px(image), dict(enumerate((0.0, *middle)))

    def camera(self, values: Any, image: Image) -> Any:
        """Convert values (k, ...) in the order of ``names`` to parameters (len(OURS), ...).

        Complex values are allowed.
        """
        unit, origin = self._lengths(image)
        out = np.zeros((len(OURS), *np.shape(values)[1:]), np.result_type(values, float))
        for (at, sign, _, _), value in zip(self.parsed, values, strict=False):
            if at in origin:
                out[at] = sign * value * unit + origin[at]
        focal = np.where(out[0] == 0.0, 1.0, out[0])  # a focal length of 0 is refused later, when the camera is made
        for (at, sign, per_focal, offset), value in zip(self.parsed, values, strict=False):
            if at not in origin:
                out[at] = sign * (value / focal if per_focal else value) + offset
        return self._balanced(out, image, -1.0)

    def values(self, ours: Any, image: Image) -> Any:
        """Convert parameters to values.

        This is the inverse of :meth:`camera` for the parameters of the convention.
        """
        unit, origin = self._lengths(image)
        ours = self._balanced(ours, image, 1.0)
        return np.array([
            sign * (ours[at] - origin[at]) / unit if at in origin
            else sign * (ours[at] - offset) * (ours[0] if per_focal else 1.0)
            for at, sign, per_focal, offset in self.parsed
        ])  # fmt: skip

    def _balanced(self, ours: Any, image: Image, sign: float) -> Any:
        """Move the linear part of balanced radial terms into the scale of D and the focal length; or the inverse."""
        if not self.is_balanced:
            return ours
        scale = 1.0 / (1.0 + sign * sum(ours[_AT[f"k{i}"]] * image.r0_mm ** (2 * i) for i in (1, 2, 3)))
        return np.array([v * scale if name in POWER or name == "focal" else v
                         for name, v in zip(OURS, ours, strict=True)])  # fmt: skip

    def interior(self, values: npt.ArrayLike, image: Image, name: str = "") -> Interior:
        """Make a camera from values (k,) in the order of ``names``.

        Raise InputError for impossible values.
        """
        ours = np.asarray(self.camera(np.asarray(values, float), image))
        empty = Interior(
            image.n_lines, image.n_samples, 1.0, np.zeros(2), np.zeros(5), self.direction,
            self.unit_px(image) if self.direction == MEASURED_TO_IDEAL else None, 0.0, name, {}, self.is_fisheye,
        )  # fmt: skip
        return with_parameters(empty, ours)


_BROWN_MM: Final = "k1 k2 k3 p2=p1 p1=-p2"
_LENS: Final = "principal_sample=cx principal_line=cy"
_TWO: Final = f"aspect=fx/f-1 focal=fy {_LENS}"
_ONE: Final = f"focal=f {_LENS}"
_FISHEYE: Final = "fisheye_1=k1 fisheye_2=k2 fisheye_3=k3 fisheye_4=k4"
_PYCOLMAP: Final = "image points of pycolmap"
_OPENCV: Final = "image points of pycolmap, whose models have the same formulas"


def _colmap(terms: str, *, is_fisheye: bool = False, absent: str = "") -> Convention:
    title = "COLMAP"
    return Convention(title, terms, _PYCOLMAP, first_pixel=0.5, is_fisheye=is_fisheye, absent=absent)


CONVENTIONS: Final = {
    "opencv": Convention("OpenCV", f"{_TWO} k1 k2 p1 p2 k3", _OPENCV),
    "opencv-fisheye": Convention("OpenCV, fisheye", f"{_TWO} {_FISHEYE}", _OPENCV, is_fisheye=True),
    "colmap-simple-pinhole": _colmap(_ONE),
    "colmap-pinhole": _colmap(_TWO),
    "colmap-simple-radial": _colmap(f"{_ONE} k1"),
    "colmap-radial": _colmap(f"{_ONE} k1 k2"),
    "colmap-opencv": _colmap(f"{_TWO} k1 k2 p1 p2"),
    "colmap-opencv-fisheye": _colmap(f"{_TWO} {_FISHEYE}", is_fisheye=True),
    "colmap-full-opencv": _colmap(f"{_TWO} k1 k2 p1 p2 k3", absent="k4 k5 k6"),
    "photomodeler": Convention(
        "PhotoModeler", f"focal=f principal_sample=xp principal_line=yp {_BROWN_MM}",
        "DBAT's published results of PhotoModeler exports", MEASURED_TO_IDEAL, in_mm=True,
    ),
    "dbat": Convention(
        "DBAT", f"focal=cc principal_sample=px principal_line=py aspect=-aspect+1 {_BROWN_MM}",
        "DBAT's published results", MEASURED_TO_IDEAL, in_mm=True, absent="skew",
    ),
    "metashape": Convention(
        "Metashape, frame", f"{_ONE} aspect=b1/f shear=b2/f k1 k2 k3 radial_9=k4 p2=p1 p1=p2",
        "formula below; not checked with the program", from_middle=True,
    ),
    "pix4d": Convention(
        "Pix4D, perspective lens", f"{_ONE} k1=r1 k2=r2 k3=r3", "formula below; not checked with the program",
        first_pixel=0.5, absent="t1 t2",
    ),
    "australis": Convention(
        "Australis, iWitness",
        f"focal=c principal_sample=xp principal_line=-yp {_BROWN_MM} film_xx=b1 affinity_a=-b2",
        "formula below (Fraser 1997); not checked with the program", MEASURED_TO_IDEAL, in_mm=True, from_middle=True,
    ),
    "balanced": Convention(
        "radial terms balanced at R0",
        "focal=c principal_sample=x0 principal_line=-y0 k1=-a1 k2=-a2 k3=-a3 p2=-b1 p1=b2 film_xx=-c1 affinity_a=c2",
        "formula below; not checked with a program", MEASURED_TO_IDEAL, in_mm=True, from_middle=True, is_balanced=True,
    ),
}  # fmt: skip
#: Conventions that are not supported, with the reason.
REFUSED: Final = {"micmac": "the direction of its polynomials (KnownConv) is not certain"}


def interior_parameters(interior: Interior) -> Array:
    """Return the parameters (len(OURS),) of a camera in its own unit."""
    return np.array([interior.focal_px, *interior.principal_px[::-1], *interior.distortion, interior.aspect,
                     *(interior.further.get(name, 0.0) for name in FURTHER)])  # fmt: skip


def with_parameters(interior: Interior, ours: Array) -> Interior:
    """Return the camera with other parameters (len(OURS),) in its own unit."""
    further = dict(zip(FURTHER, ours[-len(FURTHER) :].tolist(), strict=True))
    return replace(
        interior, focal_px=float(ours[0]), principal_px=ours[2:0:-1], distortion=ours[3:8], aspect=float(ours[8]),
        further={name: value for name, value in further.items() if value != 0.0},
        unit_px=interior.unit_px if interior.model == MEASURED_TO_IDEAL else None,
    )  # fmt: skip


def named(name: str) -> Convention:
    """Return the convention with this name; raise InputError if it is unknown."""
    if name not in CONVENTIONS:
        raise InputError.of(
            "conventions.name (failure): no conversion of cameras in this convention: {reason} -> choose one of "
            "{known}", value=name, reason=REFUSED.get(name, "not known"), known=", ".join(CONVENTIONS),
        )  # fmt: skip
    return CONVENTIONS[name]


def given_values(values: Mapping[str, float], one: Convention, image: Image) -> tuple[Array, Array]:
    """Arrange given values in the order of the convention: (k,).

    Also return their derivatives (k, n) with respect to the n given values. InputError: a
    name is unknown or missing, or a value is impossible.
    """
    rows = list(zip(one.names, one.parsed, strict=False))
    known = ", ".join(name for name, _ in rows) + (f"; {one.absent} only 0" if one.absent else "")
    for name, value in values.items():
        absent = name in one.absent.split()
        if name not in one.names or not np.isfinite(value) or (absent and value != 0.0):
            raise InputError.of(
                "conventions.value (failure): cameras of {title} cannot have this value -> give finite numbers: "
                "{known}", place=name, value=value, title=one.title, known=known,
            )  # fmt: skip
    # a camera needs its lengths and a second focal length if the convention has one; missing coefficients are 0
    missing = [name for name, (at, _, per_focal, offset) in rows
               if name not in values and (OURS[at] in LENGTHS or (per_focal and offset != 0.0))]  # fmt: skip
    if missing:
        raise InputError.of("conventions.missing (failure): cameras of {title} have more values -> give {missing}",
                            title=one.title, missing=missing)  # fmt: skip
    given = np.array([values.get(name, -sign * offset) for name, (_, sign, _, offset) in rows])
    by = np.array([[float(name == other) for other in values] for name, _ in rows])
    return given, by.reshape(len(rows), len(values))


def require_image(image: Image, *conventions: Convention, is_fit: bool = False) -> None:
    """Refuse an image that lacks a quantity which the conventions or the fit need."""
    for option, needed, found in (
        ("pixel_mm", any(c.in_mm for c in conventions), image.mm_px),
        ("image_size", is_fit or any(c.from_middle for c in conventions), min(image[:2])),
        ("r0_mm", any(c.is_balanced for c in conventions), image.r0_mm),
    ):
        if needed and not (np.isfinite(found) and found > 0.0):
            raise InputError.of("conventions.image (failure): this conversion needs a number above zero -> give it",
                                option=option, value=found)  # fmt: skip
