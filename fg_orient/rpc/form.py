"""Form of a rational function model: degree, denominators, estimated coefficients; linear and true equations.

    sample = (m a)/(1 + m' b),  line = (m c)/(1 + m' d)       (Terlemezoğlu 2019, T(2.53)-(2.55), x = sample, y = line)

m are the monomials of the normalised ground coordinates in the published order T(2.54); m' are the
monomials without the constant. The linear form is the equation multiplied by the denominator: m a -
sample m' b = sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final, get_args

import numpy as np

from factors.arrays import Array, Mask
from factors.cameras.rfm import EXPONENTS, permutation, terms
from fg_orient.model.errors import InputError
from fg_orient.rpc.options import Denominators

DEGREES: Final = (1, 2, 3)
DENOMINATORS: Final[tuple[str, ...]] = get_args(Denominators)
_PUBLISHED: Final = "T2.54"
_N_TERMS: Final = {1: 4, 2: 10, 3: 20}


@dataclass(frozen=True)
class RfmForm:
    """Coefficients of a model.

    Parameters
    ----------
    degree : int
        1, 2 or 3: largest total degree of a monomial.
    denominators : "separate", "common" or "one"
        A separate denominator for each image coordinate; a common one (IKONOS: b = d); or
        no denominator (polynomials).
    kept : tuple of int, optional
        Estimated unknowns of the complete form; the others are zero. Default: all.

    Raises
    ------
    InputError
        The degree, denominators or unknowns are not possible.
    """

    degree: int
    denominators: Denominators = "separate"
    kept: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if self.degree not in DEGREES:
            raise InputError.of("rfm.degree", place="degree", value=self.degree)
        if self.denominators not in DENOMINATORS:
            known = ", ".join(DENOMINATORS)
            raise InputError.of("rfm.denominators", place="denominators", value=self.denominators, known=known)
        if self.kept is not None:
            ascending = all(a < b for a, b in pairwise(self.kept))
            if not self.kept or not ascending or not 0 <= self.kept[0] <= self.kept[-1] < self._embedding.shape[1]:
                raise InputError.of("rfm.kept", place="kept", value=self.kept)

    @property
    def n_terms(self) -> int:
        """Number p of monomials of a polynomial: 4, 10, 20."""
        return _N_TERMS[self.degree]

    def __len__(self) -> int:
        return int(self.expansion.shape[1])

    @cached_property
    def _embedding(self) -> Array:
        """Matrix (4 p - 2, u) from the unknowns of complete form to the coefficients a, b, c, d of both coordinates."""
        p = self.n_terms
        one = np.eye(4 * p - 2)
        a, b, c, d = one[:, :p], one[:, p : 2 * p - 1], one[:, 2 * p - 1 : 3 * p - 1], one[:, 3 * p - 1 :]
        if self.denominators == "separate":
            return one
        return np.hstack([a, c, b + d] if self.denominators == "common" else [a, c])

    @cached_property
    def expansion(self) -> Array:
        """Matrix (4 p - 2, u) of zeros and ones for the estimated unknowns only."""
        return self._embedding if self.kept is None else np.ascontiguousarray(self._embedding[:, list(self.kept)])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns in the publication: a000, a100 ... b100 ... c000 ... d001.

        A common denominator is called b.
        """
        words = ["".join(map(str, e)) for e in EXPONENTS[_PUBLISHED][: self.n_terms]]
        complete = [f"{letter}{w}" for letter in "abcd" for w in (words if letter in "ac" else words[1:])]
        return tuple(complete[int(np.flatnonzero(column)[0])] for column in self.expansion.T)

    @cached_property
    def beyond_affine(self) -> Mask:
        """Mask (u,) of the unknowns that are neither constant nor linear terms of a numerator."""
        return np.array([name[0] in "bd" or sum(map(int, name[1:])) > 1 for name in self.names])

    def monomials(self, ground: Array) -> Array:
        """Return the monomials of normalised ground coordinates in the published order: (n, 3) -> (n, p)."""
        return np.ascontiguousarray(terms(ground)[:, permutation("RPC00B", _PUBLISHED)[: self.n_terms]])

    def design(self, m: Array, image: Array) -> tuple[Array, Array]:
        """Return the linear form A x = l: rows of the sample, then of the line.

        Parameters
        ----------
        m : (n, p) array
            Monomials.
        image : (n, 2) array
            Normalised line and sample.

        Returns
        -------
        A : (2 n, u) array
        l : (2 n,) array
        """
        line, sample = image.T
        return self._rows(m, -sample[:, None] * m[:, 1:], m, -line[:, None] * m[:, 1:]), np.concatenate([sample, line])

    def _rows(self, a: Array, b: Array, c: Array, d: Array) -> Array:
        zero = np.zeros((len(a), a.shape[1] + b.shape[1]))
        full = np.vstack([np.hstack([a, b, zero]), np.hstack([zero, c, d])])
        return full if self.expansion.shape[0] == self.expansion.shape[1] else full @ self.expansion

    def parts(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return the coefficients a (p,), b (p - 1,), c (p,), d (p - 1,) from the unknowns."""
        z, p = self.expansion @ x, self.n_terms
        return z[:p], z[p : 2 * p - 1], z[2 * p - 1 : 3 * p - 1], z[3 * p - 1 :]

    def below(self, x: Array, m: Array) -> Array:
        """Return the denominators of line and sample: (n, 2)."""
        _, b, _, d = self.parts(x)
        return np.column_stack([1.0 + m[:, 1:] @ d, 1.0 + m[:, 1:] @ b])

    def image(self, x: Array, m: Array) -> Array:
        """Return the normalised line and sample: (n, 2)."""
        a, _, c, _ = self.parts(x)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray(np.column_stack([m @ c, m @ a]) / self.below(x, m))

    def jacobian(self, x: Array, m: Array) -> Array:
        """Return the derivatives of the true equations, rows of the sample, then of the line: (2 n, u)."""
        image, below = self.image(x, m), self.below(x, m)
        c, a = m / below[:, :1], m / below[:, 1:]
        return self._rows(a, -image[:, 1:] * a[:, 1:], c, -image[:, :1] * c[:, 1:])

    def coefficients(self, x: Array) -> Array:
        """Return line numerator, line denominator, sample numerator, sample denominator in RPC00B order: (4, 20)."""
        a, b, c, d = self.parts(x)
        out = np.zeros((4, _N_TERMS[3]))
        for row, values in enumerate((c, np.r_[1.0, d], a, np.r_[1.0, b])):
            out[row, : len(values)] = values
        return np.ascontiguousarray(out[:, permutation(_PUBLISHED, "RPC00B")])
