"""Fitted rational function model: coefficients, both kinds of residuals, statistics, poles; cross-validation.

Cross-validation gives the errors at points that were used neither in a fit nor in the choices of its method.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from factors.arrays import Array, Index
from factors.cameras.rfm_project import RANGE
from fg_orient.adjustment.linear.system import Conditioning, LinearSystem, diagnose
from fg_orient.model.errors import InputError, NoSolutionError, finding
from fg_orient.model.names import Progress
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.points import ControlPoints, Scaling
from fg_orient.sensors.rpc import RpcModel, RpcValidity

#: Maximum number of segments between points on which denominators are computed. If there are
#: more, a random selection with a fixed seed is used.
MAX_SEGMENTS: Final = 20_000


@dataclass(frozen=True)
class RfmFit:
    """A rational function model estimated from control points.

    Parameters
    ----------
    form : RfmForm
    scaling : Scaling
    points : ControlPoints
        Points of the estimation.
    x : (u,) array
        Unknowns in the order of ``form.names``, for normalised coordinates.
    method : str
        Estimation method in words.
    kappa : float
        Factor of the penalty; 0 for plain least squares.
    penalised : (u,) array
        1 for penalised unknowns, else 0.
    true : bool
        True if the model was estimated from the true equations, False if from the linear form.
    iterations : int
    notes : tuple of str
    choice : dict
        Kappa or terms that the method has chosen from the points.
    """

    form: RfmForm
    scaling: Scaling
    points: ControlPoints
    x: Array
    method: str
    kappa: float = 0.0
    penalised: Array = field(default_factory=lambda: np.zeros(0))
    true: bool = False
    iterations: int = 1
    notes: tuple[str, ...] = ()
    choice: dict[str, str] = field(default_factory=dict)

    @cached_property
    def _monomials(self) -> Array:
        return self.form.monomials(self.scaling.ground(self.points.ground))

    @cached_property
    def _linear_form(self) -> tuple[Array, Array]:
        image = self.scaling.image(self.points.line, self.points.sample)
        return self.form.design(self._monomials, image)

    @property
    def coefficients(self) -> Array:
        """Line numerator, line denominator, sample numerator, sample denominator in RPC00B order: (4, 20)."""
        return self.form.coefficients(self.x)

    def project(self, ground: Array) -> tuple[Array, Array]:
        """Return line and sample (pixels) of ground points (n, 3): longitude, latitude in degrees, height in m."""
        normalised = self.form.image(self.x, self.form.monomials(self.scaling.ground(ground)))
        line, sample = (normalised * self.scaling.scales[RANGE.image] + self.scaling.offsets[RANGE.image]).T
        return line, sample

    def model(self, n_lines: int | None = None, n_samples: int | None = None, file: str = "") -> RpcModel:
        """Return the model for projection, location and files; its validity range is the range of the points.

        Parameters
        ----------
        n_lines, n_samples : int, optional
            Size of the image.
        file : str
            Name for messages.

        Raises
        ------
        InputError
            A scale or coefficient that :class:`fg_orient.sensors.rpc.RpcModel` refuses.
        """
        low, high = self.points.columns.min(axis=0), self.points.columns.max(axis=0)
        ranges = zip(low.tolist(), high.tolist(), strict=True)
        return RpcModel(
            self.scaling.offsets,
            self.scaling.scales,
            self.coefficients,
            RpcValidity(*ranges),
            n_lines,
            n_samples,
            file=file,
            notes=tuple(finding("rpc.of_solver", note=note) for note in self.notes),
        )

    def residuals_px(self, points: ControlPoints | None = None) -> Array:
        """Return true image residuals, projected minus observed: (n, 2) line and sample.

        Default: of the fitted points.
        """
        chosen = points or self.points
        line, sample = self.project(chosen.ground)
        return np.column_stack([line - chosen.line, sample - chosen.sample])

    @property
    def rms_px(self) -> Array:
        """RMS of the true image residuals: (2,) line and sample; inf at a pole."""
        return rms(self.residuals_px())

    @property
    def linear_residuals_px(self) -> Array:
        """Residuals v = A x - l of the linear form, scaled to pixels: (n, 2) line and sample."""
        design, observed = self._linear_form
        sample, line = (design @ self.x - observed).reshape(2, -1)
        return np.asarray(np.column_stack([line, sample]) * self.scaling.scales[RANGE.image])

    @property
    def redundancy(self) -> float:
        """Observations minus unknowns. With a penalty, the trace of the hat matrix replaces the number of unknowns."""
        unknowns = float(len(self.x))
        if self.kappa > 0.0:
            unknowns = float(np.trace(self.leverages, axis1=1, axis2=2).sum())
        return 2 * len(self.points) - unknowns

    @property
    def m0_linear_px(self) -> float:
        """m0 = sqrt([vv]/(n - u)) of the linear form, as published; nan without redundancy."""
        return self._m0(self.linear_residuals_px)

    @property
    def m0_px(self) -> float:
        """m0 of the true image residuals; nan without redundancy."""
        return self._m0(self.residuals_px())

    def _m0(self, v: Array) -> float:
        free = self.redundancy
        return float(np.sqrt(np.sum(v**2) / free)) if free > 0.0 else float("nan")

    @cached_property
    def design(self) -> Array:
        """Jacobian of the adjusted equations, normalised units: (2 n, u), sample rows first."""
        return self.form.jacobian(self.x, self._monomials) if self.true else self._linear_form[0]

    @cached_property
    def conditioning(self) -> Conditioning:
        """Diagnostics of the design, without the penalty."""
        return diagnose(LinearSystem.from_design(self.design, self._linear_form[1]))

    @property
    def rank(self) -> int:
        """Numerical rank of the design with unit-length columns, without the penalty."""
        return self.conditioning.rank_scaled

    @property
    def leverages(self) -> Array:
        """Hat matrix of each point (n, 2, 2), sample first: derivatives of its adjusted by its observed coordinates."""
        return leverages(self.design, self._penalty)

    @cached_property
    def cofactors(self) -> Array | None:
        """Cofactor matrix (u, u) of the unknowns; None if the design is rank-deficient and there is no penalty.

        With a penalty it is the posterior cofactor matrix, with the penalty as prior.
        """
        if self.kappa == 0.0 and self.rank < len(self.x):
            return None
        lengths = np.linalg.norm(self.design, axis=0)
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        rows = np.vstack([self.design, np.diag(np.sqrt(self._penalty))]) / lengths
        root = np.linalg.pinv(np.linalg.qr(rows, mode="r"))
        return np.asarray((root @ root.T) / np.outer(lengths, lengths))

    @property
    def covariance(self) -> Array | None:
        """Covariance matrix (u, u) of the unknowns: cofactors times the variance of unit weight; see ``cofactors``.

        The variance belongs to the adjusted equations and is the same for both coordinates in normalised units.
        """
        if self.cofactors is None or not self.redundancy > 0.0:
            return None
        residuals = self.residuals_px() if self.true else self.linear_residuals_px
        v = residuals / self.scaling.scales[RANGE.image]
        return np.asarray(self.cofactors * (np.sum(v**2) / self.redundancy))

    @property
    def _penalty(self) -> Array:
        return self.kappa * self.penalised if len(self.penalised) else np.zeros(len(self.x))

    @cached_property
    def least_denominators(self) -> Array:
        """Smallest denominators of line and sample at the points and on the segments between them: (2,)."""
        return least_denominators(self.form, self.x, self.scaling.ground(self.points.ground))

    @property
    def has_pole(self) -> bool:
        """True if a denominator vanishes or changes its sign at the points or between them."""
        return not bool((self.least_denominators > 0.0).all())

    def without_pole(self) -> RfmFit:
        """Return the fit if its denominators do not change sign among its points.

        Raises
        ------
        NoSolutionError
            A denominator changes sign.
        """
        if self.has_pole:
            value = f"{self.least_denominators.min():.3g}"
            raise NoSolutionError.of("rfm.pole", place=f"{self.method}, degree {self.form.degree}", value=value)
        return self


def rms(residuals: Array) -> Array:
    """Return the RMS by column; inf where a residual is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        out = np.sqrt(np.mean(residuals**2, axis=0))
    return np.where(np.isfinite(out), out, np.inf)


