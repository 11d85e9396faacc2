"""Register linear solvers; each is one function with a unique name.

A solver is ``function(system: LinearSystem, as_run: bool) -> LinearSolution``. If it
fails, it raises :class:`fg_orient.adjustment.linear.system.Breakdown`; it never returns
nan or inf. ``as_run`` selects the behaviour of the authors' program (real parts of
complex square roots); most solvers ignore it. A file that calls :func:`register_solver`
adds a solver; see docs/extending.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Literal, get_args

import numpy as np

from fg_orient.adjustment.linear.system import Breakdown, LinearSolution, LinearSystem
from fg_orient.model.errors import InputError

Family = Literal["inverse", "elimination", "tikhonov", "modern"]
Function = Callable[[LinearSystem, bool], LinearSolution]

#: Modules of this package that register solvers when imported.
_MODULES = ("inverses", "elimination", "modern", "shrinkage")


@dataclass(frozen=True)
class Solver:
    """Registered solver with a unique name; published methods have the names of the tables ("gauss_inverse").

    ``label`` is the text for tables and plots ("Gauss inverse"), ``source`` author, year
    and equation. ``published`` methods are taken from Terlemezoğlu 2019. ``function``: see the module
    docstring.
    """

    name: str
    label: str
    family: Family
    function: Function
    source: str
    published: bool = False


_REGISTRY: dict[str, Solver] = {}


def register_solver(
    name: str, label: str, family: Family, *, source: str, published: bool = False
) -> Callable[[Function], Function]:
    """Decorate a function to make it a solver.

    Parameters
    ----------
    name, label : str
        Name in options; label in tables.
    family : str
        Group of solvers in tables and figures.
    source : str
        Author, year and equation.
    published : bool
        The solver is one of Terlemezoğlu 2019.

    Raises
    ------
    ValueError
        Another solver has this name.
    """

    def add(function: Function) -> Function:
        present = _REGISTRY.get(name)
        if present is not None and present.function.__qualname__ != function.__qualname__:
            raise ValueError(f"a solver named {name!r} is registered already")
        _REGISTRY[name] = Solver(name, label, family, function, source, published)
        return function

    return add


def register_published(family: Family, name: str, label: str, equations: str) -> Callable[[Function], Function]:
    """Decorate a function to make it a solver of Terlemezoğlu 2019."""
    return register_solver(name, label, family, source=f"Terlemezoğlu 2019, {equations}", published=True)


def solvers() -> dict[str, Solver]:
    """Return all solvers by name: the published ones in the order of the publication, then the others."""
    for module in _MODULES:
        import_module(f"fg_orient.adjustment.linear.{module}")
    entries = sorted(_REGISTRY.values(), key=lambda s: (not s.published, get_args(Family).index(s.family)))
    return {entry.name: entry for entry in entries}


def solver(name: str) -> Solver:
    """Find a solver.

    InputError: there is no solver of this name.
    """
    known = solvers()
    if name not in known:
        raise InputError.of("linear.solver", option="solver", value=name, known=", ".join(known))
    return known[name]


def solve(name: str, system: LinearSystem, *, as_run: bool = False) -> LinearSolution:
    """Solve a system.

    Raises
    ------
    Breakdown
        The solver fails, or its result is not finite.
    InputError
        There is no solver of this name; A is required but not known; the result is not a real array (u,).
    """
    with np.errstate(all="ignore"):  # values that are not finite are refused below, with the name of the solver
        try:
            solution = solver(name).function(system, as_run)
        except np.linalg.LinAlgError as error:
            raise Breakdown.of("linear.library", place=name, value=error) from error
    if solution.x.shape != system.rhs.shape or not np.isrealobj(solution.x):
        raise InputError.of("linear.result_shape", place=name, value=f"shape {solution.x.shape}", unknowns=len(system))
    if not np.isfinite(solution.x).all():
        raise Breakdown.of("linear.result_not_finite", place=name)
    return solution


def attempt(name: str, system: LinearSystem, *, as_run: bool = False) -> LinearSolution:
    """Solve a system for a table: if the solver fails, x is nan, and ``failure`` contains the reason."""
    try:
        return solve(name, system, as_run=as_run)
    except Breakdown as error:
        return LinearSolution(np.full(len(system), np.nan), failure=str(error))
