"""Transformations between source and target coordinates: equation, start values, coefficients, file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.arrays import Array
from factors.cameras import plane
from fg_orient.formats.load import load_json
from fg_orient.model.errors import InputError
from fg_orient.rectification.folder import TRANSFORMATION_FILE, require_whole

SCHEMA: Final = 1


@dataclass(frozen=True)
class TransformationModel:
    """Family of transformations between source and target coordinates.

    Parameters
    ----------
    name, title : str
        Name in commands; description.
    equation : Equation
        Registered observation equation.
    dimension : int
        Number of source coordinates, 2 or 3.
    degree : int
        Degree of a polynomial; 0 for all other models.
    names : tuple of str
        Names of the unknowns, in order.
    quotient : slice, optional
        Unknowns of the denominator, whose constant is 1 (none for linear models).
    shared_scale : bool
        True if both axes must be normalised with one scale.
    """

    name: str
    title: str
    equation: Equation
    dimension: int
    degree: int
    names: tuple[str, ...]
    quotient: slice | None = None
    shared_scale: bool = False

    @property
    def setup(self) -> Array:
        """Second argument of the equation."""
        return plane.polynomial_setup(self.degree) if self.degree else np.zeros((2, 0))

    @property
    def n_unknowns(self) -> int:
        """Number of coefficients."""
        return len(self.names)

    @property
    def least_points(self) -> int:
        """Smallest number of control points with redundancy: 2n > unknowns."""
        return self.n_unknowns // 2 + 1

    @property
    def linear(self) -> bool:
        """True if the target is linear in the unknowns."""
        return self.quotient is None

    def start(self, source: Array, target: Array) -> Array:
        """Return the start values (u,) from normalised coordinates: zeros for linear models.

        Other models start from the least squares of ``numerator - target (denominator -
        1) = target``. Both rows of the projective transformation have the denominator; in
        the line-scanner DLT only the sample has it. The parallel projection
        starts from the affine model (denominator 1). So do other models if their
        denominator is not above 0 at all points.
        """
        x = np.zeros(self.n_unknowns)
        if self.linear:
            return x
        ones = np.column_stack([np.ones(len(source)), source[:, : self.dimension]])
        n, p = ones.shape
        if self.name != "parallel":
            design = np.zeros((2, n, self.n_unknowns))
            for row in range(2):
                design[row, :, row * p : (row + 1) * p] = ones
                if row == 1 or self.name == "projective":
                    design[row, :, 2 * p :] = -target[:, row, None] * ones[:, 1:]
            quotient = np.asarray(np.linalg.lstsq(design.reshape(2 * n, -1), target.T.ravel(), rcond=None)[0], float)
            if (self.denominator(source, quotient) > 0.0).all():
                return quotient
        for row in range(2):
            x[row * p : (row + 1) * p] = np.linalg.lstsq(ones, target[:, row], rcond=None)[0]
        return x

    def denominator(self, source: Array, x: Array) -> Array:
        """Return the denominator (n,) at normalised source coordinates; 1 for linear models."""
        if self.quotient is None:
            return np.ones(len(source))
        flat = source[:, : self.dimension]
        if self.name == "parallel":
            return np.asarray(1.0 + x[8] * (x[4] + flat @ x[5:8]))
        return np.asarray(1.0 + flat @ x[self.quotient])


def _polynomial(name: str, title: str, degree: int) -> TransformationModel:
    exponents = plane.polynomial_setup(degree).astype(int).T
    names = tuple(f"{letter}_{j}{k}" for letter in "ab" for j, k in exponents)
    return TransformationModel(name, title, plane.POLYNOMIAL, 2, degree, names)


_EIGHT: Final = tuple(f"{letter}{k}" for letter in "ab" for k in range(4))
_MODELS: Final = {
    model.name: model for model in (
        _polynomial("affine", "affine", 1),
        TransformationModel("helmert", "Helmert", plane.HELMERT, 2, 0, ("c", "d", "a", "b"), shared_scale=True),
        TransformationModel("projective", "projective", plane.PROJECTIVE, 2, 0,
                            ("a0", "a1", "a2", "b0", "b1", "b2", "c1", "c2"), slice(6, 8)),
        TransformationModel("affine-3d", "3-D affine", plane.AFFINE_PROJECTION, 3, 0, _EIGHT),
        TransformationModel("parallel", "parallel projection", plane.PARALLEL_PROJECTION, 3, 0, (*_EIGHT, "t"),
                            slice(8, 9)),
        TransformationModel("dlt", "line-scanner DLT", plane.LINE_SCANNER_DLT, 3, 0,
                            (*_EIGHT, "c1", "c2", "c3"), slice(8, 11)),
    )
}  # fmt: skip
#: Names in commands.
NAMES: Final = ("polynomial", *_MODELS)


def find_model(name: str, degree: int | None = None) -> TransformationModel:
    """Return the transformation of a name.

    Parameters
    ----------
    name : str
        One of ``NAMES``.
    degree : int, optional
        Degree of the polynomial, 1 to 5; no other transformation has a degree.

    Raises
    ------
    InputError
        The transformation or the degree does not exist.
    """
    if name not in NAMES:
        raise InputError.of("rectify.model", place="model", value=name, known=", ".join(NAMES))
    most = plane.MAX_DEGREE
    if (degree is None) == (name == "polynomial") or not (degree is None or 1 <= degree <= most):
        given = "none" if degree is None else degree
        raise InputError.of("rectify.degree", place=f"degree of {name}", value=given, most=most)
    return _MODELS[name] if degree is None else _polynomial(name, f"polynomial of degree {degree}", degree)


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
        """Return the scaling to the mean as origin and to a largest distance of 1, per axis or shared.

        An axis without extent has the scale 1.
        """
        offset = values.mean(axis=0)
        scale = np.abs(values - offset).max(axis=0)
        if shared:
            scale = np.full_like(scale, scale.max())
        return cls(offset, np.where(scale > 0.0, scale, 1.0))

    def normalised(self, values: Array) -> Array:
        """Return the normalised values, about -1 to 1."""
        return np.asarray((values - self.offset) / self.scale)

    def physical(self, values: Array) -> Array:
        """Convert normalised to physical values."""
        return np.asarray(values * self.scale + self.offset)


@dataclass(frozen=True)
class Transformation:
    """Transformation of source to target coordinates.

    Parameters
    ----------
    model : TransformationModel
    coefficients : (u,) array
        Coefficients of normalised source and target coordinates, in the order of ``model.names``.
    source, target : Scaling
    source_names, target_names : tuple of str
        Names of the coordinates, in order: "sample", "line", "easting", "northing", "height".
    crs : str
        Coordinate system of the map side; "" if it is not known.
    """

    model: TransformationModel
    coefficients: Array
    source: Scaling
    target: Scaling
    source_names: tuple[str, ...]
    target_names: tuple[str, ...]
    crs: str = ""

    def apply(self, source: npt.ArrayLike) -> Array:
        """Return the target coordinates (n, 2) of source coordinates (n, 2) or (n, 3), inside or outside the points.

        Parameters
        ----------
        source : (n, 2) or (n, 3) array_like
            Coordinates in the source system.
        """
        given = np.atleast_2d(np.asarray(source, float))
        three = np.zeros((len(given), 3))
        three[:, : self.model.dimension] = self.source.normalised(given)
        u, v = plane.targets(self.model.equation.name, three, self.model.setup, self.coefficients)
        return self.target.physical(np.stack(np.broadcast_arrays(u, v), axis=1))

    def plain_coefficients(self) -> dict[str, float] | None:
        """Return the coefficients for coordinates that are not normalised; None for quotients.

        Each coefficient is rounded once. With map coordinates of 4.5e6 m, the powers of
        the coordinates multiply this rounding. To transform points use :meth:`apply`.
        """
        if not self.model.linear:
            return None
        values = _expanded(self) if self.model.degree else _plain_linear(self)
        return dict(zip(self.model.names, values, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Return the content of ``transformation.json``."""
        sides = (("source", self.source_names, self.source), ("target", self.target_names, self.target))
        return {
            "schema": SCHEMA,
            "model": self.model.name,
            "degree": self.model.degree or None,
            "names": list(self.model.names),
            "coefficients": self.coefficients.tolist(),
            **{
                side: {"names": list(names), "offset": scaling.offset.tolist(), "scale": scaling.scale.tolist()}
                for side, names, scaling in sides
            },
            "crs": self.crs or None,
            "plain_coefficients": self.plain_coefficients(),
        }


