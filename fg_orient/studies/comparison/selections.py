"""Read and check the selections of a comparison: sets, solvers, backends, types and regularisations."""

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
    """Remove repetitions; raise InputError for an empty selection."""
    out = tuple(dict.fromkeys(chosen))
    if not out:
        raise InputError.of("compare.nothing", option=option, value=given)
    return out


def _chosen(given: Any, members: Mapping[str, Sequence[T]], option: str, code: str) -> tuple[T, ...]:
    """Return the selected members, each once.

    Raise InputError with this code for an unknown word.
    """
    words = _words(given)
    for word in words:
        if word not in members:
            raise InputError.of(code, option=option, value=word, known=", ".join(members))
    return _once((member for word in words for member in members[word]), option, given)


def eop_sets(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Return the numbers of EOP sets, each once, from "1-20", "5,13,PUA" or a list of numbers and names."""
    chosen: list[int] = []
    for word in _words(given):
        first, dash, last = word.partition("-")
        numbers = range(eop_set_number(first), eop_set_number(last if dash else first) + 1)
        if not numbers:
            raise InputError.of("compare.nothing", option="eop_sets", value=word)
        chosen += numbers
    return _once(chosen, "eop_sets", given)


def solver_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of solvers, each once, from "all", "published", "svd,qr" or a list of names."""
    known = registry.solvers()
    groups = {"all": list(known), "published": [name for name, one in known.items() if one.published]}
    return _chosen(given, {name: [name] for name in known} | groups, "solvers", "linear.solver")


def backend_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of backends in the order of ``BACKENDS``, from "faithful,graph" or a list."""
    chosen = _chosen(given, {name: [name] for name in BACKENDS}, "backends", "adjust.backend")
    return tuple(sorted(chosen, key=BACKENDS.index))


def types(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Return the types of pre-adjustment in order, from "1,2" or a list."""
    return tuple(sorted(_chosen(given, {str(kind): [kind] for kind in TYPES}, "types", "compare.type")))


def target(given: float | None) -> float | None:
    """Check the RMSE to reach, m; None is returned unchanged."""
    if given is not None and not (math.isfinite(given) and given > 0.0):
        raise InputError.of("compare.target", option="target", value=given)
    return given


def time_limit(given: float) -> float:
    """Check the limit of the processor time, s."""
    if not given > 0.0:
        raise InputError.of("compare.time_limit", option="time_limit_s", value=given)
    return given


# --- regularisations ------------------------------------------------------------------------------

#: Methods with a parameter kappa. For other methods, the number in a word is the cut of the rank.
WITH_KAPPA: Final = ("tikhonov", "truncated")
METHODS: Final[tuple[Method, ...]] = get_args(Method)


def regularisations(given: str | Iterable[str] | None) -> tuple[str, ...] | None:
    """Return the words "METHOD", "METHOD:RULE" or "METHOD:NUMBER" of a selection, each once.

    "all" selects all methods; None is returned unchanged.
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
    """Return whether a text is a rule, a kappa or a cut of the rank that is valid for a method."""
    number = _number(value)
    if method in WITH_KAPPA:
        return value in _rules() or number > 0.0
    return 0.0 < number < 1.0


def _rules() -> list[str]:
    """Return the rules of kappa that do not need the true solution."""
    return [name for name, rule in kappa_rules().items() if "truth" not in rule.needs]


def _number(text: str) -> float:
    """Read a text as a finite number; nan for other texts."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def regularisation_of(options: Options) -> str:
    """Return the regularisation of options as a word: "none", "tikhonov:gcv", "truncated:0.1", "minimum_norm:1e-09"."""
    method = options.regularisation
    if method == UNREGULARISED:
        return UNREGULARISED
    if method in WITH_KAPPA:
        return f"{method}:{options.kappa_rule if options.kappa is None else format(options.kappa, 'g')}"
    return f"{method}:{options.rank_cut:g}"


def regularised(options: Options, word: str) -> Options:
    """Return the options with the regularisation of a word from :func:`regularisations`.

    Parts that the word leaves out are not changed. The penalty of the options is used for
    Tikhonov's method only; the other methods penalise the deviation.
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
    """Return the options of the project file that correspond to a complete word of :func:`regularisation_of`."""
    method, _, value = word.partition(":")
    out: dict[str, Any] = {"regularisation": method}
    if method in WITH_KAPPA:
        number = _number(value)
        out |= {"kappa": number} if math.isfinite(number) else {"kappa_rule": value}
    elif value:
        out["rank_cut"] = float(value)
    return out


#: For each argument of ``compare``, the function that checks it and raises InputError.
SELECTIONS: Final[dict[str, Callable[[Any], Any]]] = {
    "eop_sets": eop_sets, "solvers": solver_names, "backends": backend_names, "types": types, "target_m": target,
    "time_limit_s": time_limit, "regularisations": regularisations,
}  # fmt: skip
