"""Stated standard deviations of groups of observations, and estimates from the residuals of one solution.

The estimate comes from one round of variance components
(``fg_orient.quality.variance_components``). The test decides whether the residuals of a group
are larger than its sigmas allow. Let v be the whitened residuals of the group,
``r = tr(R_gg)`` their redundancy, and ``S = tr(R_gg R_gg)``. If all sigmas are right, the sum of squares ``q = v^T v``
has mean r and variance 2 S, and

    q r / S ~ chi2(r^2 / S)                                              (Satterthwaite 1946)

S is not larger than r, because the eigenvalues of R_gg are at most 1. If S is not computed, r replaces it;
the test then has fewer false alarms than stated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fg_orient.adjustment.memory import EXACT_RAYS
from fg_orient.adjustment.problem import Problem
from fg_orient.model.distributions import chi_square_probability, chi_square_tail
from fg_orient.model.options import USUAL_GROUPS
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.outlier_records import OutlierTests
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.variance_components import components_of, one_round

#: S is computed in every adjustment if the matrices of all groups have at most this number of
#: elements, because this takes little time.
QUICK: Final = 2**18
#: Names of the groups in sentences, and their units.
WORDS: Final = {
    "image": ("image points", "px"), "position": ("control points horizontally", "m"),
    "height": ("control points vertically", "m"),
}  # fmt: skip


@dataclass(frozen=True)
class StatedSigma:
    """Stated sigma of a group and its estimate from the residuals.

    Parameters
    ----------
    group : str
        "image points", "control points horizontally" or "control points vertically".
    stated : float or None
        Stated sigma; None if the observations of the group have different sigmas.
    unit : str
        "px" or "m".
    factor, sd : float
        Ratio of the estimated to the stated sigma, and its standard deviation.
    redundancy : float
        Redundancy of the group.
    larger, smaller : float
        Probability of this or a larger sum of squares, and of this or a smaller one, if all sigmas are correct.
    """

    group: str
    stated: float | None
    unit: str
    factor: float
    sd: float
    redundancy: float
    larger: float
    smaller: float

    @property
    def words(self) -> str:
        """Stated and estimated value: "stated 0.1 m, estimated 0.39 +- 0.05 m"."""
        if self.stated is None:
            return f"estimated {self.factor:.2f} +- {self.sd:.2f} times those stated"
        places = max(0, 1 - int(np.floor(np.log10(max(self.stated * self.sd, 1e-12)))))
        estimated = f"{self.stated * self.factor:.{places}f} +- {self.stated * self.sd:.{places}f}"
        return f"stated {self.stated:.4g} {self.unit}, estimated {estimated} {self.unit}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the record of a run."""
        stated = self.stated
        return {
            "group": self.group,
            "stated": stated,
            "unit": self.unit,
            "estimated": None if stated is None else stated * self.factor,
            "estimated_sd": None if stated is None else stated * self.sd,
            "factor": self.factor,
            "factor_sd": self.sd,
            "redundancy": self.redundancy,
            "sentence": self.words,
        }


def stated_sigmas(known: ResidualCofactors, without: OutlierTests | None = None) -> tuple[StatedSigma, ...]:
    """Return the groups with enough redundancy for an estimate.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of a solution without a loss.
    without : OutlierTests, optional
        Tests. The point of the most suspicious observation has a gross error, which is not an error of the
        sigmas. Therefore its worst observation in each group is omitted from the probabilities.
    """
    largest = QUICK if len(known.problem.observations) <= EXACT_RAYS else 0
    residuals = GroupedResiduals(known, groups_of(known.problem, USUAL_GROUPS), largest=largest)
    names, parts = residuals.groups.names, residuals.parts
    round_ = one_round(residuals)
    found = components_of(residuals.groups, round_, round_.variance, 1, "helmert")
    q, r, _ = residuals.sums()
    s = r if parts is None else np.clip(np.diag(parts.shared)[:-1], 1e-12, r)
    if without is not None and without.n_tested:
        own = without.point == without.point[0]
        for g, name in enumerate(names):
            of_group = own & (np.take(without.parts, without.part) == name)
            q[g] -= np.nanmax(without.quadratic[of_group], initial=0.0)
    freedom, value = r**2 / s, np.maximum(q, 0.0) * r / s
    larger, smaller = chi_square_tail(freedom, value), chi_square_probability(freedom, value)
    out = []
    for g, (name, one) in enumerate(zip(names, found.components, strict=True)):
        if not one.held and one.sd is not None:
            words, unit = WORDS[name]
            out.append(
                StatedSigma(
                    words,
                    _common(known.problem, name),
                    unit,
                    one.factor,
                    one.sd,
                    one.redundancy,
                    float(larger[g]),
                    float(smaller[g]),
                )
            )
    return tuple(out)


def _common(problem: Problem, group: str) -> float | None:
    """Return the sigma that all observations of a group have; None if they differ."""
    if group == "image":
        o = problem.observations
        values = np.concatenate([o.sigma_line_px, o.sigma_sample_px])
    else:
        sigma = problem.block.points.known.sigma_enu_m[problem.observed]
        values = sigma[:, :2].ravel() if group == "position" else sigma[:, 2]
    return float(values[0]) if len(values) and np.ptp(values) <= 1e-9 * abs(values[0]) else None
