"""Stepwise reduction of a set of image unknowns, with criteria and cross-validation of each model.

Backward: the least significant coefficient is removed and the block is adjusted again, as long as its
probability is above the level. Forward: the search starts with the most significant coefficient alone. Then
it adds the most significant further coefficient, as long as it is significant. A coefficient belongs to all
images; an F test covers all images that have it (``fg_orient.quality.significance``). A step tests many
coefficients at Sidak's level. With camera parameters or without priors, all models contain the poses of frame
images.

Criteria for n observations and k unknowns, including the unit weight::

    -2 ln L = n (ln(2 pi v^T v / n) + 1) + sum ln sigma_i^2
    AIC = -2 ln L + 2k,  AICc = AIC + 2k(k + 1)/(n - k - 1),  BIC = -2 ln L + k ln n

(Akaike 1974; Hurvich & Tsai 1989; Schwarz 1978). With priors an unknown counts by the share that the observations
determine, 1 - q_jj, and v excludes the residuals of priors.

Cross-validation excludes control points and their image points from the adjustment and predicts both: image
points are projected with the adjusted orientation, and control points are intersected from their rays. Check
points stay sealed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from factors.arrays import Array
from fg_orient.model.block import Block, Coordinates, WithheldCoordinates
from fg_orient.model.distributions import sidak
from fg_orient.model.errors import InputError, NoSolutionError, RankDeficientError
from fg_orient.model.names import EOP_SETS, Progress, Role
from fg_orient.model.parameters import N_EOP, eop_codes, parameter_name
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution
from fg_orient.quality.significance import GroupTest, group_test, places_of
from fg_orient.sensors.frame_unknowns import INTERIOR, UNKNOWNS

Direction = Literal["backward", "forward"]
#: Groups of ground points; each group is excluded together.
Parts = Sequence[Sequence[int]]

#: Probability of a false choice in one step, over all coefficients of the step.
LEVEL: Final = 0.05
#: Seed of the random parts of a cross-validation.
SEED: Final = 1


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Prediction errors, predicted minus measured.

    ``image_px`` (n, 2) are errors of line and sample. ``ground_m`` (p, 3) are errors East, North, Up (X, Y, Z in a
    local system) of the points ``ids``, which are in two images or more.
    """

    n_folds: int
    ids: tuple[str, ...]
    image_px: Array
    ground_m: Array

    @property
    def image_rms(self) -> float | None:
        """Root mean square length of the prediction errors in the image, pixels."""
        return _rms_length(self.image_px)

    @property
    def ground_rms(self) -> float | None:
        """Root mean square length of the prediction errors on the ground, m; None without points in two images."""
        return _rms_length(self.ground_m)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        axes = {
            name: None if not len(values) else np.sqrt(np.mean(values**2, axis=0)).tolist()
            for name, values in (("image_line_sample_px", self.image_px), ("ground_east_north_up_m", self.ground_m))
        }
        return {
            "folds": self.n_folds,
            "n_image_points": len(self.image_px),
            "n_points": len(self.ground_m),
            "image_rms_px": self.image_rms,
            "ground_rms_m": self.ground_rms,
            **axes,
        }


def _rms_length(errors: Array) -> float | None:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else None


def folds_of(block: Block, count: int = 0) -> Parts:
    """Divide the measured control points into parts of one point, or into ``count`` random parts of similar size.

    Raise InputError if there is only one part, or if there are fewer control points than parts.
    """
    control = block.points.where(Role.CONTROL)
    control = control[np.isin(control, block.observations.point)]
    if count < 0 or count == 1 or len(control) < max(count, 2):
        raise InputError.of("statistics.folds", option="folds", value=count, control=len(control))
    if count == 0:
        return tuple((int(j),) for j in control)
    order = np.random.default_rng(SEED).permutation(control)
    return tuple(tuple(sorted(part.tolist())) for part in np.array_split(order, count))


