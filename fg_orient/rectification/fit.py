"""Adjustment of a transformation: the loop of the bundle adjustment over the points of one transformation.

Residuals are computed minus given, the sign of İpbüker 1994. m0 is per coordinate and divided by the redundancy,
``m0 = sqrt(sum (v/sigma)^2 / (2n - u))``; it is not the plain RMSE, which divides by n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.cameras.plane import RECORD
from fg_orient.adjustment.dense import RowsBackend, equation_rows
from fg_orient.adjustment.loop import OPTIMIZERS, IterationRecord
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.rectification.arguments import finite, numbers
from fg_orient.rectification.layout import Reach, reaches
from fg_orient.rectification.models import Model
from fg_orient.rectification.transformation import Scaling, Transformation

Array = npt.NDArray[np.float64]

MAX_ITERATIONS: Final = 100
#: Smallest singular value of the design (columns of unit length) by its largest, below which points do not
#: determine a transformation. Coordinates rounded to 1 mm on 10 km of straight line reach 1e-7.
RANK_LIMIT: Final = 1e-6
#: Ratio of sigmas from which on weights are beyond what a double carries through an adjustment.
SIGMA_SPAN: Final = 1e8


@dataclass(frozen=True)
class Observations:
    """Points in both systems, checked.

    Parameters
    ----------
    source : (n, 2) or (n, 3) array
    target : (n, 2) array
    sigma : (n, 2) array
        Standard deviations of the target coordinates, in their unit; ones = equal weights.
    ids : tuple of str

    Raises
    ------
    InputError
        Shapes that do not fit, values that are not finite, sigmas that are not above 0.
    """

    source: Array
    target: Array
    sigma: Array
    ids: tuple[str, ...]

    def __post_init__(self) -> None:
        n = len(self.source)
        shapes = self.source.shape in ((n, 2), (n, 3)) and self.target.shape == (n, 2) == self.sigma.shape
        if not shapes or len(self.ids) != n or not n:
            raise InputError.of("rectify.points", value=f"{self.source.shape}, {self.target.shape}")
        for name, values in (("source", self.source), ("target", self.target), ("sigma", self.sigma)):
            bad = ~np.isfinite(values).all(axis=1) | (name == "sigma" and (values <= 0.0).any(axis=1))
            if bad.any():
                raise InputError.of("rectify.points", place=f"{name} of point {self.ids[int(np.argmax(bad))]}")

    @classmethod
    def of(
        cls, source: npt.ArrayLike, target: npt.ArrayLike, sigma: npt.ArrayLike | None = None,
        ids: Sequence[str] | None = None,
    ) -> Observations:  # fmt: skip
        """From array-likes; unit sigmas, ids 1 to n if not given.

        Raises
        ------
        InputError
            See :class:`Observations`; something else than numbers; sigmas below the rounding of the coordinates, or
            of which one is 1e8 times another.
        """
        start, end = (np.atleast_2d(numbers(name, a)) for name, a in (("source", source), ("target", target)))
        names = tuple(str(k + 1) for k in range(len(start))) if ids is None else tuple(ids)
        if sigma is None:
            return cls(start, end, np.ones(end.shape), names)
        given = numbers("sigmas", sigma)
        if given.shape not in ((), end.shape, end.shape[1:]):
            raise InputError.of("rectify.points", place="sigmas", value=f"{given.shape}, {end.shape}")
        found = cls(start, end, np.broadcast_to(given, end.shape).copy(), names)
        _require_sigmas(found)
        return found

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, index: npt.NDArray[np.intp] | npt.NDArray[np.bool_]) -> Observations:
        """Some of the points."""
        ids = tuple(np.array(self.ids, dtype=object)[index])
        return Observations(self.source[index], self.target[index], self.sigma[index], ids)


@dataclass(frozen=True)
class Fit:
    """An adjusted transformation.

    Parameters
    ----------
    transformation : Transformation
    points : Observations
        The control points.
    residuals : (n, 2) array
        Computed minus given, in the unit of the target.
    whitened : (n, 2) array
        Residuals by their sigmas.
    design : (2n, u) array
        Derivatives of the whitened residuals, two rows per point.
    log : tuple of IterationRecord
    condition : float
        Of the design with columns of unit length.
    """

    transformation: Transformation
    points: Observations
    residuals: Array
    whitened: Array
    design: Array
    log: tuple[IterationRecord, ...]
    condition: float

    @property
    def model(self) -> Model:
        """The transformation's family."""
        return self.transformation.model

    @property
    def redundancy(self) -> int:
        """2n minus unknowns."""
        return 2 * len(self.points) - self.model.n_unknowns

    @property
    def weighted_squares(self) -> float:
        """Sum of the squares of the whitened residuals."""
        return float(np.sum(self.whitened**2))

    @property
    def m0(self) -> float:
        """Standard deviation of unit weight; with unit sigmas that of a target coordinate (İpbüker 1994, EK 2)."""
        return float(np.sqrt(self.weighted_squares / self.redundancy))

    @property
    def rmse(self) -> tuple[float, float, float]:
        """Plain RMSE of both target coordinates and radial: divided by n."""
        return plain_rmse(self.residuals)

    @cached_property
    def cofactors(self) -> Array:
        """Cofactors (u, u) of the normalised coefficients; times m0 squared their covariance."""
        root = np.linalg.inv(np.linalg.qr(self.design, mode="r"))
        return np.asarray(root @ root.T)

    @cached_property
    def reaches(self) -> tuple[Reach, ...]:
        """Principal directions of the points but the longest, and what is known along them."""
        source = self.points.source[:, : self.model.dimension]
        return reaches(source, self.transformation.apply, self._rows_at, self.cofactors, self.m0)

    @cached_property
    def residual_cofactors(self) -> Array:
        """Cofactors (n, 2, 2) of the whitened residuals of each point."""
        left = np.linalg.qr(self.design)[0].reshape(len(self.points), 2, -1)
        return np.asarray(np.eye(2) - left @ left.transpose(0, 2, 1))

    @property
    def redundancy_numbers(self) -> Array:
        """Share (n, 2) of an error of each observation that shows in its own residual; their sum is the redundancy."""
        return np.asarray(np.einsum("nii->ni", self.residual_cofactors))

    def prediction_sigma(self, source: npt.ArrayLike) -> Array:
        """Standard deviations (n, 2) of transformed points from those of the coefficients, in the target's unit."""
        variance = np.einsum("nii->ni", self.prediction_cofactors(source))
        return np.asarray(self.m0 * np.sqrt(np.maximum(variance, 0.0)))

    def prediction_cofactors(self, source: npt.ArrayLike) -> Array:
        """Cofactors (n, 2, 2) of transformed points from those of the coefficients; times m0 squared, target's unit."""
        rows = self._rows_at(np.atleast_2d(finite("source", source)))
        return np.asarray(rows @ self.cofactors @ rows.transpose(0, 2, 1))

    def _rows_at(self, given: Array) -> Array:
        """Derivatives (n, 2, u) of transformed points with respect to the coefficients, in the target's unit."""
        t, zero = self.transformation, np.zeros((len(given), 2))
        records = _records(t, Observations.of(given, t.target.offset + zero))
        _, rows = equation_rows(self.model.equation, records, self.model.setup)(t.coefficients, True)
        return rows.reshape(len(given), 2, -1)


