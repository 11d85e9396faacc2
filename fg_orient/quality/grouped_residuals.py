"""Residuals of a solution with the groups of its observations: sums, redundancies and medians of each group."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fg_orient.adjustment.problem import participates
from fg_orient.model.arrays import Array, Index
from fg_orient.model.distributions import chi_square_median
from fg_orient.quality.hypotheses import CHECKED
from fg_orient.quality.observation_groups import Groups
from fg_orient.quality.residuals import LARGEST, GroupCofactors, ResidualCofactors, cost


@dataclass(frozen=True, eq=False)
class GroupedResiduals:
    """Residuals of a solution by any backend, with the groups of its observations.

    Parameters
    ----------
    known : ResidualCofactors
    groups : Groups
    largest : int, optional
        Elements of the matrices of all groups above which they are not computed.
    """

    known: ResidualCofactors
    groups: Groups
    largest: int | None = None

    @cached_property
    def labels(self) -> Index:
        """Group of every row: image points, control points, priors, extra observations."""
        g, problem = self.groups, self.known.problem
        prior = np.concatenate([*g.prior, np.zeros(0, np.intp)])
        if len(prior) and problem.ties is not None:
            prior = prior[problem.ties.place]  # the prior of a shared unknown is one observation
        n_extra = sum(e.n_residuals for e in problem.block.extra)
        return np.concatenate([
            np.repeat(g.image[participates(problem.block)], 2), np.tile(g.axes, len(self.known.v_control)), prior,
            np.full(n_extra, -1),
        ]).astype(np.intp)  # fmt: skip

    def sums(self) -> tuple[Array, Array, Index]:
        """Sums of squares q, redundancies r and numbers of rows of all groups."""
        known = self.known
        v = np.concatenate([known.v_image.ravel(), known.v_control.ravel(), known.v_prior])
        blocks = (known.image, known.control)
        r = np.concatenate([*(np.einsum("nii->ni", block).ravel() for block in blocks), known.prior])
        rows, size = self.labels[: len(v)], len(self.groups.names)
        named = rows >= 0
        q, total = (np.bincount(rows[named], w[named], size).astype(float) for w in (v**2, r))
        return q, total, np.bincount(rows[named], minlength=size)

    @cached_property
    def parts(self) -> GroupCofactors | None:
        """Contributions of the groups to the cofactors; None if the block is too large."""
        if cost(self.known.problem, len(self.groups.names)) > (LARGEST if self.largest is None else self.largest):
            return None
        return GroupCofactors(self.known, self.labels, len(self.groups.names))

    def medians(self) -> Array:
        """Median of the quadratic form of each group's units over that of chi-square; nan if nothing is checked.

        Points with a single image point are left out: their form is the same for image and ground.
        """
        known, parts = self.known, dict[int, list[float]]()
        problem, o = known.problem, known.problem.observations
        many = np.bincount(o.point, minlength=len(problem.active)) > 1
        rays, seen = many[o.point], many[problem.observed]
        image, prior = self.labels[: 2 * len(o)].reshape(-1, 2), self.labels[2 * len(o) + known.v_control.size :]
        for labels, v, q in (
            (image[rays], known.v_image[rays], known.image[rays]),
            (np.tile(self.groups.axes, (int(seen.sum()), 1)), known.v_control[seen], known.control[seen]),
            (prior[:, None], known.v_prior[:, None], known.prior[:, None, None]),
        ):
            for unit in zip(labels, v, q, strict=False):  # extra observations belong to no group
                _add(parts, *unit)
        return np.array([np.median(parts[g]) if g in parts else np.nan for g in range(len(self.groups.names))])


def _add(parts: dict[int, list[float]], labels: Index, v: Array, q: Array) -> None:
    """Add the quadratic form of one unit, over the median of chi-square, to each of its groups."""
    for label in set(labels.tolist()) - {-1}:
        mine = np.flatnonzero(labels == label)
        size, axes = np.linalg.eigh(q[np.ix_(mine, mine)])
        if size[0] > CHECKED:
            form = float(np.sum((axes.T @ v[mine]) ** 2 / size))
            parts.setdefault(label, []).append(form / float(chi_square_median(len(mine))))
