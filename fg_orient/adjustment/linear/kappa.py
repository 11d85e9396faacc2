"""Registry of rules for the regularisation parameter kappa, and the algebraic rules HKB, LW, Bayes, OD.

A rule is ``function(system: LinearSystem, given: Given) -> KappaChoice``. All rules are
for the penalty |x|. So kappa has the unit of a squared observation over a squared
unknown, and depends on the units. A file that calls :func:`register_kappa_rule` adds a
rule; docs/extending.md. Rules that use a curve:
:mod:`fg_orient.adjustment.linear.kappa_graph`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import Breakdown, LinearSystem
from fg_orient.model.errors import InputError

#: Modules of this package that register rules when imported.
_MODULES: Final = ("kappa", "kappa_graph")
#: These rules use only the trace of the hat matrix and the residuals. They can treat priors as a part of the penalty.
BESIDE_PRIORS: Final = ("gcv", "discrepancy")


@dataclass(frozen=True)
class Given:
    """Additional inputs of a rule.

    Parameters
    ----------
    start_solver : str
        Solver of the least-squares solution used by HKB and LW.
    noise_norm : float, optional
        |e| of the observations l, for the discrepancy principle.
    truth : (u,) array, optional
        True solution, for CC.
    sigma_observed, sigma_unknown : float, optional
        Standard deviations of one observation and of one unknown, for Bayes.
    """

    start_solver: str = "gauss_partial_pivot_elimination"
    noise_norm: float | None = None
    truth: Array | None = None
    sigma_observed: float | None = None
    sigma_unknown: float | None = None


@dataclass(frozen=True)
class KappaChoice:
    """Kappa that a rule has chosen, with its curve.

    Parameters
    ----------
    kappa : float
    rule : str
    notes : tuple of str
        Remarks: clamping; kappa at the end of the grid.
    grid, curve : (n,) array, optional
        Kappas and the values of the function whose maximum, minimum or zero the rule uses; for plots.
    """

    kappa: float
    rule: str
    notes: tuple[str, ...] = ()
    grid: Array | None = None
    curve: Array | None = None


RuleFunction = Callable[[LinearSystem, Given], KappaChoice]


@dataclass(frozen=True)
class KappaRule:
    """Registered rule; ``needs`` names the fields of :class:`Given` that must be set.

    ``published``: the rule is in Terlemezoğlu 2019. ``source``: author, year and equation.
    """

    name: str
    label: str
    function: RuleFunction
    source: str
    published: bool = False
    needs: tuple[str, ...] = ()


_REGISTRY: dict[str, KappaRule] = {}


def register_kappa_rule(
    name: str, label: str, *, source: str, published: bool = False, needs: tuple[str, ...] = ()
) -> Callable[[RuleFunction], RuleFunction]:
    """Decorate a function to make it a kappa rule.

    Parameters
    ----------
    name, label : str
        Name for :func:`choose_kappa`; label in tables.
    source : str
        Author, year and equation.
    published : bool
        Whether the rule is described in Terlemezoğlu 2019.
    needs : tuple of str
        Fields of :class:`Given` that must be set.

    Raises
    ------
    ValueError
        Another rule has this name.
    """

    def add(function: RuleFunction) -> RuleFunction:
        present = _REGISTRY.get(name)
        if present is not None and present.function.__qualname__ != function.__qualname__:
            raise ValueError(f"a kappa rule named {name!r} is registered already")
        _REGISTRY[name] = KappaRule(name, label, function, source, published, needs)
        return function

    return add


def kappa_rules() -> dict[str, KappaRule]:
    """Return all rules by name."""
    for module in _MODULES:
        import_module(f"fg_orient.adjustment.linear.{module}")
    return dict(_REGISTRY)


def clamped(choice: KappaChoice) -> KappaChoice:
    """Clamp kappa to [0, 1] as published, with a remark: above 1 gives 1, below 0 or nan (rounding) gives 0.

    The bound depends on the units: with kilometres instead of metres kappa changes by 1e6.
    """
    value = choice.kappa
    if value > 1.0:
        return replace(choice, kappa=1.0, notes=(*choice.notes, f"kappa {value:.3g} clamped to 1"))
    if not value >= 0.0:
        return replace(choice, kappa=0.0, notes=(*choice.notes, f"kappa {value:.3g} set to 0"))
    return choice


def choose_kappa(name: str, system: LinearSystem, given: Given | None = None, *, clamp: bool = False) -> KappaChoice:
    """Apply a rule.

    ``name`` is a key of :func:`kappa_rules`; ``clamp``: see :func:`clamped`.

    Raises
    ------
    InputError
        There is no rule of this name, or an input of the rule is missing.
    Breakdown
        The rule finds no kappa, or (without ``clamp``) a kappa that is negative or not finite.
    """
    known = kappa_rules()
    if name not in known:
        raise InputError.of("linear.kappa_rule", place="kappa rule", value=name, known=", ".join(known))
    facts = given or Given()
    for field in known[name].needs:
        if getattr(facts, field) is None:
            raise InputError.of("linear.kappa_needs", place=f"kappa rule {name}", needed=field)
    with np.errstate(all="ignore"):  # values that are not finite are clamped or refused here
        choice = known[name].function(system, facts)
    if clamp:
        return clamped(choice)
    if not (np.isfinite(choice.kappa) and choice.kappa >= 0.0):
        raise Breakdown.of("linear.no_kappa", place=f"kappa rule {name}", value=f"{choice.kappa:.3g}")
    return choice


def unit_variance(system: LinearSystem, x: Array) -> float:
    """Return the variance of unit weight s0^2 = |A x - l|^2/f.

    InputError: A is not known, or the redundancy is not positive.
    """
    design, observed = system.require_design("s0")
    if system.redundancy <= 0:
        raise InputError.of("linear.redundancy", place="s0", value=f"{len(design)} rows, {len(system)} unknowns")
    return (float(np.sum((design @ x - observed) ** 2)) + system.rest.squares) / system.redundancy


@register_kappa_rule("hkb", "HKB", source="Hoerl, Kennard, Baldwin 1975; T(3.5)", published=True)
def hkb(system: LinearSystem, given: Given) -> KappaChoice:
    """Return kappa = u s0^2/(x^T x) of the least-squares solution.

    It has no meaning if that solution is inaccurate.
    """
    x = solve(given.start_solver, system).x
    return KappaChoice(float(np.float64(len(x) * unit_variance(system, x)) / (x @ x)), "hkb")


@register_kappa_rule("lw", "LW", source="Lawless, Wang 1976; T(3.6) with canonical coefficients", published=True)
def lw(system: LinearSystem, given: Given) -> KappaChoice:
    """Return kappa = u s0^2/sum(lambda_i alpha_i^2), alpha = V^T x; the denominator is |A x|^2."""
    x = solve(given.start_solver, system).x
    eigenvalues, vectors = np.linalg.eigh(system.normal)
    return KappaChoice(float(len(x) * unit_variance(system, x) / np.sum(eigenvalues * (vectors.T @ x) ** 2)), "lw")


@register_kappa_rule(
    "bayes",
    "Bayes",
    source="T(3.7) with variances",
    published=True,
    needs=("sigma_observed", "sigma_unknown"),
)
def bayes(system: LinearSystem, given: Given) -> KappaChoice:
    """Return kappa = sigma_l^2/sigma_x^2: the posterior mean under independent priors of equal variance."""
    sigmas = given.sigma_observed or 0.0, given.sigma_unknown or 0.0
    if not all(np.isfinite(sigma) and sigma > 0.0 for sigma in sigmas):
        raise InputError.of("linear.sigmas", place="kappa rule bayes", value="{:g}, {:g}".format(*sigmas))
    return KappaChoice(float((sigmas[0] / sigmas[1]) ** 2), "bayes")


@register_kappa_rule("od", "OD (eigenvalue)", source="Terlemezoğlu 2019, T(3.8)", published=True)
def od(system: LinearSystem, given: Given) -> KappaChoice:
    """Return kappa = the eigenvalue of N in [0, 1] nearest to 1; 0 if there is no such eigenvalue.

    It depends on the units.
    """
    eigenvalues = np.linalg.eigvalsh(system.normal)
    inside = eigenvalues[(eigenvalues >= 0.0) & (eigenvalues <= 1.0)]
    return KappaChoice(float(inside.max()) if len(inside) else 0.0, "od")