def cross_validate(block: Block, folds: Parts, **options: Any) -> CrossValidation:
    """Exclude each part (:func:`folds_of`) once and predict it from the others.

    ``options`` are options of :func:`fg_orient.adjust`, which raises its errors if a part cannot be
    excluded.
    """
    image, ground, ids = [np.zeros((0, 2))], [np.zeros((0, 3))], list[str]()
    check_points = options.pop("check_points", None) or block.options.check_points
    block = _without_check_points(block, keep_rays=check_points == "use")
    known, o = block.points.known.ecef_m, block.observations
    for fold in folds:
        solution = adjust(left_out(block, fold), check_points="exclude", **options)
        ids += solution.accuracy.check.ids
        ground.append(solution.accuracy.check.enu_m)
        for k, entry in enumerate(block.images):
            rows = np.flatnonzero(np.isin(o.point, fold) & (o.image == k))
            if len(rows):
                line, sample = entry.sensor.project(known[o.point[rows]], solution.correction(entry.id))
                image.append(np.stack([line - o.line[rows], sample - o.sample[rows]], axis=1))
    return CrossValidation(len(folds), tuple(ids), np.vstack(image), np.vstack(ground))


def left_out(block: Block, fold: Sequence[int]) -> Block:
    """Return the block in which these control points are check points. Points with one image point are removed."""
    points, o, known, chosen = block.points, block.observations, block.points.known, np.array(fold, np.intp)
    gone = np.isin(np.arange(len(points.ids)), chosen)
    sealed = Coordinates(known.ecef_m[chosen], known.sigma_enu_m[chosen], known.fixed[chosen])
    single = gone & (np.bincount(o.point, minlength=len(gone)) < 2)
    ids = tuple(points.ids[j] for j in chosen)
    return replace(
        block,
        points=points.without_coordinates(gone, Role.CHECK),
        observations=o.take(~single[o.point]),
        withheld=WithheldCoordinates(ids, lambda: sealed),
    )


def _without_check_points(block: Block, *, keep_rays: bool) -> Block:
    """Return the block with tie points in place of check points, or without their image points."""
    points, check = block.points, block.points.where(Role.CHECK)
    roles = tuple(Role.TIE if role is Role.CHECK else role for role in points.roles)
    keep = ~np.isin(block.observations.point, check) | keep_rays
    nothing = Coordinates(np.empty((0, 3)), np.empty((0, 3)), np.zeros(0, bool))
    return replace(
        block,
        points=replace(points, roles=roles),
        observations=block.observations.take(keep),
        withheld=WithheldCoordinates((), lambda: nothing),
    )


@dataclass(frozen=True)
class Criteria:
    """Criteria of one model with n observations, without priors.

    k is the number of unknowns that the observations determine, plus one for the unit weight. Values are None for an
    exact fit, whose likelihood has no maximum; ``aicc`` also if n <= k + 1.
    """

    n: int
    k: float
    sigma0: float
    log_likelihood: float | None
    aic: float | None
    aicc: float | None
    bic: float | None


@dataclass(frozen=True)
class Step:
    """One model of a reduction.

    ``changed`` is the coefficient that was dropped or added ("" for the first model), and ``test`` is its test.
    ``tests`` of all coefficients of the model begin with the least significant.
    """

    unknowns: tuple[str, ...]
    changed: str
    test: GroupTest | None
    tests: tuple[GroupTest, ...]
    criteria: Criteria
    validation: CrossValidation | None = None


