"""Adjust a transformation to points, and examine the extent of these points in each direction.

Residuals are computed minus given, with the sign of İpbüker 1994. m0 refers to one
coordinate and is divided by the redundancy: ``m0 = sqrt(sum (v/sigma)^2 / (2n - u))``. It
is not the plain RMSE, which is divided by n.

If the control points lie on a straight line within their noise, the adjustment converges,
but the transformation is useless away from this line. Therefore the standard deviation of
the scale is computed for each principal direction of the points in the source system
(centred, one scale). It is compared with the standard deviation in the longest direction.
For an affine transformation their ratio is the ratio of the extents, the condition number
of the centred design. It depends neither on the unit nor on the size of the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from factors.cameras.plane import RECORD
from fg_orient.adjustment.dense import RowsBackend, equation_rows
from fg_orient.adjustment.loop import OPTIMIZERS, IterationRecord
from fg_orient.model import arrays
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.rectification.arguments import finite, numbers
from fg_orient.rectification.transformation import Scaling, Transformation, TransformationModel

MAX_ITERATIONS: Final = 100
#: Points determine a transformation if the ratio of the smallest to the largest singular
#: value of the design (columns of unit length) is above this. A straight line of 10 km, with
#: coordinates rounded to 1 mm, has a ratio of 1e-7.
RANK_LIMIT: Final = 1e-6
#: Largest ratio of sigmas. The ratio of weights is its square; larger ratios exceed the
#: precision of a double in an adjustment.
SIGMA_SPAN: Final = 1e8
#: A direction is weak if its ratio of standard deviations is above this. Example: a strip 20 times longer than wide.
WEAK_RATIO: Final = 20.0
#: A weak direction is not determined at all if the ratio of the noise to the root mean square
#: width of the points is above this. For points on a line this ratio is 0.7 on average for
#: any number of points, if all noise is in the source. The limit is half of this.
NOISE_SHARE: Final = 1.0 / 3.0
#: A coordinate is named if its component of the direction is above this (3 degrees).
LEAST_SHARE: Final = 0.05
#: Half the step of difference quotients, relative to the extent of the points.
STEP: Final = 1e-3


@dataclass(frozen=True)
class Observations:
    """Points with their coordinates in both systems; all values have been checked.

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
        Shapes do not fit, values are not finite, or standard deviations are not above 0.
    """

    source: Array
    target: Array
    sigma: Array
    ids: tuple[str, ...]

    def __post_init__(self) -> None:
        n, ids = len(self.target), arrays.names(self.ids, "ids")
        object.__setattr__(self, "ids", ids)
        for name, fits, size in (
            ("target", self.target.shape == (n, 2) and n > 0, self.target.shape),
            ("source", self.source.shape in ((n, 2), (n, 3)), self.source.shape),
            ("sigma", self.sigma.shape == (n, 2), self.sigma.shape),
            ("ids", len(ids) == n, len(ids)),
        ):
            if not fits:
                raise InputError.of("rectify.points", place=name, value=f"{size}, {n} targets")
        for name, values in (("source", self.source), ("target", self.target), ("sigma", self.sigma)):
            bad = ~np.isfinite(values).all(axis=1) | (name == "sigma" and (values <= 0.0).any(axis=1))
            if bad.any():
                raise InputError.of("rectify.points", place=f"{name} of point {self.ids[int(np.argmax(bad))]}")

    @classmethod
    def of(
        cls,
        source: npt.ArrayLike,
        target: npt.ArrayLike,
        sigma: npt.ArrayLike | None = None,
        ids: Sequence[str] | None = None,
    ) -> Observations:
        """Make observations from lists or arrays.

        Parameters
        ----------
        source : (n, 2) or (n, 3) array_like
            Coordinates in the source system.
        target : (n, 2) array_like
            Coordinates in the target system.
        sigma : float, (2,) or (n, 2) array_like, optional
            Standard deviations of the target coordinates, in their unit; default 1.
        ids : sequence of n str, optional
            Default: 1 to n.

        Raises
        ------
        InputError
            See :class:`Observations`; values that are not numbers; sigmas below the
            rounding of the coordinates, or with a ratio above 1e8.
        """
        start, end = (np.atleast_2d(numbers(name, a)) for name, a in (("source", source), ("target", target)))
        names = tuple(str(k + 1) for k in range(len(start))) if ids is None else tuple(ids)
        if sigma is None:
            return cls(start, end, np.ones(end.shape), names)
        given = numbers("sigmas", sigma)
        if given.shape not in ((), end.shape, end.shape[1:]):
            raise InputError.of("rectify.points", place="sigmas", value=f"{given.shape}, {end.shape}")
        points = cls(start, end, np.broadcast_to(given, end.shape).copy(), names)
        _require_sigmas(points)
        return points

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, index: Index | Mask) -> Observations:
        """Return some of the points."""
        ids = tuple(np.array(self.ids, dtype=object)[index])
        return Observations(self.source[index], self.target[index], self.sigma[index], ids)


@dataclass(frozen=True)
class Reach:
    """Principal direction of the control points that is not the longest one.

    Parameters
    ----------
    direction : (k,) array
        Unit vector of the source system.
    ratio : float
        Standard deviation of the scale along it, divided by that along the longest direction.
    sigma : float
        Standard deviation of the scale along it, divided by the scale along the longest direction.
    noise : float
        Noise of a point in the source system, divided by the root mean square extent in this direction.
    """

    direction: Array
    ratio: float
    sigma: float
    noise: float

    @property
    def is_weak(self) -> bool:
        """True if the points are narrow in this direction."""
        return self.ratio > WEAK_RATIO

    @property
    def is_unknown(self) -> bool:
        """True if the points are so narrow that their noise exceeds their extent."""
        return self.is_weak and self.noise > NOISE_SHARE

    def describe(self, names: tuple[str, ...]) -> str:
        """Return the direction in the names of the source coordinates: "line", or "0.71 sample - 0.71 line"."""
        first = self.direction[np.argmax(np.abs(self.direction))]
        parts = [
            (v, name) for v, name in zip(self.direction * np.sign(first), names, strict=True) if abs(v) >= LEAST_SHARE
        ]
        if len(parts) == 1:
            return parts[0][1]
        rest = (f" {'-' if v < 0.0 else '+'} {abs(v):.2f} {name}" for v, name in parts[1:])
        return f"{parts[0][0]:.2f} {parts[0][1]}" + "".join(rest)


@dataclass(frozen=True)
class TransformationFit:
    """Adjusted transformation.

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
        Condition number of the design with columns of unit length.
    """

    transformation: Transformation
    points: Observations
    residuals: Array
    whitened: Array
    design: Array
    log: tuple[IterationRecord, ...]
    condition: float

    @property
    def model(self) -> TransformationModel:
        """Family of the transformation."""
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
        """Standard deviation of unit weight; with unit sigmas, of a target coordinate (İpbüker 1994, EK 2)."""
        return float(np.sqrt(self.weighted_squares / self.redundancy))

    @property
    def rmse(self) -> tuple[float, float, float]:
        """Plain RMSE of both target coordinates and radial: divided by n."""
        return plain_rmse(self.residuals)

    @cached_property
    def cofactors(self) -> Array:
        """Cofactors (u, u) of the normalised coefficients.

        Times m0 squared they are the covariance.
        """
        root = np.linalg.inv(np.linalg.qr(self.design, mode="r"))
        return np.asarray(root @ root.T)

    @cached_property
    def reaches(self) -> tuple[Reach, ...]:
        """Principal directions of the points, without the longest."""
        source = self.points.source[:, : self.model.dimension]
        centre = source.mean(axis=0)
        _, extent, axes = np.linalg.svd(source - centre, full_matrices=False)
        step = STEP * extent[0] / np.sqrt(len(source))
        ends = np.concatenate([centre + step * axes, centre - step * axes])
        values, rows = (a.reshape(2, len(axes), 2, -1) for a in (self.transformation.apply(ends), self._rows_at(ends)))
        scale = float(np.linalg.norm((values[0, 0] - values[1, 0]) / (2.0 * step)))
        slopes = (rows[0] - rows[1]) / (2.0 * step)
        sigma = np.sqrt(0.5 * np.einsum("kij,jl,kil->k", slopes, self.cofactors, slopes))
        share = self.m0 * sigma[1:] / scale
        # the standard deviation of a slope is the noise divided by the extent and the root of the number of points
        noise = np.sqrt(len(source)) * share
        return tuple(map(Reach, axes[1:], (sigma[1:] / sigma[0]).tolist(), share.tolist(), noise.tolist()))

    @cached_property
    def residual_cofactors(self) -> Array:
        """Cofactors (n, 2, 2) of the whitened residuals of each point."""
        left = np.linalg.qr(self.design)[0].reshape(len(self.points), 2, -1)
        return np.asarray(np.eye(2) - left @ left.transpose(0, 2, 1))

    @property
    def redundancy_numbers(self) -> Array:
        """Redundancy numbers (n, 2) of the target coordinates; their sum is the redundancy."""
        return np.asarray(np.einsum("nii->ni", self.residual_cofactors))

    def prediction_sigma(self, source: npt.ArrayLike) -> Array:
        """Return standard deviations (n, 2) of transformed points, caused by the coefficients, in the target's unit.

        Parameters
        ----------
        source : (n, 2) array_like
            Coordinates in the source system.
        """
        variance = np.einsum("nii->ni", self.prediction_cofactors(source))
        return np.asarray(self.m0 * np.sqrt(np.maximum(variance, 0.0)))

    def prediction_cofactors(self, source: npt.ArrayLike) -> Array:
        """Return cofactors (n, 2, 2) of transformed points, caused by the coefficients, in the target's unit.

        Parameters
        ----------
        source : (n, 2) array_like
            Coordinates in the source system. Times m0 squared the cofactors are the covariance.
        """
        rows = self._rows_at(np.atleast_2d(finite("source", source)))
        return np.asarray(rows @ self.cofactors @ rows.transpose(0, 2, 1))

    def _rows_at(self, given: Array) -> Array:
        """Return derivatives (n, 2, u) of transformed points with respect to the coefficients, in the target's unit."""
        t, zero = self.transformation, np.zeros((len(given), 2))
        records = _records(t, Observations.of(given, t.target.offset + zero))
        _, rows = equation_rows(self.model.equation, records, self.model.setup)(t.coefficients, True)
        return rows.reshape(len(given), 2, -1)


