"""The transformations by name: equation, unknowns, start values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.cameras import line_scanner, plane
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]
#: Gives start values of the unknowns from normalised source and target coordinates.
Start = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Model:
    """A transformation between source and target coordinates.

    Parameters
    ----------
    name, title : str
        Its name in commands; in words.
    equation : Equation
        Registered observation equation.
    dimension : int
        Number of source coordinates, 2 or 3.
    degree : int
        Of a polynomial; 0 for all others.
    names : tuple of str
        Of the unknowns, in order.
    quotient : slice, optional
        Unknowns of the denominator beside its 1 (none for linear models).
    shared_scale : bool
        Whether both axes must be normalised with one scale.
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
        """Fewest control points with redundancy: 2n > unknowns."""
        return self.n_unknowns // 2 + 1

    @property
    def linear(self) -> bool:
        """Tell whether the target is linear in the unknowns."""
        return self.quotient is None

    def start(self, source: Array, target: Array) -> Array:
        """Start values (u,): zeros for linear models, else the solution of the equation times its denominator.

        Where that denominator is not above 0 at all points, the affine model (denominator 1) is the start.
        """
        x = np.zeros(self.n_unknowns)
        if self.quotient is None:
            return x
        ones = np.column_stack([np.ones(len(source)), source[:, : self.dimension]])
        found = _algebraic(self, ones, target)
        if (self.denominator(source, found) > 0.0).all():
            return found
        for row in range(2):
            x[row * ones.shape[1] : (row + 1) * ones.shape[1]] = np.linalg.lstsq(ones, target[:, row], rcond=None)[0]
        return x

    def denominator(self, source: Array, x: Array) -> Array:
        """Denominator (n,) at normalised source coordinates; 1 for linear models."""
        if self.quotient is None:
            return np.ones(len(source))
        flat = source[:, : self.dimension]
        if self.name == "parallel":
            return np.asarray(1.0 + x[8] * (x[4] + flat @ x[5:8]))
        return np.asarray(1.0 + flat @ x[self.quotient])


def _algebraic(model: Model, ones: Array, target: Array) -> Array:
    """Least squares of ``numerator - target (denominator - 1) = target``; parallel projection: of its affine part.

    Both rows of the projective transformation have the denominator, of the line-scanner DLT the sample alone.
    """
    n, p = ones.shape
    x = np.zeros(model.n_unknowns)
    if model.name == "parallel":
        for row in range(2):
            x[row * p : (row + 1) * p] = np.linalg.lstsq(ones, target[:, row], rcond=None)[0]
        return x
    design = np.zeros((2 * n, model.n_unknowns))
    for row in range(2):
        rows = slice(row * n, (row + 1) * n)
        design[rows, row * p : (row + 1) * p] = ones
        if row == 1 or model.name == "projective":
            design[rows, 2 * p :] = -target[:, row : row + 1] * ones[:, 1:]
    return np.asarray(np.linalg.lstsq(design, target.T.ravel(), rcond=None)[0])


def _polynomial_names(degree: int) -> tuple[str, ...]:
    exponents = plane.polynomial_setup(degree).astype(int).T
    return tuple(f"{letter}_{j}{k}" for letter in "ab" for j, k in exponents)


_EIGHT: Final = tuple(f"{letter}{k}" for letter in "ab" for k in range(4))
_OTHERS: Final = (
    Model("helmert", "Helmert", plane.HELMERT, 2, 0, ("c", "d", "a", "b"), shared_scale=True),
    Model("projective", "projective", plane.PROJECTIVE, 2, 0, ("a0", "a1", "a2", "b0", "b1", "b2", "c1", "c2"),
          slice(6, 8)),
    Model("affine-3d", "3-D affine", line_scanner.AFFINE_PROJECTION, 3, 0, _EIGHT),
    Model("parallel", "parallel projection", line_scanner.PARALLEL_PROJECTION, 3, 0, (*_EIGHT, "t"), slice(8, 9)),
    Model("dlt", "line-scanner DLT", line_scanner.LINE_SCANNER_DLT, 3, 0, (*_EIGHT, "c1", "c2", "c3"), slice(8, 11)),
)  # fmt: skip
#: Names in commands.
NAMES: Final = ("polynomial", "affine", *(model.name for model in _OTHERS))
#: Those from ground coordinates with heights to the image.
SPATIAL: Final = tuple(model.name for model in _OTHERS if model.dimension == 3)


def find_model(name: str, degree: int | None = None) -> Model:
    """Give a transformation by name.

    Parameters
    ----------
    name : str
        One of ``NAMES``.
    degree : int, optional
        Of the polynomial, 1 to 5; no other transformation has one.

    Raises
    ------
    InputError
        No such transformation or degree.
    """
    if name not in NAMES:
        raise InputError.of("rectify.model", place="model", value=name, known=", ".join(NAMES))
    most = plane.MAX_DEGREE
    if (degree is None) == (name == "polynomial") or not (degree is None or 1 <= degree <= most):
        given = "none" if degree is None else degree
        raise InputError.of("rectify.degree", place=f"degree of {name}", value=given, most=most)
    if name == "polynomial" and degree is not None:
        return Model(name, f"polynomial of degree {degree}", plane.POLYNOMIAL, 2, degree, _polynomial_names(degree))
    if name == "affine":
        return Model(name, "affine", plane.POLYNOMIAL, 2, 1, _polynomial_names(1))
    return next(model for model in _OTHERS if model.name == name)
