"""Parsing and checks of the arguments that select sets, solvers, backends, types and regularisations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar, cast, get_args

from fg_orient.adjustment.linear import registry
from fg_orient.adjustment.linear.kappa import kappa_rules
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options
from fg_orient.model.options import Regularisation as Method
from fg_orient.model.parameters import eop_set_number
from fg_orient.studies.comparison.model import BACKENDS, TYPES, UNREGULARISED

T = TypeVar("T")


def _words(given: Any) -> list[str]:
    """Return the words of a selection, which is a number, a text with commas, or a list of both."""
    if isinstance(given, int):
        return [str(given)]
    return [str(word).strip() for word in (given.split(",") if isinstance(given, str) else given)]


def _once(chosen: Iterable[T], option: str, given: object) -> tuple[T, ...]:
    """Return a selection without repetitions; raise InputError if it is empty."""
    out = tuple(dict.fromkeys(chosen))
    if not out:
        raise InputError.of("compare.nothing", option=option, value=given)
    return out


def _chosen(given: Any, members: Mapping[str, Sequence[T]], option: str, code: str) -> tuple[T, ...]:
    """Return the members that the words of a selection name, each once.

    An unknown word raises InputError with this code.
    """
    words = _words(given)
    for word in words:
        if word not in members:
            raise InputError.of(code, option=option, value=word, known=", ".join(members))
    return _once((member for word in words for member in members[word]), option, given)


def eop_sets(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Return the numbers of the EOP sets in "1-20", "5,13,PUA" or a list of numbers and names, each once."""
    chosen: list[int] = []
    for word in _words(given):
        first, dash, last = word.partition("-")
        numbers = range(eop_set_number(first), eop_set_number(last if dash else first) + 1)
        if not numbers:
            raise InputError.of("compare.nothing", option="eop_sets", value=word)
        chosen += numbers
    return _once(chosen, "eop_sets", given)


def solver_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of the solvers in "all", "published", "svd,qr" or a list of names, each once."""
    known = registry.solvers()
    groups = {"all": list(known), "published": [name for name, one in known.items() if one.published]}
    return _chosen(given, {name: [name] for name in known} | groups, "solvers", "linear.solver")


def backend_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of the backends in "faithful,graph" or a list, in the order of ``BACKENDS``."""
    chosen = _chosen(given, {name: [name] for name in BACKENDS}, "backends", "adjust.backend")
    return tuple(sorted(chosen, key=BACKENDS.index))


def types(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Return the types of pre-adjustment in "1,2" or a list, in ascending order."""
    return tuple(sorted(_chosen(given, {str(kind): [kind] for kind in TYPES}, "types", "compare.type")))


def target(given: float | None) -> float | None:
    """Return the RMSE to reach, m, after a check; None stays None."""
    if given is not None and not (math.isfinite(given) and given > 0.0):
        raise InputError.of("compare.target", option="target", value=given)
    return given


def time_limit(given: float) -> float:
    """Return the limit of the processor time, s, after a check."""
    if not given > 0.0:
        raise InputError.of("compare.time_limit", option="time_limit_s", value=given)
    return given


# --- regularisations ------------------------------------------------------------------------------

#: Methods with a parameter kappa; the number of other methods is the cut of the rank.
WITH_KAPPA: Final = ("tikhonov", "truncated")
METHODS: Final[tuple[Method, ...]] = get_args(Method)


def regularisations(given: str | Iterable[str] | None) -> tuple[str, ...] | None:
    """Return the words of a selection of regularisations, each once.

    A word is "METHOD", "METHOD:RULE" or "METHOD:NUMBER"; "all" selects all methods; None
    stays None.
    """
    if given is None:
        return None
    out: list[str] = []
    for word in _words(given):
        method, colon, value = word.partition(":")
        possible = method in METHODS and not (colon and (method == UNREGULARISED or not _is_value(method, value)))
        if word != "all" and not possible:
            raise InputError.of(
                "compare.regularisation", option="regularisations", value=word, methods=", ".join(METHODS),
                rules=", ".join(_rules()),
            )  # fmt: skip
        out += METHODS if word == "all" else [word]
    return _once(out, "regularisations", given)


def _is_value(method: str, value: str) -> bool:
    """Return whether a text is a rule, a kappa or a cut of the rank for a method."""
    number = _number(value)
    if method in WITH_KAPPA:
        return value in _rules() or number > 0.0
    return 0.0 < number < 1.0


def _rules() -> list[str]:
    """Return the rules of kappa that do not need the true solution."""
    return [name for name, rule in kappa_rules().items() if "truth" not in rule.needs]


def _number(text: str) -> float:
    """Return the finite number in a text; nan for other texts."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def regularisation_of(options: Options) -> str:
    """Return the regularisation of options as one word, such as "none", "tikhonov:gcv" or "minimum_norm:1e-09"."""
    method = options.regularisation
    if method == UNREGULARISED:
        return UNREGULARISED
    if method in WITH_KAPPA:
        return f"{method}:{options.kappa_rule if options.kappa is None else format(options.kappa, 'g')}"
    return f"{method}:{options.rank_cut:g}"


def regularised(options: Options, word: str) -> Options:
    """Return options with the regularisation of a word; values that the word does not state stay unchanged.

    The word comes from :func:`regularisations`. The penalty of the options is used for
    Tikhonov's method; other methods penalise the deviation.
    """
    method, _, value = word.partition(":")
    out = replace(options, regularisation=cast(Method, method))
    if method != "tikhonov":
        out = replace(out, penalty="deviation", penalty_deviation=False)
    if method not in WITH_KAPPA:
        return replace(out, kappa=None, rank_cut=float(value) if value else options.rank_cut)
    number = _number(value)
    if math.isfinite(number):
        return replace(out, kappa=number)
    return replace(out, kappa=None, kappa_rule=value) if value else out


def options_of(word: str) -> dict[str, Any]:
    """Return the options of the project file for a complete word of :func:`regularisation_of`."""
    method, _, value = word.partition(":")
    out: dict[str, Any] = {"regularisation": method}
    if method in WITH_KAPPA:
        number = _number(value)
        out |= {"kappa": number} if math.isfinite(number) else {"kappa_rule": value}
    elif value:
        out["rank_cut"] = float(value)
    return out


#: Functions that check the arguments of ``compare`` and raise InputError, by the name of the argument.
SELECTIONS: Final[dict[str, Callable[[Any], Any]]] = {
    "eop_sets": eop_sets, "solvers": solver_names, "backends": backend_names, "types": types, "target_m": target,
    "time_limit_s": time_limit, "regularisations": regularisations,
}  # fmt: skip
