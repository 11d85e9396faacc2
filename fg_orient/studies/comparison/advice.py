"""Recommend an EOP set, a regularisation and an engine from a comparison, with reasons.

The set is chosen as follows. If there are check points, the set with the least mean
square error at these points is the reference. Another set is not distinguishable from the reference if
its mean square error is larger by at most the standard error of the reference (one-standard-error rule:
Breiman et al. 1984). Of these sets, the set with the least AICc is recommended
(``fg_orient.orientation.reduction``). The standard error of a mean square s is ``s sqrt(2 / h)``, with
h as in ``set_results``. Errors of the orientation are common to all check points, so that the number h
of independent errors is smaller than the number of coordinates. Without check points, the least AICc
decides. Sets with directions that only a prior determines are last. After the choice, the check points
are no longer an independent test of the chosen set: its errors look slightly too small.

The regularisation is chosen as follows. A regularised estimate is biased. Its standard
deviations do not describe its accuracy, and its likelihood has no AICc. Therefore it is
compared by the errors at check points, which contain the bias. If an estimate without
regularisation is not distinguishable from the best one, it is recommended. Without check
points, a regularised estimate is recommended only if no other estimate has a solution. If
there are several, the estimate with the fewest effective unknowns (trace of the resolution) is
recommended.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from fg_orient.studies.comparison.model import LOOP_SOLVER, OWN_CHOICE, Key, Row
from fg_orient.studies.comparison.selections import options_of
from fg_orient.studies.comparison.set_results import SetResult

#: Minimum number of check points that decide between sets.
ENOUGH: Final = 3
#: Two engines have the same solution if they differ by at most this: prior sigmas, m.
SAME_SIGMAS, SAME_M = 1e-4, 1e-4
#: The default engine is recommended if it needs at most this processor time, s.
NEGLIGIBLE_S: Final = 0.5
#: It is also recommended if it needs at most this multiple of the time of the fastest engine.
SLOWER: Final = 1.5


@dataclass(frozen=True)
class Advice:
    """Recommended set, regularisation and engine.

    Parameters
    ----------
    eop_set : int or None
        Recommended set; None if no set has a solution.
    backend, solver, optimizer, regularisation : str
        Columns of the recommended row; "" if there is no such row.
    set_reason, solver_reason : tuple of str
        Reasons, as sentences.
    options : dict
        Options of the project file that select this adjustment.
    """

    eop_set: int | None = None
    backend: str = ""
    solver: str = ""
    optimizer: str = ""
    set_reason: tuple[str, ...] = ()
    solver_reason: tuple[str, ...] = ()
    options: dict[str, Any] | None = None
    regularisation: str = ""

    @property
    def key(self) -> Key:
        """Return the engine of the recommended row."""
        return Key(self.backend, None, self.solver, self.optimizer, self.regularisation)

    @property
    def set_key(self) -> tuple[int | None, str]:
        """Return the recommended set and its regularisation."""
        return self.eop_set, self.regularisation


def advise(
    sets: Sequence[SetResult], rows: Iterable[Row], labels: dict[str, str], *, priors: bool = True
) -> Advice:  # fmt: skip
    """Recommend a set and an engine for it.

    Parameters
    ----------
    sets : sequence of SetResult
    rows : iterable of Row
    labels : dict
        Labels of the solvers by name.
    priors : bool
        Whether the block was adjusted with priors. If not, the recommended options state it.
    """
    best, why = best_set(sets)
    if best is None:
        return Advice(set_reason=why)
    options: dict[str, Any] = {"eop_set": best.eop_set} if priors else {"eop_set": best.eop_set, "priors": False}
    if any(s.is_regularised for s in sets):
        options |= options_of(best.regularisation)
    own = [r for r in rows if (r.eop_set, r.regularisation) == best.key and r.backend != "faithful"]
    row, because = best_engine(best, own, labels)
    if row is None:
        return Advice(
            best.eop_set, set_reason=why, solver_reason=because, options=options, regularisation=best.regularisation
        )
    options["backend"] = "graph" if row.backend == "explicit" else row.backend
    if row.backend == "dense":
        options["solver"] = row.solver
    options["optimizer"] = row.optimizer
    return Advice(
        best.eop_set, row.backend, row.solver, row.optimizer, why, because, options, best.regularisation
    )  # fmt: skip


def best_set(sets: Sequence[SetResult]) -> tuple[SetResult | None, tuple[str, ...]]:
    """Return the recommended set with its regularisation, and the reasons."""
    usable = [s for s in sets if s.is_usable]
    if not usable:
        first = next((s.failure or s.reason for s in sets), "")
        return None, (f"no EOP set has a solution: {first}" if first else "no engine that adjusts was compared",)
    determined = [s for s in usable if not s.undetermined] or usable
    left = len(usable) - len(determined)
    holder = "priors or a regularisation determine" if any(s.is_regularised for s in usable) else "priors determine"
    remark = (f"{_sets(left, usable)} left aside: only {holder} some of their directions",) if left else ()
    if len(usable) == 1:
        return usable[0], (f"the only {_noun(sets)} with a solution", *_of_bias(usable[0]))
    checked = [s for s in determined if s.n_check >= ENOUGH]
    if not checked:
        best, why = _least(determined)
        text = f"no check points decide: of {_sets(len(determined), determined)} {why}"
        return best, (text, *_of_bias(best), *remark)
    closest = min(checked, key=lambda s: s.check_rmse_3d_m)
    equal = [s for s in checked if _indistinguishable(s, closest)]
    best, why = _least(equal)
    text = f"3-D RMSE {best.check_rmse_3d_m:.3g} m at {best.n_check} check points"
    if len(checked) == 1:
        return best, (text, *_of_bias(best), *remark)
    if len(equal) == 1:
        text += f", the least of {_sets(len(checked), checked)} by more than a standard error"
        return best, (text, *_of_bias(best), *remark)
    name = closest.words if closest.is_regularised else str(closest.eop_set)
    text += f"; the least of {_sets(len(checked), checked)} is {closest.check_rmse_3d_m:.3g} m (set {name})"
    within = f"{_sets(len(equal), equal)} are within its standard error; of these {why}"
    return best, (text, within, *_of_bias(best), *remark)


def _noun(sets: Sequence[SetResult]) -> str:
    return "set and regularisation" if any(s.is_regularised for s in sets) else "set"


def _sets(count: int, sets: Sequence[SetResult]) -> str:
    """Return the number of sets, or of pairs of set and regularisation, as words."""
    if any(s.is_regularised for s in sets):
        return f"{count} pair of set and regularisation" if count == 1 else f"{count} pairs of set and regularisation"
    return f"{count} set" if count == 1 else f"{count} sets"


def _of_bias(best: SetResult) -> tuple[str, ...]:
    """Return a warning if the estimate is regularised."""
    if not best.is_regularised:
        return ()
    text = "the estimate is regularised and therefore biased: its standard deviations do not describe its accuracy"
    if math.isfinite(best.bias_m):
        text += f"; of the predicted RMSE {best.bias_m:.2g} m are bias by deviations of one prior sigma"
    return (text,)


def _indistinguishable(one: SetResult, closest: SetResult) -> bool:
    """Return whether the mean square at the check points exceeds the least one by at most its standard error."""
    return one.check_rmse_3d_m**2 <= closest.check_rmse_3d_m**2 * (1.0 + math.sqrt(2.0 / closest.check_freedom))


def _least(sets: Sequence[SetResult]) -> tuple[SetResult, str]:
    """Return the set without regularisation that has the least AICc, and the reason.

    If AICc is missing, the least BIC decides, then the number of unknowns.
    """
    plain = [s for s in sets if not s.is_regularised]
    if not plain:
        best = min(sets, key=lambda s: (_or_inf(s.effective_unknowns), s.image_unknowns, s.eop_set))
        why = f"it has the fewest effective unknowns ({best.effective_unknowns:.3g}); biased estimates have no AICc"
        return best, why
    name = next((n for n in ("aicc", "bic") if all(math.isfinite(getattr(s, n)) for s in plain)), "image_unknowns")
    best = min(plain, key=lambda s: (getattr(s, name), s.image_unknowns, s.eop_set))
    if len(plain) == len(sets):
        return best, _criterion(name, best, plain)
    if len(plain) == 1:
        return best, "it alone is not regularised, and so without bias"
    return best, f"{len(plain)} are not regularised, and so without bias; of these {_criterion(name, best, plain)}"


def _or_inf(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _criterion(name: str, best: SetResult, sets: Sequence[SetResult]) -> str:
    """Describe the criterion, and whether BIC agrees with it."""
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
    """Return the recommended row of the set among the engines that options can select, and the reasons."""
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
    """Return a sentence on how many engines have the same solution, another solution, or no solution."""
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
    """Return whether the program would adjust the block with this engine by default."""
    if row.optimizer != best.optimizer:
        return False
    if row.backend == "dense":
        return best.backend == "dense" and row.solver == best.solver
    if row.backend == "explicit" and row.solver != LOOP_SOLVER:
        return False
    return best.backend == ("graph" if row.backend == "explicit" else row.backend)
