"""The module has the models of the 27 nonlinear regression sets of NIST StRD and reads the files.

Source: Statistical Reference Datasets, nonlinear regression, US National Institute of Standards and Technology (public
domain).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
#: One file has a wrong value: name of the set, parameter, certified value.
MISPRINT = ("Roszman1", 0, 0.20196866396)


def _saturation(x: Any, b1: Any, b2: Any) -> Any:
    return b1 * (1.0 - np.exp(-b2 * x))


def _decay_over_line(x: Any, b1: Any, b2: Any, b3: Any) -> Any:
    return np.exp(-b1 * x) / (b2 + b3 * x)


def _two_peaks(x: Any, b1: Any, b2: Any, b3: Any, b4: Any, b5: Any, b6: Any, b7: Any, b8: Any) -> Any:
    return b1 * np.exp(-b2 * x) + b3 * np.exp(-((x - b4) ** 2) / b5**2) + b6 * np.exp(-((x - b7) ** 2) / b8**2)


def _cubic_over_cubic(x: Any, b1: Any, b2: Any, b3: Any, b4: Any, b5: Any, b6: Any, b7: Any) -> Any:
    return (b1 + x * (b2 + x * (b3 + x * b4))) / (1.0 + x * (b5 + x * (b6 + x * b7)))


def _three_decays(x: Any, b1: Any, b2: Any, b3: Any, b4: Any, b5: Any, b6: Any) -> Any:
    return b1 * np.exp(-b2 * x) + b3 * np.exp(-b4 * x) + b5 * np.exp(-b6 * x)


def _cycles(x: Any, b1: Any, b2: Any, b3: Any, b4: Any, b5: Any, b6: Any, b7: Any, b8: Any, b9: Any) -> Any:
    year, second, third = (2.0 * np.pi * x / period for period in (12.0, b4, b7))
    annual = b2 * np.cos(year) + b3 * np.sin(year)
    return b1 + annual + b5 * np.cos(second) + b6 * np.sin(second) + b8 * np.cos(third) + b9 * np.sin(third)


#: Model of each set, ``model(x, b1, b2, ...)``; Nelson's x holds two rows and its observation is log y.
MODELS: dict[str, Callable[..., Any]] = {
    "Bennett5": lambda x, b1, b2, b3: b1 * (b2 + x) ** (-1.0 / b3),
    "BoxBOD": _saturation,
    "Chwirut1": _decay_over_line,
    "Chwirut2": _decay_over_line,
    "DanWood": lambda x, b1, b2: b1 * x**b2,
    "ENSO": _cycles,
    "Eckerle4": lambda x, b1, b2, b3: b1 / b2 * np.exp(-0.5 * ((x - b3) / b2) ** 2),
    "Gauss1": _two_peaks,
    "Gauss2": _two_peaks,
    "Gauss3": _two_peaks,
    "Hahn1": _cubic_over_cubic,
    "Kirby2": lambda x, b1, b2, b3, b4, b5: (b1 + b2 * x + b3 * x**2) / (1.0 + b4 * x + b5 * x**2),
    "Lanczos1": _three_decays,
    "Lanczos2": _three_decays,
    "Lanczos3": _three_decays,
    "MGH09": lambda x, b1, b2, b3, b4: b1 * (x**2 + x * b2) / (x**2 + x * b3 + b4),
    "MGH10": lambda x, b1, b2, b3: b1 * np.exp(b2 / (x + b3)),
    "MGH17": lambda x, b1, b2, b3, b4, b5: b1 + b2 * np.exp(-x * b4) + b3 * np.exp(-x * b5),
    "Misra1a": _saturation,
    "Misra1b": lambda x, b1, b2: b1 * (1.0 - (1.0 + b2 * x / 2.0) ** -2.0),
    "Misra1c": lambda x, b1, b2: b1 * (1.0 - (1.0 + 2.0 * b2 * x) ** -0.5),
    "Misra1d": lambda x, b1, b2: b1 * b2 * x / (1.0 + b2 * x),
    "Nelson": lambda x, b1, b2, b3: b1 - b2 * x[0] * np.exp(-b3 * x[1]),
    "Rat42": lambda x, b1, b2, b3: b1 / (1.0 + np.exp(b2 - b3 * x)),
    "Rat43": lambda x, b1, b2, b3, b4: b1 / (1.0 + np.exp(b2 - b3 * x)) ** (1.0 / b4),
    "Roszman1": lambda x, b1, b2, b3, b4: b1 - b2 * x - np.arctan(b3 / (x - b4)) / np.pi,
    "Thurber": _cubic_over_cubic,
}  # fmt: skip


@dataclass(frozen=True)
class Certified:
    """A set: observations y (n,), x (n,) or (2, n), two starts (2, u), certified values."""

    name: str
    x: Array
    y: Array
    starts: Array
    parameters: Array
    standard_deviations: Array
    squares: float


def read_set(path: Path) -> Certified:
    """Read a file as NIST prints it."""
    lines = path.read_text().splitlines()
    name = path.stem
    rows = [re.findall(r"[-+.\dE]+", line.split("=")[1]) for line in lines if re.match(r"\s*b\d+ =", line)]
    start1, start2, value, sigma = np.array(rows, float).T
    if name == MISPRINT[0]:
        value[MISPRINT[1]] = MISPRINT[2]
    squares = next(float(line.split(":")[1]) for line in lines if line.startswith("Residual Sum of Squares"))
    first = max(k for k, line in enumerate(lines) if line.startswith("Data:")) + 1
    table = np.array([line.split() for line in lines[first:] if line.strip()], float)
    y, x = table[:, 0], table[:, 1] if table.shape[1] == 2 else table[:, 1:].T
    return Certified(name, x, np.log(y) if name == "Nelson" else y, np.array([start1, start2]), value, sigma, squares)


def digits(found: npt.ArrayLike, certified: npt.ArrayLike) -> float:
    """Return the least log relative error -log10 |q - c| / |c|, at most 11, the digits certified (McCullough 1998)."""
    found, certified = np.asarray(found), np.asarray(certified)
    with np.errstate(divide="ignore"):
        return float(np.min(np.minimum(-np.log10(np.abs(found - certified) / np.abs(certified)), 11.0)))
