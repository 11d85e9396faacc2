"""Variance components: by how much the sigmas of each group of observations are too small or too large.

With whitened residuals v, their cofactors ``R = I - A N^-1 A^T`` and the rows of group i selected by E_i::

    q_i  = v^T E_i v,   r_i = tr(E_i R),   S_ij = tr(E_i R E_j R)
    s_i^2 = q_i / r_i                                                      (Foerstner 1979)
    S s^2 = q                                                              (Helmert 1907, Grafarend et al. 1980)

Both have the same fixed point, s_i = 1 for all groups, since the rows of S sum up to r; there it is the maximum of the
residual (restricted) likelihood (Patterson & Thompson 1971), and ``2 S^-1`` the covariance of the s_i^2. Helmert's
equations reach it in a few rounds (S point by point: ``fg_orient.quality.group_cofactors``); Foerstner's are never
negative and are taken for variances that Helmert's make negative, and where image unknowns and groups are too many.
A round of either needs a new adjustment (``fg_orient.orientation.components``).

What is not named in ``groups`` has the sigmas that it was given. A component whose estimate is not above its own
standard deviation has too little redundancy: it is held. The robust variant puts medians in the place of sums; half
of a group may then be grossly wrong, if their errors neither move the solution nor leave their own group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from fg_orient.adjustment.problem import Problem, State, participates
from fg_orient.adjustment.rows import residuals
from fg_orient.model.distributions import chi_square_median
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.options import USUAL_GROUPS
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.group_cofactors import LARGEST, GroupCofactors, cost
from fg_orient.quality.observation_groups import Groups, groups_of
from fg_orient.quality.reliability import ResidualCofactors, residual_cofactors
from fg_orient.quality.suspects import Suspects

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Method = Literal["helmert", "median"]

METHODS: Final = ("helmert", "median")
#: A block of residuals with an eigenvalue of its cofactors below this is not checked in all directions.
CHECKED: Final = 1e-6


@dataclass(frozen=True)
class VarianceComponent:
    """One group.

    Parameters
    ----------
    group : str
        Name: "image", "image left", "height", "prior attitude".
    n : int
        Residuals in the group.
    redundancy : float
        Sum of their redundancy numbers.
    factor : float
        What the given sigmas are to be multiplied with; 1 where the component is held.
    sd : float or None
        Standard deviation of the factor; None where it is held, or with medians.
    held : str
        Why it is held; empty if it is estimated.
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
        Of the variances s_i^2 of the components that are not held, relative to their values.
    exact : bool
        False where the standard deviations leave out what groups share: they are lower bounds then.
    rounds : int
        Adjustments that it took; 1: the factors of one solution, not iterated.
    method : str
    """

    components: tuple[VarianceComponent, ...]
    covariance: Array
    exact: bool
    rounds: int
    method: Method

    def factor(self, group: str) -> float:
        """Factor of a group by its name.

        Raises
        ------
        KeyError
            There is no such group.
        """
        return {c.group: c.factor for c in self.components}[group]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was held, and what the standard deviations are."""
        out = [finding("components.held", group=c.group, why=c.held) for c in self.components if c.held]
        if not self.exact and self.method == "helmert":
            out.append(finding("components.lower_bounds"))
        return tuple(out)

    def as_dict(self) -> dict[str, Any]:
        """For the record of a run."""
        return {
            "method": self.method, "rounds": self.rounds, "exact": self.exact,
            "components": [
                {"group": c.group, "n": c.n, "redundancy": c.redundancy, "factor": c.factor, "sd": c.sd,
                 "held": c.held or None}
                for c in self.components
            ],
        }  # fmt: skip