def plain_rmse(residuals: Array) -> tuple[float, float, float]:
    """RMSE of both axes and radial of residuals (n, 2); nan without points."""
    if not len(residuals):
        return np.nan, np.nan, np.nan
    x, y = np.sqrt(np.mean(residuals**2, axis=0))
    return float(x), float(y), float(np.hypot(x, y))


def fit(
    points: Observations, model: Model, *, source_names: Sequence[str] = (),
    target_names: Sequence[str] = ("X", "Y"), crs: str = "", optimizer: str | None = None,
) -> Fit:  # fmt: skip
    """Adjust a transformation.

    Parameters
    ----------
    points : Observations
        Control points.
    model : Model
        See :func:`fg_orient.rectification.models.find_model`.
    source_names, target_names : sequence of str
        For the record; source coordinates without names are x, y, z.
    crs : str
        Of the map side.
    optimizer : str, optional
        Of the loop; default Gauss-Newton for linear models, Levenberg-Marquardt for quotients.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        2n <= unknowns; points on a line, a curve or a plane that do not determine the transformation, plane ones also
        within their noise of a line; heights missing.
    NoSolutionError
        The iteration does not converge, or a denominator vanishes among the points.
    """
    _require(points, model)
    source = Scaling.of(points.source[:, : model.dimension], shared=model.shared_scale)
    target = Scaling.of(points.target, shared=model.shared_scale)
    names = tuple(source_names) or ("x", "y", "z")[: model.dimension]
    blank = Transformation(model, np.zeros(model.n_unknowns), source, target, names, tuple(target_names), crs)
    records = _records(blank, points)
    rows = equation_rows(model.equation, records, model.setup)
    start = model.start(records[:, RECORD.source], records[:, RECORD.target])
    _require_determined(points, model, rows(start, True)[1])
    name = optimizer or ("gauss-newton" if model.linear else "levenberg-marquardt")
    found = OPTIMIZERS[name](RowsBackend(rows), start, MAX_ITERATIONS)
    if not found.converged:
        raise NoSolutionError.of("rectify.not_converged", place=model.title, reason=found.end.message)
    below = model.denominator(records[:, RECORD.source], found.state)
    if not (below > 0.0).all():
        raise NoSolutionError.of("rectify.pole", place=model.title, value=points.ids[int(np.argmin(below))])
    residual, design = rows(found.state, True)
    condition = _require_determined(points, model, design)
    whitened = residual.reshape(-1, 2)
    done = Transformation(model, found.state, source, target, blank.source_names, blank.target_names, crs)
    result = Fit(done, points, whitened * points.sigma, whitened, design, found.log, condition)
    _require_reach(result)
    return result