@dataclass(frozen=True)
class Reduction:
    """All models of a reduction in their order, the level of each step, and the solution of the last model.

    ``kept``: unknowns of all models.
    """

    direction: Direction
    level: float
    steps: tuple[Step, ...]
    solution: Solution
    kept: tuple[str, ...] = ()

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Unknowns of the last model: all significant or kept ones."""
        return self.steps[-1].unknowns

    @property
    def closest_set(self) -> tuple[int, tuple[str, ...], tuple[str, ...]] | None:
        """EOP set with the fewest differences; see :func:`closest_eop_set`."""
        return closest_eop_set(self.unknowns)

    def best(self, criterion: str) -> Step:
        """Return the step with the least "aic", "aicc", "bic", or prediction error "image" or "ground"."""

        def value(step: Step) -> float:
            source = step.criteria if criterion in ("aic", "aicc", "bic") else step.validation
            figure = getattr(source, criterion if source is step.criteria else f"{criterion}_rms", None)
            return float("inf") if figure is None else float(figure)

        return min(self.steps, key=value)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        closest = self.closest_set
        named = ("aic", "aicc", "bic", *(("image", "ground") if self.steps[0].validation else ()))
        return {
            "direction": self.direction,
            "level": self.level,
            "unknowns": list(self.unknowns),
            "kept": list(self.kept),
            "closest_eop_set": None
            if closest is None
            else {
                "number": closest[0],
                "name": EOP_SETS[closest[0]].name,
                "only_in_set": list(closest[1]),
                "not_in_set": list(closest[2]),
            },
            "best": {name: self.steps.index(self.best(name)) for name in named},
            "steps": [
                {
                    "unknowns": list(s.unknowns),
                    "changed": s.changed or None,
                    "test": None if s.test is None else dict(vars(s.test)),
                    "tests": [dict(vars(t)) for t in s.tests],
                    **vars(s.criteria),
                    "validation": None if s.validation is None else s.validation.as_dict(),
                }
                for s in self.steps
            ],
        }


def closest_eop_set(unknowns: Iterable[str]) -> tuple[int, tuple[str, ...], tuple[str, ...]] | None:
    """Return the EOP set with the fewest differences: its number, additional and missing coefficients."""
    eop = [parameter_name(code) for code in range(N_EOP)]
    mine = set(unknowns) & set(eop)
    if not mine:
        return None

    def difference(number: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
        codes = {parameter_name(code) for code in eop_codes(number)}
        return tuple(n for n in eop if n in codes - mine), tuple(n for n in eop if n in mine - codes)

    number = min(EOP_SETS, key=lambda n: (sum(map(len, difference(n))), n))
    return number, *difference(number)


def reduce_unknowns(
    block: Block,
    *,
    direction: Direction = "backward",
    level: float = LEVEL,
    folds: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Reduction:
    """Reduce the set of unknowns of a block's images.

    Parameters
    ----------
    block : Block
        Block whose options name the whole set. Gross errors and variance components are determined with the whole set
        and kept for all models.
    direction : str
        "backward" or "forward".
    level : float
        Probability of a false choice in one step.
    folds : int, optional
        Number of parts of the control points for the cross-validation of every model; 0: one point in each part.
        Default: no cross-validation.
    progress : callable, optional
        Function that is called before each adjustment.
    **options
        Options of :func:`fg_orient.adjust`.

    Raises
    ------
    InputError
        See :func:`fg_orient.adjust`. The direction is unknown, there are fewer control points than folds, or the
        options contain a loss or a search.
    NoSolutionError
        There is no covariance or no redundancy.
    """
    if direction not in ("backward", "forward"):
        raise InputError.of("options.value", option="direction", value=direction, expected='"backward" or "forward"')
    if not 0.0 < level < 1.0:
        raise InputError.of("options.value", option="level", value=level, expected="a number above 0 and below 1")
    run = _Runs(block, options, progress, folds)
    full = run.adjust(())
    every = tuple(dict.fromkeys(name for p in full.problem.parameters for name in p.names))
    run.kept = kept = _poses(every) if _has_camera(every) or not full.block.options.priors else ()
    n = len(every) - len(kept)
    run.keep(full, n + 1 if direction == "backward" else 1 + n * (n + 1) // 2)
    steps = _backward(run, full, every, level) if direction == "backward" else _forward(run, every, level)
    return Reduction(direction, level, tuple(step for step, _ in steps), steps[-1][1], kept)


def _poses(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names that are rotations or projection centres of frame images."""
    return tuple(name for name in names if name in UNKNOWNS and name not in INTERIOR)


def _has_camera(names: Iterable[str]) -> bool:
    """Return whether these names contain parameters of cameras."""
    return any(name in INTERIOR for name in names)


class _Runs:
    """Adjustments of one block with different unknowns."""

    def __init__(self, block: Block, options: dict[str, Any], progress: Progress | None, folds: int | None) -> None:
        self._block, self._options, self._count = block, options, folds
        self._folds: Parts = () if folds is None else folds_of(block, folds)
        self._report, self._done, self.most = progress or (lambda done, most, text: None), 0, 1
        #: Unknowns that all models contain.
        self.kept: tuple[str, ...] = ()

    def adjust(self, unknowns: tuple[str, ...]) -> Solution:
        """Adjust with these unknowns; by default with the unknowns of the options."""
        self._report(self._done, self.most, f"{len(unknowns)} unknowns" if unknowns else "all unknowns")
        self._done += 1
        given = {**self._options, **({"image_unknowns": unknowns} if unknowns else {})}
        solution = adjust(self._block, **given)
        solution.required_cofactors(unweighted="statistics.significance_weighted")
        if solution.redundancy <= 0:
            raise NoSolutionError.of("statistics.no_redundancy", place=self._block.name, value=solution.redundancy)
        return solution

    def keep(self, full: Solution, most: int) -> None:
        """Keep the gross errors and variance components of the first model for all other models."""
        self.most = most
        self._block = replace(full.block, options=replace(full.block.options, snoop=False, variance_components=()))
        self._options = {k: v for k, v in self._options.items() if k not in ("snoop", "variance_components")}
        if self._count is not None:
            self._folds = folds_of(self._block, self._count)

    def step(self, solution: Solution, unknowns: tuple[str, ...], changed: str, test: GroupTest | None) -> Step:
        """Record a model."""
        tested = (coefficient_test(solution, name) for name in unknowns if name not in self.kept)
        tests = sorted(tested, key=lambda t: -t.probability)
        validation = None
        if self._folds:
            self._report(self._done, self.most, f"cross-validation of {len(unknowns)} unknowns")
            validation = cross_validate(self._block, self._folds, image_unknowns=unknowns, **self._options)
        return Step(unknowns, changed, test, tuple(tests), criteria(solution), validation)


