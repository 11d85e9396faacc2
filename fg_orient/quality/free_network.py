"""Free networks: inner constraints and S-transformations.

The Jacobian of a network without control has a null space E: motions without effect on the observations. Constraints
``E^T D (x - x_0) = 0``, as many as motions, select one solution; the diagonal matrix D selects the unknowns of the
datum. All choices have the same residuals and the same shape, and each follows from any other by an S-transformation
(Baarda 1973)::

    S = I - E (E^T D E)^-1 E^T D,    x_D = x_0 + S (x - x_0),    Q_D = S Q S^T

With all unknowns in D this is the solution of the pseudo-inverse, with the least trace of Q (Meissl 1962); with some
unknowns, the trace of their part is least (Koch 1999, 3.3).

The adjustment uses a minimal datum: d image unknowns, as many as motions, each with one observation, selected by
pivoting so that the datum is well conditioned. These observations get no residual, so shape and residuals are those of
the free network, every backend solves regular equations, and no factor connects more variables. (Inner constraints as
factors would connect all points.) An S-transformation then leads to the requested datum: for the state in steps with
repeated adjustments, because a motion is not linear, and for the cofactors once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import qr

from factors._contract import Argument, Equation
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.errors import InputError, finding
from fg_orient.quality.covariance import Cofactors, Indeterminate, MatrixCofactors
from fg_orient.quality.elimination import UNOBSERVABLE, followed_by_ground, reduced_rows, spectrum
from fg_orient.quality.joint import NamedMatrix

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

#: Number of unknowns up to which all cofactors of a free network are formed.
MAX_UNKNOWNS: Final = 3000
#: A datum is reached when its step is below this, in prior sigmas and metres.
REACHED: Final = 1e-9
#: Steps to the datum; convergence is quadratic.
MAX_STEPS: Final = 10
_LABEL: Final = "minimal datum"


def _residual(record: Any, setup: Any, x: Any) -> Any:
    """``x - x_0`` of the unknowns with the numbers of the record."""
    return x[record.astype(np.intp)] - setup[0]


def _kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    jacobian = np.eye(len(x))[record.astype(np.intp)] if want else np.empty((0, 0))
    return _residual(record, setup, x), jacobian


#: Some unknowns of an image, each observed with sigma 1 prior sigma.
HELD_UNKNOWNS: Final = Equation(
    "held_unknowns", _kernel, _residual, (Argument("x", "prior sigma"),), "minimal datum of a free network",
)  # fmt: skip


def null_space(problem: Problem, state: State) -> Array:
    """Motions (n, d) without effect on the observations: image unknowns in prior sigmas, then unknown points in m.

    Columns are orthonormal in the image unknowns. Extra observations are not included.
    """
    rows = linearised(problem, state)
    with one_blas_thread():
        s, vt = spectrum(reduced_rows(problem, rows))
    motions = np.asarray(vt[s <= UNOBSERVABLE].T)
    motions = motions if problem.ties is None else problem.ties.widened(motions)
    ground = followed_by_ground(problem, rows, motions)[problem.active]
    return np.vstack([motions, ground.reshape(3 * len(ground), motions.shape[1])])


def without_priors(block: Block) -> Block:
    """The block without prior observations, which would fix the network."""
    return replace(block, options=replace(block.options, priors=False))


def with_minimal_datum(problem: Problem) -> Problem:
    """Hold image unknowns at their start values, as many as motions."""
    motions = null_space(problem, problem.start)[: problem.n_image_unknowns]
    d = motions.shape[1]
    chosen = np.sort(qr(motions.T, mode="r", pivoting=True)[1][:d]) if d else np.zeros(0)
    return _holding(problem, chosen.astype(np.intp))


def _holding(problem: Problem, chosen: Index) -> Problem:
    """Hold these image unknowns (d,) by observations, and no others."""
    held = []
    for k, image in enumerate(problem.block.images):
        own = chosen[(chosen >= problem.first[k]) & (chosen < problem.first[k + 1])] - problem.first[k]
        if len(own):
            value = problem.unknowns(problem.start, k)[own][None]
            held.append(ExtraObservation(
                HELD_UNKNOWNS, (f"image:{image.id}",), own.astype(float), value, len(own),
                f"{_LABEL} of image {image.id}",
            ))  # fmt: skip
    others = tuple(e for e in problem.block.extra if e.equation is not HELD_UNKNOWNS)
    return replace(problem, block=replace(problem.block, extra=(*others, *held)))


def held_unknowns(problem: Problem) -> Index:
    """Image unknowns (d,) that are held for the minimal datum, as many as motions."""
    held = [
        problem.first[problem.block.image_index(e.unknowns[0].removeprefix("image:"))] + e.record.astype(np.intp)
        for e in problem.block.extra
        if e.equation is HELD_UNKNOWNS
    ]
    return np.concatenate([np.zeros(0, np.intp), *held])


def to_inner_datum(
    problem: Problem, estimate: Estimate, run: Callable[[Problem], Estimate]
) -> tuple[Problem, Estimate]:
    """Transform a minimally constrained adjustment to inner constraints on its ground points.

    Parameters
    ----------
    problem : Problem
        With its minimal datum; the constraints refer to the coordinates of its start.
    estimate : Estimate
    run : callable
        Adjusts a problem from its start.

    Returns
    -------
    The problem with its minimal datum at the values of the result; the estimate, not converged if the datum is not
    reached.
    """
    chosen, first = held_unknowns(problem), estimate
    reference, at = problem.vector(problem.start), problem
    datum = datum_points(problem)
    for _ in range(MAX_STEPS):
        motions = null_space(problem, estimate.state)
        step = datum_step(problem.vector(estimate.state) - reference, motions, datum)
        if not len(chosen) or not estimate.converged or np.abs(step).max() < REACHED:
            break
        at = _holding(_undamped(replace(at, start=problem.moved(estimate.state, step))), chosen)
        estimate = run(at)
    else:
        estimate = replace(estimate, converged=False, end=finding("loop.free_datum"))
    whole = replace(estimate, log=first.log, iterations=first.iterations, structure_s=first.structure_s,
                    solve_s=first.solve_s + (estimate.solve_s if estimate is not first else 0.0))  # fmt: skip
    block = replace(at.block, options=problem.block.options)
    return replace(at, start=problem.start, block=block), whole


def _undamped(problem: Problem) -> Problem:
    """The problem with Gauss-Newton as optimiser: damped steps along a weak motion converge too slowly."""
    options = replace(problem.block.options, optimizer="gauss-newton")
    return replace(problem, block=replace(problem.block, options=options))


def datum_points(problem: Problem, names: tuple[str, ...] = ()) -> Mask:
    """Unknowns (n,) of a datum: named images and ground points, or all ground points.

    InputError: unknown image or point, or a point that is not an unknown.
    """
    out = np.zeros(problem.n_columns, bool)
    if not names:
        out[problem.n_image_unknowns :] = True
    for name in names:
        place = problem.block.find(name)
        if place is None:
            raise InputError.of("covariance.no_such", option="datum", value=name)
        kind, k = place
        if kind != "image" and not problem.active[k]:
            raise InputError.of("covariance.not_unknown", option="datum", value=name)
        out[problem.image_slice(k) if kind == "image" else problem.point_slice(k)] = True
    return out


@dataclass(frozen=True, eq=False)
class FreeNetwork(MatrixCofactors):
    """A free network in one datum, with its cofactors (``fg_orient.quality.covariance.Cofactors``).

    Parameters
    ----------
    problem : Problem
        With its minimal datum.
    cofactors : (n, n) array
        In prior scale, columns as in ``Problem.vector``.
    state : State
    null_space : (n, d) array
        Motions at the state; unknowns of all images in prior sigmas, then of all unknown points in m.
    datum : (n,) bool array
        Unknowns of the datum.
    """

    state: State
    null_space: Array
    datum: Mask

    @classmethod
    def of(cls, problem: Problem, state: State, minimal: Cofactors) -> FreeNetwork:
        """Inner constraints on the ground points, from a solution and its cofactors in the minimal datum.

        Indeterminate is raised for more than 3000 unknowns.
        """
        if problem.n_unknowns > MAX_UNKNOWNS:
            raise Indeterminate(
                f"the free network has {problem.n_unknowns} unknowns; all its cofactors are formed up to {MAX_UNKNOWNS}"
            )
        motions, datum = null_space(problem, state), datum_points(problem)
        with one_blas_thread():
            every = minimal.joint(tuple(range(problem.n_images)), tuple(np.flatnonzero(problem.active).tolist()))
            return cls(problem, s_transform(every, motions, datum), state, motions, datum)

    @property
    def datum_defect(self) -> int:
        """Number of motions without effect on the observations."""
        return int(self.null_space.shape[1])

    def in_datum(self, *names: str) -> FreeNetwork:
        """S-transformation to the datum of images ("image:3") and points ("point:12"); without names: all points.

        The state is moved along the motions at the solution. This is exact to first order: the movement is a few sigmas
        of start values, and the shape changes by its square. InputError: unknown names, or too few for all motions.
        """
        problem, datum = self.problem, datum_points(self.problem, names)
        difference = problem.vector(self.state) - problem.vector(problem.start)
        state = problem.moved(self.state, datum_step(difference, self.null_space, datum))
        q = s_transform(self.cofactors, self.null_space, datum)
        return FreeNetwork(problem, q, state, self.null_space, datum)

    def cofactor_matrix(self) -> NamedMatrix:
        """Cofactors of all unknowns in physical units: m, m/s, rad, px for images, m for points."""
        problem = self.problem
        ids = [problem.block.points.ids[j] for j in np.flatnonzero(problem.active)]
        names = [f"{i.id}.{n}" for i, p in zip(problem.block.images, problem.parameters, strict=True) for n in p.names]
        names += [f"{name}.{axis}" for name in ids for axis in "xyz"]
        units = [u for p in problem.parameters for u in p.units] + ["m"] * (3 * len(ids))
        scale = np.concatenate([*(p.sigma for p in problem.parameters), np.ones(3 * len(ids))])
        return NamedMatrix(tuple(names), tuple(units), self.cofactors * np.outer(scale, scale))


# --- S-transformations ----------------------------------------------------------------------------

#: Maximum condition of the motions, restricted to the unknowns of a datum that fixes them.
FIXES: Final = 1e8


def s_transform(cofactors: Array, null_space: Array, select: Mask) -> Array:
    """Cofactors ``S Q S^T`` (n, n) in the datum of some unknowns.

    Parameters
    ----------
    cofactors : (n, n) array
        In any datum: of a minimally constrained adjustment, or of another choice of inner constraints.
    null_space : (n, d) array
        Free motions, any basis.
    select : (n,) bool array
        Unknowns of the datum.

    Raises
    ------
    InputError
        These unknowns do not fix all motions.
    """
    # Q - E (A Q) - (A Q)^T E^T + E (A Q A^T) E^T: cheaper than two products with S
    a = _coordinates(null_space, select)
    aq = a @ cofactors
    moved = null_space @ aq
    out = cofactors - moved - moved.T + null_space @ (aq @ a.T) @ null_space.T
    return np.asarray(0.5 * (out + out.T))


def datum_step(difference: Array, null_space: Array, select: Mask) -> Array:
    """Step ``(S - I) (x - x_0)`` along the motions to the datum; parameters as of :func:`s_transform`."""
    return np.asarray(-null_space @ (_coordinates(null_space, select) @ difference))


def _coordinates(null_space: Array, select: Mask) -> Array:
    """``(E^T D E)^-1 E^T D`` (d, n): size of each motion, from the unknowns of the datum."""
    part = null_space[select]
    out = np.zeros(null_space.T.shape)
    if not null_space.shape[1]:
        return out
    s = np.linalg.svd(part, compute_uv=False) if len(part) >= part.shape[1] else np.zeros(1)
    if not len(s) or s[-1] * FIXES <= np.linalg.norm(null_space, 2):
        raise InputError.of("statistics.datum", option="datum", value=f"{int(select.sum())} unknowns",
                            count=null_space.shape[1])  # fmt: skip
    out[:, select] = np.linalg.pinv(part)
    return out
