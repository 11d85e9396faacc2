"""Variance components: factors by which the sigmas of each group of observations are too small or too large.

With whitened residuals v, their cofactors ``R = I - A N^-1 A^T`` and the rows of group i selected by E_i::

    q_i  = v^T E_i v,   r_i = tr(E_i R),   S_ij = tr(E_i R E_j R)
    s_i^2 = q_i / r_i                                                      (Foerstner 1979)
    S s^2 = q                                                              (Helmert 1907, Grafarend et al. 1980)

Both have the same fixed point, s_i = 1 for all groups, because the row sums of S are r. It is the maximum of the
residual (restricted) likelihood (Patterson & Thompson 1971), and ``2 S^-1`` is the covariance of the s_i^2 there.
Helmert's equations converge in a few rounds (S point by point: ``fg_orient.quality.residuals``). Foerstner's estimates
are never negative. They replace negative variances of Helmert's equations, and all estimates if there are too many
unknowns and groups. Each round requires a new adjustment (``fg_orient.orientation.components``).

Ungrouped observations keep their given sigmas. A component is held if its estimate is not larger than its
standard deviation, because its redundancy is then too small. The robust variant uses medians instead of sums.
It tolerates gross errors in up to half of a group if they change neither the solution nor other groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.model.options import USUAL_GROUPS
from fg_orient.quality.hypotheses import CHECKED
from fg_orient.quality.observation_groups import GroupedResiduals, Groups, groups_of
from fg_orient.quality.residuals import ResidualCofactors

if TYPE_CHECKING:
    from fg_orient.quality.suspects import Suspects

Method = Literal["helmert", "median"]
METHODS: Final = get_args(Method)


@dataclass(frozen=True, eq=False)
class Round:
    """Result of one round.

    Parameters
    ----------
    variance : (g,) array
        Factors of the variances; 1 if the component is held.
    negative : (g,) bool array
        Groups without a positive variance from Helmert's equations.
    held : tuple of str
        Reasons why components are held, one per group.
    covariance : (g, g) array
        Covariance of the variances; nan in rows and columns of held components.
    count, redundancy : (g,) arrays
    exact : bool
    """

    variance: Array
    negative: Mask
    held: tuple[str, ...]
    covariance: Array
    count: Index
    redundancy: Array
    exact: bool


def one_round(
    residuals: GroupedResiduals, method: Method = "helmert", *, keep: Sequence[bool] = (), judge: bool = True
) -> Round:
    """Estimate the components from one solution.

    Parameters
    ----------
    residuals : GroupedResiduals
    method : str
    keep : sequence of bool
        Components that are held in any case.
    judge : bool
        False: hold only groups that no other observation checks. Helmert's equations are unbiased for any weights. They
        correct sigmas that are wrong by orders of magnitude, even if a group has no redundancy with these sigmas.
    """
    q, r, count = residuals.sums()
    shared = None if residuals.parts is None else residuals.parts.shared
    s = np.diag(np.append(r, 0.0)) if shared is None else shared
    medians = residuals.medians() if method == "median" else np.ones(len(r))
    nothing = (r <= CHECKED) | np.isnan(medians)
    held = ["nothing checks them" if none else "" for none in nothing]
    free, inverse = _hold(s[:-1, :-1], r, held, keep, judge)
    variance, negative = np.ones(len(r)), np.zeros(len(r), bool)
    if free.any():
        known = s[:-1][:, [*np.flatnonzero(~free), len(r)]].sum(axis=1)[free]
        helmert = inverse @ (q[free] - known)
        negative[free] = (helmert <= 0.0) & judge & (shared is not None)
        positive = np.where((helmert > 0.0) & (shared is not None), helmert, q[free] / r[free])
        variance[free] = medians[free] if method == "median" else positive
    covariance = np.full((len(r), len(r)), np.nan)
    covariance[np.ix_(free, free)] = 2.0 * inverse
    return Round(variance, negative & (method == "helmert"), tuple(held), covariance, count, r, shared is not None)


def _hold(s: Array, r: Array, held: list[str], keep: Sequence[bool], judge: bool) -> tuple[Mask, Array]:
    """Hold components at the given sigmas, the worst first, until each estimate exceeds its standard deviation.

    Adds the reasons to ``held``; returns the free components and the inverse of their S.
    """
    kept = np.array(keep or [False] * len(r), bool)
    while True:
        free = np.array([not text for text in held], bool)
        scale = np.sqrt(np.outer(r[free], r[free]))  # scaled, because redundancies may differ by orders of magnitude
        inverse = np.linalg.pinv(s[np.ix_(free, free)] / scale, rcond=1e-10, hermitian=True) / scale
        sd = np.zeros(len(r))
        # 1 / r is the least possible variance; it replaces the diagonal of a singular S
        sd[free] = np.sqrt(2.0 * np.maximum(np.diag(inverse), 1.0 / r[free]))
        worst = int(np.argmax(np.where(kept & free, np.inf, sd)))
        if not (kept & free).any() and (sd[worst] < 1.0 or not judge):
            return free, inverse
        held[worst] = f"a redundancy of {r[worst]:.1f} leaves its variance uncertain by {100.0 * sd[worst]:.0f} %"
        if kept[worst]:  # the redundancy of this component was computed with its given sigma
            held[worst] = (
                f"its redundancy would be too small with an estimated sigma; at the given sigma it is {r[worst]:.1f}"
            )


# --- components of all groups ----------------------------------------------------------------------
@dataclass(frozen=True)
class VarianceComponent:
    """Component of one group.

    Parameters
    ----------
    group : str
        Name: "image", "image left", "height", "prior attitude".
    n : int
        Number of residuals in the group.
    redundancy : float
        Sum of their redundancy numbers.
    factor : float
        Factor of the given sigmas; 1 if the component is held.
    sd : float or None
        Standard deviation of the factor; None if the component is held, or with medians.
    held : str
        Reason why the component is held; empty if it is estimated.
    """

    group: str
    n: int
    redundancy: float
    factor: float
    sd: float | None
    held: str = ""


@dataclass(frozen=True)
class VarianceComponents:
    """Components of all groups.

    Parameters
    ----------
    components : tuple of VarianceComponent
    covariance : (g, g) array
        Covariance of the variances s_i^2 of the estimated components, relative to their values.
    exact : bool
        False if the standard deviations neglect the dependence of the groups: they are lower bounds.
    rounds : int
        Number of adjustments; 1: the factors come from one solution, without iteration.
    method : str
    """

    components: tuple[VarianceComponent, ...]
    covariance: Array
    exact: bool
    rounds: int
    method: Method

    def factor(self, group: str) -> float:
        """Return the factor of a group by its name; KeyError for an unknown group."""
        return {c.group: c.factor for c in self.components}[group]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on held components, and on standard deviations that are lower bounds."""
        out = [finding("components.held", group=c.group, why=c.held) for c in self.components if c.held]
        if not self.exact and self.method == "helmert":
            out.append(finding("components.lower_bounds"))
        return tuple(out)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the record of a run."""
        return {
            "method": self.method,
            "rounds": self.rounds,
            "exact": self.exact,
            "components": [{**vars(c), "held": c.held or None} for c in self.components],
        }


def components_of(groups: Groups, round_: Round, variance: Array, rounds: int, method: Method) -> VarianceComponents:
    """Return the result of the last round; ``variance`` (g,): factors of the given variances."""
    free = np.array([not text for text in round_.held], bool)
    components = []
    for g, name in enumerate(groups.names):
        factor = float(np.sqrt(variance[g]))
        sd = 0.5 * factor * float(np.sqrt(round_.covariance[g, g])) if free[g] and method == "helmert" else None
        components.append(
            VarianceComponent(name, int(round_.count[g]), float(round_.redundancy[g]), factor, sd, round_.held[g])
        )
    return VarianceComponents(tuple(components), round_.covariance[np.ix_(free, free)], round_.exact, rounds, method)


def variance_components(
    known: ResidualCofactors, *, groups: tuple[str, ...] = USUAL_GROUPS, method: Method = "helmert"
) -> VarianceComponents:
    """Estimate components from one solution by any backend, without a loss and without iteration.

    ``groups``: words of ``observation_groups.GROUPINGS``. InputError: groups or method are unknown.
    """
    require_method(method)
    residuals = GroupedResiduals(known, groups_of(known.problem, groups))
    only = one_round(residuals, method)
    return components_of(residuals.groups, only, only.variance, 1, method)


def require_method(method: str) -> None:
    """Raise InputError for a method that does not exist."""
    if method not in METHODS:
        raise InputError.of("statistics.method", place="method", value=method, known=", ".join(METHODS))


#: Degrees of freedom used for a known variance. With this number the F distribution equals chi-square to 1e-8.
KNOWN: Final = 1e8


def freedoms(residuals: GroupedResiduals, suspects: Sequence[Suspects], components: VarianceComponents) -> Array:
    """Compute the degrees of freedom (n,) of the tests of all suspects with estimated variance components.

    The variance of a suspect's estimated error is a weighted sum of the components::

        Var = sum_j c_j s_j^2,   c_j = tr((E^T R E)^+ E^T R E_j R E) / d,   sum_j c_j = 1

    with the variance ``c^T C c``, where C is the covariance of the s_j^2. Its degrees of freedom are
    ``nu = 2 / (c^T C c)`` (Satterthwaite 1946; of mixed models: Fai & Cornelius 1996). T of the suspect is
    then tested as in ``fg_orient.quality.hypotheses`` with ``v^T v = f = nu``. Two simpler choices are worse
    (docs/variance-components.md): the redundancy of the whole block gives too many alarms, and so does the
    redundancy of the suspect's group. The latter is used if there are too many unknowns and groups.

    Parameters
    ----------
    residuals : GroupedResiduals
        Residuals of the solution with these components.
    suspects : sequence of Suspects
        Suspects of the same solution.
    components : VarianceComponents
    """
    covariance, parts = _covariance(components), residuals.parts
    out = [np.zeros(0)]
    for s in suspects:
        share = _own(residuals, s) if parts is None else parts.shares(s.point, s.rows, s.columns)
        out.append(_satterthwaite(share, covariance))
    return np.concatenate(out)


def _covariance(components: VarianceComponents) -> Array:
    """Return C of all groups; zero for held components, and in the last row and column for ungrouped observations."""
    names = [c.group for c in components.components]
    free = [k for k, c in enumerate(components.components) if not c.held]
    covariance = np.zeros((len(names) + 1, len(names) + 1))
    covariance[np.ix_(free, free)] = components.covariance
    return covariance


def _satterthwaite(share: Array, covariance: Array) -> Array:
    """Return the degrees of freedom (n,) of shares (n, g)."""
    variance = np.einsum("ng,gh,nh->n", share, covariance, share)
    return np.asarray(np.minimum(KNOWN, 2.0 / np.maximum(variance, 2.0 / KNOWN)))


def _own(residuals: GroupedResiduals, s: Suspects) -> Array:
    """Return shares (n, g) of the groups in the suspects' rows, for use without the contributions of all groups."""
    select = np.eye(len(residuals.groups.names) + 1)[residuals.labels]  # the label -1 (no group) selects the last row
    share = np.einsum("nm,nmg->ng", np.sum(s.columns**2, axis=2), select[s.rows])
    return np.asarray(share / share.sum(axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class UnknownFreedom:
    """Degrees of freedom of tests of image unknowns, whose variance is also a sum of the components.

    The cofactors are ``Q = sum_j W_j`` (``fg_orient.quality.residuals``). For unknowns with cofactors ``Q = L L^T``
    together, ``c_j = tr(L^-1 W_j L^-T) / d``.

    Parameters
    ----------
    parts : (g, u, u) array
        W_j of the image unknowns, shared ones once.
    covariance : (g, g) array
    free : (w,) int array
        Row of ``parts`` of each place in ``problem.image_columns``.
    """

    parts: Array
    covariance: Array
    free: Index

    @classmethod
    def of(cls, known: ResidualCofactors, components: VarianceComponents) -> UnknownFreedom:
        """Compute from a solution with these components.

        Raise NoSolutionError if there are too many image unknowns and groups.
        """
        problem = known.problem
        groups = groups_of(problem, problem.block.options.variance_components)
        parts = GroupedResiduals(known, groups).parts
        u = problem.n_free_unknowns
        if parts is None:
            raise NoSolutionError.of(
                "statistics.components_large", place=problem.block.name, value=u, groups=len(groups.names)
            )
        free = np.arange(u) if problem.ties is None else problem.ties.of
        return cls(parts.parts, _covariance(components), free)

    def each(self) -> Array:
        """Return the degrees of freedom (w,) of every unknown alone, in the order of ``problem.image_columns``."""
        share = np.einsum("guu->ug", self.parts)
        return _satterthwaite(share / share.sum(axis=1, keepdims=True), self.covariance)[self.free]

    def together(self, index: Index) -> float:
        """Return the degrees of freedom of the F test of unknowns at these places."""
        mine = self.free[index]
        parts = self.parts[:, mine[:, None], mine]
        q = parts.sum(axis=0)
        length = np.sqrt(np.diag(q))
        scaled = parts / np.outer(length, length)
        share = np.einsum("gii->g", np.linalg.solve(q / np.outer(length, length), scaled)) / len(mine)
        return float(_satterthwaite(share[None], self.covariance)[0])


def least_freedom(components: VarianceComponents) -> float:
    """Return the smallest degrees of freedom of all components, for observations outside the adjustment."""
    variances = np.diag(components.covariance)
    return min(KNOWN, 2.0 / float(variances.max())) if len(variances) else KNOWN
