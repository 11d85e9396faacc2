"""Recommendation of a comparison: the EOP set, the engine and the reasons, and the accuracy that the block predicts.

Set. With check points, sets whose mean square error at these points exceeds the least one by at most its standard error
are not distinguishable (one-standard-error rule: Breiman et al. 1984); of these the set with the least AICc is taken
(``fg_orient.orientation.reduction``). The standard error of a mean square s is ``s sqrt(2 / h)``, h as below: errors of
the orientation are common to all check points, which are fewer independent errors than coordinates. Without check
points the least AICc decides. Sets with directions that nothing but a prior determines come last. The choice uses the
check points: they are then no longer an independent test of the chosen set, whose errors look slightly too small.

Target. The errors of n check points have the joint covariance C, which the adjustment predicts, with the variances of
the measured coordinates. Their mean square along an axis is about ``g chi2(h) / h`` with ``g = tr C / n`` and ``h =
(tr C)^2 / tr C^2`` (Satterthwaite 1946). Its 95 % limit of the worst ECEF axis is the RMSE to reach.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem
from fg_orient.model.distributions import chi_square_limit
from fg_orient.model.errors import NoSolutionError
from fg_orient.model.names import EOP_SETS, Status
from fg_orient.orientation.reduction import criteria
from fg_orient.orientation.solution import Solution
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.studies.comparison.model import LOOP_SOLVER, OWN_CHOICE, Key, Row

#: Probability that the RMSE of a correct prediction exceeds its limit.
LEVEL: Final = 0.05
#: Check points from which on they decide between sets.
ENOUGH: Final = 3
#: Differences up to which two engines have the same solution: prior sigmas, m.
SAME_SIGMAS, SAME_M = 1e-4, 1e-4
#: The default engine is recommended up to this processor time, and up to this multiple of the fastest engine.
NEGLIGIBLE_S: Final = 0.5
SLOWER: Final = 1.5


@dataclass(frozen=True)
class SetResult:
    """Adjustment with one EOP set, as by :func:`fg_orient.adjust`.

    Parameters
    ----------
    eop_set : int
    name : str
    image_unknowns : int
    failure : str
        Reason for a missing solution; "" if there is one.
    status, reason : str
        Status of the solution and its sentence.
    backend, solver, optimizer : str
        Engine of the adjustment; the solver of full matrices.
    undetermined : int
        Directions of the images that nothing but a prior determines.
    sigma0, global_p : float
        A posteriori standard deviation of unit weight, and probability of the global test.
    aic, aicc, bic : float
        Criteria of the model; nan without them.
    n_check : int
        Number of check points.
    check_rmse_3d_m : float
        RMSE of the check points, all axes together.
    check_freedom : float
        Number of independent errors in their mean square.
    predicted_m, limit_m : float
        Predicted RMSE at the check points of the worst ECEF axis, and its 95 % limit; nan without a covariance.
    prediction_factor : float
        Errors of the check points over the predicted ones, by their joint covariance.
    prediction_holds : bool or None
        Whether chance explains this factor; None if it is not tested.
    processor_s : float
        With all statistics.
    """

    eop_set: int
    name: str
    image_unknowns: int
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
    prediction_factor: float = math.nan
    prediction_holds: bool | None = None
    processor_s: float = math.nan

    @property
    def is_usable(self) -> bool:
        """Whether there is a converged solution."""
        return not self.failure and self.status != Status.NOT_CONVERGED.value


def of_failure(eop_set: int, failure: str, problem: Problem) -> SetResult:
    """Set without a solution."""
    return SetResult(eop_set, EOP_SETS[eop_set].name, problem.n_free_unknowns, failure)


def of_solution(eop_set: int, solution: Solution, processor_s: float) -> SetResult:
    """Set with its solution."""
    values: dict[str, Any] = {}
    with suppress(NoSolutionError):
        model = criteria(solution)
        values |= {name: _number(getattr(model, name)) for name in ("aic", "aicc", "bic")}
    with suppress(NoSolutionError):
        test = solution.global_test()
        values["global_p"] = math.nan if test is None else test.probability
    with suppress(NoSolutionError):
        prediction = solution.prediction_test()
        values |= {"prediction_factor": prediction.factor, "prediction_holds": prediction.honest}
    check = solution.accuracy.check
    predicted, limit, freedom = predicted_rmse(check)
    lengths = np.linalg.norm(check.enu_m, axis=1)
    return SetResult(
        eop_set, EOP_SETS[eop_set].name, solution.problem.n_free_unknowns, status=solution.status.value,
        reason=solution.reason, backend=solution.backend, solver=solution.solver, optimizer=solution.optimizer,
        undetermined=sum(solution.rank_defect.values()), sigma0=solution.sigma0, n_check=len(check),
        check_rmse_3d_m=float(np.sqrt(np.mean(lengths**2))) if len(lengths) else math.nan, check_freedom=freedom,
        predicted_m=predicted, limit_m=limit, processor_s=processor_s, **values,
    )  # fmt: skip


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def predicted_rmse(check: PointDifferences) -> tuple[float, float, float]:
    """Predicted RMSE of check points and its 95 % limit, of the worst ECEF axis, m; independent errors of all axes.

    nan, nan and the number of coordinates without a joint covariance.
    """
    if check.covariance_m2 is None or check.joint is None:
        return math.nan, math.nan, 3.0 * len(check)
    k, turn = len(check.selected), check.joint.axes[check.selected]
    c = check.covariance_m2.reshape(k, 3, k, 3)
    ecef = np.einsum("aji,ajbk,bkl->aibl", turn, c, turn)
    squares = [(float(np.trace(own)) / k, _limit(own)) for own in (ecef[:, axis, :, axis] for axis in range(3))]
    limit = math.sqrt(max(limit for _, limit in squares))
    return math.sqrt(max(s for s, _ in squares)), limit, _freedom(check.covariance_m2)


def _limit(covariance: Array) -> float:
    """Limit (95 %) of the mean square of correlated errors (n, n)."""
    freedom = _freedom(covariance)
    return float(np.trace(covariance)) / len(covariance) / freedom * float(chi_square_limit(freedom, LEVEL))


def _freedom(covariance: Array) -> float:
    """Number of independent errors in the mean square of correlated ones."""
    return float(np.trace(covariance)) ** 2 / float(np.sum(covariance**2))


# --- recommendation -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Advice:
    """Recommended set and engine.

    Parameters
    ----------
    eop_set : int or None
        None if no set has a solution.
    backend, solver, optimizer : str
        Columns of the recommended row; "" without one.
    set_reason, solver_reason : tuple of str
        Sentences.
    options : dict
        Options of the project file that make this adjustment.
    """

    eop_set: int | None = None
    backend: str = ""
    solver: str = ""
    optimizer: str = ""
    set_reason: tuple[str, ...] = ()
    solver_reason: tuple[str, ...] = ()
    options: dict[str, Any] | None = None

    @property
    def key(self) -> Key:
        """Engine of the recommended row."""
        return Key(self.backend, None, self.solver, self.optimizer)


def advise(sets: Sequence[SetResult], rows: Iterable[Row], labels: dict[str, str]) -> Advice:
    """Recommend a set and an engine for it.

    Parameters
    ----------
    sets : sequence of SetResult
    rows : iterable of Row
    labels : dict
        Solver name to its label.
    """
    best, why = best_set(sets)
    if best is None:
        return Advice(set_reason=why)
    options: dict[str, Any] = {"eop_set": best.eop_set}
    row, because = best_engine(best, [r for r in rows if r.eop_set == best.eop_set and r.backend != "faithful"], labels)
    if row is None:
        return Advice(best.eop_set, set_reason=why, solver_reason=because, options=options)
    options["backend"] = "graph" if row.backend == "explicit" else row.backend
    if row.backend == "dense":
        options["solver"] = row.solver
    options["optimizer"] = row.optimizer
    return Advice(best.eop_set, row.backend, row.solver, row.optimizer, why, because, options)


def best_set(sets: Sequence[SetResult]) -> tuple[SetResult | None, tuple[str, ...]]:
    """Recommended set and the reasons."""
    usable = [s for s in sets if s.is_usable]
    if not usable:
        first = next((s.failure or s.reason for s in sets), "")
        return None, (f"no EOP set has a solution: {first}" if first else "no engine that adjusts was compared",)
    determined = [s for s in usable if not s.undetermined] or usable
    left = len(usable) - len(determined)
    remark = (f"{_sets(left)} left aside: only priors determine some of their directions",) if left else ()
    if len(usable) == 1:
        return usable[0], ("the only set with a solution",)
    checked = [s for s in determined if s.n_check >= ENOUGH]
    if not checked:
        best = _least(determined)
        return best, (f"no check points decide: of {_sets(len(determined))} {_criterion(best, determined)}", *remark)
    closest = min(checked, key=lambda s: s.check_rmse_3d_m)
    equal = [s for s in checked if _indistinguishable(s, closest)]
    best = _least(equal)
    text = f"3-D RMSE {best.check_rmse_3d_m:.3g} m at {best.n_check} check points"
    if len(checked) == 1:
        return best, (text, *remark)
    if len(equal) == 1:
        return best, (f"{text}, the least of {_sets(len(checked))} by more than a standard error", *remark)
    text += f"; the least of {_sets(len(checked))} is {closest.check_rmse_3d_m:.3g} m (set {closest.eop_set})"
    within = f"{_sets(len(equal))} are within its standard error; of these {_criterion(best, equal)}"
    return best, (text, within, *remark)


def _sets(count: int) -> str:
    return f"{count} set" if count == 1 else f"{count} sets"


def _indistinguishable(one: SetResult, closest: SetResult) -> bool:
    """Whether the mean square at the check points exceeds the least one by at most its standard error."""
    return one.check_rmse_3d_m**2 <= closest.check_rmse_3d_m**2 * (1.0 + math.sqrt(2.0 / closest.check_freedom))


def _least(sets: Sequence[SetResult]) -> SetResult:
    """Set with the least AICc; without it BIC, then fewest unknowns."""
    name = _decisive(sets)
    return min(sets, key=lambda s: (getattr(s, name), s.image_unknowns, s.eop_set))


def _decisive(sets: Sequence[SetResult]) -> str:
    """Criterion that all sets have."""
    return next((n for n in ("aicc", "bic") if all(math.isfinite(getattr(s, n)) for s in sets)), "image_unknowns")


def _criterion(best: SetResult, sets: Sequence[SetResult]) -> str:
    """Words on the criterion, and whether BIC agrees."""
    name = _decisive(sets)
    if name == "image_unknowns":
        return "it has the fewest unknowns (there is no AICc of all of them)"
    text = f"it has the least {'AICc' if name == 'aicc' else 'BIC'}"
    other = min(sets, key=lambda s: s.bic)
    if name == "bic" or not math.isfinite(other.bic):
        return text
    return f"{text} and BIC" if other is best else f"{text} (the least BIC: set {other.eop_set})"


def best_engine(
    best: SetResult, rows: Sequence[Row], labels: dict[str, str]
) -> tuple[Row | None, tuple[str, ...]]:  # fmt: skip
    """Recommended row among those of the set, which options can select, and the reasons."""
    solved = [r for r in rows if not r.failure]
    same = [r for r in solved if not (r.difference_sigmas > SAME_SIGMAS or r.difference_m > SAME_M)]
    eliminated = any(r.backend == "graph" and not r.left_out for r in rows)
    possible = [r for r in same if r.backend in ("dense", "graph") or (r.backend == "schur" and OWN_CHOICE in r.notes)
                or (r.backend == "explicit" and not eliminated and _is_default(best, r))]  # fmt: skip
    if not possible:
        return None, ("no engine that options select has this solution",)
    fastest = min(possible, key=lambda r: r.processor_s)
    default = next((r for r in possible if _is_default(best, r)), None)
    enough = max(NEGLIGIBLE_S, SLOWER * fastest.processor_s)
    chosen = default if default is not None and default.processor_s <= enough else fastest
    others: dict[str, Row] = {}
    for r in sorted(same, key=lambda r: r.processor_s):
        if r.backend != chosen.backend:
            others.setdefault(r.backend, r)
    times = [f"{'the default' if chosen is default else 'the fastest'} {chosen.processor_s:.2g} s"]
    times += [f"{r.key.name(labels)} {r.processor_s:.2g} s" for r in others.values()]
    return chosen, (_agreement(rows, solved, same), f"processor time: {'; '.join(times)}")


def _agreement(rows: Sequence[Row], solved: Sequence[Row], same: Sequence[Row]) -> str:
    """Sentence on the engines with the same solution, another one, and none."""
    left = sum(r.left_out for r in rows)
    text = f"{len(same)} of {len(rows)} engines give the same solution"
    apart = [max((getattr(r, name) for r in same if math.isfinite(getattr(r, name))), default=math.nan)
             for name in ("difference_sigmas", "difference_m")]  # fmt: skip
    if all(map(math.isfinite, apart)):
        text += f" (within {apart[0]:.0e} prior sigmas and {apart[1]:.0e} m)"
    failed = len(rows) - left - len(solved)
    untried = "was not tried" if left == 1 else "were not tried"
    for count, words in ((len(solved) - len(same), "another one"), (failed, "none"), (left, untried)):
        text += f", {count} {words}" if count else ""
    return text


def _is_default(best: SetResult, row: Row) -> bool:
    """Whether the program adjusts the block in this way by default."""
    if row.optimizer != best.optimizer:
        return False
    if row.backend == "dense":
        return best.backend == "dense" and row.solver == best.solver
    if row.backend == "explicit" and row.solver != LOOP_SOLVER:
        return False
    return best.backend == ("graph" if row.backend == "explicit" else row.backend)
