"""Find jitter: test against no jitter, choose resolution and strength by restricted likelihood, compute bands.

1. The statistic of an angle that has no curve yet is the largest gain of log likelihood over all numbers of intervals
   and strengths. The statistic of a step is the largest of all angles. Its distribution without further
   jitter is simulated in the linear model, with the same choices (parametric bootstrap). A step
   therefore finds jitter that does not exist only with the probability :data:`LEVEL`.
2. The best curve is added if the test rejects, and all strengths and resolutions are optimised in turn. Images have one
   resolution for roll and pitch. Steps are repeated until the test does not reject.
3. A band contains the uncertainty of strength and resolution: models with other values are weighted by their likelihood
   (:meth:`JitterChoice.band`).

An angle is resolved over k intervals if jitter of 1 px would be determined by more than
half: the mean of ``l / (1 + l)`` over the eigenvalues l of its information exceeds 0.5.
Three intervals describe a cycle, so k of them resolve ``k / 3`` cycles. Beyond that the
control is too sparse, or ground points absorb the jitter. An angle without any resolved
frequency gets no curve: its extrapolation between few points could do more harm than the
jitter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array
from fg_orient.quality.jitter_system import RESOLUTIONS, Fit, JitterSystem, Strength, mean_squares

#: Probability of finding jitter in a step although there is none.
LEVEL: Final = 0.01
#: Number of simulated blocks per step, and seed of their errors.
SIMULATED: Final = 999
SEED: Final = 1
#: Strengths that are tested, px.
STRENGTHS: Final = np.geomspace(0.03, 10.0, 25)
#: Factors of a strength that are tried when the choice is optimised, and when a band is computed.
REFINED: Final = (0.5, 0.7, 0.84, 1.19, 1.41, 2.0)
MIXED: Final = (0.35, 0.5, 0.71, 1.0, 1.41, 2.0, 2.8)
#: Number of neighbouring resolutions on both sides that are tried.
NEIGHBOURS: Final = 2
#: An optimisation ends if the log likelihood increases by less than the first number. A model is ignored if its log
#: likelihood is below the best one by more than the second number.
SETTLED, NEGLIGIBLE = 1e-2, 4.0
#: Number of intervals that describe a cycle.
PER_CYCLE: Final = 3.0
#: Number of intervals at which the shares absorbed by points and orientation are computed.
ABSORBED_AT: Final = 8
#: Number of lines of a band.
LINES: Final = 201
#: Normal quantile of a one-sided bound of 95 %. At this bound, the log likelihood is lower than its
#: maximum by ``DROP``.
ONE_SIDED: Final = 1.644854
DROP: Final = 0.5 * ONE_SIDED**2


@dataclass(frozen=True)
class Step:
    """Test of a step: gain of log likelihood, its limit, probability of a larger gain without jitter, and the curve."""

    gain: float
    limit: float
    p: float
    best: Strength
    #: Largest amplitude of each angle (px, at resolutions that the points resolve) that
    #: the likelihood does not exclude (95 %); nan for an angle with a curve, or without
    #: such resolutions.
    bounds: Array

    @property
    def rejects(self) -> bool:
        """True if the step finds jitter."""
        return self.p <= LEVEL


@dataclass(frozen=True)
class Band:
    """Jitter of an angle at lines of its image, without its quadratic polynomial, px.

    Parameters
    ----------
    tau : (N,) array
        Normalised lines from -1 to 1.
    value : (N,) array
        Estimate of the chosen model.
    sd : (N,) array
        Standard deviation, with the uncertainty of strength and resolution.
    mean_square : float
        Posterior mean of the mean square over the lines.
    """

    tau: Array
    value: Array
    sd: Array
    mean_square: float

    @property
    def amplitude_px(self) -> float:
        """Amplitude of a sine wave with this mean square."""
        return float(np.sqrt(2.0 * self.mean_square))


@dataclass(frozen=True)
class JitterChoice:
    """Chosen jitter of a block.

    Parameters
    ----------
    system : JitterSystem
    chosen : tuple of Strength
        Curves in the order in which they were found.
    steps : tuple of Step
        Test of each step; only the last one does not reject, unless every resolved angle has a curve.
    """

    system: JitterSystem
    chosen: tuple[Strength, ...]
    steps: tuple[Step, ...]

    def resolved_cycles(self, angle: int) -> float:
        """Return the highest frequency, cycles per image, that the points resolve in an angle; 0 if none."""
        return max((k / PER_CYCLE for k in self.system.resolved[angle]), default=0.0)

    def absorbed(self, angle: int) -> tuple[float, float]:
        """Return the shares of the effect of jitter on image points that ground points and orientation absorb."""
        _, points, orientation = self.system.information(angle, ABSORBED_AT)
        return points, orientation

    @cached_property
    def fit(self) -> Fit:
        """Estimate with the chosen curves."""
        return self.system.fit(self.chosen)

    def band(self, number: int) -> Band:
        """Return the band of a chosen curve, averaged over models with other strengths and resolutions of its angle."""
        tau = np.linspace(-1.0, 1.0, LINES)
        value, _ = self.fit.curve(number, tau)
        own = self.chosen[number]
        fits = [
            self.system.fit(_changed(self.system, self.chosen, own.angle, intervals=k, factor=factor))
            for k in _near(own.intervals)
            for factor in MIXED
        ]
        best = max(fit.log for fit in fits)
        fits = [fit for fit in fits if fit.log > best - NEGLIGIBLE]
        weights = np.exp([fit.log - best for fit in fits])
        curves = np.array([fit.curve(number, tau) for fit in fits])
        second = np.average(curves[:, 0] ** 2 + curves[:, 1] ** 2, axis=0, weights=weights)
        variance = np.average((curves[:, 0] - value) ** 2 + curves[:, 1] ** 2, axis=0, weights=weights)
        return Band(tau, value, np.sqrt(variance), float(np.mean(second)))


def choose(system: JitterSystem) -> JitterChoice:
    """Return the jitter for which there is evidence."""
    rng, chosen, steps = np.random.default_rng(SEED), tuple[Strength, ...](), list[Step]()
    while len(chosen) < len(system.angles):
        tested = step(system, chosen, rng)
        if tested is None:
            break
        steps.append(tested)
        if not tested.rejects:
            break
        chosen = _optimised(system, _joined(system, chosen, tested.best))
    return JitterChoice(system, chosen, tuple(steps))


def step(system: JitterSystem, chosen: Sequence[Strength], rng: np.random.Generator) -> Step | None:
    """Test whether a further angle has jitter, with the curves chosen so far; None if no further angle is resolved."""
    design, observed = system.bordered(chosen)
    (m, p), nu = design.shape, system.freedom
    q = np.linalg.qr(design)[0]
    drawn = np.column_stack([observed, rng.standard_normal((m, SIMULATED))])
    drawn -= q @ (q.T @ drawn)
    squares = np.sum(drawn**2, axis=0)
    if nu > m - p:  # the system was compressed to m rows: draw the sum of squares of the others
        squares[1:] += rng.chisquare(nu - (m - p), SIMULATED)
    largest, bounds, best = np.full(SIMULATED + 1, -np.inf), np.full(len(system.angles), np.nan), None
    taken = {c.angle for c in chosen}
    for angle in range(len(system.angles)):
        told = system.resolved[angle]
        if angle in taken or not told:
            continue
        trials = list[_Trial]()
        for k in RESOLUTIONS:
            x = np.zeros((m, k + 3))
            x[: len(system.design)] = system.columns[angle, k]
            x -= q @ (q.T @ x)
            eigenvalues, vectors = np.linalg.eigh(x.T @ x)
            along = (x @ vectors).T @ drawn
            gain = _gains(np.maximum(eigenvalues, 0.0), along**2, squares, nu)
            top = int(np.argmax(gain[:, 0]))
            if gain[top, 0] > largest[0]:
                best = Strength(angle, k, float(STRENGTHS[top]))
            largest = np.maximum(largest, gain.max(axis=0))
            if k in told:
                trials.append(_Trial(k, gain[:, 0], np.maximum(eigenvalues, 0.0), vectors[:k], along[:, 0]))
        bounds[angle] = _bound(trials, squares[0] / nu)
    if best is None:
        return None
    exceeding = 1 + int(np.count_nonzero(largest[1:] >= largest[0]))
    return Step(
        float(largest[0]), float(np.quantile(largest[1:], 1.0 - LEVEL)), exceeding / (SIMULATED + 1), best, bounds
    )


class _Trial(NamedTuple):
    """Trial of jitter over k intervals: gains of all strengths, eigenvalues, eigenvectors (k, k + 3), y along them."""

    intervals: int
    gain: Array
    eigenvalues: Array
    vectors: Array
    along: Array


def _bound(trials: Sequence[_Trial], scale: float) -> float:
    """Return the largest amplitude, px, that the observations do not exclude; nan if no resolution was tried.

    Strengths and resolutions within :data:`DROP` of the largest likelihood are possible.
    With each, the mean square of the curve without its quadratic polynomial has a
    posterior mean and standard deviation (``z^T Q z`` of normal z).
    """
    if not trials:
        return float("nan")
    least, out = max(0.0, *(float(one.gain.max()) for one in trials)) - DROP, 0.0
    for one in trials:
        for g in STRENGTHS[one.gain >= least]:
            weight = g**2 / (1.0 + g**2 * one.eigenvalues)
            z = one.vectors @ (weight * one.along)
            covariance = scale * (one.vectors * weight) @ one.vectors.T
            shape = mean_squares(one.intervals)
            moved, spread = shape @ z, shape @ covariance
            mean = z @ moved + np.trace(spread)
            sd = np.sqrt(2.0 * np.sum(spread * spread.T) + 4.0 * moved @ covariance @ moved)
            out = max(out, float(np.sqrt(2.0 * (mean + ONE_SIDED * sd))))
    return out


def _gains(eigenvalues: Array, along: Array, squares: Array, nu: int) -> Array:
    """Return the gains of log likelihood (S, n) of S strengths; ``along`` (r, n) are squares along eigenvectors."""
    g2 = STRENGTHS[:, None] ** 2
    weight = g2 / (1.0 + g2 * eigenvalues)
    rest = np.maximum(1.0 - weight @ along / squares, np.finfo(float).tiny)
    return np.asarray(-0.5 * (np.log1p(g2 * eigenvalues).sum(axis=1)[:, None] + nu * np.log(rest)))


def _image(system: JitterSystem, angle: int) -> int:
    return system.angles[angle].image


def _near(intervals: int) -> tuple[int, ...]:
    """Return the neighbouring resolutions."""
    at = RESOLUTIONS.index(intervals)
    return RESOLUTIONS[max(0, at - NEIGHBOURS) : at + NEIGHBOURS + 1]


def _changed(
    system: JitterSystem, chosen: Sequence[Strength], angle: int, *, intervals: int, factor: float = 1.0
) -> tuple[Strength, ...]:
    """Return the curves with a changed strength of one angle and changed intervals of all curves of its image."""
    return tuple(
        Strength(
            c.angle,
            intervals if _image(system, c.angle) == _image(system, angle) else c.intervals,
            c.px * factor if c.angle == angle else c.px,
        )
        for c in chosen
    )


def _joined(system: JitterSystem, chosen: Sequence[Strength], best: Strength) -> tuple[Strength, ...]:
    """Return the curves with one curve added.

    All curves of its image get the finer of the two resolutions.
    """
    own = [c.intervals for c in chosen if _image(system, c.angle) == _image(system, best.angle)]
    return _changed(system, (*chosen, best), best.angle, intervals=max(best.intervals, *own, 0))


def _optimised(system: JitterSystem, chosen: tuple[Strength, ...]) -> tuple[Strength, ...]:
    """Return the curves whose strengths and resolutions, changed in turn, have the largest likelihood."""
    best = system.fit(chosen).log
    while True:
        before = best
        for number in range(len(chosen)):
            own = chosen[number]
            trials = [_changed(system, chosen, own.angle, intervals=k) for k in _near(own.intervals)]
            trials += [_changed(system, chosen, own.angle, intervals=own.intervals, factor=f) for f in REFINED]
            logs = [system.fit(trial).log for trial in trials]
            if max(logs) > best:
                best, chosen = max(logs), trials[int(np.argmax(logs))]
        if best - before < SETTLED:
            return chosen
