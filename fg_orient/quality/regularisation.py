"""Regularisation of the image unknowns: penalty, rank and kappa are chosen at the start values for all backends.

With the ground points eliminated
(``fg_orient.quality.elimination``), a step of the image unknowns solves ``A x = l``. x is the total deviation
from the metadata, in prior sigmas. Here the prior sigmas are only units. If there are priors, each unknown
has an additional row
``x = 0``. The method uses the norm ``|D x|``, where D changes the units. With ``A D^-1 = U S V^T``:

- tikhonov: ``|A x - l|^2 + kappa |L D x|^2`` is minimised; L is the identity, or a penalty of the correction functions;
- truncated: directions with ``s^2 < kappa`` stay at the metadata, ``v^T D x = 0``;
- minimum_norm: directions with ``s <= rank_cut s_1`` stay there: the pseudo-inverse of Moore and Penrose;
- generalised_ridge, stein, ridge_stein: as minimum_norm, but the components of x along the other directions
  are also reduced (``fg_orient.adjustment.linear.shrinkage``).

A held direction gets an observation of zero with a weight w of at least s_1. A residual of one sigma then
moves a direction of singular value s by
``s / w^2``. The weight is chosen so that this is :data:`HELD` or less, but w is at most :data:`STIFFEST`
times s_1. The result of each method is a matrix R of rows that all backends add
(``fg_orient.adjustment.penalty``).

Rules of kappa use a system in standard form (Eldén 1982; Hansen 1998, 2.3). Its unknowns
``y`` have the penalty ``|y|^2``. Directions without penalty are eliminated, and directions below the rank cut
are removed. It has as many rows as there are whitened image and control observations, minus the number of
ground coordinates and unpenalised directions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.border_matrix import triangle
from fg_orient.adjustment.linear.kappa import BESIDE_PRIORS, Given, KappaChoice, choose_kappa
from fg_orient.adjustment.linear.shrinkage import SHRINKAGE, shrinkage_penalties
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS, LinearSystem, Rest, column_lengths
from fg_orient.adjustment.penalty import NORMAL_LIMIT, penalties, penalty_squares, without_penalties
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.regularised import Regularisation
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.block import Block
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.quality.elimination import UNOBSERVABLE, reduced_system
from fg_orient.quality.penalties import penalty_rows

#: Largest movement of a held direction, in units of the norm, by a residual of one sigma.
HELD: Final = 1e-10
#: Largest weight of held directions as a multiple of the largest singular value: the condition number grows with it.
STIFFEST: Final = 1e3
#: Smallest ratio of the singular values on both sides of the cut for a clear rank.
GAP: Final = 100.0
SOURCE: Final = "Tikhonov 1963; Hansen 1998"


def require_possible(block: Block) -> None:
    """Refuse options that contradict a regularisation.

    InputError: a penalty of another method; a datum that is defined without the metadata.
    """
    options = block.options
    if options.regularisation == "none":
        return
    if options.regularisation != "tikhonov" and options.penalty != "deviation":
        raise InputError.of("regularise.penalty", option="penalty", value=options.penalty)
    if options.datum in ("free", "inner", "vendor"):
        raise InputError.of("regularise.datum", option="datum", value=options.datum)


def with_regularisation(problem: Problem) -> Problem:
    """Add the penalty of the options to a problem as observations, and record it.

    Raises
    ------
    InputError
        A method or a rule is not possible for more than 2000 image unknowns; a rule is unknown; penalty and
        observations leave a direction undetermined; the normal equations are too ill-conditioned for the Schur backend.
    Breakdown
        The rule finds no kappa.
    """
    if problem.block.options.regularisation == "none":
        return problem
    require_possible(problem.block)
    problem = without_penalties(problem)
    with one_blas_thread():
        if problem.n_free_unknowns > MAX_UNKNOWNS:
            # imported here because it loads scipy.optimize
            from fg_orient.quality.large_regularisation import large_regularisation

            chosen = large_regularisation(problem)
        else:
            chosen = _chosen(problem, reduced_system(problem, problem.start))
    if problem.block.options.backend == "schur" and chosen.condition > NORMAL_LIMIT:
        raise InputError.of(
            "regularise.condition", option="backend", value="schur", condition=chosen.condition, limit=NORMAL_LIMIT
        )
    rows = penalties(problem, chosen.rows, SOURCE, chosen.condition)
    chosen = replace(chosen, n_rows=sum(own.n_residuals for own in rows))
    return replace(problem, block=replace(problem.block, extra=(*problem.block.extra, *rows)), regularisation=chosen)


def _chosen(problem: Problem, system: LinearSystem) -> Regularisation:
    """Choose the regularisation of a reduced system in prior sigmas."""
    options = problem.block.options
    units = _units(problem, system)
    design, observed = system.require_design("regularisation")
    system = LinearSystem.from_design(design / units, observed, system.rest)
    _, s, vt = system.decomposition
    if s[0] == 0.0:
        raise InputError.of("regularise.zero", place=problem.block.name)
    z, rank = len(s), int(np.count_nonzero(s > options.rank_cut * s[0]))
    below = float(s[rank]) if rank < z else 0.0
    gap = float(s[rank - 1]) / below if below > 0.0 else np.inf
    penalty = penalty_rows(problem)
    if penalty is not None:
        _require_complete(problem, penalty / units, vt[rank:].T)
    standard = standard_form(system, None if penalty is None else penalty / units, options.rank_cut)
    kappa, choice = None, None
    if options.regularisation in ("tikhonov", "truncated"):
        choice = None if options.kappa is not None else _by_rule(problem, standard)
        kappa = options.kappa if choice is None else choice.kappa
    held, weights = np.arange(z) >= rank, np.zeros(z)  # one element per direction
    if options.regularisation == "tikhonov":
        assert kappa is not None
        weights[:], rows = kappa, np.sqrt(kappa) * (np.diag(units) if penalty is None else penalty)
    else:
        if options.regularisation == "truncated":
            assert kappa is not None
            held |= s**2 < kappa
        elif options.regularisation in SHRINKAGE:
            weights[:rank] = shrinkage_penalties(options.regularisation, standard)[0]
            held |= np.isinf(weights)
        stiff = np.sqrt(s[held].max(initial=0.0) / HELD) / s[0]
        weights[held] = (min(max(stiff, 1.0), STIFFEST) * s[0]) ** 2
        own = np.flatnonzero(weights)
        rows = np.sqrt(weights[own])[:, None] * vt[own] * units
    # in this case the rows of the penalty have the same singular vectors as A
    if penalty is None and options.regularised_units == "prior_sigmas":
        squares = s**2 + weights + float(options.priors)
        condition, determined = _ratio(np.sqrt(squares)), float(np.sum(weights / squares))
    else:
        condition, determined = _with_all_rows(design, rows, priors=options.priors)
    return Regularisation(
        options.regularisation,
        kappa,
        "" if choice is None else choice.rule,
        choice,
        s,
        rank,
        gap,
        units,
        rows,
        vt[held].T,
        standard,
        condition,
        determined,
    )


def _ratio(values: Array) -> float:
    """Return the ratio of the largest to the smallest value; inf if the smallest is zero."""
    return float(values.max() / values.min()) if values.min() > 0.0 else np.inf


def _with_all_rows(design: Array, rows: Array, *, priors: bool) -> tuple[float, float]:
    """Return the condition of B (design, rows R, priors), and the trace of ``R Q R^T`` with ``Q^-1 = B^T B``."""
    z = design.shape[1]
    _, s, vt = np.linalg.svd(triangle(np.vstack([design, rows, np.eye(z) if priors else np.zeros((0, z))])))
    condition = _ratio(s)
    return condition, float(np.sum((rows @ vt.T / s) ** 2)) if np.isfinite(condition) else float(z)


def _units(problem: Problem, system: LinearSystem) -> Array:
    """Return D (z,): it converts unknowns from prior sigmas to the units of the norm."""
    kind = problem.block.options.regularised_units
    if kind == "columns":
        return column_lengths(system)
    if kind == "prior_sigmas":
        return np.ones(len(system))
    return problem.free(np.concatenate([model.raw_sigma for model in problem.models]))


def _require_complete(problem: Problem, penalty: Array, null: Array) -> None:
    """Raise InputError if neither the penalty nor priors act on the unobserved directions ``null`` (z, d)."""
    if problem.block.options.priors or not null.shape[1]:
        return
    left = null @ np.linalg.svd(penalty @ null)[2].T
    unseen = np.linalg.norm(penalty @ left, axis=0) <= problem.block.options.rank_cut * np.linalg.norm(penalty, 2)
    if unseen.any():
        raise InputError.of(
            "regularise.common_null", option="penalty", value=problem.block.options.penalty, n=int(unseen.sum())
        )


def standard_form(system: LinearSystem, penalty: Array | None, cut: float) -> LinearSystem:
    """Return the system with the penalty |y|^2 and full rank; see the module docstring.

    Parameters
    ----------
    system : LinearSystem
        System with A (r, z).
    penalty : (k, z) array or None
        L; None: the identity.
    cut : float
        Share of the largest singular value up to which directions are removed.
    """
    design, observed = system.require_design("standard form")
    rest = system.rest
    if penalty is None:
        left, s, _ = system.decomposition
    else:
        _, s, vt = np.linalg.svd(penalty)
        rank = int(np.count_nonzero(s > cut * s[0]))
        free = design @ vt[rank:].T
        q, values, _ = np.linalg.svd(free, full_matrices=False)
        q = q[:, values > cut * np.linalg.norm(design, 2)] if values.size else q
        design = (design - q @ (q.T @ design)) @ np.linalg.pinv(penalty, rcond=cut)
        observed = observed - q @ (q.T @ observed)
        rest = Rest(rest.rows - q.shape[1], rest.squares)
        left, s, _ = np.linalg.svd(design, full_matrices=False)
    keep = s > cut * s[0]
    beta = left[:, keep].T @ observed
    outside = max(float(observed @ observed - beta @ beta), 0.0)
    return LinearSystem.from_design(
        np.diag(s[keep]), beta, Rest(rest.rows + len(observed) - len(beta), rest.squares + outside)
    )


def given_inputs(system: LinearSystem) -> Given:
    """Return the inputs of the rules: observations have the standard deviation 1, unknowns one prior sigma."""
    rows = len(system.require_design("noise")[0]) + system.rest.rows
    return Given(start_solver="svd", noise_norm=float(np.sqrt(rows)), sigma_observed=1.0, sigma_unknown=1.0)


def _by_rule(problem: Problem, standard: LinearSystem) -> KappaChoice:
    """Choose kappa by the rule of the options."""
    options = problem.block.options
    choice = choose_kappa(options.kappa_rule, standard, given_inputs(standard))
    if not options.priors or options.kappa_rule == "bayes":
        return choice
    plain = options.penalty == "deviation" and options.regularised_units == "prior_sigmas"
    if options.kappa_rule not in BESIDE_PRIORS or not plain or options.regularisation != "tikhonov":
        known = ", ".join(("bayes", *BESIDE_PRIORS))
        raise InputError.of("regularise.rule_priors", option="kappa_rule", value=options.kappa_rule, known=known)
    note = ("the priors are a penalty of 1, which is subtracted",)
    return replace(choice, kappa=max(choice.kappa - 1.0, 0.0), notes=(*choice.notes, *note))


def findings(problem: Problem) -> list[Finding]:
    """Report a note on the regularisation, and doubts about the rank of a minimum norm."""
    chosen, options = problem.regularisation, problem.block.options
    if chosen is None:
        return []
    out, z, s = [], problem.n_free_unknowns, chosen.singular_values
    if chosen.method not in ("tikhonov", "truncated"):
        weak = int(np.count_nonzero(s[: chosen.rank] <= UNOBSERVABLE))
        if chosen.gap < GAP:
            out.append(
                finding(
                    "regularise.rank_ambiguous",
                    rank=chosen.rank,
                    z=z,
                    above=s[chosen.rank - 1] / s[0],
                    below=s[chosen.rank] / s[0],
                    cut=options.rank_cut,
                    gap=GAP,
                )
            )
        if weak and options.regularised_units == "prior_sigmas":
            out.append(finding("regularise.weak", n=weak, prior_sigmas=1.0 / UNOBSERVABLE))
    note = finding(
        "solution.regularised", method=chosen.method, kappa=kappa_text(chosen), held=chosen.held or None, z=z
    )
    return [*out, note]


def share_of_penalty(problem: Problem, state: State, chi2: float) -> float | None:
    """Return the penalty's share in the minimised sum of chi2 and penalty; None without a regularisation."""
    if problem.regularisation is None:
        return None
    penalty = penalty_squares(problem, state)
    return penalty / (chi2 + penalty)


def kappa_text(chosen: Regularisation) -> str | None:
    """Describe kappa and its rule; None for a minimum norm."""
    if chosen.kappa is None:
        return None
    return f"{chosen.kappa:.3g}" + (f" by the rule {chosen.rule}" if chosen.rule else "")