def plain_rmse(residuals: Array) -> tuple[float, float, float]:
    """Return the RMSE of both axes and radial of residuals (n, 2); nan without points."""
    if not len(residuals):
        return np.nan, np.nan, np.nan
    x, y = np.sqrt(np.mean(residuals**2, axis=0))
    return float(x), float(y), float(np.hypot(x, y))


def fit(
    points: Observations,
    model: TransformationModel,
    *,
    source_names: Sequence[str] = (),
    target_names: Sequence[str] = ("X", "Y"),
    crs: str = "",
) -> TransformationFit:
    """Adjust a transformation.

    Parameters
    ----------
    points : Observations
        Control points.
    model : TransformationModel
        See :func:`fg_orient.rectification.models.find_model`.
    source_names, target_names : sequence of str
        For the record; default names of source coordinates are x, y, z.
    crs : str
        Coordinate system of the map.

    Raises
    ------
    InputError
        There are too few points (2n <= unknowns), or heights are missing. The points lie
        on a line, a curve or a plane and do not determine the transformation; or, for
        plane transformations, close to a line within their noise.
    NoSolutionError
        The iteration does not converge, or a denominator vanishes among the points.
    """
    if points.source.shape[1] < model.dimension:
        raise InputError.of("rectify.heights", place=model.title)
    require_redundancy(model, len(points))
    source = Scaling.of(points.source[:, : model.dimension], shared=model.shared_scale)
    target = Scaling.of(points.target, shared=model.shared_scale)
    names = tuple(source_names) or ("x", "y", "z")[: model.dimension]
    blank = Transformation(model, np.zeros(model.n_unknowns), source, target, names, tuple(target_names), crs)
    records = _records(blank, points)
    rows = equation_rows(model.equation, records, model.setup)
    start = model.start(records[:, RECORD.source], records[:, RECORD.target])
    _require_determined(points, model, rows(start, True)[1])
    optimise = OPTIMIZERS["gauss-newton" if model.linear else "levenberg-marquardt"]
    run = optimise(RowsBackend(rows), start, MAX_ITERATIONS)
    if not run.converged:
        raise NoSolutionError.of("rectify.not_converged", place=model.title, reason=run.end.message)
    below = model.denominator(records[:, RECORD.source], run.state)
    if not (below > 0.0).all():
        raise NoSolutionError.of("rectify.pole", place=model.title, value=points.ids[int(np.argmin(below))])
    residual, design = rows(run.state, True)
    condition = _require_determined(points, model, design)
    whitened = residual.reshape(-1, 2)
    done = replace(blank, coefficients=run.state)
    result = TransformationFit(done, points, whitened * points.sigma, whitened, design, run.log, condition)
    for reach in result.reaches if model.dimension == 2 else ():  # for models with heights this is only a warning
        if reach.is_unknown:
            raise InputError.of(
                "rectify.narrow",
                place=model.title,
                value=f"{len(points)} points",
                direction=reach.describe(names),
                times=1.0 / reach.noise,
            )
    return result


