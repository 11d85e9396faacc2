"""Doubts that follow from tests: gross errors, corrections too large for their priors, missed required accuracy.

Each doubt has a share of the probability that a block without mistakes ends with exit code 4 (:data:`BUDGET`). A user
accepts a doubt by its code, its place and, as an option, a limit of its size (:func:`with_accepted`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import release
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.distributions import chi_square_tail, sidak
from fg_orient.model.errors import Finding, InputError, by_severity, finding
from fg_orient.model.machine import MANY_ROWS, return_memory
from fg_orient.model.messages import CATALOGUE
from fg_orient.quality.accuracy import CHANCE, PointDifferences
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.covariance import gives_statistics
from fg_orient.quality.hypotheses import CHECKED
from fg_orient.quality.outlier_records import OutlierTests
from fg_orient.quality.outliers import outlier_tests
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.stated_sigmas import StatedSigma, stated_sigmas

#: Probability of the two-sided interval of sigma0.
SIGMA0_LEVEL: Final = 0.999
#: Largest probability of each doubt in a block without mistakes, for all tests of the doubt together (see
#: docs/verdict.md).
BUDGET: Final = {
    "sigma0": 0.0005, "gross_error": 0.002, "beyond_prior": 0.001, "check_beyond": CHANCE, "check_far": CHANCE,
    "sigmas": 0.001,
}  # fmt: skip
#: Level of Baarda's test of one observation. If its probability is larger, the given sigmas allow the error.
ALPHA: Final = 0.001
#: Smallest factor by which the sigma of a group must be wrong: smaller factors change little.
MATTERS: Final = 1.25
#: An image is suspicious if at least this number of its image points, and at least half of them, are
#: suspicious.
CROWD: Final = 3
#: Number of points whose accuracy is computed together.
_CHUNK: Final = 100_000
_ACCEPTANCE: Final = re.compile(r"(verdict\.)?(?P<code>[a-z0-9_]+)(:(?P<place>.*?))?(<=(?P<limit>[0-9.eE+-]+))?")


class Examined(NamedTuple):
    """Doubts that follow from tests of a solution, with the computed cofactors, tests and sigmas."""

    findings: list[Finding]
    residuals: ResidualCofactors | None = None
    tests: OutlierTests | None = None
    sigmas: tuple[StatedSigma, ...] = ()


def of_solution(
    problem: Problem, estimate: Estimate, ground_m: Array, cofactors: Cofactors | None, check: PointDifferences
) -> Examined:
    """Return the doubts that follow from tests of a solution.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
        Converged estimate.
    ground_m : (N, 3) array
        Adjusted points, ECEF or local.
    cofactors : Cofactors or None
    check : PointDifferences
    """
    options, f = problem.block.options, problem.redundancy
    scale = float(np.sqrt(estimate.chi2 / f)) if f > 0 and estimate.weights is None else 1.0
    out = missed_accuracy(problem, ground_m, cofactors, scale)
    if cofactors is None or estimate.weights is not None or f <= 0:
        return Examined(out)
    out += [*exceeded_priors(problem, estimate.state, cofactors), *of_check_points(check)]
    if not gives_statistics(problem, cofactors):
        return Examined(out)
    residuals = ResidualCofactors(problem, estimate.state, cofactors)
    residuals.compute()
    if len(problem.observations) >= MANY_ROWS and not options.snoop:  # the next round of the search uses them again
        release(problem, "records")
    return_memory(len(problem.observations))
    tests = outlier_tests(
        residuals,
        estimate.chi2,
        level=options.outlier_level,
        test=options.outlier_test,
        control=options.multiple_testing,
    )
    gross = gross_errors(tests, options.accept, estimate.chi2)
    sigmas = stated_sigmas(residuals, tests if gross else None)
    # the other residuals contain parts of a gross error: if it alone explains sigma0, no sigma is doubted
    doubted = [] if any(explains_all(one) for one in gross) else wrong_sigmas(sigmas)
    return Examined([*out, *gross, *doubted], residuals, tests, sigmas)


def explains_all(found: Finding) -> bool:
    """Return whether a finding is a gross error without which sigma0 is inside its interval."""
    return found.severity == "doubt" and found.data.get("without") is not None


def wrong_sigmas(sigmas: Sequence[StatedSigma]) -> list[Finding]:
    """Report a doubt on the group whose stated sigmas are too small, and notes on groups whose sigmas are too large.

    Sigmas that are too large make the result look worse than it is. This is no reason to doubt it.
    """
    level, out = sidak(BUDGET["sigmas"], max(len(sigmas), 1)), list[Finding]()
    small = [s for s in sigmas if s.larger <= level and s.factor - 2.0 * s.sd > 1.0 and s.factor >= MATTERS]
    for s in sorted(small, key=lambda s: s.larger)[:1]:
        out.append(
            finding(
                "verdict.sigmas",
                place=s.group,
                words=s.words,
                size=s.factor,
                level=100.0 * BUDGET["sigmas"],
                more=[o.group for o in small if o is not s],
            )
        )
    for s in sigmas:
        if s.smaller <= level and s.factor <= 1.0 / MATTERS:
            out.append(finding("verdict.sigmas_large", place=s.group, words=s.words, size=s.factor))
    return out


def gross_errors(tests: OutlierTests, accept: Sequence[str] = (), chi2: float | None = None) -> list[Finding]:
    """Return the doubts on accepted observations, then the doubt on the most suspicious other observation.

    ``chi2`` is the weighted sum of squares of the adjustment. If it is given, the finding states sigma0 without the
    observation, provided that this sigma0 is inside its interval.

    A gross error makes other observations suspicious, too; these are only counted. An error that the given sigmas allow
    (Baarda's test of this observation alone) is not a doubt, although it is large relative to a small sigma0.
    """
    level, d = BUDGET["gross_error"], tests.dimension
    unlikely = np.flatnonzero((d > 0) & (tests.probability <= sidak(level, max(tests.n_tested, 1))))
    above = unlikely[chi_square_tail(d[unlikely], tests.quadratic[unlikely]) <= ALPHA]
    first = np.sort(np.unique(tests.of_class[above], return_index=True)[1])
    out: list[Finding] = []
    for rank, k in enumerate(above[first].tolist()):
        test = tests[k]
        also, places = test.inseparable, _decimals(float(np.abs(test.error).max(initial=0.0)))
        out.append(
            finding(
                "verdict.gross_error",
                place=test.name,
                size=test.statistic,
                symbol=test.symbol,
                error=" ".join(f"{round(value, places) + 0.0:+.{places}f}" for value in test.error),  # no -0.00
                unit=test.unit,
                also=list(also),
                level=100.0 * level,
                more=len(first) - rank - 1 or None,
                crowd=_crowd(tests, above),
                without=None if chi2 is None else _sigma0_without(tests, k, chi2),
            )
        )
        if not _accepts(out[-1], accept):
            break
    return out


def _decimals(size: float) -> int:
    """Return the number of decimals of an error: two, or two significant digits of a small error."""
    return max(2, 1 - int(np.floor(np.log10(size)))) if 0.0 < size < np.inf else 2


def _sigma0_without(tests: OutlierTests, k: int, chi2: float) -> float | None:
    """Return sigma0 without an observation, from its quadratic form; None if it is above its 99.9 % interval."""
    rest, freedom = max(chi2 - float(tests.quadratic[k]), 0.0), tests.problem.redundancy - int(tests.dimension[k])
    if freedom <= 0 or float(chi_square_tail(freedom, rest)) < 0.5 * (1.0 - SIGMA0_LEVEL):
        return None
    return float(np.sqrt(rest / freedom))


def _crowd(tests: OutlierTests, above: Index) -> str | None:
    """Describe the image that has most of its points above their limits; None if there is no such image."""
    problem, rows = tests.problem, np.unique(tests.row[above])
    images = problem.observations.image
    count = np.bincount(images[rows[rows >= 0]], minlength=problem.n_images)
    worst, total = int(np.argmax(count)), np.bincount(images, minlength=problem.n_images)
    if count[worst] < CROWD or 2 * count[worst] < total[worst]:
        return None
    return f"{count[worst]} of the {total[worst]} image points of image {problem.block.images[worst].id}"


def exceeded_priors(problem: Problem, state: State, cofactors: Cofactors) -> list[Finding]:
    """Report a doubt on the image unknown that differs most from its prior, if its prior does not allow the difference.

    In units of the prior variance, the correction x of an unknown has the variance ``1 - q``, where q is its
    cofactor after the adjustment.
    """
    if not problem.block.options.priors:
        return []
    x = problem.image_columns(state)
    q = np.concatenate([np.diag(cofactors.image(k)) for k in range(problem.n_images)])
    squares = np.where(1.0 - q > CHECKED, x**2 / np.maximum(1.0 - q, CHECKED), 0.0)
    above = chi_square_tail(1, squares) <= sidak(BUDGET["beyond_prior"], problem.n_free_unknowns)
    if not above.any():
        return []
    worst = int(np.argmax(squares))
    image = int(np.searchsorted(problem.first, worst, side="right")) - 1
    parameters, k = problem.parameters[image], worst - int(problem.first[image])
    return [
        finding(
            "verdict.beyond_prior",
            place=f"{parameters.names[k]} of image {problem.block.images[image].id}",
            size=float(np.sqrt(squares[worst])),
            correction=float(x[worst] * parameters.sigma[k]),
            sigma=float(parameters.sigma[k]),
            unit=parameters.units[k],
            level=100.0 * BUDGET["beyond_prior"],
            more=int(above.sum()) - 1 or None,
        )
    ]


def of_check_points(check: PointDifferences) -> list[Finding]:
    """Return the doubt on check coordinates above 3 standard deviations, unless chance explains maximum and number."""
    beyond, out = check.beyond, list[Finding]()
    if beyond.far:
        out.append(
            finding("verdict.check_far", size=beyond.largest, limit=beyond.largest_limit, n=beyond.n, points=beyond.far)
        )
    if beyond.many:
        points = list(dict.fromkeys(row[0] for row in check.suspicious()))
        out.append(
            finding(
                "verdict.check_beyond",
                points=points,
                size=beyond.count,
                n=beyond.n,
                expected=beyond.expected,
                level=100.0 * BUDGET["check_beyond"],
            )
        )
    return out


def missed_accuracy(problem: Problem, ground_m: Array, cofactors: Cofactors | None, scale: float) -> list[Finding]:
    """Report a doubt on adjusted points whose standard deviation exceeds the required accuracy along any axis.

    Parameters
    ----------
    problem : Problem
    ground_m : (N, 3) array
        Adjusted points, ECEF or local.
    cofactors : Cofactors or None
    scale : float
        Factor that converts roots of cofactors to standard deviations.
    """
    required = problem.block.options.required_accuracy_m
    if required is None:
        return []
    if cofactors is None:
        return [finding("verdict.accuracy_unknown", required=required)]
    points = np.flatnonzero(problem.active & np.isfinite(ground_m).all(axis=1))
    worst, beyond = 0.0, list[int]()
    for begin in range(0, len(points), _CHUNK):
        some = points[begin : begin + _CHUNK]
        axes = problem.axes(ground_m[some])
        variance = np.einsum("nij,njk,nik->ni", axes, cofactors.points(some), axes)
        largest = scale * np.sqrt(np.maximum(variance, 0.0)).max(axis=1)
        worst, beyond = max(worst, float(largest.max())), [*beyond, *some[largest > required].tolist()]
    names = [problem.block.points.ids[j] for j in beyond]
    return (
        [finding("verdict.accuracy", n=len(names), of=len(points), required=required, size=worst, points=names)]
        if names
        else []
    )


def _accepts(doubt: Finding, accept: Sequence[str]) -> bool:
    """Return whether a doubt is accepted by code, place and limit."""
    for text in accept:
        part = _ACCEPTANCE.fullmatch(text)
        if part is None or f"verdict.{part['code']}" != doubt.code or part["place"] not in (None, doubt.place):
            continue
        if part["limit"] is None or float(doubt.data.get("size", np.inf)) <= float(part["limit"]):
            return True
    return False


def require_acceptances(accept: Iterable[str]) -> None:
    """Raise InputError for an acceptance that cannot be read."""
    for text in accept:
        part = _ACCEPTANCE.fullmatch(text)
        if part is None or not _is_number(part["limit"]):
            form = "CODE, CODE:OBJECT or CODE:OBJECT<=LIMIT, such as gross_error:point 12<=20"
            raise InputError.of("options.value", option="accept", value=repr(text), expected=form)


def _is_number(text: str | None) -> bool:
    try:
        return text is None or np.isfinite(float(text))
    except ValueError:
        return False


def with_accepted(findings: Sequence[Finding], accept: Sequence[str]) -> list[Finding]:
    """Sort findings by severity, the most serious first; accepted doubts become notes, and one note lists them."""
    accepted = [f for f in findings if CATALOGUE[f.code].severity == "doubt" and _accepts(f, accept)]
    out = [replace(f, severity="note") if f in accepted else f for f in findings if f.code != "verdict.accepted"]
    if accepted:
        names = [f"{f.code.removeprefix('verdict.')}{f':{f.place}' if f.place else ''}" for f in accepted]
        out.append(finding("verdict.accepted", names=names))
    return by_severity(out)
