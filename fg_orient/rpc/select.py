"""Select the coefficients of a rational function model, or choose a penalty on them.

A selection is ``function(reduced: Reduced) -> Selection``: it returns the coefficients
beyond the affine part that are kept, or a kappa. :func:`fit_selected` then fits the true
equations with them. The publications describe their methods in words only; each docstring
states the implemented method. A file that calls :func:`register_selection` adds a method.

Selections use the linear form without its affine part. The affine unknowns (constant and
linear terms of the numerators) are always kept; they are eliminated by QR. The result is an ordinary
regression A x = l in the coefficients beyond the affine part. Its columns are orthogonal to the affine
columns, so a penalty |x| is in standard form (Eldén 1977).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Final, NamedTuple

import numpy as np

from factors._contract import compiled
from factors.arrays import Array, Index
from fg_orient.adjustment.linear.kappa import choose_kappa
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.distributions import f_quantile, t_quantile
from fg_orient.model.errors import InputError
from fg_orient.rpc.estimate import fit_true, linear_system
from fg_orient.rpc.fit import RfmFit, leverages
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.options import EVALUATIONS
from fg_orient.rpc.points import ControlPoints, Scaling

#: Modules of this package with further selections.
_MODULES: Final = ("search",)


@dataclass(frozen=True)
class Reduced:
    """Regression in the coefficients that a selection may drop.

    Parameters
    ----------
    design : (r, q) array
        Columns orthogonal to the affine ones.
    observed : (r,) array
        Observations, also orthogonal to the affine columns.
    unknowns : (q,) array of int
        Numbers of these coefficients in the form.
    always : (k,) array of int
        Numbers of the affine unknowns.
    affine : (r, k) array
        Orthonormal basis of the affine columns.
    seed, evaluations : int
        Seed of a random search, and the maximum number of subsets that it evaluates.
    """

    design: Array
    observed: Array
    unknowns: Index
    always: Index
    affine: Array
    seed: int = 1
    evaluations: int = EVALUATIONS

    @classmethod
    def of(cls, points: ControlPoints, form: RfmForm) -> Reduced:
        """Eliminate the affine part.

        Raises
        ------
        InputError
            A coordinate has no extent.
        """
        system = linear_system(points, form, Scaling.of(points))
        a, observed = system.require_design("reduced system")
        doubtful = form.beyond_affine
        q = np.linalg.qr(a[:, ~doubtful])[0]
        rest = a[:, doubtful]
        rest = rest - q @ (q.T @ rest)
        rest = rest - q @ (q.T @ rest)  # orthogonalising twice is sufficient (Kahan, Parlett 1980)
        left = observed - q @ (q.T @ observed)
        return cls(rest, left - q @ (q.T @ left), np.flatnonzero(doubtful), np.flatnonzero(~doubtful), q)

    @property
    def system(self) -> LinearSystem:
        """Linear system for the rules of :mod:`fg_orient.adjustment.linear.kappa`."""
        return LinearSystem.from_design(self.design, self.observed)

    @property
    def freedom(self) -> int:
        """Rows minus affine unknowns: the redundancy of the affine model."""
        return len(self.design) - len(self.always)

    def fit(self, chosen: Index) -> tuple[Array, float, Array]:
        """Fit some columns by least squares: x (k,), sum of squared residuals, diagonal of (A^T A)^-1 (k,)."""
        if not len(chosen):
            return np.zeros(0), float(self.observed @ self.observed), np.zeros(0)
        columns = self.design[:, chosen]
        length = np.linalg.norm(columns, axis=0)
        left, values, right = np.linalg.svd(columns / length, full_matrices=False)
        keep = values > len(columns) * np.finfo(np.float64).eps * values[0]
        inverse = right[keep].T / values[keep]
        x = inverse @ (left[:, keep].T @ self.observed)
        v = self.observed - columns @ (x / length)
        return x / length, float(v @ v), np.sum(inverse**2, axis=1) / length**2

    def kept(self, chosen: Index, form: RfmForm) -> tuple[int, ...]:
        """Return the numbers of the affine and the chosen unknowns in the complete form."""
        numbers = np.sort(np.concatenate([self.always, self.unknowns[chosen]]))
        return tuple(int(k) if form.kept is None else form.kept[int(k)] for k in numbers)


#: Level of the two-sided test of a coefficient.
SIGNIFICANCE: Final = 0.05
#: Columns are duplicates of each other if their correlation is above this (USS).
CORRELATION: Final = 0.9
#: LASSO path: number of lambdas, and ratio of the smallest to the largest.
LAMBDAS: Final = 40
LEAST_LAMBDA: Final = 1e-3
SWEEPS: Final = 10_000
CONVERGED: Final = 1e-8
#: Kappas that :func:`press` compares: from nearly no penalty to a model that is practically affine.
KAPPAS: Final = np.geomspace(1e-6, 1e4, 61)
#: Smallest redundancy that must remain.
LEAST_FREEDOM: Final = 10
#: Stepwise regression uses a column of length 1 only if its part orthogonal to the chosen columns is longer than this.
INDEPENDENT: Final = 1e-4


@dataclass(frozen=True)
class Selection:
    """Result of a selection.

    Parameters
    ----------
    chosen : (k,) array of int
        Columns of the reduced system.
    kappa : float
        Penalty of the final fit on all unknowns beyond the affine ones.
    """

    chosen: Index
    kappa: float = 0.0


Function = Callable[[Reduced], Selection]


class Method(NamedTuple):
    """Registered selection: label for tables, source, function."""

    label: str
    source: str
    function: Function


_REGISTRY: dict[str, Method] = {}


def register_selection(name: str, label: str, *, source: str) -> Callable[[Function], Function]:
    """Decorate a function to make it a selection.

    Parameters
    ----------
    name, label : str
        Name in options; label in tables.
    source : str
        Author and year.

    Raises
    ------
    ValueError
        Another selection has this name.
    """

    def add(function: Function) -> Function:
        present = _REGISTRY.get(name)
        if present is not None and present.function.__qualname__ != function.__qualname__:
            raise ValueError(f"a selection named {name!r} is registered already")
        _REGISTRY[name] = Method(label, source, function)
        return function

    return add


def fit_selected(
    points: ControlPoints,
    form: RfmForm,
    name: str,
    *,
    allow_pole: bool = False,
    seed: int = 1,
    evaluations: int = EVALUATIONS,
) -> RfmFit:
    """Choose from these points and fit the true equations.

    Parameters
    ----------
    points : ControlPoints
    form : RfmForm
    name : str
        Name of a registered selection.
    allow_pole : bool
        Return a model even if a denominator changes sign among the points.
    seed, evaluations : int
        See :class:`Reduced`.

    Returns
    -------
    RfmFit
        Fit whose ``choice`` names the kappa or the terms.

    Raises
    ------
    InputError
        The selection does not exist, or the points cannot be used.
    NoSolutionError
        The fit has no solution, or a pole.
    """
    for module in _MODULES:
        import_module(f"fg_orient.rpc.{module}")
    if name not in _REGISTRY:
        raise InputError.of("rfm.selector", place="selection", value=name, known=", ".join(_REGISTRY))
    reduced = replace(Reduced.of(points, form), seed=seed, evaluations=evaluations)
    selection = _REGISTRY[name].function(reduced)
    chosen = RfmForm(form.degree, form.denominators, reduced.kept(selection.chosen, form))
    fit = fit_true(points, chosen, kappa=selection.kappa, allow_pole=allow_pole)
    terms = " ".join(name for name, beyond in zip(chosen.names, chosen.beyond_affine, strict=True) if beyond)
    choice = {"kappa": f"{selection.kappa:.3g}"} if selection.kappa > 0.0 else {"terms": terms}
    return replace(fit, method=_REGISTRY[name].label, choice=choice)


def _everything(reduced: Reduced) -> Index:
    return np.arange(reduced.design.shape[1])


@register_selection("ridge_gcv", "ridge, GCV", source="Golub, Heath, Wahba 1979")
def ridge_gcv(reduced: Reduced) -> Selection:
    """Keep all coefficients; choose kappa by generalised cross-validation."""
    return Selection(_everything(reduced), choose_kappa("gcv", reduced.system).kappa)


@register_selection("ridge_l_curve", "ridge, L-curve", source="Yuan & Lin 2008; Hansen, O'Leary 1993")
def ridge_l_curve(reduced: Reduced) -> Selection:
    """Keep all coefficients; choose kappa at the corner of the L-curve."""
    return Selection(_everything(reduced), choose_kappa("l_curve", reduced.system).kappa)


@register_selection("ridge_press", "ridge, leave-one-out", source="Allen 1974")
def press(reduced: Reduced) -> Selection:
    """Keep all coefficients; choose the kappa with the least sum of squared errors at excluded points.

    Both equations of a point are excluded together. The errors follow from the hat
    matrix, so no new fit is needed.
    """
    return Selection(_everything(reduced), float(KAPPAS[int(np.argmin([press_of(reduced, k) for k in KAPPAS]))]))


def press_of(reduced: Reduced, kappa: float) -> float:
    """Return the sum of squared errors at excluded points, linear form, with the affine part refitted."""
    affine = len(reduced.always)
    design = np.hstack([reduced.affine, reduced.design])
    penalty = np.concatenate([np.zeros(affine), np.full(reduced.design.shape[1], kappa)])
    n = len(design) // 2
    rows = np.vstack([reduced.design, np.sqrt(kappa) * np.eye(reduced.design.shape[1])])
    x = np.linalg.lstsq(rows, np.concatenate([reduced.observed, np.zeros(reduced.design.shape[1])]), rcond=None)[0]
    v = reduced.observed - reduced.design @ x
    pair = np.stack([v[:n], v[n:]], axis=1)
    left_out = np.linalg.solve(np.eye(2) - leverages(design, penalty), pair[:, :, None])
    return float(np.sum(left_out**2))


@register_selection("lasso", "LASSO, BIC", source="Tibshirani 1996; Long et al. 2015 (L1LS)")
def lasso(reduced: Reduced) -> Selection:
    """Select coefficients by the LASSO with the least BIC of its refit, then fit without the penalty."""
    length = np.linalg.norm(reduced.design, axis=0)
    unit = reduced.design / length
    largest = float(np.abs(unit.T @ reduced.observed).max())
    best, best_bic, x = np.zeros(0, dtype=np.intp), _bic(reduced, np.zeros(0, dtype=np.intp)), np.zeros(unit.shape[1])
    for penalty in np.geomspace(largest, LEAST_LAMBDA * largest, LAMBDAS):
        x = lasso_solution(unit, reduced.observed, float(penalty), x)
        chosen = np.flatnonzero(x)
        if reduced.freedom - len(chosen) < LEAST_FREEDOM:
            break
        bic = _bic(reduced, chosen)
        if bic < best_bic:
            best, best_bic = chosen, bic
    return Selection(best)


def lasso_solution(design: Array, observed: Array, penalty: float, start: Array | None = None) -> Array:
    """Minimise |A x - l|^2/2 + lambda |x|_1 by coordinate descent (Friedman et al. 2010).

    Parameters
    ----------
    design : (r, q) array
        Columns of length 1.
    observed : (r,) array
    penalty : float
        lambda.
    start : (q,) array, optional

    Returns
    -------
    (q,) array
    """
    x = np.zeros(design.shape[1]) if start is None else start.copy()
    gram = np.ascontiguousarray(design.T @ design)
    _descend(gram, design.T @ observed - gram @ x, x, penalty)
    return x


@compiled
def _descend(gram: Array, gradient: Array, x: Array, penalty: float) -> None:
    """Minimise by coordinate descent, in place; ``gradient`` is A^T (l - A x)."""
    for _ in range(SWEEPS):
        largest, size = 0.0, 0.0
        for j in range(len(x)):
            rho = gradient[j] + x[j]
            new = np.sign(rho) * max(abs(rho) - penalty, 0.0)
            change = new - x[j]
            if change != 0.0:
                gradient -= change * gram[j]
                x[j] = new
            largest, size = max(largest, abs(change)), max(size, abs(new))
        if largest <= CONVERGED * size:
            break


def _bic(reduced: Reduced, chosen: Index) -> float:
    """Return the Bayes information criterion of least squares with some columns (Schwarz 1978)."""
    rows = len(reduced.design)
    return float(rows * np.log(reduced.fit(chosen)[1] / rows) + (len(chosen) + len(reduced.always)) * np.log(rows))


def _explained(reduced: Reduced, chosen: Index, least: float) -> Array:
    """Return the squares that columns (q,) explain in addition to the chosen columns; -1 for dependent columns.

    For a column of length 1, the part that is orthogonal to the chosen columns must be
    longer than ``least``. Otherwise the column is dependent.
    """
    unit = reduced.design / np.linalg.norm(reduced.design, axis=0)
    q = np.linalg.qr(unit[:, chosen])[0]
    rest = unit - q @ (q.T @ unit)
    rest -= q @ (q.T @ rest)
    size = np.linalg.norm(rest, axis=0)
    free = size > least
    free[chosen] = False
    gain = (rest.T @ (reduced.observed - q @ (q.T @ reduced.observed))) / np.where(free, size, 1.0)
    return np.where(free, gain**2, -1.0)


def _without_insignificant(reduced: Reduced, chosen: Index, last: int = -1) -> Index:
    """Drop the least significant column (t test, 5 %) until all are significant or the column ``last`` is dropped."""
    while len(chosen) and last in (-1, *chosen):
        x, square, cofactors = reduced.fit(chosen)
        freedom = reduced.freedom - len(chosen)
        t = np.abs(x) / np.sqrt(square / freedom * cofactors)
        weakest = int(t.argmin())
        if t[weakest] >= t_quantile(freedom, 1.0 - 0.5 * SIGNIFICANCE):
            break
        chosen = np.delete(chosen, weakest)
    return chosen


@register_selection("nested", "nested regression", source="after Long & Jiao 2012; Tengfei et al. 2014 (NRBOS)")
def nested(reduced: Reduced) -> Selection:
    """Add coefficients one by one to nested models until BIC increases.

    The part of the next column that is orthogonal to the previous columns explains most of the
    residuals. (The minimum of BIC over all models has many more columns, because the linear form
    prefers denominators near zero.)
    """
    best = np.zeros(0, dtype=np.intp)
    while len(best) < reduced.design.shape[1] and reduced.freedom - len(best) > LEAST_FREEDOM:
        gain = _explained(reduced, best, float(np.sqrt(np.finfo(np.float64).eps)))
        longer = np.append(best, int(gain.argmax()))
        if gain.max() < 0.0 or _bic(reduced, np.sort(longer)) >= _bic(reduced, np.sort(best)):
            break
        best = longer
    return Selection(np.sort(best))


@register_selection("uss", "uncorrelated and significant", source="after Moghaddam et al. 2018 (USS-RFM)")
def uss(reduced: Reduced) -> Selection:
    """Select the significant coefficients among those that do not duplicate a better coefficient.

    In the order of their correlation with the residuals of the affine model, a
    coefficient is accepted if its correlation with each coefficient accepted before is at
    most 0.9. Then the least significant coefficient is dropped until all are significant.
    """
    unit = reduced.design / np.linalg.norm(reduced.design, axis=0)
    correlation = np.abs(unit.T @ unit)
    taken: list[int] = []
    for j in np.argsort(-np.abs(unit.T @ reduced.observed)):
        if not taken or float(correlation[j, taken].max()) <= CORRELATION:
            taken.append(int(j))
    taken = taken[: reduced.freedom - LEAST_FREEDOM]
    return Selection(_without_insignificant(reduced, np.sort(np.array(taken, dtype=np.intp))))


@register_selection("scatter", "stepwise regression", source="after Zhang et al. 2012; Efroymson 1960")
def scatter(reduced: Reduced) -> Selection:
    """Select coefficients by stepwise regression with F tests at 5 %.

    The coefficient that explains most is added if it is significant. Then all
    coefficients that are no longer significant are removed.
    """
    chosen = np.zeros(0, dtype=np.intp)
    # a limit of steps: Efroymson's rule cannot repeat a state, but rounding errors could cause this
    for _ in range(4 * reduced.design.shape[1]):
        freedom = reduced.freedom - len(chosen) - 1
        gain = _explained(reduced, chosen, INDEPENDENT)
        j = int(gain.argmax())
        left = reduced.fit(chosen)[1] - gain[j]
        if freedom < LEAST_FREEDOM or gain[j] * freedom <= f_quantile(1, freedom, 1.0 - SIGNIFICANCE) * left:
            break
        chosen = _without_insignificant(reduced, np.sort(np.append(chosen, j)), j)
        if j not in chosen:
            break
    return Selection(chosen)
