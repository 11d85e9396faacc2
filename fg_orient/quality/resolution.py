"""Bias, variance and resolution of a regularised estimate: which unknown comes from the observations.

With the reduced normal matrix N of the image unknowns, P of their priors and the rows R of the penalty,

    Q = (N + P + R^T R)^-1,   x = Q A^T l,   resolution Q N,   bias -Q R^T R x,   variance Q (N + P) Q

all in prior sigmas. The resolution of an unknown is the change of its estimate if its true value
changes by one unit. It is 1 if the observations alone determine the unknown, and 0 if priors or penalty
determine it. Its matrix has eigenvalues in [0, 1]; their sum is the number of unknowns that the
observations determine.

The bias needs the true x. The *plug-in* bias uses the estimate instead, and is too small. In directions that
no observation determines the bias cannot be estimated. Its bound for a true deviation of one prior sigma is
given instead. The mean square error comes from a Monte Carlo simulation of the linear model: true deviations
N(0, 1) in prior sigmas, observations N(0, 1), kappa held.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import solve_triangular

from factors.arrays import Array
from fg_orient.adjustment.border_matrix import triangle
from fg_orient.adjustment.linear.l_curve import l_curve_of
from fg_orient.adjustment.penalty import without_penalties
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.regularised import Regularisation
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.quality.cofactors import PointCofactors
from fg_orient.quality.elimination import reduced_system
from fg_orient.quality.large_regularisation import large_record
from fg_orient.quality.regularisation import given_inputs

#: Number of draws of the simulation, and its seed: the standard error of a root mean square error is 2 %.
DRAWS: Final = 1000
SEED: Final = 0
#: Smallest resolution of an unknown determined by the observations, and largest of an unknown determined by the
#: metadata.
DETERMINED, HELD = 0.9, 0.1
#: Record of the curve of a large system; it has no list of kappas.
_NO_CURVE: Final[dict[str, Any]] = {
    "kappa": [], "residual_norm": [], "solution_norm": [], "curvature": [], "choices": [],
}  # fmt: skip


@dataclass(frozen=True)
class Resolution:
    """Statistics of the free image unknowns, in prior sigmas.

    Parameters
    ----------
    matrix : (z, z) array
        Resolution Q N.
    eigenvalues : (z,) array
        Eigenvalues of the resolution, descending.
    posterior : (z,) array
        Roots of the diagonal of Q: standard deviations if the penalty is a true prior.
    noise : (z,) array
        Roots of the diagonal of the variance: the effect of the errors of observations and priors only.
    bias : (z,) array
        Plug-in bias.
    bias_bound : (z,) array
        Largest bias caused by a true deviation of one prior sigma in the directions without observations.
    rmse : (z,) array
        Root mean square error of the simulation.
    gain : (z, r) array
        Q A^T: effect of the observations.
    """

    matrix: Array
    eigenvalues: Array
    posterior: Array
    noise: Array
    bias: Array
    bias_bound: Array
    rmse: Array
    gain: Array


def resolution(problem: Problem, state: State) -> Resolution:
    """Compute the statistics at a solution of a regularised problem; under a loss the problem has its weights."""
    chosen = problem.regularisation
    assert chosen is not None
    with one_blas_thread():
        system = reduced_system(without_penalties(problem), state)
        prior = np.eye(len(system)) if problem.block.options.priors else np.zeros((0, len(system)))
        return of_rows(system.require_design("resolution")[0], prior, chosen, problem.image_vector(state))


def of_rows(design: Array, prior: Array, chosen: Regularisation, x: Array) -> Resolution:
    """Compute the statistics of an estimate x (z,) with rows A (r, z), of the priors (p, z) and of the penalty."""
    z = len(x)
    root = triangle(np.vstack([design, prior, chosen.rows]))
    inverse = solve_triangular(root, np.eye(z))  # the cofactors are Q = inverse inverse^T
    observed, of_prior, held = design @ inverse, prior @ inverse, chosen.rows @ inverse
    gain = inverse @ observed.T  # Q A^T
    pull = inverse @ held.T @ chosen.rows  # Q R^T R
    null = np.linalg.qr(chosen.null / chosen.units[:, None]).Q
    rng = np.random.default_rng(SEED)
    truth, noise = rng.standard_normal((z, DRAWS)), rng.standard_normal((len(design), DRAWS))
    error = gain @ (design @ truth + noise) - truth
    return Resolution(
        gain @ design,
        np.asarray(np.linalg.svd(observed, compute_uv=False) ** 2),
        np.linalg.norm(inverse, axis=1),
        np.hypot(np.linalg.norm(gain, axis=1), np.linalg.norm(inverse @ of_prior.T, axis=1)),
        -pull @ x,
        np.linalg.norm(pull @ null, axis=1),
        np.sqrt(np.mean(error**2, axis=1)),
        gain,
    )


def record_of(problem: Problem, state: State, cofactors: PointCofactors | None) -> dict[str, Any] | None:
    """Return the section ``regularisation`` of a record (docs/results.md); None for a problem without regularisation.

    The keys of a Tikhonov solver of the dense backend (``fg_orient.quality.conditioning``) have the same meaning.
    """
    chosen = problem.regularisation
    if chosen is None:
        return None
    if chosen.standard is None:
        large, curve, eigenvalues = large_record(problem, state, cofactors), _NO_CURVE, []
        columns, effective = large["columns"], large["effective_unknowns"]
    else:
        found = resolution(problem, state)
        eigenvalues = found.eigenvalues.tolist()
        curve, effective = asdict(l_curve_of(chosen.standard, given_inputs(chosen.standard))), sum(eigenvalues)
        columns = {
            "resolution": np.diag(found.matrix),
            "sd_posterior": found.posterior,
            "sd_noise": found.noise,
            "bias_plug_in": found.bias,
            "bias_bound": found.bias_bound,
            "rmse_simulated": found.rmse,
        }
    curve, determined_by = dict(curve), sources(columns["resolution"])
    return {
        "solver": chosen.method,
        "label": chosen.method.replace("_", " "),
        "rule": chosen.rule or None,
        "kappa": chosen.kappa,
        "failure": "",
        "rules": curve.pop("choices"),
        "curve": curve,
        "steps": [],
        "penalty": problem.block.options.penalty,
        "units": problem.block.options.regularised_units,
        "notes": [] if chosen.choice is None else list(chosen.choice.notes),
        "rank": None if chosen.standard is None else chosen.rank,
        "held_directions": chosen.held,
        "gap": chosen.gap if np.isfinite(chosen.gap) else None,
        "singular_values": chosen.singular_values,
        "condition": chosen.condition,
        "effective_unknowns": effective,
        "resolution_eigenvalues": eigenvalues,
        "simulation": None if chosen.standard is None else {"draws": DRAWS, "seed": SEED},
        "unknowns": [
            {"image": image, "unknown": name, "determined_by": source, **{key: v[k] for key, v in columns.items()}}
            for k, ((image, name), source) in enumerate(zip(labels(problem), determined_by, strict=True))
        ],
    }


def sources(resolution: Array) -> list[str | None]:
    """Return what determines each unknown: "observations", "metadata" or "both".

    None if the resolution is not known.
    """
    return [
        None if np.isnan(r) else "observations" if r >= DETERMINED else "metadata" if r <= HELD else "both"
        for r in resolution.tolist()
    ]


def labels(problem: Problem) -> list[tuple[str, str]]:
    """Return image (or id of the images that share it) and name of each free image unknown."""
    wide = [
        (p.shared[j] if p.shared and p.shared[j] else image.id, name)
        for image, p in zip(problem.block.images, problem.parameters, strict=True)
        for j, name in enumerate(p.names)
    ]
    return wide if problem.ties is None else [wide[j] for j in problem.ties.place.tolist()]
