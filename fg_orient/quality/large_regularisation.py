"""Regularisation of more than 2000 image unknowns by Tikhonov's method. Traces are sampled, without a decomposition.

The penalty is the deviation in prior sigmas. Rank and singular values are not computed. With the cofactors Q of the
solution and kappa, the resolution is ``I - (kappa + p) Q``; p is 1 with priors and 0 without.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from factors.arrays import Array
from fg_orient.adjustment.linear.kappa import BESIDE_PRIORS, Given, KappaChoice
from fg_orient.adjustment.linear.kappa_graph import SAMPLED, on_curves
from fg_orient.adjustment.linear.sampled import PROBES, SEED, SampledRidge, signs
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.normal_equations import NormalEquations
from fg_orient.adjustment.penalty import without_penalties
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.regularised import Regularisation
from fg_orient.model.errors import InputError
from fg_orient.quality.cofactors import PointCofactors


def large_regularisation(problem: Problem) -> Regularisation:
    """Choose the regularisation of a large problem at its start.

    InputError: another method, penalty or unit was chosen, or a rule that needs a decomposition.
    """
    options, z = problem.block.options, problem.n_free_unknowns
    if (options.regularisation, options.penalty, options.regularised_units) != (
        "tikhonov",
        "deviation",
        "prior_sigmas",
    ):
        raise InputError.of("linear.too_large", option="regularisation", value=z, limit=MAX_UNKNOWNS)
    choice = _choice(problem) if options.kappa is None else KappaChoice(options.kappa, "")
    probes = signs(z, PROBES, SEED)
    solve = NormalEquations.of(problem, problem.start).factor(choice.kappa + float(options.priors))
    # estimate of the trace of R Q R^T
    determined = choice.kappa * float(np.mean(np.sum(probes * solve(probes), axis=0)))
    return Regularisation(
        "tikhonov",
        choice.kappa,
        choice.rule,
        choice if choice.rule else None,
        np.zeros(0),
        z,
        np.inf,
        np.ones(z),
        sparse.eye_array(z, format="csr") * np.sqrt(choice.kappa),
        np.zeros((z, 0)),
        None,
        np.nan,
        determined,
    )


def _choice(problem: Problem) -> KappaChoice:
    """Choose kappa by the rule of the options."""
    options = problem.block.options
    if options.kappa_rule == "bayes":
        return KappaChoice(1.0, "bayes")
    possible = [rule for rule in SAMPLED if not options.priors or rule in BESIDE_PRIORS]
    if options.kappa_rule not in possible:
        known = ", ".join(("bayes", *possible))
        raise InputError.of("regularise.rule_large", option="kappa_rule", value=options.kappa_rule, known=known)
    curves = sampled_ridge(problem, options.kappa_rule)
    choice = on_curves(options.kappa_rule, curves, Given(noise_norm=float(np.sqrt(curves.rows))))
    notes = [f"{PROBES} probes, standard error of the trace {curves.trace_error(choice.kappa):.2g}"]
    if options.kappa_rule == "gcv":
        low, high = curves.gcv_interval(choice.kappa)
        notes.append(f"kappa {low:.3g} to {high:.3g} at 95 % by the error of the trace")
    kappa = max(choice.kappa - 1.0, 0.0) if options.priors else choice.kappa
    return replace(choice, kappa=kappa, notes=(*choice.notes, *notes))


def sampled_ridge(problem: Problem, rule: str) -> SampledRidge:
    """Return the Tikhonov solutions of the reduced system at the start, without priors."""
    equations = NormalEquations.of(without_penalties(problem), problem.start)
    priors = problem.n_free_unknowns if problem.block.options.priors else 0
    rows = problem.n_observations - priors - 3 * int(problem.active.sum())
    return SampledRidge(equations.factor, equations.rhs, equations.squares, rows, equations.largest(), rule)


def large_record(problem: Problem, state: State, cofactors: PointCofactors | None) -> dict[str, Any]:
    """Return values of ``resolution.record_of`` for a large problem.

    Values that need a decomposition or cofactors are null.
    """
    chosen = problem.regularisation
    assert chosen is not None and chosen.kappa is not None
    p, z = 1.0 if problem.block.options.priors else 0.0, problem.n_free_unknowns
    x, nothing = problem.image_vector(state), np.full(z, np.nan)
    q = nothing
    if cofactors is not None:
        q = problem.free(np.concatenate([np.diag(cofactors.joint((k,), ())) for k in range(problem.n_images)]))
    solve = NormalEquations.of(without_penalties(problem), state).factor(chosen.kappa + p)
    share = 1.0 - (chosen.kappa + p) * q
    columns: dict[str, Array] = {
        "resolution": share,
        "sd_posterior": np.sqrt(q),
        "sd_noise": nothing,
        "bias_plug_in": -chosen.kappa * solve(x[:, None])[:, 0],
        "bias_bound": nothing,
        "rmse_simulated": nothing,
    }
    return {"effective_unknowns": float(share.sum()), "columns": columns}
