"""Results of a comparison by EOP set and regularisation, and the predicted accuracy at the check points.

The RMSE to reach is derived as follows. The adjustment predicts the joint covariance
matrix C of the errors of n check points; C includes the variances of the measured
coordinates. Along an axis, their mean square is approximately ``g chi2(h) / h`` with ``g
= tr C / n`` and ``h = (tr C)^2 / tr C^2`` (Satterthwaite 1946). The 95 % limit for the
worst ECEF axis is the RMSE to reach. For a regularised estimate, C contains the expected
products of the errors including the bias (``fg_orient.quality.regularised_points``).
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem
from fg_orient.model.distributions import chi_square_limit
from fg_orient.model.errors import NoSolutionError
from fg_orient.model.names import EOP_SETS, Status
from fg_orient.orientation.reduction import criteria
from fg_orient.orientation.solution import Solution
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.regularised_points import expected_errors
from fg_orient.studies.comparison.model import UNREGULARISED, regularisation_words
from fg_orient.studies.comparison.selections import regularisation_of

#: Probability that the RMSE of a correct prediction exceeds its limit.
LEVEL: Final = 0.05


@dataclass(frozen=True)
class SetResult:
    """Result of :func:`fg_orient.adjust` with one EOP set.

    Parameters
    ----------
    eop_set : int
    name : str
    image_unknowns : int
    regularisation : str
        Word for the regularisation, as in a row.
    kappa : float
        Regularisation parameter; nan if there is none.
    held : int
        Number of directions that a truncation or a minimum norm keeps at the metadata.
    effective_unknowns : float
        Number of image unknowns that the penalty does not determine: trace of the
        resolution, including the share of priors. nan without a regularisation.
    failure : str
        Reason for a missing solution; "" if there is one.
    status, reason : str
        Status of the solution and its sentence.
    backend, solver, optimizer : str
        Engine of the adjustment; the solver of full matrices.
    undetermined : int
        Number of directions of the images that only a prior determines.
    sigma0, global_p : float
        A posteriori standard deviation of unit weight, and probability of the global test.
    aic, aicc, bic : float
        Information criteria of the model; nan if they do not exist.
    n_check : int
        Number of check points.
    check_rmse_3d_m : float
        RMSE of the check points over all axes.
    check_freedom : float
        Number of independent errors in the mean square of the check points.
    predicted_m, limit_m : float
        Predicted RMSE at the check points of the worst ECEF axis, and its 95 % limit; nan
        without a covariance. With a regularisation they contain the bias of true
        deviations of one prior sigma.
    bias_m : float
        Part of ``predicted_m`` that is bias, for its axis; nan without a regularisation.
    prediction_factor : float
        Ratio of the errors at the check points to the predicted errors, by their joint
        covariance matrix; nan with a regularisation.
    prediction_holds : bool or None
        True if chance explains this factor; None if it is not tested.
    processor_s : float
        Processor time with all statistics, s.
    """

    eop_set: int
    name: str
    image_unknowns: int
    regularisation: str = UNREGULARISED
    kappa: float = math.nan
    held: int = 0
    effective_unknowns: float = math.nan
    failure: str = ""
    status: str = ""
    reason: str = ""
    backend: str = ""
    solver: str = ""
    optimizer: str = ""
    undetermined: int = 0
    sigma0: float = math.nan
    global_p: float = math.nan
    aic: float = math.nan
    aicc: float = math.nan
    bic: float = math.nan
    n_check: int = 0
    check_rmse_3d_m: float = math.nan
    check_freedom: float = math.nan
    predicted_m: float = math.nan
    limit_m: float = math.nan
    bias_m: float = math.nan
    prediction_factor: float = math.nan
    prediction_holds: bool | None = None
    processor_s: float = math.nan

    @property
    def is_usable(self) -> bool:
        """Return whether there is a converged solution."""
        return not self.failure and self.status != Status.NOT_CONVERGED.value

    @property
    def is_regularised(self) -> bool:
        """Return whether the estimate is biased because of a regularisation."""
        return self.regularisation != UNREGULARISED

    @property
    def key(self) -> tuple[int, str]:
        """Return the set and the regularisation."""
        return self.eop_set, self.regularisation

    @property
    def words(self) -> str:
        """Return set, name and regularisation in words, for example "20 (PUVA), tikhonov (gcv)"."""
        own = regularisation_words(self.regularisation)
        return f"{self.eop_set} ({self.name})" + (f", {own}" if own else "")


def of_failure(eop_set: int, failure: str, problem: Problem, regularisation: str = UNREGULARISED) -> SetResult:
    """Make the result of a set without a solution."""
    name = EOP_SETS[eop_set].name
    return SetResult(eop_set, name, problem.n_free_unknowns, regularisation, failure=failure)


def of_solution(eop_set: int, solution: Solution, processor_s: float) -> SetResult:
    """Make the result of a set from its solution."""
    values: dict[str, Any] = {}
    check, chosen = solution.accuracy.check, solution.problem.regularisation
    covariance = check.covariance_m2
    with suppress(NoSolutionError):
        test = solution.global_test()
        values["global_p"] = math.nan if test is None else test.probability
    if chosen is None:
        with suppress(NoSolutionError):
            model = criteria(solution)
            values |= {name: _number(getattr(model, name)) for name in ("aic", "aicc", "bic")}
        with suppress(NoSolutionError):
            prediction = solution.prediction_test()
            values |= {"prediction_factor": prediction.factor, "prediction_holds": prediction.honest}
    else:
        values |= {"kappa": _number(chosen.kappa), "held": chosen.held,
                   "effective_unknowns": solution.problem.n_free_unknowns - chosen.determined}  # fmt: skip
        covariance, bias = expected_at(solution, check)
        values["bias_m"] = bias_of(check, covariance, bias)
    predicted, limit, freedom = predicted_rmse(check, covariance)
    lengths = np.linalg.norm(check.enu_m, axis=1)
    return SetResult(
        eop_set, EOP_SETS[eop_set].name, solution.problem.n_free_unknowns,
        regularisation_of(solution.problem.block.options), status=solution.status.value,
        reason=solution.reason, backend=solution.backend, solver=solution.solver, optimizer=solution.optimizer,
        undetermined=sum(solution.rank_defect.values()), sigma0=solution.sigma0, n_check=len(check),
        check_rmse_3d_m=float(np.sqrt(np.mean(lengths**2))) if len(lengths) else math.nan, check_freedom=freedom,
        predicted_m=predicted, limit_m=limit, processor_s=processor_s, **values,
    )  # fmt: skip


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def expected_at(solution: Solution, check: PointDifferences) -> tuple[Array | None, Array | None]:
    """Return the expected products of the errors at selected check points (3k, 3k), and the products of the bias.

    The unit is m^2, and the axes are East, North, Up. The first matrix includes the
    variances of the measured coordinates. The solution is regularised. A matrix is None
    if it is unknown.
    """
    if check.joint is None or not len(check):
        return None, None
    rows = check.selected
    found = expected_errors(solution.weighted, solution.state, check.index[rows])
    if found is None:
        return None, None
    turn = block_diag(*check.joint.axes[rows])
    both = [turn @ own @ turn.T for own in (found.total, found.bias)]
    return both[0] + np.diag(check.own_sigma_enu_m[rows].ravel() ** 2), both[1]


def predicted_rmse(check: PointDifferences, covariance: Array | None) -> tuple[float, float, float]:
    """Return the predicted RMSE of check points on the worst ECEF axis, its 95 % limit, and the independent errors.

    The third value is the number of independent errors of all axes. ``covariance`` (3k,
    3k) belongs to the selected points in East, North, Up, m^2. Without it, the result is
    nan, nan and the number of coordinates.
    """
    if covariance is None:
        return math.nan, math.nan, 3.0 * len(check)
    squares = [(_mean_square(own), _limit(own)) for own in _by_axis(check, covariance)]
    limit = math.sqrt(max(limit for _, limit in squares))
    return math.sqrt(max(s for s, _ in squares)), limit, _freedom(covariance)


def bias_of(check: PointDifferences, covariance: Array | None, bias: Array | None) -> float:
    """Return the RMS of the bias along the axis of :func:`predicted_rmse`, m; nan if it is unknown."""
    if covariance is None or bias is None:
        return math.nan
    worst = int(np.argmax([_mean_square(own) for own in _by_axis(check, covariance)]))
    return math.sqrt(_mean_square(_by_axis(check, bias)[worst]))


def _by_axis(check: PointDifferences, covariance: Array) -> list[Array]:
    """Return the parts (k, k) along each ECEF axis of a matrix (3k, 3k) in East, North, Up."""
    assert check.joint is not None
    k, turn = len(check.selected), check.joint.axes[check.selected]
    ecef = np.einsum("aji,ajbk,bkl->aibl", turn, covariance.reshape(k, 3, k, 3), turn)
    return [ecef[:, axis, :, axis] for axis in range(3)]


def _mean_square(covariance: Array) -> float:
    return float(np.trace(covariance)) / len(covariance)


def _limit(covariance: Array) -> float:
    """Return the 95 % limit of the mean square of errors with the covariance matrix (n, n)."""
    freedom = _freedom(covariance)
    return _mean_square(covariance) / freedom * float(chi_square_limit(freedom, LEVEL))


def _freedom(covariance: Array) -> float:
    """Return the number of independent errors in the mean square of correlated errors."""
    return float(np.trace(covariance)) ** 2 / float(np.sum(covariance**2))
