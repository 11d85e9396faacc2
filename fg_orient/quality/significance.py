"""Significance of the image unknowns: t tests of single coefficients, F tests of groups.

One unknown has ``m_j = m0 sqrt(q_jj)`` and ``t = |x_j| / m_j`` with f degrees of freedom (Terlemezoğlu 2019,
eqs. 2.78-2.80; m0^2 = v^T P v / f). d unknowns together have ``F = x^T Q^-1 x / (d m0^2)`` with d and f. The
hypothesis is that the correction is zero. An insignificant orientation parameter can keep the value of the
metadata. An insignificant term of a look-angle polynomial or RPC compensation can be omitted. Of many single
tests 5 % are significant by chance. Therefore ``adjusted`` is Holm's (1979) probability over all
coefficients. F tests of groups are not adjusted.

The prior observation of a tested unknown has exactly the value that the hypothesis states. If the hypothesis
is true and the other unknowns follow their priors, the corrections have the variance ``Q - Q P Q``, not Q. (P
is the inverse of the prior covariance of the tested unknowns, I in prior sigmas; Q and P are their blocks.) T
is the square of the corrections in this variance. m0 is computed without these priors:
``m0^2 = (v^T P v - x^T (P^-1 - Q)^-1 x) / (f - d)``. T / (d m0^2) has the distribution F of d and f - d. It
equals the test of an adjustment without the priors of the tested unknowns. An unknown that only its prior
determines (``prior_share`` near 1) is never significant: the observations contain no information about it.
Correlated unknowns may each be insignificant but significant together, so they are removed one at a time
(``fg_orient.orientation.reduction``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.cofactors import DenseUnknowns, UnknownCofactors
from fg_orient.adjustment.problem import Problem
from fg_orient.model.distributions import f_tail, holm, t_two_sided
from fg_orient.model.errors import NoSolutionError
from fg_orient.model.parameters import term_of
from fg_orient.quality.hypotheses import CHECKED
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.variance_components import UnknownFreedom

#: Probability of a false alarm among all coefficients.
LEVEL: Final = 0.05
_TINY: Final = float(np.finfo(float).tiny)
#: Each part of the distortion of a camera has coefficients with these names.
DISTORTION: Final = {
    "radial distortion": re.compile("k[0-9]|(radial|orthogonal)_[0-9]"), "decentring distortion": re.compile("p[12]"),
    "affinity": re.compile("(affinity|film)_[a-z]+"), "Brown's parameters": re.compile("a[0-9]+"),
}  # fmt: skip


@dataclass(frozen=True)
class CoefficientTest:
    """Test of one unknown of an image.

    Parameters
    ----------
    image, name, unit : str
    value, sd : float
        Correction and its standard deviation, ``unit``.
    t : float
        t; with priors it is not ``value / sd``, see the module.
    probability : float
        Probability of this or a larger t if the correction is zero.
    adjusted : float
        Probability over all coefficients of the block (Holm).
    prior_share : float or None
        Share of the prior in the weight of the unknown, 0 to 1; None without priors.
    freedom : float
        Degrees of freedom of t: f; with priors f - 1; with estimated variance components Satterthwaite's value.
    """

    image: str
    name: str
    unit: str
    value: float
    sd: float
    t: float
    probability: float
    adjusted: float
    prior_share: float | None
    freedom: float


@dataclass(frozen=True)
class GroupTest:
    """F test of several unknowns together.

    Parameters
    ----------
    group : str
        "roll, all terms", "all terms of degree 1 in time", "roll_1 of all images".
    dimension : int
    statistic : float
        F.
    probability : float
        Probability of this or a larger F if all corrections are zero.
    freedom : float
        Degrees of freedom of the denominator.
    """

    group: str
    dimension: int
    statistic: float
    probability: float
    freedom: float


@dataclass(frozen=True)
class Significance:
    """Tests of all unknowns of the images.

    Parameters
    ----------
    redundancy : int
        f.
    level : float
    coefficients : tuple of CoefficientTest
    groups : tuple of GroupTest
        Tests of each coefficient over all images (if several), of each component, and of each degree of one kind
        (``parameters.Term``).
    """

    redundancy: float
    level: float
    coefficients: tuple[CoefficientTest, ...]
    groups: tuple[GroupTest, ...]

    def significant(self, test: CoefficientTest) -> bool:
        """Return whether a coefficient is significant among all coefficients."""
        return test.adjusted <= self.level

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "redundancy": self.redundancy,
            "level": self.level,
            "coefficients": [{**vars(c), "significant": self.significant(c)} for c in self.coefficients],
            "groups": [dict(vars(g)) for g in self.groups],
        }


def significance(
    known: ResidualCofactors, sigma0: float, freedom: UnknownFreedom | None, *, level: float = LEVEL
) -> Significance:
    """Test all unknowns of the images.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of a solution by any backend, without a loss; NoSolutionError without redundancy.
    sigma0 : float
        m0.
    freedom : UnknownFreedom or None
        Scale and degrees of freedom with estimated variance components; they replace m0 and its degrees of freedom.
    level : float
        Probability of a false alarm among all coefficients.
    """
    problem = known.problem
    _require_unbiased(problem)
    f = problem.redundancy
    if f <= 0:
        raise NoSolutionError.of("statistics.no_redundancy", place=problem.block.name, value=f)
    x = problem.image_columns(known.state)
    q = np.concatenate([np.diag(known.cofactors.image(k)) for k in range(problem.n_images)])
    m0, nu = (sigma0, np.full(len(x), float(f))) if freedom is None else (1.0, freedom.each())
    scale = np.concatenate([parameters.sigma for parameters in problem.parameters])
    priors, images = problem.block.options.priors, problem.block.images
    labels = [
        (images[k].id, name, unit)
        for k, parameters in enumerate(problem.parameters)
        for name, unit in zip(parameters.names, parameters.units, strict=True)
    ]
    j = places_of(problem, lambda _: True)
    x, q, nu, shares = x[j], q[j], nu[j], np.minimum(q, 1.0)[j] if priors else None
    noise = m0 * np.sqrt(q)
    if shares is not None:
        tests = [under_priors(x[k : k + 1], q[k : k + 1, None], m0, nu[k], freedom is None) for k in range(len(x))]
        t2, d, nu = (np.array(column, np.float64) for column in zip(*tests, strict=True))
        noise = np.where(d * t2 > 0.0, np.abs(x) / np.sqrt(np.maximum(t2, _TINY)), np.inf)
    coefficients = coefficient_tests([labels[k] for k in j.tolist()], x, m0 * np.sqrt(q), nu, scale[j], shares, noise)
    groups = tuple(group_test(known, sigma0, freedom, name, index) for name, index in _groups(problem).items())
    return Significance(f, level, coefficients, groups)


def group_test(
    known: ResidualCofactors, sigma0: float, freedom: UnknownFreedom | None, name: str, index: Index
) -> GroupTest:
    """Test the unknowns at the places (d,) in ``problem.image_columns`` together by F."""
    problem, q = known.problem, known.cofactors.unknowns(index)
    _require_unbiased(problem)
    m0, f = (sigma0, float(problem.redundancy)) if freedom is None else (1.0, freedom.together(index))
    x = problem.image_columns(known.state)[index]
    if not problem.block.options.priors:
        return together(name, x, q, m0, f)
    statistic, d, f = under_priors(x, q.matrix, m0, f, freedom is None)
    return GroupTest(name, d, statistic, float(f_tail(d, f, statistic)) if d else 1.0, f)


def _require_unbiased(problem: Problem) -> None:
    """Raise NoSolutionError for regularised unknowns: their tests assume an estimate without bias."""
    if problem.regularisation is not None:
        raise NoSolutionError.of("statistics.significance_regularised", place=problem.block.name)


def under_priors(x: Array, q: Array, m0: float, f: float, estimated: bool) -> tuple[float, int, float]:
    """Return F of unknowns x (d,) with priors, the number of tested directions, and f without these priors.

    x and the cofactors q (d, d) are in prior sigmas. If ``estimated`` is True, m0 is computed from all
    residuals except residuals of the priors of x.
    """
    share, axes = np.linalg.eigh(q)  # eigenvalues: share of the priors in each direction
    tested = 1.0 - share > CHECKED
    d = int(tested.sum())
    left = f - d if estimated else f
    if not d or left <= 0.0:
        return 0.0, 0, max(left, 1.0)
    prior = float(np.sum((axes.T @ x)[tested] ** 2 / (1.0 - share[tested])))
    square = (m0**2 * f - prior) / left if estimated else m0**2
    return (DenseUnknowns(q).square(x) + prior) / (d * max(square, _TINY)), d, left


def coefficient_tests(
    labels: Sequence[tuple[str, str, str]],
    x: Array,
    sd: Array,
    freedom: Array,
    scale: Array | None = None,
    shares: Array | None = None,
    noise: Array | None = None,
) -> tuple[CoefficientTest, ...]:
    """Test single unknowns.

    Parameters
    ----------
    labels : sequence of (str, str, str)
        Image or camera, name and unit of each unknown.
    x, sd, freedom : (k,) arrays
        Corrections, their standard deviations, and the degrees of freedom of these.
    scale : (k,) array, optional
        Factors that convert ``x`` and ``sd`` to the units; default: 1.
    shares : (k,) array, optional
        Shares of the priors.
    noise : (k,) array, optional
        Standard deviations of ``x`` if its true value is zero; default: ``sd``.
    """
    t, scale = np.abs(x) / (sd if noise is None else noise), np.ones(len(x)) if scale is None else scale
    p = t_two_sided(freedom, t)
    columns = [v.tolist() for v in (x * scale, sd * scale, t, p, holm(p))]
    prior = [None] * len(x) if shares is None else shares.tolist()
    rows = zip(labels, *columns, prior, freedom.tolist(), strict=True)
    return tuple(CoefficientTest(*label, *row) for label, *row in rows)


def together(name: str, x: Array, q: UnknownCofactors, m0: float, f: float) -> GroupTest:
    """Test unknowns x (d,) with cofactors q together by F; f: degrees of freedom of m0."""
    d, statistic = len(x), q.square(x) / (len(x) * m0**2)
    return GroupTest(name, d, statistic, float(f_tail(d, f, statistic)), f)


def camera_significance(
    labels: Sequence[tuple[str, str]],
    values: Array,
    cofactors: Array,
    m0: float,
    redundancy: int,
    freedom: Callable[[Sequence[int]], float] | None = None,
) -> Significance:
    """Test the hypothesis 0 for each distortion parameter, and for the parts of the distortion of each camera.

    Parameters
    ----------
    labels : sequence of (str, str)
        Camera and name of each parameter.
    values : (k,) array
    cofactors : (k, k) array
    m0 : float
    redundancy : int
        Redundancy, above 0.
    freedom : callable, optional
        Function that returns the degrees of freedom of the joint variance of some parameters, given
        their numbers; default: the redundancy.
    """
    freedom = freedom or (lambda _: float(redundancy))
    part = [next((words for words, form in DISTORTION.items() if form.fullmatch(name)), "") for _, name in labels]
    sd, parts = m0 * np.sqrt(np.diag(cofactors)), dict[str, list[int]]()
    rows = [k for k, words in enumerate(part) if words and sd[k] > 0.0]
    for k in rows:
        parts.setdefault(f"{part[k]} of {labels[k][0]}", []).append(k)
    each = np.array([freedom([k]) for k in rows], float)
    coefficients = coefficient_tests([(*labels[k], "") for k in rows], values[rows], sd[rows], each)
    groups = (
        together(name, values[at], DenseUnknowns(cofactors[np.ix_(at, at)]), m0, freedom(at))
        for name, at in parts.items()
        if len(at) > 1
    )
    return Significance(redundancy, LEVEL, coefficients, tuple(groups))


def places_of(problem: Problem, wanted: Callable[[str], object]) -> Index:
    """Return places in ``problem.image_columns`` of the named unknowns; shared unknowns in their first image."""
    names = [name for parameters in problem.parameters for name in parameters.names]
    places = range(len(names)) if problem.ties is None else np.sort(problem.ties.place).tolist()
    return np.array([j for j in places if wanted(names[j])], np.intp)


def _groups(problem: Problem) -> dict[str, Index]:
    """Return groups of more than one unknown: coefficient over all images, component, degree."""
    names = list(dict.fromkeys(name for p in problem.parameters for name in p.names))
    groups: dict[str, Index] = {}
    if problem.n_images > 1:
        groups |= {f"{n} of all images": places_of(problem, lambda name, n=n: name == n) for n in names}  # type: ignore[misc]
    terms = {name: term for name in names if (term := term_of(name)) is not None}
    for words, of in (("{}, all terms", attrgetter("component")), ("all terms of {}", attrgetter("kind"))):
        for value in filter(None, dict.fromkeys(map(of, terms.values()))):
            mine = {name for name, term in terms.items() if of(term) == value}
            groups[words.format(value)] = places_of(problem, mine.__contains__)
    groups |= {words: places_of(problem, form.fullmatch) for words, form in DISTORTION.items()}
    return {name: index for name, index in groups.items() if len(index) > 1}