def leverages(design: Array, penalty: Array) -> Array:
    """Return the hat matrix blocks (n, 2, 2) of points whose rows are i and n + i of the design (2 n, u)."""
    n = len(design) // 2
    rows = np.vstack([design, np.diag(np.sqrt(penalty))]) if penalty.any() else design
    left, values, _ = np.linalg.svd(rows, full_matrices=False)
    q = left[:, values > max(rows.shape) * np.spacing(values[0])]
    pair = np.stack([q[:n], q[n : 2 * n]], axis=1)
    return np.asarray(pair @ np.swapaxes(pair, 1, 2))


def least_denominators(form: RfmForm, x: Array, ground: Array) -> Array:
    """Return the smallest denominators (2,) at normalised points (n, 3) and between them.

    On a segment a denominator is a cubic: four values determine it, and its minimum is exact.
    """
    first, second = _pairs(len(ground))
    ends = form.below(x, form.monomials(ground))
    if not len(first):
        return np.asarray(ends.min(axis=0))
    step = ground[second] - ground[first]
    inner = [form.below(x, form.monomials(ground[first] + t * step)) for t in (1.0 / 3.0, 2.0 / 3.0)]
    f0, f1, f2, f3 = ends[first], inner[0], inner[1], ends[second]
    c1 = -5.5 * f0 + 9.0 * f1 - 4.5 * f2 + f3
    c2 = 9.0 * f0 - 22.5 * f1 + 18.0 * f2 - 4.5 * f3
    c3 = -4.5 * f0 + 13.5 * f1 - 13.5 * f2 + 4.5 * f3
    lowest = [ends.min(axis=0)]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        root = np.sqrt(c2**2 - 3.0 * c1 * c3)
        for t in ((-c2 + root) / (3.0 * c3), -c1 / (c2 + root)):  # both forms are needed because c3 may be zero
            inside = (t > 0.0) & (t < 1.0)
            values = f0 + t * (c1 + t * (c2 + t * c3))
            lowest.append(np.where(inside, values, np.inf).min(axis=0))
    return np.asarray(np.min(lowest, axis=0))