def _require_sigmas(points: Observations) -> None:
    """Refuse sigmas that the rounding of the coordinates or of the adjustment hides."""
    least = np.spacing(np.abs(points.target).max(axis=0))
    smallest = np.maximum(least, points.sigma.max() / SIGMA_SPAN)
    bad = (points.sigma < smallest).any(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError.of(
            "rectify.sigma_absurd", place=f"sigma of point {points.ids[k]}", value=float(points.sigma[k].min()),
            least=float(least.max()), largest=float(points.sigma.max()), span=SIGMA_SPAN,
        )  # fmt: skip


def _require_reach(found: Fit) -> None:
    """Refuse plane transformations of points whose width is their noise; heights that say little are remarked only."""
    for reach in found.reaches if found.model.dimension == 2 else ():
        if reach.is_unknown:
            t = found.transformation
            raise InputError.of("rectify.narrow", place=t.model.title, value=f"{len(found.points)} points",
                                direction=reach.words(t.source_names), times=1.0 / reach.noise)  # fmt: skip


def _require(points: Observations, model: Model) -> None:
    equations = 2 * len(points)
    if points.source.shape[1] < model.dimension:
        raise InputError.of("rectify.heights", place=model.title)
    if equations <= model.n_unknowns:
        raise InputError.of(
            "rectify.few_points", place=model.title, points=len(points), equations=equations,
            unknowns=model.n_unknowns, least=model.least_points,
        )  # fmt: skip


def _require_determined(points: Observations, model: Model, design: Array) -> float:
    """Refuse points that do not determine the transformation; give the condition number of the scaled design."""
    length = np.linalg.norm(design, axis=0)
    values = np.linalg.svd(design / np.where(length > 0.0, length, 1.0), compute_uv=False)
    if values[-1] > RANK_LIMIT * values[0]:
        return float(values[0] / values[-1])
    flat = points.source[:, : model.dimension]
    spread = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    narrow = spread <= RANK_LIMIT * max(float(spread[0]), np.finfo(float).tiny)
    if narrow[1]:
        raise InputError.of("rectify.collinear", place=model.title, value=f"{len(points)} points")
    figure = "on a curve of its degree" if model.dimension == 2 else "on a surface of its form"
    if model.dimension == 3 and narrow[2]:
        figure = "in a plane: heights must differ from it"
    raise InputError.of("rectify.degenerate", place=model.title, value=f"{len(points)} points", model=model.title,
                        figure=figure)  # fmt: skip


def _records(t: Transformation, points: Observations) -> Array:
    """Records of the equation (n, 8): normalised coordinates, whitening by sigma in normalised units."""
    source, scale = np.zeros((len(points), 3)), t.target.scale / points.sigma
    source[:, : t.model.dimension] = t.source.normalised(points.source[:, : t.model.dimension])
    target = t.target.normalised(points.target)
    return RECORD.pack(source=source, target=target, w11=scale[:, 0], w12=0.0, w22=scale[:, 1])
