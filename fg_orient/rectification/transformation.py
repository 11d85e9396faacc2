"""A transformation with its coefficients: applied, written, read back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.kernels.plane_batch import targets_of
from fg_orient.model.errors import InputError
from fg_orient.rectification.models import Model, find_model

Array = npt.NDArray[np.float64]

SCHEMA: Final = 1
#: Largest file that can be a transformation.
_MAX_BYTES: Final = 1_000_000


@dataclass(frozen=True)
class Scaling:
    """Normalised coordinates ``(value - offset)/scale``, axis by axis.

    Parameters
    ----------
    offset, scale : (k,) array
    """

    offset: Array
    scale: Array

    @classmethod
    def of(cls, values: Array, *, shared: bool = False) -> Scaling:
        """Centre on the mean; largest distance from it, per axis or shared, becomes 1 (an axis without extent: 1)."""
        offset = values.mean(axis=0)
        scale = np.abs(values - offset).max(axis=0)
        if shared:
            scale = np.full_like(scale, scale.max())
        return cls(offset, np.where(scale > 0.0, scale, 1.0))

    def normalised(self, values: Array) -> Array:
        """To about -1 .. 1."""
        return np.asarray((values - self.offset) / self.scale)

    def physical(self, values: Array) -> Array:
        """Back again."""
        return np.asarray(values * self.scale + self.offset)


@dataclass(frozen=True)
class Transformation:
    """Source to target coordinates.

    Parameters
    ----------
    model : Model
    coefficients : (u,) array
        Of normalised source and target coordinates, in the order of ``model.names``.
    source, target : Scaling
    source_names, target_names : tuple of str
        What the coordinates are, in order: "sample", "line", "easting", "northing", "height".
    crs : str
        Of the map side; "" if it is not known.
    """

    model: Model
    coefficients: Array
    source: Scaling
    target: Scaling
    source_names: tuple[str, ...]
    target_names: tuple[str, ...]
    crs: str = ""

    def apply(self, source: npt.ArrayLike) -> Array:
        """Target coordinates (n, 2) of source coordinates (n, 2) or (n, 3); no check of where they lie."""
        given = np.atleast_2d(np.asarray(source, float))
        three = np.zeros((len(given), 3))
        three[:, : self.model.dimension] = self.source.normalised(given)
        found = targets_of(self.model.equation, three, self.model.setup, self.coefficients)
        return self.target.physical(found)

    def plain_coefficients(self) -> dict[str, float] | None:
        """Coefficients of the coordinates themselves; None for quotients.

        They are rounded once. In full metres of a map projection (4.5e6 m) they lose as many digits as the powers
        have: to transform points use :meth:`apply`.
        """
        if not self.model.linear:
            return None
        if self.model.degree:
            values = _expanded(self)
        else:
            values = _plain_linear(self)
        return dict(zip(self.model.names, values, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Give the content of ``transformation.json``."""
        return {
            "schema": SCHEMA, "model": self.model.name, "degree": self.model.degree or None,
            "names": list(self.model.names), "coefficients": self.coefficients.tolist(),
            "source": {"names": list(self.source_names), "offset": self.source.offset.tolist(),
                       "scale": self.source.scale.tolist()},
            "target": {"names": list(self.target_names), "offset": self.target.offset.tolist(),
                       "scale": self.target.scale.tolist()},
            "crs": self.crs or None, "plain_coefficients": self.plain_coefficients(),
        }  # fmt: skip


def read_transformation(path: Path) -> Transformation:
    """Read ``transformation.json`` of a result folder, or the folder.

    Raises
    ------
    InputError
        It cannot be read or is something else.
    """
    file = path / "transformation.json" if path.is_dir() else path
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise InputError.of("rectify.saved", file=file, value="too large")
        return _from_dict(json.loads(file.read_text("utf-8")))
    except OSError as error:
        raise InputError.of("rectify.saved", file=file, value=error.strerror) from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError.of("rectify.saved", file=file) from None


def _from_dict(found: Mapping[str, Any]) -> Transformation:
    """Rebuild a transformation; ValueError, KeyError or TypeError if something does not fit."""
    if found["schema"] != SCHEMA:
        raise ValueError("schema")
    name = found["model"]
    model = find_model(name, found["degree"] if name == "polynomial" else None)
    sides = []
    for side, size in (("source", model.dimension), ("target", 2)):
        scaling = Scaling(np.array(found[side]["offset"], float), np.array(found[side]["scale"], float))
        names = tuple(str(word) for word in found[side]["names"])
        both = np.concatenate([scaling.offset, scaling.scale])
        if both.shape != (2 * size,) or len(names) != size or not np.isfinite(both).all() or (scaling.scale <= 0).any():
            raise ValueError(side)
        sides.append((scaling, names))
    x = np.array(found["coefficients"], float)
    if x.shape != (model.n_unknowns,) or not np.isfinite(x).all():
        raise ValueError("coefficients")
    return Transformation(model, x, sides[0][0], sides[1][0], sides[0][1], sides[1][1], str(found["crs"] or ""))


def _expanded(t: Transformation) -> list[float]:
    """Plain coefficients of a polynomial by the binomial theorem, in rational numbers: rounded once at the end."""
    exponents = [(int(j), int(k)) for j, k in t.model.setup.T]
    (o_x, o_y), (s_x, s_y) = ([Fraction(float(v)) for v in a] for a in (t.source.offset, t.source.scale))
    out: list[float] = []
    for row in range(2):
        plain = dict.fromkeys(exponents, Fraction(0))
        for (j, k), value in zip(exponents, t.coefficients.reshape(2, -1)[row], strict=True):
            share = Fraction(float(value)) / (s_x**j * s_y**k)
            for m in range(j + 1):
                for n in range(k + 1):
                    plain[m, n] += share * comb(j, m) * comb(k, n) * (-o_x) ** (j - m) * (-o_y) ** (k - n)
        scale, offset = Fraction(float(t.target.scale[row])), Fraction(float(t.target.offset[row]))
        plain = {powers: value * scale for powers, value in plain.items()}
        plain[0, 0] += offset
        out += [float(plain[powers]) for powers in exponents]
    return out


def _plain_linear(t: Transformation) -> list[float]:
    """Plain coefficients of Helmert (one scale per side) and of the 3-D affine transformation."""
    x, ratio = t.coefficients, t.target.scale
    if t.model.name == "helmert":
        a, b = x[2:] * ratio[0] / t.source.scale[0]
        turned = np.array([a * t.source.offset[0] - b * t.source.offset[1],
                           b * t.source.offset[0] + a * t.source.offset[1]])  # fmt: skip
        c, d = t.target.offset + ratio * x[:2] - turned
        return [float(c), float(d), float(a), float(b)]
    rows = x.reshape(2, 4)
    slopes = rows[:, 1:] * ratio[:, None] / t.source.scale
    constants = t.target.offset + ratio * rows[:, 0] - slopes @ t.source.offset
    return [float(v) for v in np.column_stack([constants, slopes]).ravel()]