def _pairs(n: int) -> tuple[Index, Index]:
    """Return all pairs of n points, or a seeded selection of pairs."""
    if n * (n - 1) // 2 <= MAX_SEGMENTS:
        first, second = np.triu_indices(n, 1)
        return first, second
    rng = np.random.default_rng(n)
    first, second = rng.integers(0, n, (2, MAX_SEGMENTS))
    return first, second


Estimator = Callable[[ControlPoints], RfmFit]


@dataclass(frozen=True)
class CrossValidation:
    """Errors at points that were not used in the fit.

    Parameters
    ----------
    residuals_px : (n, 2) array
        True image residuals, projected minus observed, line and sample; inf for folds without a solution.
    fits : tuple of RfmFit or None
        Fit of each fold.
    failures : dict
        For each fold without a solution, the reason.
    """

    residuals_px: Array
    fits: tuple[RfmFit | None, ...]
    failures: dict[int, str]

    @property
    def rms_px(self) -> Array:
        """RMS per axis: (2,) line and sample."""
        return rms(self.residuals_px)

    @property
    def choices(self) -> dict[str, int]:
        """Choices of the folds with their counts, most frequent first."""
        words = (", ".join(f"{k} {v}" for k, v in f.choice.items()) for f in self.fits if f is not None)
        return dict(Counter(words).most_common())


def cross_validate(
    points: ControlPoints,
    estimator: Estimator,
    *,
    folds: int | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> CrossValidation:
    """Leave out each point, or each of k folds; fit the other points and project the excluded points.

    The estimator receives only the points of the other folds, and chooses its kappa or
    terms again in each fold (nested cross-validation, Varma & Simon 2006).

    Parameters
    ----------
    points : ControlPoints
    estimator : callable
        Function from ControlPoints to RfmFit, for instance ``lambda p: fit_selected(p, form, "ridge_gcv")``.
    folds : int, optional
        k; default leave-one-out.
    seed : int
        Seed of the assignment of points to folds.
    progress : callable, optional
        Function that is called with (done, of, text) before each fold.

    Raises
    ------
    InputError
        Number of folds out of range, or points that the estimator refuses.
    """
    n = len(points)
    k = n if folds is None else folds
    if not 2 <= k <= n:
        raise InputError.of("rfm.folds", place="folds", value=k, points=n)
    place = np.arange(n) if folds is None else np.random.default_rng(seed).permutation(n) % k
    residuals = np.full((n, 2), np.inf)
    fits: list[RfmFit | None] = []
    failures: dict[int, str] = {}
    for fold in range(k):
        if progress is not None:
            progress(fold, k, "cross-validation")
        out = place == fold
        try:
            fit = estimator(points.take(~out))
        except NoSolutionError as error:
            failures[fold] = str(error)
            fits.append(None)
            continue
        residuals[out] = fit.residuals_px(points.take(out))
        fits.append(fit)
    return CrossValidation(residuals, tuple(fits), failures)
