"""Named parameters of an image: EOP coefficients and look-angle polynomial.

Codes are defined in ``factors.cameras.pushbroom``: ``3 component + degree`` for the 27 EOP coefficients, ``27 + 2 k``
and ``28 + 2 k`` for the coefficients of ``s^k`` in psi_x and psi_y. Unknowns are in prior sigmas; coefficients are for
tau in [-1, 1].
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.model.arrays import wrong
from fg_orient.model.block import Block, Image, Options
from fg_orient.model.declaration import require_declared
from fg_orient.model.errors import InputError
from fg_orient.model.names import ATTITUDE, COMPONENTS, EOP_SETS, POSITION, VELOCITY
from fg_orient.model.options import Datum

UNITS = ("m", "m", "m", "m/s", "m/s", "m/s", "rad", "rad", "rad")
N_EOP = 27
#: Number of coefficients of a look polynomial of the highest degree, 5.
N_LOOK = 12
#: Codes of curves: CURVE + CURVES component + number (``factors.cameras.pushbroom``).
CURVE, CURVES = 64, 32
#: Names of the degrees in tau.
DEGREES = ("constant", "linear in time", "quadratic in time")

#: For each kind of term: its short name, and the description of its degree.
_TERMS: Final = (
    (re.compile(rf"(?P<component>{'|'.join(COMPONENTS)})_(?P<degree>[012])"), "degree {} in time"),
    (re.compile(rf"(?P<component>{'|'.join(COMPONENTS)})_c[0-9]+(?P<degree>)"), "the curves"),
    (re.compile(r"(?P<component>psi_[xy])_s(?P<degree>[0-5])"), "degree {} of the look angles"),
    (re.compile(r"(?P<component>line|sample)_(?P<degree>0)"), "degree {} of the RPC compensation"),
    (re.compile(r"(?P<component>line|sample)_l(?P<degree>1)"), "degree {} in line of the RPC compensation"),
    (re.compile(r"(?P<component>line|sample)_s(?P<degree>1)"), "degree {} in sample of the RPC compensation"),
    (re.compile(r"(?P<component>rotation|centre|principal)_(x|y|z|sample|line)(?P<degree>)"), ""),
)


def eop_set_number(name: int | str) -> int:
    """Return the number of an EOP set given by number or name; raises InputError if the set is unknown."""
    text = str(name).strip().upper()
    for number, one in EOP_SETS.items():
        if text in (str(number), one.name):
            return number
    names = ", ".join(f"{number} {one.name}" for number, one in EOP_SETS.items())
    raise InputError.of("parameters.eop_set", option="eop_set", value=name, names=names)


def with_options(block: Block, caller: str, **given: Any) -> Block:
    """Return the block with replaced options; an option that is None keeps its value.

    Raises
    ------
    InputError
        A value is not allowed.
    TypeError
        A name is not an option; the message names the ``caller``.
    """
    if not isinstance(block, Block):
        raise wrong("block", repr(block), "a Block, for instance that of read_project")
    require_declared(given, caller, Options)
    values: dict[str, Any] = {
        name: tuple(v) if isinstance(v, Sequence) and not isinstance(v, str) else v
        for name, v in given.items()
        if v is not None
    }
    if "eop_set" in values:
        values["eop_set"] = eop_set_number(values["eop_set"])
    return replace(block, options=replace(block.options, **values))


def chosen_datum(options: Options, images: Sequence[Image], *, control: bool) -> Datum:
    """Return the datum of a block.

    "auto" becomes "vendor" if only metadata determine the position, otherwise "control".
    ``control``: True if the block has control points, or observations that may replace them. "inner" also becomes
    "vendor" if the metadata orient all images, because such a block has no exact datum defect.
    """
    by_metadata = options.priors and not control and all(image.sensor.orients for image in images)
    if options.datum == "auto":
        return "vendor" if by_metadata else "control"
    return "vendor" if options.datum == "inner" and by_metadata else options.datum


def eop_codes(number: int) -> tuple[int, ...]:
    """Return the codes of the coefficients in a set, ordered by component, then degree."""
    return tuple(3 * c + k for c in EOP_SETS[number].components for k in EOP_SETS[number].degrees)


@dataclass(frozen=True)
class Term:
    """Parsed short name of a coefficient or coordinate.

    Parameters
    ----------
    component : str
        Such as "roll", "psi_x", "line", "centre".
    degree : int or None
        None for a coordinate or a curve.
    kind : str
        Description of the degree: "degree 1 in time". Degrees in different variables are of different kinds; "" without
        a degree.
    """

    component: str
    degree: int | None
    kind: str


def term_of(name: str) -> Term | None:
    """Return component, degree and kind of an unknown by its short name; None for a name without them (``k1``)."""
    for pattern, kind in _TERMS:
        found = pattern.fullmatch(name)
        if found:
            digit = found["degree"]
            return Term(found["component"], int(digit) if digit else None, kind.format(digit))
    return None


@dataclass(frozen=True, eq=False)
class ImageParameters:
    """Unknowns of one image in the order of its vector, for any sensor.

    Parameters
    ----------
    codes : tuple of int
        Codes of the image's observation equation: ``factors.cameras.pushbroom``, ``factors.cameras.rfm_equation``.
    sigma : (k,) array
        Prior sigmas in ``units``; the vector itself is in units of these prior sigmas.
    names : tuple of str
        Short names of component and degree: ``x_0``, ``roll_2``, ``psi_y_s1``, ``line_0``.
    units : tuple of str
        Physical unit of each unknown.
    words : tuple of str
        Description of each unknown: "position X (constant, m)".
    shared : tuple of str
        Id under which images share each unknown, "" if only this image has it; () if the image shares none.
    """

    codes: tuple[int, ...]
    sigma: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    words: tuple[str, ...]
    shared: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.codes)

    @cached_property
    def own(self) -> Mask:
        """True for unknowns (k,) that no other image shares."""
        return np.array([not name for name in self.shared or ("",) * len(self)], dtype=bool)

    def take(self, which: Mask) -> ImageParameters:
        """Return the selected unknowns (k,)."""
        at = np.flatnonzero(which).tolist()

        def of(values: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(values[j] for j in at) if values else ()

        return ImageParameters(
            of(self.codes), self.sigma[at], of(self.names), of(self.units), of(self.words), of(self.shared)
        )

    @cached_property
    def setup(self) -> Array:
        """Setup array of the equation (2, k): codes and prior sigmas."""
        return np.ascontiguousarray(np.stack([np.array(self.codes, float), self.sigma]))


def chosen_codes(options: Options) -> tuple[int, ...]:
    """Return the codes of a pushbroom image's unknowns: the named ones, otherwise from EOP set and look polynomial."""
    if options.image_unknowns:
        every = (*range(N_EOP + N_LOOK), *curve_codes(options, POSITION + ATTITUDE))
        known = {parameter_name(code): code for code in every}
        return tuple(sorted(known[name] for name in options.image_unknowns if name in known))
    degree = options.look_polynomial
    eop = eop_codes(options.eop_set)
    look = tuple(range(N_EOP, N_EOP + (0 if degree is None else 2 * (degree + 1))))
    return eop + look + curve_codes(options, sorted({code // 3 for code in eop} - set(VELOCITY)))


def curve_codes(options: Options, components: Iterable[int]) -> tuple[int, ...]:
    """Return the codes of the curves of these components, ordered by component, then number."""
    return tuple(CURVE + CURVES * c + k for c in components for k in range(options.curve_intervals))


def require_unknowns(options: Options, codes: tuple[int, ...], file: str, known: Iterable[str]) -> None:
    """Refuse an image if ``image_unknowns`` contains none of its unknowns."""
    if not codes:
        raise InputError.of(
            "parameters.unknowns",
            file=file,
            place="image_unknowns",
            value=", ".join(options.image_unknowns),
            known=", ".join(known),
        )


def orientation_parameters(options: Options, file: str = "", camera: str = "") -> ImageParameters:
    """Return the unknowns of a pushbroom image: EOP coefficients, then look polynomial, then curves.

    ``camera``: images of the same camera share the look polynomial, if option ``look_shared`` is set. InputError if
    ``image_unknowns`` contains none of the unknowns.
    """
    codes = chosen_codes(options)
    require_unknowns(options, codes, file, (parameter_name(code) for code in range(N_EOP + N_LOOK)))
    table = np.repeat([options.position_sigma_m, options.velocity_sigma_m_s, options.attitude_sigma_rad], 3, axis=0)
    plain = np.concatenate([table.ravel(), np.full(N_LOOK, options.look_sigma_rad)])
    curve = np.repeat([options.curve_position_sigma_m, np.nan, options.curve_attitude_sigma_rad], 3)
    sigma = np.array([plain[c] if c < CURVE else curve[(c - CURVE) // CURVES] for c in codes])
    units = tuple("rad" if N_EOP <= code < CURVE else UNITS[_component(code)] for code in codes)
    shared = tuple(f"look angles of {camera}" if N_EOP <= c < CURVE else "" for c in codes)
    return ImageParameters(
        codes,
        sigma,
        tuple(map(parameter_name, codes)),
        units,
        tuple(map(parameter_words, codes)),
        shared if options.look_shared and any(shared) else (),
    )


def _component(code: int) -> int:
    """Return the position of the EOP of a coefficient or curve in ``COMPONENTS``."""
    return code // 3 if code < N_EOP else (code - CURVE) // CURVES


def parameter_name(code: int) -> str:
    """Return the short name of one coefficient, such as ``roll_1``, or of a curve, such as ``roll_c4``."""
    if code >= CURVE:
        return f"{COMPONENTS[_component(code)]}_c{(code - CURVE) % CURVES}"
    if code < N_EOP:
        return f"{COMPONENTS[code // 3]}_{code % 3}"
    return f"psi_{'xy'[(code - N_EOP) % 2]}_s{(code - N_EOP) // 2}"


def parameter_words(code: int) -> str:
    """Return the description of a coefficient: "velocity Y (constant, m/s)", "look angle psi_x_s1"."""
    if N_EOP <= code < CURVE:
        return f"look angle {parameter_name(code)}"
    component = _component(code)
    if component in POSITION:
        name = f"position {'XYZ'[component]}"
    elif component in VELOCITY:
        name = f"velocity {'XYZ'[component - 3]}"
    else:
        name = ("roll", "pitch", "yaw")[component - ATTITUDE[0]]
    shape = DEGREES[code % 3] if code < N_EOP else f"curve {(code - CURVE) % CURVES}"
    return f"{name} ({shape}, {UNITS[component]})"