def require_redundancy(model: TransformationModel, n_points: int) -> None:
    """Refuse a number of control points without redundancy.

    Raises
    ------
    InputError
        The number of equations, 2n, does not exceed the number of unknowns.
    """
    if 2 * n_points <= model.n_unknowns:
        raise InputError.of(
            "rectify.few_points",
            place=model.title,
            points=n_points,
            equations=2 * n_points,
            unknowns=model.n_unknowns,
            least=model.least_points,
        )


def _require_sigmas(points: Observations) -> None:
    """Refuse sigmas below the rounding of the coordinates or of the adjustment."""
    least = np.spacing(np.abs(points.target).max(axis=0))
    smallest = np.maximum(least, points.sigma.max() / SIGMA_SPAN)
    bad = (points.sigma < smallest).any(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError.of(
            "rectify.sigma_absurd",
            place=f"sigma of point {points.ids[k]}",
            value=float(points.sigma[k].min()),
            least=float(least.max()),
            largest=float(points.sigma.max()),
            span=SIGMA_SPAN,
        )


def _require_determined(points: Observations, model: TransformationModel, design: Array) -> float:
    """Return the condition number of the scaled design.

    Raise InputError if points do not determine the transformation.
    """
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
    raise InputError.of(
        "rectify.degenerate", place=model.title, value=f"{len(points)} points", model=model.title, figure=figure
    )


def _records(t: Transformation, points: Observations) -> Array:
    """Return the records (n, 8) of the equation: normalised coordinates, whitening by sigma in normalised units."""
    source, scale = np.zeros((len(points), 3)), t.target.scale / points.sigma
    source[:, : t.model.dimension] = t.source.normalised(points.source[:, : t.model.dimension])
    target = t.target.normalised(points.target)
    return RECORD.pack(source=source, target=target, w11=scale[:, 0], w12=0.0, w22=scale[:, 1])