def read_transformation(path: Path) -> Transformation:
    """Read ``transformation.json``.

    Parameters
    ----------
    path : Path
        The file, or the result folder of ``rectify fit`` that contains it.

    Raises
    ------
    InputError
        The file cannot be read, or it is not a transformation; the folder is incomplete or was changed.
    """
    if path.is_dir():
        require_whole(path)
    file = path / TRANSFORMATION_FILE if path.is_dir() else path
    if not file.is_file():
        raise InputError.of("rectify.saved", file=file, value="no such file")
    content = load_json(file, "rectify.saved")
    try:
        return _from_dict(content)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        raise InputError.of("rectify.saved", file=file) from None


def _from_dict(record: Mapping[str, Any]) -> Transformation:
    """Return the transformation that the content of a file describes.

    Raise ValueError, KeyError or TypeError for invalid content.
    """
    if record["schema"] != SCHEMA:
        raise ValueError("schema")
    name = record["model"]
    model = find_model(name, record["degree"] if name == "polynomial" else None)
    scalings, names = list[Scaling](), list[tuple[str, ...]]()
    for side, size in (("source", model.dimension), ("target", 2)):
        both = np.array([record[side]["offset"], record[side]["scale"]], float)
        names.append(tuple(map(str, record[side]["names"])))
        if both.shape != (2, size) or len(names[-1]) != size or not np.isfinite(both).all() or (both[1] <= 0).any():
            raise ValueError(side)
        scalings.append(Scaling(*both))
    x = np.array(record["coefficients"], float)
    if x.shape != (model.n_unknowns,) or not np.isfinite(x).all():
        raise ValueError("coefficients")
    return Transformation(model, x, scalings[0], scalings[1], names[0], names[1], str(record["crs"] or ""))


def _expanded(t: Transformation) -> list[float]:
    """Expand the plain coefficients of a polynomial in rational numbers, rounded once at the end."""
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
    """Return the plain coefficients of Helmert (one scale per side) and of the 3-D affine transformation."""
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
