"""Common part of the result of every adjustment and of every round of a search for gross errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Weights, weighted_problem
from fg_orient.model.block import Block
from fg_orient.model.errors import Finding, NoSolutionError
from fg_orient.model.names import Status
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.outlier_records import OutlierTests
from fg_orient.quality.outliers import outlier_tests
from fg_orient.quality.reliability import unseen_shifts
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import Kind
from fg_orient.quality.variance_components import VarianceComponents


@dataclass(frozen=True, kw_only=True)
class AdjustmentResult:
    """Fit, cofactors and tests of an adjustment, also of each round of a search for gross errors.

    Parameters
    ----------
    problem : Problem
        Problem that was solved: block, parameters, weights, start.
    status : Status
    state : State
        Unknowns in prior sigmas and local metres.
    chi2 : float
        Weighted sum of squares of all residuals; under a loss with the weights at the solution.
    cofactors : Cofactors or None
        Cofactors; None if the covariance cannot be computed, for the reason in ``unavailable``. Under a loss these are
        the cofactors of least squares with the weights at the solution.
    weights : Weights or None
        Weights of image points (n,) and ground points (N,) under a loss.
    components : VarianceComponents or None
        Variance components that were applied to the sigmas of ``block``, if the options request them.
    residuals : ResidualCofactors or None
        Cofactors of the residuals, if the assessment of this solution has computed them.
    tests : OutlierTests or None
        Tests of all observations according to the options, if the assessment of this solution has computed them.
    """

    problem: Problem
    status: Status
    state: State
    chi2: float
    cofactors: Cofactors | None
    unavailable: tuple[Finding, ...] = ()
    weights: Weights | None = None
    components: VarianceComponents | None = None
    residuals: ResidualCofactors | None = None
    tests: OutlierTests | None = None

    @property
    def block(self) -> Block:
        """Block that was adjusted."""
        return self.problem.block

    @property
    def redundancy(self) -> float:
        """Observations minus unknowns; with a penalty observations minus the trace of their hat matrix."""
        return self.problem.redundancy

    @property
    def sigma0(self) -> float:
        """A posteriori standard deviation of unit weight (nan without redundancy); below 1 under a loss."""
        return float(np.sqrt(self.chi2 / self.redundancy)) if self.redundancy > 0 else float("nan")

    def required_cofactors(self, *, unweighted: str = "") -> Cofactors:
        """Return the cofactors; raise NoSolutionError if there are none."""
        if self.cofactors is None:
            raise NoSolutionError.of("covariance.unavailable", value="; ".join(map(str, self.unavailable)))
        self._require_unweighted(unweighted)
        return self.cofactors

    def _require_unweighted(self, code: str) -> None:
        if self.weights is not None and code:
            raise NoSolutionError.of(code, place=self.block.options.loss)

    @cached_property
    def weighted(self) -> Problem:
        """Problem to which the cofactors belong: under a loss with the weights at the solution."""
        return self.problem if self.weights is None else weighted_problem(self.problem, self.weights)

    @cached_property
    def residual_cofactors(self) -> ResidualCofactors:
        """Residuals, their cofactors (whitened, prior scale) and redundancy numbers."""
        known = self.residuals
        if known is not None and known.problem is self.weighted and known.cofactors is self.cofactors:
            return known
        return ResidualCofactors(self.weighted, self.state, self.required_cofactors())

    def outlier_tests(
        self, *, level: float | None = None, test: str | None = None, control: str | None = None, kind: Kind = "groups"
    ) -> OutlierTests:
        """Test every observation for a gross error, most suspicious first; see ``fg_orient.quality.outliers``.

        Parameters
        ----------
        level, test, control : optional
            Default: options ``outlier_level``, ``outlier_test`` and ``multiple_testing`` of the block.
        kind : str
            "groups": image points, position and height of control points; "coordinates"; "points".

        Raises
        ------
        InputError
            Invalid name or level.
        NoSolutionError
            The covariance could not be computed.
        """
        self.required_cofactors(unweighted="covariance.weighted")
        options, known = self.block.options, self.tests
        level = options.outlier_level if level is None else level
        test = options.outlier_test if test is None else test
        control = options.multiple_testing if control is None else control
        if known is not None and known.problem is self.problem and self.components is None and kind == "groups":
            if (known.level, known.test, known.control) == (level, test, control):
                return known
        return outlier_tests(
            self.residual_cofactors,
            self.chi2,
            kind=kind,
            components=self.components,
            level=level,
            test=test,
            control=control,
        )

    @cached_property
    def unseen_shifts(self) -> Array:
        """Shift (N, 3), m, East, North, Up of points that an unseen error of one pixel causes; nan if there is none.

        See ``fg_orient.quality.reliability``.
        """
        return unseen_shifts(self.residual_cofactors)
