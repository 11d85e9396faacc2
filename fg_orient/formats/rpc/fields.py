"""Shared parts of all RPC readers: the fields of a file by their ``_RPC.TXT`` names, and the model made from them.

A reader collects texts with their places; :func:`build` makes numbers of them, moves the pixel
origin to ours, (0, 0) = centre of the first pixel, and coefficients to RPC00B order.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.cameras.rfm import EXPONENTS, N_TERMS, permutation
from factors.cameras.rfm_project import RANGE
from fg_orient.formats.registry import read_bytes
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel, RpcValidity

Array = npt.NDArray[np.float64]

#: Line, sample, longitude, latitude, height: the order of ``RpcModel``.
AXES: Final = ("LINE", "SAMP", "LONG", "LAT", "HEIGHT")
#: The order of ``RpcModel.coefficients``.
POLYNOMIALS: Final = ("LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN")
UNITS: Final = ("pixels", "pixels", "degrees", "degrees", "meters")
#: Coefficient order where a file does not name one.
USUAL_ORDER: Final = "RPC00B"
#: No RPC text is longer.
MAX_BYTES: Final = 16 * 2**20

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Reading:
    """Conventions of a file: the order of its coefficients, and its pixel coordinate of the first pixel.

    ``first_pixel`` None is the format's own (docs/rpc.md).
    """

    order: str = USUAL_ORDER
    first_pixel: float | None = None

    def __post_init__(self) -> None:
        if self.order not in EXPONENTS:
            raise InputError.of("rpc.unknown_order", value=self.order, known=", ".join(EXPONENTS))


@dataclass
class RpcFields:
    """Texts of one file: name of ``_RPC.TXT`` -> (text, place)."""

    file: str
    cells: dict[str, tuple[str, str]] = field(default_factory=dict)

    def add(self, name: str, text: str, place: str) -> None:
        """Take a text.

        Raises
        ------
        InputError
            The name has one already.
        """
        if name in self.cells:
            raise InputError.of("rpc.doubled", file=self.file, place=place, field=name)
        self.cells[name] = (text, place)

    def add_group(self, stem: str, texts: list[str], place: str) -> None:
        """Take the coefficients of one polynomial, ``LINE_NUM`` and so on."""
        for k, text in enumerate(texts):
            self.add(f"{stem}_COEFF_{k + 1}", text, place)

    def number(self, name: str) -> float:
        """Give a finite number.

        Raises
        ------
        InputError
            It is missing or no number.
        """
        if name not in self.cells:
            raise InputError.of("rpc.missing", file=self.file, field=name)
        text, place = self.cells[name]
        if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            raise InputError.of("rpc.not_a_number", file=self.file, place=f"{place}, {name}", value=text)
        return float(text)

    def maybe(self, name: str) -> float | None:
        """Give a finite number, or None where the file has none."""
        return self.number(name) if name in self.cells else None

    def group(self, stem: str) -> Array:
        """Give the coefficients of one polynomial: (20,), in the order of the file.

        Raises
        ------
        InputError
            There are not exactly 20, or one is no number.
        """
        wanted = [f"{stem}_COEFF_{k}" for k in range(1, N_TERMS + 1)]
        given = [name for name in self.cells if name.startswith(f"{stem}_COEFF_")]
        if len(given) != N_TERMS:
            raise InputError.of("rpc.coefficient_count", file=self.file, place=f"{stem}_COEFF", count=len(given))
        return np.array([self.number(name) for name in wanted])


def require_order(file: str, place: str, found: str, reading: Reading) -> None:
    """Refuse coefficients in another order than the one asked for.

    Raises
    ------
    InputError
        Names both orders and how to ask for the file's.
    """
    if found != reading.order:
        known = found if found in EXPONENTS else f"{found}, which is not known"
        raise InputError.of("rpc.order", file=file, place=place, value=found, found=known, asked=reading.order)


def build(
    fields: RpcFields, reading: Reading, form: str, first_pixel: float, extra: Mapping[str, Any] | None = None
) -> RpcModel:
    """Make the model from the fields of a file.

    Parameters
    ----------
    fields : RpcFields
    reading : Reading
        Its ``first_pixel`` wins over the argument.
    form : str
        Name of the format.
    first_pixel : float
        Pixel coordinate that the format gives the centre of the first pixel.
    extra : mapping, optional
        Further fields of ``RpcModel``; pixels 0-based.

    Raises
    ------
    InputError
        A field is missing or no number, or the model is not sound.
    """
    offsets = np.array([fields.number(f"{axis}_OFF") for axis in AXES])
    scales = np.array([fields.number(f"{axis}_SCALE") for axis in AXES])
    coefficients = np.stack([fields.group(stem) for stem in POLYNOMIALS])[:, permutation(reading.order, USUAL_ORDER)]
    offsets[RANGE.image] -= first_pixel if reading.first_pixel is None else reading.first_pixel
    more = {"err_bias_m": fields.maybe("ERR_BIAS"), "err_rand_m": fields.maybe("ERR_RAND"), **(extra or {})}
    return RpcModel(offsets, scales, coefficients, file=fields.file, format=form, **more)


def validity(model_offsets: Array, model_scales: Array, domain: Mapping[str, tuple[float, float]]) -> RpcValidity:
    """Ranges of a model with stated domains of "line", "sample" (0-based) and "lon", "lat".

    Pixels are cut to offset -+ scale: a model fitted to a part of the image is good there only.
    """
    low, high = model_offsets - np.abs(model_scales), model_offsets + np.abs(model_scales)
    line, sample = (
        (max(domain[name][0], float(low[k])), min(domain[name][1], float(high[k])))
        for k, name in enumerate(("line", "sample"))
    )
    return RpcValidity(line, sample, domain["lon"], domain["lat"], (float(low[4]), float(high[4])))


def read_text(path: str | os.PathLike[str]) -> str:
    """Give a text file; bytes beyond ASCII can only be remarks."""
    return read_bytes(path, MAX_BYTES).decode("latin-1")


def printed(value: float) -> str:
    """Shortest text that reads back as the same number."""
    return repr(float(value))
