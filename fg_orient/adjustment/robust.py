"""Robust losses on an adjustment: what a backend weights its rows with.

The cost is the sum of rho(t) over image points (t: whitened norm of 2 residuals) and control points (3), half the
squares of priors and own observations. Rows times the root of their weight give Gauss-Newton steps that are those of
iteratively reweighted least squares (Holland & Welsch 1977); the gradient is that of the cost.

Each loss is mixed with :data:`FLOOR` parts of the square, so that a ground point whose rays have lost all weight keeps
a place: the rays' own intersection. With the weights held fixed the problem is an ordinary one
(:func:`weighted_problem`); covariances are those of that one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from factors.losses import ALIASES, Curve, Loss, find, losses
from fg_orient.adjustment.problem import Problem, State, whitened_records
from fg_orient.adjustment.rows import residuals
from fg_orient.model.block import ImagePoints, Options
from fg_orient.model.distributions import chi_square_quantile
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: Share of the square in every loss: an observation 1000 sigmas off pulls like one of 0.001 sigma. Smaller, and the
#: cofactors of a point with one good ray drown in rounding (its pivots differ by this factor).
FLOOR: Final = 1e-6
IMAGE, CONTROL = 2, 3
NONE: Final = "none"
#: Weights that are no loss but an iteration of their own (``fg_orient.adjustment.irls``).
IN_CYCLES: Final = ("danish_original", "lad")
#: Of these the rules whose weights are no share of the information of an observation: 1/t, above 1 or below.
UNWEIGHED: Final = ("lad",)
#: Scales of image points and control points: residuals are judged in sigmas.
A_PRIORI: Final = (1.0, 1.0)


@dataclass(frozen=True)
class ScaledLoss:
    """A loss and its constant c: weight and cost of whitened norms t.

    Parameters
    ----------
    weight, cost : callables
        See :class:`factors.losses.Loss`.
    constant : float
        c, in sigmas.
    """

    weight: Curve
    cost: Curve
    constant: float

    def weights(self, norm: npt.ArrayLike) -> Array:
        """Weights of whitened norms, from FLOOR to 1."""
        return np.asarray(FLOOR + (1.0 - FLOOR) * self.weight(np.asarray(norm) / self.constant))

    def costs(self, norm: npt.ArrayLike) -> Array:
        """Integrals of ``t * weights(t)`` from 0."""
        u = np.asarray(norm) / self.constant
        return np.asarray(self.constant**2 * (0.5 * FLOOR * u**2 + (1.0 - FLOOR) * self.cost(u)))


@dataclass(frozen=True)
class Robust:
    """The losses of an adjustment: of image points and of control points."""

    image: ScaledLoss
    control: ScaledLoss

    def weigh(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array, float]:
        """Weights of image points (n,) and control points (m,) from their squared norms, and the cost of both."""
        image, control = np.sqrt(image_squares), np.sqrt(control_squares)
        cost = float(np.sum(self.image.costs(image)) + np.sum(self.control.costs(control)))
        return self.image.weights(image), self.control.weights(control), cost


class Weighing(Protocol):
    """What a backend weights its rows with."""

    def weigh(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array, float]:
        """Weights of image points (n,) and control points (m,) from their squared norms, and the cost of both."""
        ...


@dataclass(frozen=True)
class Given:
    """Weights that do not follow the residuals: of image points (n,), in the order of the backend, control points (m,).

    The cost is half the weighted squares.
    """

    image: Array
    control: Array

    def weigh(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array, float]:
        """See :class:`Weighing`."""
        cost = 0.5 * float(np.vdot(self.image, image_squares) + np.vdot(self.control, control_squares))
        return self.image, self.control, cost


S_contra = TypeVar("S_contra", contravariant=True)


class RobustBackend(Protocol[S_contra]):
    """A backend that weights its rows."""

    robust: Robust | None

    def squares(self, state: S_contra) -> tuple[Array, Array]:
        """Squared whitened norms of image points (n,) and control points (m,), in any order."""
        ...


@dataclass(frozen=True)
class Weights:
    """Weights at a state: of image points (n,) and, 1 for all others, control points (N,).

    ``scale``: unit of the losses of both, in sigmas.
    """

    image: Array
    control: Array
    scale: tuple[float, float] = A_PRIORI


def are_information(loss: str, weights: Weights) -> bool:
    """Tell whether cofactors with these weights mean something: none may make an observation better than its sigma."""
    largest = max(float(weights.image.max(initial=0.0)), float(weights.control.max(initial=0.0)))
    return loss not in UNWEIGHED and largest <= 1.0 + 1e-12


def find_loss(name: str) -> Loss:
    """Find a loss.

    Raises
    ------
    InputError
        There is none of this name.
    """
    loss = find(name)
    if loss is None:
        known = ", ".join((NONE, *losses(), *ALIASES, *IN_CYCLES))
        raise InputError.of("adjust.loss", option="loss", value=name, known=known)
    return loss


def robust_of(options: Options) -> Robust | None:
    """Losses with their constants for 95 % efficiency; None for least squares."""
    return None if options.loss == NONE else scaled(find_loss(options.loss))


def scaled(loss: Loss, scale: tuple[float, float] = A_PRIORI) -> Robust:
    """Give a loss for image points and control points, its constants in units of these scales."""
    constants = (loss.constant(d) * s for d, s in zip((IMAGE, CONTROL), scale, strict=True))
    return Robust(*(ScaledLoss(loss.weight, loss.cost, c) for c in constants))


def inlier_limit(probability: float, dimension: int) -> float:
    """Whitened norm that a good observation keeps with this probability: root of the chi-square quantile."""
    return float(np.sqrt(chi_square_quantile(dimension, probability)))


def control_squares(problem: Problem, state: State) -> Array:
    """Squared whitened norms (m,) of the observed control points, in their order."""
    return np.asarray(np.sum(problem.control_residuals(state, np.flatnonzero(problem.observed)) ** 2, axis=1))


def squares(problem: Problem, state: State) -> tuple[Array, Array]:
    """Squared whitened norms of the image points (n,) and of the observed control points (m,), in their order."""
    return np.sum(residuals(problem, state) ** 2, axis=1), control_squares(problem, state)


def weights_at(problem: Problem, state: State, robust: Robust) -> tuple[Weights, float]:
    """Weights at a state, in the order of the problem; excess of the cost over half the weighted squares."""
    image_squares, observed_squares = squares(problem, state)
    image, observed, cost = robust.weigh(image_squares, observed_squares)
    control = np.ones(len(problem.observed))
    control[problem.observed] = observed
    return Weights(image, control), cost - 0.5 * float(image @ image_squares + observed @ observed_squares)


def weighted_problem(problem: Problem, weights: Weights) -> Problem:
    """The problem whose least squares has these weights: sigmas divided by their roots, the same whitening else."""
    o, root = problem.observations, np.sqrt(weights.image)
    scaled = ImagePoints(o.image, o.point, o.line, o.sample, o.sigma_line_px / root, o.sigma_sample_px / root)
    control = problem.control_records.copy()
    control[:, POINT.whitening] *= np.sqrt(weights.control)[:, None]
    records = whitened_records(problem.models, scaled, problem.start.ground + problem.origin_m, problem.origin_m)
    return replace(problem, observations=scaled, records=records, control_records=control)
