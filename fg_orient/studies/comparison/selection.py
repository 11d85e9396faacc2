"""What to compare: EOP sets, solvers, backends and types, as words or as lists."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from fg_orient.adjustment.linear import registry
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import eop_set_number
from fg_orient.studies.comparison.model import BACKENDS, TYPES

T = TypeVar("T")


def eop_sets(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Numbers of the EOP sets in "1-20", "5,13,PUA" or a list of numbers and names; each once.

    Raises
    ------
    InputError
        There is no such set, or none is given.
    """
    words = [given] if isinstance(given, int) else given.split(",") if isinstance(given, str) else list(given)
    found: list[int] = []
    for word in words:
        first, dash, last = str(word).partition("-")
        numbers = range(eop_set_number(first), eop_set_number(last if dash else first) + 1)
        if not numbers:
            raise InputError.of("compare.nothing", option="eop_sets", value=word)
        found += numbers
    return _once(found, "eop_sets", given)


def solver_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Names of the solvers in "all", "published", "svd,qr" or a list of names; each once.

    Raises
    ------
    InputError
        There is no such solver, or none is given.
    """
    known = registry.solvers()
    found: list[str] = []
    for word in given.split(",") if isinstance(given, str) else list(given):
        name = word.strip()
        if name == "all":
            found += known
        elif name == "published":
            found += [n for n, s in known.items() if s.published]
        elif name in known:
            found.append(name)
        else:
            raise InputError.of("linear.solver", option="solvers", value=name, known=", ".join(known))
    return _once(found, "solvers", given)


def backend_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Names of the backends in "faithful,graph" or a list, in our order.

    Raises
    ------
    InputError
        There is no such backend, or none is given.
    """
    words = [w.strip() for w in (given.split(",") if isinstance(given, str) else given)]
    for word in words:
        if word not in BACKENDS:
            raise InputError.of("adjust.backend", option="backends", value=word, known=", ".join(BACKENDS))
    return _once([name for name in BACKENDS if name in words], "backends", given)


def types(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Types of pre-adjustment in "1,2" or a list, in order.

    Raises
    ------
    InputError
        Neither 1 nor 2, or none is given.
    """
    words = [given] if isinstance(given, int) else given.split(",") if isinstance(given, str) else list(given)
    texts = [str(word).strip() for word in words]
    for text in texts:
        if text not in map(str, TYPES):
            raise InputError.of("compare.type", option="types", value=text)
    return _once([kind for kind in TYPES if str(kind) in texts], "types", given)


def require(options: Mapping[str, Any]) -> None:
    """Refuse arguments of ``compare`` that select nothing, before any file is read.

    Raises
    ------
    InputError
        Something does not exist, or nothing is given.
    """
    judges: dict[str, Callable[[Any], object]] = {
        "eop_sets": eop_sets, "solvers": solver_names, "backends": backend_names, "types": types,
    }  # fmt: skip
    for name in [name for name in judges if name in options]:
        judges[name](options[name])
    if options.get("target_m") is not None:
        target(options["target_m"])


def target(given: float) -> float:
    """Length to reach, m.

    Raises
    ------
    InputError
        Not above zero, or not finite.
    """
    if not (math.isfinite(given) and given > 0.0):
        raise InputError.of("compare.target", option="target", value=given)
    return given


def _once(found: list[T], place: str, given: object) -> tuple[T, ...]:
    """Drop repetitions; nothing at all is refused."""
    if not found:
        raise InputError.of("compare.nothing", place=place, value=given)
    return tuple(dict.fromkeys(found))