class Residuals:
    """Whitened residuals of a solution in the axes of their groups, and their cofactors.

    Parameters
    ----------
    problem, state, cofactors
        Of a solution by any backend.
    groups : Groups
    known : ResidualCofactors, optional
        Those of the solution, if they were computed before.
    """

    def __init__(
        self, problem: Problem, state: State, cofactors: Cofactors, groups: Groups,
        known: ResidualCofactors | None = None,
    ) -> None:  # fmt: skip
        found = known or residual_cofactors(problem, state, cofactors)
        self._problem, self._state, self._cofactors, self.groups = problem, state, cofactors, groups
        self._turns = turn = self._turn()
        self.observed = np.flatnonzero(problem.observed)
        self.image, self.image_cofactors = residuals(problem, state), found.image
        self.control = np.einsum("nij,nj->ni", turn, problem.control_residuals(state, self.observed))
        self.control_cofactors = turn @ found.control @ np.swapaxes(turn, 1, 2)
        self.prior = problem.image_vector(state) if problem.block.options.priors else np.zeros(0)
        self.prior_redundancy = found.prior
        self.n_extra = sum(e.n_residuals for e in problem.block.extra)

    def _turn(self) -> Array:
        """Rotations (m, 3, 3) from the rows of the control factors to East, North, Up in sigmas."""
        problem = self._problem
        axes = problem.axes(problem.control_records[problem.observed, POINT.place] + problem.origin_m)
        sigma = problem.block.points.known.sigma_enu_m[problem.observed]
        return np.asarray(axes / sigma[:, :, None] @ np.linalg.inv(problem.control_weights(problem.observed)))

    @cached_property
    def labels(self) -> Index:
        """Group of every row: image points, control points, priors, own observations."""
        g, block = self.groups, self._problem.block
        prior = np.concatenate([*g.prior, np.zeros(0, np.intp)])
        if len(prior) and self._problem.ties is not None:
            prior = prior[self._problem.ties.place]  # a prior in common is one observation
        return np.concatenate([
            np.repeat(g.image[participates(block)], 2), np.tile(g.axes, len(self.observed)), prior,
            np.full(self.n_extra, -1),
        ]).astype(np.intp)  # fmt: skip

    def sums(self) -> tuple[Array, Array, Index]:
        """Sums of squares q, redundancies r and numbers of rows of all groups."""
        rows = self.labels[: len(self.labels) - self.n_extra]
        v = np.concatenate([self.image.ravel(), self.control.ravel(), self.prior])
        r = np.concatenate([
            np.einsum("nii->ni", self.image_cofactors).ravel(), np.einsum("nii->ni", self.control_cofactors).ravel(),
            self.prior_redundancy,
        ])  # fmt: skip
        size, named = len(self.groups.names), rows >= 0
        count = np.bincount(rows[named], minlength=size)
        q, total = (np.bincount(rows[named], w[named], size).astype(float) for w in (v**2, r))
        return q, total, count

    @cached_property
    def parts(self) -> GroupCofactors | None:
        """What the groups give to cofactors; None where the block is too large."""
        if cost(self._problem, len(self.groups.names)) > LARGEST:
            return None
        return GroupCofactors(self._problem, self._state, self._cofactors, self.labels, len(self.groups.names))

    def rows_of(self, found: Suspects) -> Index:
        """Rows (n, m) of suspects: their image points, then the coordinates of their point if m is odd."""
        control = found.v.shape[1] % 2
        rays = (found.v.shape[1] - 3 * control) // 2
        of_point = self._problem.observations.point
        order = np.argsort(of_point, kind="stable")
        seen = order[np.searchsorted(of_point[order], found.point)[:, None] + np.arange(rays)]
        seen = np.where(found.row[:, None] >= 0, found.row[:, None], seen)
        place = np.searchsorted(self.observed, found.point)[:, None]
        coordinates = 2 * len(self.image) + 3 * place + np.arange(3 * control)
        return np.hstack([(2 * seen[:, :, None] + np.arange(2)).reshape(len(seen), -1), coordinates])

    def columns_of(self, found: Suspects) -> Array:
        """Columns (n, m, k) of their errors, those in the rows of control factors turned to East, North, Up."""
        out = found.columns.copy()
        if found.v.shape[1] % 2:
            out[:, -3:] = self._turns[np.searchsorted(self.observed, found.point)] @ out[:, -3:]
        return out

    def shared(self) -> Array | None:
        """S of all groups, last row and column: what belongs to none; None where the block is too large."""
        return None if self.parts is None else self.parts.shared

    def medians(self) -> Array:
        """Median of the quadratic form of each group's units over that of chi-square; nan where nothing is checked.

        Points with a single ray are left out: their form says the same for image and ground.
        """
        o, parts = self._problem.observations, dict[int, list[float]]()
        many = np.bincount(o.point, minlength=len(self._problem.active)) > 1
        labels = self.labels[: 2 * len(o)].reshape(-1, 2)
        for i in np.flatnonzero(many[o.point]):
            _add(parts, labels[i], self.image[i], self.image_cofactors[i])
        for i in np.flatnonzero(many[self.observed]):
            _add(parts, self.groups.axes, self.control[i], self.control_cofactors[i])
        for label, x, r in zip(self.labels[2 * len(o) + 3 * len(self.observed) :], self.prior, self.prior_redundancy,
                               strict=False):  # fmt: skip
            _add(parts, np.array([label]), np.array([x]), np.array([[r]]))
        return np.array([np.median(parts[g]) if g in parts else np.nan for g in range(len(self.groups.names))])


def _add(parts: dict[int, list[float]], labels: Index, v: Array, q: Array) -> None:
    """Note the quadratic forms of one unit, over the median of chi-square, for each of its groups."""
    for label in set(labels.tolist()) - {-1}:
        mine = np.flatnonzero(labels == label)
        size, axes = np.linalg.eigh(q[np.ix_(mine, mine)])
        if size[0] > CHECKED:
            form = float(np.sum((axes.T @ v[mine]) ** 2 / size))
            parts.setdefault(label, []).append(form / float(chi_square_median(len(mine))))