def coefficient_test(solution: Solution, name: str) -> GroupTest:
    """Return the F test of a coefficient over all images that have it."""
    index = places_of(solution.problem, lambda known: known == name)
    return group_test(solution.residual_cofactors, solution.sigma0, solution.unknown_freedom, name, index)


def _backward(run: _Runs, full: Solution, every: tuple[str, ...], level: float) -> list[tuple[Step, Solution]]:
    """Drop the least significant coefficient until all are significant."""
    steps = [(run.step(full, every, "", None), full)]
    while len(steps[-1][0].tests) > (0 if run.kept else 1):
        last = steps[-1][0]
        worst = last.tests[0]
        if worst.probability <= sidak(level, len(last.tests)):
            break
        rest = tuple(name for name in last.unknowns if name != worst.group)
        try:
            solution = run.adjust(rest)
        except InputError:  # raised if an image would have no unknown left
            break
        steps.append((run.step(solution, rest, worst.group, worst), solution))
    return steps


def _forward(run: _Runs, every: tuple[str, ...], level: float) -> list[tuple[Step, Solution]]:
    """Add the most significant coefficient until none is significant; without kept ones the first is always added."""
    steps: list[tuple[Step, Solution]] = []
    if run.kept:
        solution = run.adjust(run.kept)
        steps.append((run.step(solution, run.kept, "", None), solution))
    while True:
        chosen = steps[-1][0].unknowns if steps else ()
        trials: list[tuple[GroupTest, tuple[str, ...], Solution]] = []
        for name in (n for n in every if n not in chosen):
            trial = tuple(n for n in every if n in (*chosen, name))
            # models in which an image has no unknown, or an unobservable one, are skipped
            with suppress(InputError, RankDeficientError):
                solution = run.adjust(trial)
                trials.append((coefficient_test(solution, name), trial, solution))
        if not trials:
            return steps
        test, taken, solution = min(trials, key=lambda t: (t[0].probability, -t[0].statistic, t[0].group))
        if steps and test.probability > sidak(level, len(trials)):
            return steps
        steps.append((run.step(solution, taken, test.group, test), solution))


def criteria(solution: Solution) -> Criteria:
    """Return the criteria of the model of a solution."""
    problem, q = solution.problem, solution.required_cofactors()
    priors, o, known = problem.block.options.priors, problem.observations, problem.block.points.known
    x = problem.image_vector(solution.state) if priors else np.zeros(0)
    squares, n = solution.chi2 - float(x @ x), problem.n_observations - len(x)
    log_sigma = np.log(o.sigma_line_px).sum() + np.log(o.sigma_sample_px).sum()
    log_sigma += np.log(known.sigma_enu_m[problem.observed]).sum()
    determined = float(problem.n_free_unknowns)
    if priors:
        determined = sum(float(np.sum(1.0 - np.diag(q.image(k)))) for k in range(problem.n_images))
    k = 1.0 + 3.0 * int(problem.active.sum()) + determined
    if squares <= 0.0:  # for an exact fit the likelihood has no maximum
        return Criteria(n, k, solution.sigma0, None, None, None, None)
    log_likelihood = float(-0.5 * (n * (np.log(2.0 * np.pi * squares / n) + 1.0) + 2.0 * float(log_sigma)))
    aic = float(-2.0 * log_likelihood + 2.0 * k)
    aicc = aic + 2.0 * k * (k + 1.0) / (n - k - 1.0) if n > k + 1.0 else None
    return Criteria(n, k, solution.sigma0, log_likelihood, aic, aicc, float(-2.0 * log_likelihood + k * np.log(n)))
