"""Choice of the coefficients of a rational function model, or of a penalty on them.

A selection is ``function(reduced: Reduced) -> Selection``: it gives the coefficients beyond the affine part that are
kept, or a kappa. :func:`fit_selected` then fits the true equations with them. The publications describe their methods
in words; the method as it is done here is stated with each. A file that calls :func:`register_selection` adds one.

Selections work on the linear form without its affine part. Its unknowns (constant and linear terms of the numerators)
are never in doubt and are eliminated by QR. This leaves an ordinary regression A x = l in the coefficients beyond the
affine part, with rows orthogonal to the affine columns, so that a penalty |x| is in standard form (Eldén 1977).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Array, compiled
from fg_orient.adjustment.linear.kappa import choose_kappa
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.distributions import f_quantile, t_quantile
from fg_orient.model.errors import InputError
from fg_orient.rpc.estimate import fit_true, linear_system
from fg_orient.rpc.fit import RfmFit, leverages
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.rfm_points import ControlPoints, Scaling

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Reduced:
    """Regression of the coefficients in doubt.

    Parameters
    ----------
    design : (r, q) array
        Columns orthogonal to the affine ones.
    observed : (r,) array
        Alike.
    unknowns : (q,) array of int
        Their numbers in the form.
    always : (k,) array of int
        Unknowns that stay.
    affine : (r, k) array
        Orthonormal basis of their columns.
    """

    design: Array
    observed: Array
    unknowns: Indices
    always: Indices
    affine: Array

    @classmethod
    def of(cls, points: ControlPoints, form: RfmForm) -> Reduced:
        """Eliminate the affine part.

        Raises
        ------
        InputError
            A coordinate without extent.
        """
        system = linear_system(points, form, Scaling.of(points))
        a, observed = system.require_design("reduced system")
        doubtful = form.beyond_affine
        q = np.linalg.qr(a[:, ~doubtful])[0]
        rest = a[:, doubtful]
        rest = rest - q @ (q.T @ rest)
        rest = rest - q @ (q.T @ rest)  # twice is enough (Kahan, Parlett 1980)
        left = observed - q @ (q.T @ observed)
        return cls(rest, left - q @ (q.T @ left), np.flatnonzero(doubtful), np.flatnonzero(~doubtful), q)

    @property
    def system(self) -> LinearSystem:
        """As a linear system, for the rules of :mod:`fg_orient.adjustment.linear.kappa`."""
        return LinearSystem.from_design(self.design, self.observed)

    @property
    def freedom(self) -> int:
        """Rows minus affine unknowns: the redundancy if no coefficient in doubt is taken."""
        return len(self.design) - len(self.always)

    def fit(self, chosen: Indices) -> tuple[Array, float, Array]:
        """Least squares with some columns: x (k,), sum of squared residuals, diagonal of (A^T A)^-1 (k,)."""
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

    def kept(self, chosen: Indices, form: RfmForm) -> tuple[int, ...]:
        """Numbers of unknowns of the complete form: the affine ones and the chosen."""
        numbers = np.sort(np.concatenate([self.always, self.unknowns[chosen]]))
        return tuple(int(k) if form.kept is None else form.kept[int(k)] for k in numbers)


#: Two-sided, for the tests of a coefficient.
SIGNIFICANCE: Final = 0.05
#: Columns whose correlation exceeds this share are duplicates of each other (USS).
CORRELATION: Final = 0.9
#: LASSO path: number of lambdas and smallest share of the largest.
LAMBDAS: Final = 40
LEAST_LAMBDA: Final = 1e-3
SWEEPS: Final = 10_000
CONVERGED: Final = 1e-8
#: Kappas of :func:`press`: from a model that is affine in practice to one that is not held.
KAPPAS: Final = np.geomspace(1e-6, 1e4, 61)
#: Observations that a free coefficient must leave over.
LEAST_FREEDOM: Final = 10


@dataclass(frozen=True)
class Selection:
    """Choice of a method.

    Parameters
    ----------
    chosen : (k,) array of int
        Columns of the reduced system.
    kappa : float
        Penalty of the final fit on all unknowns beyond the affine ones.
    """

    chosen: Indices
    kappa: float = 0.0


Function = Callable[[Reduced], Selection]


@dataclass(frozen=True)
class Method:
    """A registered selection: name, label for tables, source, function."""

    name: str
    label: str
    source: str
    function: Function


_REGISTRY: dict[str, Method] = {}


def register_selection(name: str, label: str, *, source: str) -> Callable[[Function], Function]:
    """Decorate a function to make it a selection.

    Raises
    ------
    ValueError
        Another selection has this name.
    """

    def add(function: Function) -> Function:
        present = _REGISTRY.get(name)
        if present is not None and present.function.__qualname__ != function.__qualname__:
            raise ValueError(f"a selection named {name!r} is registered already")
        _REGISTRY[name] = Method(name, label, source, function)
        return function

    return add


def selections() -> dict[str, Method]:
    """All selections by name."""
    return dict(_REGISTRY)


def fit_selected(points: ControlPoints, form: RfmForm, name: str, *, allow_pole: bool = False) -> RfmFit:
    """Choose from these points and fit the true equations.

    Parameters
    ----------
    points : ControlPoints
    form : RfmForm
    name : str
        Of :func:`selections`.
    allow_pole : bool
        Give a model even if a denominator changes sign among the points.

    Returns
    -------
    RfmFit
        ``choice`` says what was chosen.

    Raises
    ------
    InputError
        No such selection, or unusable points.
    NoSolutionError
        The fit has no solution, or a pole.
    """
    if name not in _REGISTRY:
        raise InputError.of("rfm.selector", place="selection", value=name, known=", ".join(_REGISTRY))
    reduced = Reduced.of(points, form)
    found = _REGISTRY[name].function(reduced)
    chosen = RfmForm(form.degree, form.denominators, reduced.kept(found.chosen, form))
    fit = fit_true(points, chosen, kappa=found.kappa, allow_pole=allow_pole)
    kappa = {"kappa": f"{found.kappa:.3g}"} if found.kappa > 0.0 else {}
    terms = (
        {} if kappa else {"terms": " ".join(n for n, b in zip(chosen.names, chosen.beyond_affine, strict=True) if b)}
    )
    return replace(fit, method=_REGISTRY[name].label, choice=kappa | terms)


def _everything(reduced: Reduced) -> Indices:
    return np.arange(reduced.design.shape[1])


@register_selection("ridge_gcv", "ridge, GCV", source="Golub, Heath, Wahba 1979")
def ridge_gcv(reduced: Reduced) -> Selection:
    """All coefficients, kappa by generalised cross-validation."""
    return Selection(_everything(reduced), choose_kappa("gcv", reduced.system).kappa)


@register_selection("ridge_l_curve", "ridge, L-curve", source="Yuan & Lin 2008; Hansen, O'Leary 1993")
def ridge_l_curve(reduced: Reduced) -> Selection:
    """All coefficients, kappa at the corner of the L-curve."""
    return Selection(_everything(reduced), choose_kappa("l_curve", reduced.system).kappa)


@register_selection("ridge_press", "ridge, leave-one-out", source="Allen 1974")
def press(reduced: Reduced) -> Selection:
    """All coefficients, kappa with the least sum of squared errors at points left out.

    Both equations of a point are left out together; the errors follow from the hat matrix without a new fit.
    """
    return Selection(_everything(reduced), float(KAPPAS[int(np.argmin([press_of(reduced, k) for k in KAPPAS]))]))


def press_of(reduced: Reduced, kappa: float) -> float:
    """Sum of squared errors at points left out, linear form, affine part refitted too."""
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
    """Coefficients that the LASSO with the least BIC of its refit keeps; then least squares without the penalty."""
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
    """Coordinate descent in place; ``gradient`` is A^T (l - A x)."""
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


def _bic(reduced: Reduced, chosen: Indices) -> float:
    """Bayes information criterion of least squares with some columns (Schwarz 1978)."""
    rows = len(reduced.design)
    return float(rows * np.log(reduced.fit(chosen)[1] / rows) + (len(chosen) + len(reduced.always)) * np.log(rows))


@register_selection("nested", "nested regression", source="after Long & Jiao 2012; Tengfei et al. 2014 (NRBOS)")
def nested(reduced: Reduced) -> Selection:
    """Nested models by orthogonal least squares, each one more coefficient, until BIC rises.

    A column joins if, orthogonal to those before it, it explains most of what is left. (The least BIC of all lies far
    behind: the linear form pays for denominators near zero.)
    """
    left, work = reduced.observed.copy(), reduced.design / np.linalg.norm(reduced.design, axis=0)
    order: list[int] = []
    best, best_bic = np.zeros(0, dtype=np.intp), _bic(reduced, np.zeros(0, dtype=np.intp))
    while len(order) < work.shape[1] and reduced.freedom - len(order) > LEAST_FREEDOM:
        size = np.linalg.norm(work, axis=0)
        usable = size > np.sqrt(np.finfo(np.float64).eps)  # what is less is a combination of those before
        usable[order] = False
        if not usable.any():
            break
        gain = np.where(usable, np.abs(work.T @ left) / np.where(usable, size, 1.0), -1.0)
        j = int(gain.argmax())
        q = work[:, j] / size[j]
        left = left - q * (q @ left)
        work = work - np.outer(q, q @ work)
        order.append(j)
        bic = _bic(reduced, np.sort(order))
        if bic >= best_bic:
            break
        best, best_bic = np.sort(order), bic
    return Selection(best)


@register_selection("uss", "uncorrelated and significant", source="after Moghaddam et al. 2018 (USS-RFM)")
def uss(reduced: Reduced) -> Selection:
    """Coefficients that duplicate no better one, then those that stay significant.

    In the order of their correlation with what the affine model leaves, a coefficient is taken if its correlation with
    each one taken before is at most 0.9; then the least significant (t test, 5 %) is dropped until all are significant.
    """
    unit = reduced.design / np.linalg.norm(reduced.design, axis=0)
    correlation = np.abs(unit.T @ unit)
    taken: list[int] = []
    for j in np.argsort(-np.abs(unit.T @ reduced.observed)):
        if not taken or float(correlation[j, taken].max()) <= CORRELATION:
            taken.append(int(j))
    taken = taken[: reduced.freedom - LEAST_FREEDOM]
    chosen = np.sort(np.array(taken, dtype=np.intp))
    while len(chosen):
        t = _t_values(reduced, chosen)
        weakest = int(t.argmin())
        if t[weakest] >= t_quantile(reduced.freedom - len(chosen), 1.0 - 0.5 * SIGNIFICANCE):
            break
        chosen = np.delete(chosen, weakest)
    return Selection(chosen)


def _t_values(reduced: Reduced, chosen: Indices) -> Array:
    """|x|/sigma of least squares with some columns."""
    x, square, cofactors = reduced.fit(chosen)
    variance = square / (reduced.freedom - len(chosen))
    return np.asarray(np.abs(x) / np.sqrt(variance * cofactors))


@register_selection("scatter", "scatter-matrix elimination", source="after Zhang et al. 2012; Efroymson 1960")
def scatter(reduced: Reduced) -> Selection:
    """Stepwise regression on the scatter matrix [A l]^T [A l] of unit columns by elimination transformations.

    The coefficient with the largest share of the remaining scatter enters if the F test holds at 5 %; then those for
    which it no longer holds leave: the transformation applied twice restores the matrix.
    """
    unit = np.column_stack([reduced.design / np.linalg.norm(reduced.design, axis=0), reduced.observed])
    table = unit.T @ unit
    q = len(table) - 1
    inside = np.zeros(q, dtype=bool)
    for _ in range(4 * q):  # Efroymson's rule cannot cycle; rounding could
        entering = _entering(table, inside, reduced.freedom - int(inside.sum()) - 1)
        if entering < 0:
            break
        table, inside[entering] = eliminated(table, entering), True
        while (leaving := _leaving(table, inside, reduced.freedom - int(inside.sum()))) >= 0:
            table, inside[leaving] = eliminated(table, leaving), False
            if leaving == entering:
                return Selection(np.flatnonzero(inside))
    return Selection(np.flatnonzero(inside))


def eliminated(table: Array, k: int) -> Array:
    """Elimination (sweep) transformation of a symmetric matrix on pivot k; twice restores it (Beaton 1964)."""
    pivot, column, row = table[k, k], table[:, k].copy(), table[k].copy()
    out = table - np.outer(column, row / pivot)
    out[k], out[:, k] = row / pivot, -column / pivot
    out[k, k] = 1.0 / pivot
    return np.asarray(out)


def _entering(table: Array, inside: npt.NDArray[np.bool_], freedom: int) -> int:
    """Column outside that explains most, if the F test holds; else -1."""
    diagonal = table.diagonal()[:-1]
    usable = ~inside & (diagonal > 1e-8)  # what is less is a combination of those inside
    if not usable.any() or freedom < LEAST_FREEDOM:
        return -1
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(usable, table[:-1, -1] ** 2 / np.where(usable, diagonal, 1.0), -1.0)
    best = int(gain.argmax())
    left = table[-1, -1] - gain[best]
    return best if gain[best] * freedom > f_quantile(1, freedom, 1.0 - SIGNIFICANCE) * left else -1


def _leaving(table: Array, inside: npt.NDArray[np.bool_], freedom: int) -> int:
    """Column inside that explains least, if the F test fails; else -1."""
    loss = np.where(inside, table[:-1, -1] ** 2 / np.where(inside, np.abs(table.diagonal()[:-1]), 1.0), np.inf)
    least = int(loss.argmin())
    limit = f_quantile(1, freedom, 1.0 - SIGNIFICANCE) * table[-1, -1]
    return least if inside.any() and loss[least] * freedom < limit else -1
