"""Recommendation of an EOP set, a regularisation and an engine, with reasons.

EOP set: two sets are not distinguishable if the mean square error at the check points exceeds
the least one by at most its standard error (one-standard-error rule: Breiman et al. 1984). Of
these sets, the set with the least AICc is recommended (``fg_orient.orientation.reduction``).
The standard error of a mean square s is ``s sqrt(2 / h)``, h as in ``set_results``: errors of
the orientation are common to all check points, so there are fewer independent errors than
coordinates. Without check points the least AICc decides. Sets with directions that only a
prior determines come last. If check points have selected a set, they no longer test it
independently: its errors appear slightly too small.

Regularisation: a regularised estimate is biased. Its standard deviations are not an accuracy,
and its likelihood has no AICc. Estimates are compared by the errors at check points, which
contain the bias. An estimate without regularisation is recommended if it is not
distinguishable from the best one. Without check points a regularised estimate is recommended
only if no other estimate has a solution. Of several regularised estimates, the one with the
fewest effective unknowns (trace of the resolution) is recommended.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from fg_orient.studies.comparison.model import LOOP_SOLVER, OWN_CHOICE, Key, Row
from fg_orient.studies.comparison.selections import options_of
from fg_orient.studies.comparison.set_results import SetResult

#: Number of check points that is sufficient to decide between sets.
ENOUGH: Final = 3
#: Two engines have the same solution if the differences are at most these: prior sigmas, m.
SAME_SIGMAS, SAME_M = 1e-4, 1e-4
#: The default engine is recommended if its processor time is at most this, or at most this
#: multiple of the fastest engine's.
NEGLIGIBLE_S: Final = 0.5
SLOWER: Final = 1.5


@dataclass(frozen=True)
class Advice:
    """Recommended set, regularisation and engine.

    Parameters
    ----------
    eop_set : int or None
        None if no set has a solution.
    backend, solver, optimizer, regularisation : str
        Columns of the recommended row; "" without one.
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
        """Engine of the recommended row, as a key."""
        return Key(self.backend, None, self.solver, self.optimizer, self.regularisation)

    @property
    def set_key(self) -> tuple[int | None, str]:
        """Recommended set and its regularisation."""
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
        Solver name to its label.
    priors : bool
        True if the block was adjusted with priors. Otherwise the options contain this, too.
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
    """Return a warning on a regularised estimate; nothing for other estimates."""
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
    """Return a set and the reason: not regularised, then least AICc (or BIC), then fewest unknowns."""
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
    """Return a text on the criterion, and on the agreement of BIC."""
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
    """Return the recommended engine for a set, of those that options can select, and the reasons."""
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
    """Return a sentence on the engines with the same solution, with another solution, and without solution."""
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
    """Return whether this row is the default way in which the program adjusts the block."""
    if row.optimizer != best.optimizer:
        return False
    if row.backend == "dense":
        return best.backend == "dense" and row.solver == best.solver
    if row.backend == "explicit" and row.solver != LOOP_SOLVER:
        return False
    return best.backend == ("graph" if row.backend == "explicit" else row.backend)
