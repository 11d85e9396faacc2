"""Linear model of jitter near a solution, from reduced rows of the orientation and of splines of roll and pitch.

The rows of all observations, without the ground points (``fg_orient.quality.elimination``), are

    y = A beta + sum_j X_j u_j + e,   beta ~ prior sigmas,   u_j ~ N(0, g_j^2 I),   e ~ N(0, s^2 I)

``X_j`` has the ``k + 3`` columns of jitter of one angle over k intervals: splines without
quadratics, and the degree-2 coefficients, whose effect equals the effect of columns of A
(``factors.geometry.polynomials``). The strengths g and the scale s follow from the restricted
likelihood, in which beta is integrated (Patterson & Thompson 1971)::

    log L = -1/2 (log det H + nu log RSS),   H = normal matrix of A and all g_j X_j with their priors

``RSS`` is the weighted sum of squares with all priors, nu the number of reduced rows. A
strength is the root mean square motion of image points, px. Jitter of some pixels turns
the image by 1e-5 rad, where the model is linear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index
from factors.geometry import polynomials
from fg_orient.adjustment.border_matrix import triangle
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import InputError
from fg_orient.model.jitter import ANGLES
from fg_orient.quality.elimination import CHUNK, PointRows, control_residuals, eliminated_points, extra_rows

#: Numbers of intervals that are tested. ``FINE`` is their common multiple: splines over ``FINE``
#: intervals contain all these splines.
RESOLUTIONS: Final = (2, 3, 4, 6, 8, 12, 16, 24, 32)
FINE: Final = 96
#: Share of jitter of 1 px that must be determined at a resolution.
RESOLVED: Final = 0.5
_F: Final = FINE + polynomials.DEGREE
#: Maximum number of images: dense matrices have about 200 columns for each.
MOST_IMAGES: Final = 12


class Strength(NamedTuple):
    """Jitter of an angle: number of the angle in the system, number of intervals, and strength (px)."""

    angle: int
    intervals: int
    px: float


@dataclass(frozen=True)
class Angle:
    """Angle of an image that may have jitter.

    Parameters
    ----------
    image : int
    name : str
        "roll" or "pitch".
    px_per_rad : float
        Motion of image points per rad, root mean square over the observations.
    raw : (99, 99) array
        Normal matrix of the splines over 96 intervals (rad) before ground points are eliminated.
    """

    image: int
    name: str
    px_per_rad: float
    raw: Array


@dataclass(frozen=True)
class JitterSystem:
    """Linear model of jitter.

    Parameters
    ----------
    angles : tuple of Angle
    design : (m, p) array
        A; its last rows are the priors of the orientation.
    observed : (m,) array
        y.
    columns : dict of (m, k + 3) arrays
        X of unit strength, 1 px, by number of the angle and number of intervals.
    freedom : int
        nu.
    """

    angles: tuple[Angle, ...]
    design: Array
    observed: Array
    columns: dict[tuple[int, int], Array]
    freedom: int

    def bordered(self, chosen: Sequence[Strength]) -> tuple[Array, Array]:
        """Return A and y with the columns and priors of chosen jitter."""
        if not chosen:
            return self.design, self.observed
        more = np.hstack([self.columns[c.angle, c.intervals] * c.px for c in chosen])
        n, (m, p) = more.shape[1], self.design.shape
        out: Array = np.zeros((m + n, p + n))
        out[:m, :p], out[:m, p:], out[m:, p:] = self.design, more, np.eye(n)
        return out, np.append(self.observed, np.zeros(n))

    def fit(self, chosen: Sequence[Strength]) -> Fit:
        """Return the likelihood and the estimate with chosen jitter."""
        design, observed = self.bordered(chosen)
        p = design.shape[1]
        r = np.asarray(np.linalg.qr(np.column_stack([design, observed]), mode="r"))
        rss = float(r[p, p] ** 2)
        log = -float(np.log(np.abs(np.diag(r)[:p])).sum()) - 0.5 * self.freedom * float(np.log(rss))
        return Fit(self, tuple(chosen), r[:p, :p], r[:p, p], rss, log)

    @cached_property
    def orientation(self) -> Array:
        """Orthonormal basis (m, p) of the columns of A."""
        return np.linalg.qr(self.design)[0]

    @cached_property
    def resolved(self) -> tuple[tuple[int, ...], ...]:
        """For each angle, the numbers of intervals at which at least RESOLVED of jitter of 1 px is determined."""
        return tuple(
            tuple(k for k in RESOLUTIONS if np.mean((own := self.information(angle, k)[0]) / (1.0 + own)) >= RESOLVED)
            for angle in range(len(self.angles))
        )

    def information(self, angle: int, intervals: int) -> tuple[Array, float, float]:
        """Return the eigenvalues (k,) of jitter of 1 px, and the shares that ground points and orientation absorb.

        An eigenvalue is the squared ratio of jitter to noise along one of k independent shapes.
        """
        x = self.columns[angle, intervals][:, :intervals]
        rest = x - self.orientation @ (self.orientation.T @ x)
        shape = _shape(intervals)[:, :intervals]
        of = self.angles[angle]
        raw = float(np.sum(shape * (of.raw @ shape))) / of.px_per_rad**2
        points, all_of = float(np.sum(x**2)), float(np.sum(rest**2))
        eigenvalues = np.maximum(np.linalg.eigvalsh(rest.T @ rest), 0.0)
        return eigenvalues, 1.0 - points / raw, (points - all_of) / raw


@dataclass(frozen=True)
class Fit:
    """Estimate with chosen jitter: triangular factor, right-hand side, sum of squares, restricted likelihood."""

    system: JitterSystem
    chosen: tuple[Strength, ...]
    root: Array
    rhs: Array
    rss: float
    log: float

    @cached_property
    def _inverse(self) -> Array:
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self.root, np.eye(len(self.root))))

    def curve(self, number: int, tau: Array) -> tuple[Array, Array]:
        """Return jitter (N,) px without its quadratic polynomial at N lines, and its standard deviations (N,) px."""
        begin = self.system.design.shape[1]
        for before in self.chosen[:number]:
            begin += before.intervals + polynomials.DEGREE
        own = self.chosen[number]
        values = without_quadratic(tau, polynomials.jitter_curves(tau, own.intervals)) * own.px
        rows = values @ self._inverse[begin : begin + own.intervals]
        scale = self.rss / self.system.freedom
        return rows @ self.rhs, np.sqrt(scale * np.sum(rows**2, axis=1))


def without_quadratic(tau: Array, values: Array) -> Array:
    """Return values (N, ...) at N lines minus their least-squares polynomials of degree 2."""
    q = np.linalg.qr(np.asarray(tau)[:, None] ** np.arange(3))[0]
    return np.asarray(values - q @ (q.T @ values))


@cache
def mean_squares(intervals: int) -> Array:
    """Return Q (k, k): ``z^T Q z`` is the mean square of jitter with unknowns z, without its quadratic polynomial."""
    tau = np.linspace(-1.0, 1.0, 8 * FINE + 1)
    values = without_quadratic(tau, polynomials.jitter_curves(tau, intervals))
    return np.asarray(values.T @ values / len(tau))


@cache
def _shape(intervals: int) -> Array:
    """Return coefficients (99, k) over 96 intervals that represent unit jitter over k intervals without quadratics."""
    tau = np.linspace(-1.0, 1.0, 8 * FINE + 1)
    wanted = polynomials.jitter_curves(tau, intervals)
    # exact, because the fine splines have all knots of the others
    return np.asarray(np.linalg.lstsq(polynomials.basis(tau, FINE), wanted, rcond=None)[0])


def jitter_system(problem: Problem, state: State) -> JitterSystem:
    """Return the linear model of jitter at a solution without jitter curves.

    Raises
    ------
    InputError
        No image has the unknowns that jitter needs, or too many have them.
    """
    rows = linearised(problem, state)
    o, angles, moves = problem.observations, list[tuple[int, str, list[int]]](), list[Array]()
    sigma_px = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    for image, parameters in enumerate(problem.parameters):
        for name in ANGLES:
            names = [f"{name}_{degree}" for degree in range(polynomials.DEGREE)]
            if set(names) <= set(parameters.names):
                places = [parameters.names.index(one) for one in names]
                move = rows.image[:, :, places[0]] / parameters.sigma[places[0]]
                moves.append(np.where((o.image == image)[:, None], move, 0.0))
                angles.append((image, name, places))
    if not angles:
        raise InputError.of("jitter.no_angles", option="jitter", value=problem.block.name)
    if len(angles) > MOST_IMAGES * len(ANGLES):
        raise InputError.of("jitter.many", option="jitter", value=len(angles) // len(ANGLES), limit=MOST_IMAGES)
    px_per_rad = [
        float(np.sqrt(np.mean(np.sum((move * sigma_px)[o.image == image] ** 2, axis=1))))
        for (image, _, _), move in zip(angles, moves, strict=True)
    ]
    tau = np.empty(len(o))
    for image, of_block in enumerate(problem.block.images):
        own = o.image == image
        tau[own] = polynomials.normalised(o.line[own], of_block.sensor.n_lines)
    residual = np.concatenate(
        [
            rows.residual.ravel(),
            control_residuals(problem, state).ravel(),
            *(extra_blocks(problem, extra, state, jacobian=False)[0] for extra in problem.block.extra),
        ]
    )
    named, z = problem.named_points(), problem.n_free_unknowns
    begin = 2 * len(o) + 3 * int(problem.observed.sum())
    parts = chain(eliminated_points(problem, rows, named), extra_rows(problem, state, named, begin))
    p, wide = z + 3 * len(named), _F * len(angles)
    raw, out, count = np.zeros((len(angles), _F, _F)), [np.zeros((0, p + wide + 1))], 0
    with one_blas_thread():
        for part in parts:
            for reduced, splines in _wide(part, p, residual, np.stack(moves), tau):
                flat = splines.reshape(-1, len(angles), _F)
                raw += np.einsum("njf,njg->jfg", flat, flat, optimize=True)
                out.append(reduced)
                count += len(reduced)
                if sum(map(len, out)) > 2 * (p + wide + 1) + CHUNK // (p + wide):
                    out = [triangle(np.vstack(out))]
        short = triangle(np.vstack(out))
    prior = np.hstack([np.eye(z), np.zeros((z, p - z))])
    design, splines = np.vstack([short[:, :p], prior]), np.vstack([short[:, p:-1], np.zeros((z, wide))])
    columns, found = dict[tuple[int, int], Array](), list[Angle]()
    for j, (image, name, places) in enumerate(angles):
        own = problem.image_slice(image).start + np.array(places)
        free = own if problem.ties is None else problem.ties.of[own]
        linear = design[:, free] / problem.parameters[image].sigma[places]
        linear[len(short) :] = 0.0
        for k in RESOLUTIONS:
            spline = splines[:, _F * j : _F * (j + 1)] @ _shape(k)
            columns[j, k] = np.hstack([spline, linear * polynomials.jitter_quadratic(k)]) / px_per_rad[j]
        found.append(Angle(image, name, px_per_rad[j], raw[j]))
    observed = np.append(short[:, -1], -problem.image_vector(state))
    return JitterSystem(tuple(found), design, observed, columns, count - 3 * len(named))


def _wide(part: PointRows, p: int, residual: Array, moves: Array, tau: Array) -> Iterator[tuple[Array, Array]]:
    """Yield reduced rows (n, p + J F + 1) of points, and the rows (P, r, J F) of their splines before the elimination.

    ``moves`` (J, n, 2) are the derivatives of image points with respect to the angles, per rad.
    """
    n_points, r = part.rows.shape
    n_angles, n = moves.shape[:2]
    q = part.reduced.shape[1]
    step = max(1, CHUNK // (r * n_angles * _F))
    for begin in range(0, n_points, step):
        rows, columns = part.rows[begin : begin + step], part.columns[begin : begin + step]
        of_image = rows < 2 * n
        ray: Index = np.where(of_image, rows // 2, 0)
        move = np.where(of_image, moves[:, ray, rows % 2], 0.0)  # (J, P, r)
        values = polynomials.basis(tau[ray].ravel(), FINE).reshape(*ray.shape, _F)
        splines = (np.moveaxis(move, 0, 2)[..., None] * values[:, :, None]).reshape(*rows.shape, n_angles * _F)
        turned = np.swapaxes(part.basis[begin : begin + step], 1, 2)
        out = np.zeros((len(rows), q, p + n_angles * _F + 1))
        place = np.arange(len(rows))[:, None, None], np.arange(q)[None, :, None], columns[:, None, :]
        # additional columns contain zeros and have the place of the first one
        np.add.at(out, place, part.reduced[begin : begin + step])
        out[:, :, p:-1] = turned @ splines
        out[:, :, -1] = -(turned @ residual[rows][:, :, None])[:, :, 0]
        yield out.reshape(-1, out.shape[2]), splines