@dataclass(frozen=True, eq=False)
class Round:
    """Result of one round.

    Parameters
    ----------
    variance : (g,) array
        Factors of the variances; 1 where the component is held.
    negative : (g,) bool array
        Where Helmert's equations gave no variance above zero.
    held : tuple of str
        Why a component is held, one per group.
    covariance : (g, g) array
        Of the variances; rows and columns of held ones are nan.
    count, redundancy : (g,) arrays
    exact : bool
    """

    variance: Array
    negative: npt.NDArray[np.bool_]
    held: tuple[str, ...]
    covariance: Array
    count: Index
    redundancy: Array
    exact: bool


def one_round(
    residuals: Residuals, method: Method = "helmert", *, keep: Sequence[bool] = (), judge: bool = True
) -> Round:
    """Estimate the components from one solution.

    Parameters
    ----------
    residuals : Residuals
    method : str
    keep : sequence of bool
        Components that are held in any case.
    judge : bool
        False: hold nothing but what nothing checks. Helmert's equations are unbiased for any weights and find sigmas
        that are wrong by orders of magnitude, although these leave a group no redundancy.
    """
    q, r, count = residuals.sums()
    shared = residuals.shared()
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


def _hold(
    s: Array, r: Array, held: list[str], keep: Sequence[bool], judge: bool
) -> tuple[npt.NDArray[np.bool_], Array]:
    """Hold components, the worst first, until each estimate is above its own standard deviation.

    Adds to ``held`` why; gives what is free and the inverse of its S.
    """
    kept = np.array(keep or [False] * len(r), bool)
    while True:
        free = np.array([not text for text in held], bool)
        scale = np.sqrt(np.outer(r[free], r[free]))  # redundancies may differ by orders of magnitude
        inverse = np.linalg.pinv(s[np.ix_(free, free)] / scale, rcond=1e-10, hermitian=True) / scale
        sd = np.zeros(len(r))
        # 1 / r: the least variance that there is, where S is singular
        sd[free] = np.sqrt(2.0 * np.maximum(np.diag(inverse), 1.0 / r[free]))
        worst = int(np.argmax(np.where(kept & free, np.inf, sd)))
        if not (kept & free).any() and (sd[worst] < 1.0 or not judge):
            return free, inverse
        held[worst] = f"a redundancy of {r[worst]:.1f} leaves its variance uncertain by {100.0 * sd[worst]:.0f} %"
        if kept[worst]:  # these figures are those at the given sigma
            held[worst] = (
                f"estimated it would leave itself too little redundancy; at the given sigma it is {r[worst]:.1f}"
            )


def components_of(
    groups: Groups, round_: Round, variance: Array, rounds: int, method: Method
) -> VarianceComponents:  # fmt: skip
    """Make the result; ``variance`` (g,): factors of the given variances."""
    free = np.array([not text for text in round_.held], bool)
    components = []
    for g, name in enumerate(groups.names):
        factor = float(np.sqrt(variance[g]))
        sd = 0.5 * factor * float(np.sqrt(round_.covariance[g, g])) if free[g] and method == "helmert" else None
        components.append(VarianceComponent(name, int(round_.count[g]), float(round_.redundancy[g]), factor, sd,
                                            round_.held[g]))  # fmt: skip
    return VarianceComponents(tuple(components), round_.covariance[np.ix_(free, free)], round_.exact, rounds, method)


def variance_components(
    problem: Problem, state: State, cofactors: Cofactors, *, groups: tuple[str, ...] = USUAL_GROUPS,
    method: Method = "helmert", known: ResidualCofactors | None = None,
) -> VarianceComponents:  # fmt: skip
    """Components from one solution, not iterated.

    Parameters
    ----------
    problem, state, cofactors
        Of a solution by any backend, without a loss.
    groups : tuple of str
        Of :data:`GROUPINGS`.
    method : str
        "helmert" or "median".
    known : ResidualCofactors, optional
        Those of the solution, if they were computed before.

    Returns
    -------
    VarianceComponents

    Raises
    ------
    InputError
        Groups or method do not exist.
    """
    require_method(method)
    residuals = Residuals(problem, state, cofactors, groups_of(problem, groups), known)
    found = one_round(residuals, method)
    return components_of(residuals.groups, found, found.variance, 1, method)


def require_method(method: str) -> None:
    """Refuse a method that does not exist.

    Raises
    ------
    InputError
        See above.
    """
    if method not in METHODS:
        raise InputError.of("statistics.method", place="method", value=method, known=", ".join(METHODS))
