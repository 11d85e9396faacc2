"""Common parts of all RPC readers and writers. Each value has the name that ``_RPC.TXT`` uses for it.

A reader collects texts with their places in the file. :func:`build` converts them to
numbers. It changes the pixel origin such that (0, 0) is the centre of the first pixel,
and changes the coefficients to RPC00B order. A writer arranges the texts of
:func:`texts_of`.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.cameras.rfm import EXPONENTS, N_TERMS, permutation
from factors.cameras.rfm_project import RANGE
from fg_orient.formats.load import load_bytes
from fg_orient.model.digits import NUMBER
from fg_orient.model.errors import InputError
from fg_orient.model.names import FIRST_PIXELS
from fg_orient.sensors.rpc import RpcModel

#: Axes in the order of ``RpcModel``: line, sample, longitude, latitude, height.
AXES: Final = ("LINE", "SAMP", "LONG", "LAT", "HEIGHT")
#: Polynomials in the order of ``RpcModel.coefficients``.
POLYNOMIALS: Final = ("LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN")
#: Names of the estimated errors, m.
ERRORS: Final = ("ERR_BIAS", "ERR_RAND")
#: In RPC00B, the centre of the first pixel has this coordinate.
FIRST_PIXEL: Final = 0.0
#: Order of the coefficients if the file does not name an order.
USUAL_ORDER: Final = "RPC00B"
#: Pattern of the names in ``_RPC.TXT``, and of the names for all coefficients of a polynomial.
NAMES: Final = re.compile(
    rf"(?:{'|'.join(AXES)})_(?:OFF|SCALE)|{'|'.join(ERRORS)}|(?:{'|'.join(POLYNOMIALS)})_COEFF(?:_[^_]*)?"
)


@dataclass(frozen=True)
class Reading:
    """Conventions of a file: the order of its coefficients, and the coordinate of its first pixel's centre.

    If ``first_pixel`` is None, the convention of the format is used (docs/rpc.md).
    """

    order: str = USUAL_ORDER
    first_pixel: float | None = None

    def __post_init__(self) -> None:
        if self.order not in EXPONENTS:
            raise InputError.of("rpc.unknown_order", value=self.order, known=", ".join(EXPONENTS))
        low, high = FIRST_PIXELS
        if self.first_pixel is not None and not low <= self.first_pixel <= high:
            expected = f"a number from {low:g} to {high:g}"
            raise InputError.of("options.value", option="first_pixel", value=self.first_pixel, expected=expected)


@dataclass
class RpcFields:
    """Texts of one file and their places, by the names of ``_RPC.TXT``.

    Parameters
    ----------
    file : str
    reading : Reading
        Order of the coefficients and first pixel, as the user states them.
    """

    file: str
    reading: Reading
    cells: dict[str, tuple[str, str]] = field(default_factory=dict)

    def add(self, name: str, text: str, place: str) -> None:
        """Add a text; raise InputError if the name already has a text."""
        if name in self.cells:
            raise InputError.of("rpc.doubled", file=self.file, place=place, field=name)
        self.cells[name] = (text, place)

    def take(self, name: str, text: str, place: str) -> bool:
        """Add a text if its name occurs in ``_RPC.TXT``; return False for other names.

        A name such as ``LINE_NUM_COEFF`` adds the texts of all its coefficients.
        """
        if not NAMES.fullmatch(name):
            return False
        many = name.endswith("_COEFF")
        for each, one in ((f"{name}_{k}", one) for k, one in enumerate(text.split(), 1)) if many else ((name, text),):
            self.add(each, one, place)
        return True

    def number(self, name: str) -> float:
        """Return the finite number with this name.

        Raises
        ------
        InputError
            The number is missing, or the text is not a number.
        """
        if name not in self.cells:
            raise InputError.of("rpc.missing", file=self.file, field=name)
        text, place = self.cells[name]
        if not NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            raise InputError.of("rpc.not_a_number", file=self.file, place=f"{place}, {name}", value=text)
        return float(text)

    def group(self, stem: str) -> Array:
        """Return the coefficients (20,) of one polynomial, in the order of the file.

        Raises
        ------
        InputError
            There are not exactly 20 coefficients, or one is not a number.
        """
        wanted = [f"{stem}_COEFF_{k}" for k in range(1, N_TERMS + 1)]
        given = [name for name in self.cells if name.startswith(f"{stem}_COEFF_")]
        if len(given) != N_TERMS:
            raise InputError.of("rpc.coefficient_count", file=self.file, place=f"{stem}_COEFF", count=len(given))
        return np.array([self.number(name) for name in wanted])

    def require_order(self, place: str, stated: str) -> None:
        """Refuse coefficients in another order than the requested one.

        The InputError names both orders.
        """
        asked = self.reading.order
        if stated != asked:
            known = stated if stated in EXPONENTS else f"{stated}, which is not known"
            raise InputError.of("rpc.order", file=self.file, place=place, value=stated, found=known, asked=asked)

    def model(self, form: str, first_pixel: float = FIRST_PIXEL, **extra: Any) -> RpcModel:
        """Make the model from the collected texts.

        Parameters
        ----------
        form : str
            Name of the format.
        first_pixel : float
            Coordinate of the first pixel's centre in the format. A value that the user states has priority.
        **extra
            Further fields of ``RpcModel``; pixels are counted from 0.

        Raises
        ------
        InputError
            A field is missing or is not a number, or the model is not valid.
        """
        offsets, scales = (np.array([self.number(f"{axis}_{word}") for axis in AXES]) for word in ("OFF", "SCALE"))
        rows = np.stack([self.group(stem) for stem in POLYNOMIALS])
        stated = self.reading.first_pixel
        offsets[RANGE.image] -= first_pixel if stated is None else stated
        bias, rand = (self.number(name) if name in self.cells else None for name in ERRORS)
        return RpcModel(
            offsets, scales, rows[:, permutation(self.reading.order, USUAL_ORDER)], file=self.file, format=form,
            err_bias_m=bias, err_rand_m=rand, **extra,
        )  # fmt: skip


def texts_of(model: RpcModel, first_pixel: float = FIRST_PIXEL) -> dict[str, str]:
    """Return the texts of a model by their names in ``_RPC.TXT``, with all digits.

    The 20 coefficients of ``LINE_NUM_COEFF`` are one text. ``first_pixel`` is the
    coordinate of the first pixel's centre. Unknown errors are left out.
    """
    offsets = model.offsets.copy()
    offsets[RANGE.image] += first_pixel
    values: dict[str, Any] = {f"{axis}_OFF": value for axis, value in zip(AXES, offsets, strict=True)}
    values |= {f"{axis}_SCALE": value for axis, value in zip(AXES, model.scales, strict=True)}
    values |= {f"{stem}_COEFF": row for stem, row in zip(POLYNOMIALS, model.coefficients, strict=True)}
    values |= zip(ERRORS, (model.err_bias_m, model.err_rand_m), strict=True)
    return {name: printed(np.atleast_1d(value)) for name, value in values.items() if value is not None}


def read_text(path: str | os.PathLike[str]) -> str:
    """Read a text file; bytes that are not ASCII can only occur in remarks and are ignored."""
    return load_bytes(path, "rpc_bytes", "rpc.unreadable").decode("latin-1")


def printed(values: Iterable[float]) -> str:
    """Return numbers as their shortest texts without loss of digits, separated by blanks."""
    return " ".join(repr(float(value)) for value in values)
