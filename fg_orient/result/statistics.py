"""Redundancy, reliability, correlations and tests of a result.

The functions make sections of the record and columns of the tables. They also state why figures are missing.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.cofactors import AUTO_LIMIT
from fg_orient.adjustment.constraints import has_constraints
from fg_orient.formats.table_write import Column
from fg_orient.model.errors import Finding, finding
from fg_orient.model.machine import in_gb
from fg_orient.quality.causes import unseen_mistakes
from fg_orient.quality.covariance import gives_statistics
from fg_orient.quality.reliability import CHECKABLE, UNSEEN, noncentrality
from fg_orient.result.plain import Table, of_axes, table_of_rows

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution
    from fg_orient.quality.causes import unseen_mistakes
    from fg_orient.quality.covariance import NamedMatrix
    from fg_orient.quality.outlier_records import GroupTest, OutlierTests
    from fg_orient.quality.rejection import Search
from fg_orient.quality.reliability import BlockReliability, Reliability

#: Maximum number of observations or correlations that are listed.
MAX_NAMED: Final = 20
#: Correlations of at least this size are listed.
HIGH: Final = 0.95
#: Correlations between different images are computed only up to this number of image unknowns.
JOINT_UNKNOWNS: Final = 600
#: Columns of ``outliers.csv``; the columns of estimated errors have the order of ``_ERRORS``.
OUTLIER_COLUMNS: Final = (
    "round", "part", "image", "id", "line", "sample", "test", "dimension", "statistic", "limit", "probability", "level",
    "error_line_px", "error_sample_px", "error_east_m", "error_north_m", "error_up_m", "inseparable",
    "left_out_with_it", "readmitted", "statistic_without", "probability_without",
)  # fmt: skip
_PIXEL: Final = ("line", "sample")
#: For each part of an observation, the numbers of its columns among the five columns of estimated errors.
_ERRORS: Final = {"image": (0, 1), "position": (2, 3), "height": (4,), "point": ()}


def unavailable(solution: Solution, *figures: str) -> Finding | None:
    """Return why redundancy numbers and figures that depend on them are unavailable; None if they are available."""
    problem, chosen = solution.problem, solution.block.options.statistics
    if solution.cofactors is None:
        return finding("absent.covariance", figures=figures)
    if gives_statistics(problem, solution.cofactors):
        return None
    if solution.memory is not None and solution.memory.statistics_left_out:
        return finding("absent.memory", figures=figures, allowed=in_gb(solution.memory.allowed or 0))
    if chosen == "basic":
        return finding("absent.basic", figures=figures)
    return finding("absent.large", figures=figures, limit=AUTO_LIMIT)


def reliability_of(solution: Solution) -> BlockReliability | None:
    """Return the reliability figures; None if they are unavailable or if a loss is used."""
    return None if unavailable(solution) or solution.weights is not None else solution.reliability()


def missing(solution: Solution) -> list[Finding]:
    """Return the reasons why figures of reliability and correlations are null."""
    if solution.cofactors is None:
        own = ["figures"] if has_constraints(solution.problem.block) else []
        return [finding("absent.covariance", figures=["reliability", "correlations", *own])]
    why = unavailable(solution, "reliability")
    if why is None and solution.weights is not None:
        why = finding("absent.loss_but_redundancy", figures=["reliability"])
    return [] if why is None else [why]


def reliability_record(solution: Solution) -> dict[str, Any] | None:
    """Return the section ``reliability`` of the record."""
    found = reliability_of(solution)
    if found is None:
        return None
    image, control, o = found.image, found.control, solution.problem.observations
    rays = np.bincount(o.point, minlength=len(solution.problem.active))[o.point]
    unchecked = image.not_checkable
    known = found.cofactors
    sums = (image.redundancy, control.redundancy, known.prior, np.concatenate([np.zeros(0), *known.extra]))
    names = ("image_points", "control_points", "priors", "own_observations")
    return {
        "alpha": found.alpha, "power": found.power, "noncentrality": noncentrality(found.alpha, found.power),
        "redundancy_sum": found.cofactors.redundancy_sum,
        "redundancy": {name: float(part.sum()) for name, part in zip(names, sums, strict=True)},
        "least": _least(solution, found),
        "limit_of_checkable": CHECKABLE,
        "n_image_points_not_checkable": int(unchecked.sum()),
        "n_of_these_with_two_rays": int((unchecked & (rays == 2)).sum()),
        "n_control_coordinates_not_checkable": int((control.redundancy < CHECKABLE).sum()),
        "not_checkable": [*_control_unchecked(solution, control), *_image_unchecked(solution, image, rays)],
        "unseen_mistakes": [one.as_dict() for one in unseen_mistakes(known, solution.accuracy.check)],
        "largest_mdb": _largest(solution, image),
    }  # fmt: skip


def unseen_record(solution: Solution) -> dict[str, Any] | None:
    """Summarise the points on which an image error can act without being seen; None if there are none.

    Return their number, and the median and the largest shift of a point by an error of one pixel, m.
    """
    if unavailable(solution):
        return None
    length = np.linalg.norm(solution.unseen_shifts, axis=1)
    seen = np.flatnonzero(np.isfinite(length))
    if not len(seen):
        return None
    worst = int(seen[np.argmax(length[seen])])
    return {"limit": UNSEEN, "n": len(seen), "median_m": float(np.median(length[seen])),
            "largest_m": float(length[worst]), "id": solution.block.points.ids[worst]}  # fmt: skip


def _least(solution: Solution, found: BlockReliability) -> dict[str, Any]:
    """Return the coordinate with the smallest redundancy number."""
    best: dict[str, Any] = {"redundancy": None, "name": None}
    axes = (_PIXEL, solution.problem.axis_names)
    for part, names in zip((found.image, found.control), axes, strict=True):
        if not part.redundancy.size:
            continue
        row, axis = (int(k) for k in np.unravel_index(np.argmin(part.redundancy), part.redundancy.shape))
        value = float(part.redundancy[row, axis])
        if best["redundancy"] is None or value < best["redundancy"]:
            who = solution.problem.label(row) if part is found.image else f"point {_control_id(solution, row)}"
            best = {"redundancy": value, "name": f"{names[axis]} of {who}"}
    return best


def _control_id(solution: Solution, row: int) -> str:
    """Return the id of a weighted control point.

    The argument is its number among the weighted control points.
    """
    return solution.block.points.ids[int(np.flatnonzero(solution.problem.observed)[row])]


def _control_unchecked(solution: Solution, control: Reliability) -> list[dict[str, Any]]:
    """Return control coordinates that no other observation checks.

    The smallest redundancy is first.
    """
    rows, axes = np.nonzero(control.redundancy < CHECKABLE)
    out = []
    for k in np.argsort(control.redundancy[rows, axes], kind="stable")[:MAX_NAMED].tolist():
        row, axis, point = int(rows[k]), int(axes[k]), _control_id(solution, int(rows[k]))
        name, r = solution.problem.axis_names[axis], float(control.redundancy[row, axis])
        out.append({
            "image": None, "id": point, "redundancy": r, "direction": np.eye(3)[axis].tolist(),
            "sentence": f"{name} of control point {point}: redundancy {abs(r):.4f}, "
            + _undetected(float(control.minimal_detectable_bias[row, axis]), "m"),
        })  # fmt: skip
    return out


def _image_unchecked(solution: Solution, image: Reliability, rays: Index) -> list[dict[str, Any]]:
    """Return image points that have an unchecked direction.

    Points with a number of rays other than two are first, then the smallest redundancy is first.
    """
    rows = np.flatnonzero(image.not_checkable)
    order = np.lexsort((np.round(image.least[rows], 9), rays[rows] == 2))[:MAX_NAMED]
    o, block, out = solution.problem.observations, solution.block, []
    for row in rows[order].tolist():
        line, sample = (float(v) for v in image.direction[row])
        two = rays[row] == 2
        out.append({
            "image": block.images[o.image[row]].id, "id": block.points.ids[o.point[row]],
            "redundancy": float(image.least[row]), "direction": [line, sample],
            "sentence": f"{solution.problem.label(row)}: along (line {line:+.3f}, sample {sample:+.3f})"
            f"{', the epipolar line of its two rays' if two else ''}: redundancy {abs(float(image.least[row])):.4f}, "
            + _undetected(float(image.largest[row]), "px"),
        })  # fmt: skip
    return out


def _undetected(bias: float, unit: str) -> str:
    """Describe in words how large errors can be that the test does not detect."""
    return "an error of any size stays unseen" if np.isnan(bias) else f"errors below {bias:.3g} {unit} stay unseen"


def _largest(solution: Solution, image: Reliability) -> list[dict[str, Any]]:
    """Return the checked image points with the largest minimal detectable biases, in standard deviations."""
    rows = np.flatnonzero(~image.not_checkable)
    o, block = solution.problem.observations, solution.block
    worst = rows[np.argsort(image.least[rows], kind="stable")[:MAX_NAMED]]
    columns = {
        **of_axes("redundancy_{}", _PIXEL, image.redundancy),
        **of_axes("mdb_{}_px", _PIXEL, image.minimal_detectable_bias), "mdb_largest_px": image.largest,
        "external_m": image.ground_m.max(axis=1), "external_image": image.eop.max(axis=1),
    }  # fmt: skip
    return [
        {"image": block.images[o.image[r]].id, "id": block.points.ids[o.point[r]],
         **{name: float(values[r]) for name, values in columns.items()}}
        for r in worst.tolist()
    ]  # fmt: skip


def correlation_record(solution: Solution) -> dict[str, Any] | None:
    """Return the section ``correlations`` of the record: high correlations of image unknowns."""
    if solution.cofactors is None:
        return None
    problem, images = solution.problem, solution.block.images
    joint = problem.n_image_unknowns <= JOINT_UNKNOWNS
    groups = [tuple(image.id for image in images)] if joint else [(image.id,) for image in images]
    found: list[tuple[float, str, str]] = []
    for group in groups:
        matrix = solution.cofactor_matrix(*(f"image:{name}" for name in group))
        every = np.arange(len(matrix.names))
        # an unknown that images share occurs once: its correlation with itself is 1
        found += _high(matrix, every if problem.ties is None or not joint else problem.ties.place)
    found.sort(key=lambda row: -abs(row[0]))
    return {
        "limit": HIGH, "between_images": joint, "n": len(found),
        "largest": [{"a": a, "b": b, "correlation": r} for r, a, b in found[:MAX_NAMED]],
    }  # fmt: skip


def _high(matrix: NamedMatrix, columns: Index) -> list[tuple[float, str, str]]:
    """Return the high correlations of these columns of a matrix with the names of the unknowns."""
    r, names = np.triu(matrix.correlations[np.ix_(columns, columns)], 1), [matrix.names[k] for k in columns]
    return [(float(r[a, b]), names[a], names[b]) for a, b in np.argwhere(np.abs(r) > HIGH).tolist()]


def image_columns(solution: Solution) -> dict[str, Column]:
    """Return the statistical columns of ``residuals.csv``; none if the statistics are unavailable.

    With a loss, these are only the redundancy numbers.
    """
    found = reliability_of(solution)
    if found is not None:
        image = found.image
        return {
            **of_axes("redundancy_{}", _PIXEL, image.redundancy), "redundancy_least": image.least,
            **of_axes("w_{}", _PIXEL, image.normalised), **of_axes("mdb_{}_px", _PIXEL, image.minimal_detectable_bias),
            "external_m": image.ground_m.max(axis=1), "external_point": image.ground.max(axis=1),
            "external_image": image.eop.max(axis=1),
        }  # fmt: skip
    if unavailable(solution):
        return {}
    return dict(of_axes("redundancy_{}", _PIXEL, np.einsum("nii->ni", solution.residual_cofactors.image)))


def point_columns(solution: Solution) -> dict[str, Column]:
    """Return the statistical columns of ``points.csv``.

    They contain the reliability of control points and the effects of undetected errors on
    each point. ``external_m`` is empty if an observation of the point has no minimal
    detectable bias, because the effect then has no bound. For ``unseen_east_m`` etc. see
    ``Solution.unseen_shifts``. With a loss, only these columns exist.
    """
    if unavailable(solution):
        return {}
    unseen = of_axes("unseen_{}_m", ("east", "north", "up"), solution.unseen_shifts)
    found = reliability_of(solution)
    if found is None:
        return dict(unseen)
    n, rows = len(solution.problem.active), np.flatnonzero(solution.problem.observed)
    out: dict[str, Column] = {}
    parts = {"redundancy_{}": found.control.redundancy, "w_{}": found.control.normalised,
             "mdb_{}_m": found.control.minimal_detectable_bias}  # fmt: skip
    for name, values in parts.items():
        column = np.full((n, 3), np.nan)
        column[rows] = values
        out |= of_axes(name, ("east", "north", "up"), column)
    external = np.full(n, -np.inf)
    np.maximum.at(external, solution.problem.observations.point, _unbounded(found.image.ground_m))
    np.maximum.at(external, rows, _unbounded(found.control.ground_m))
    external[~solution.problem.active] = np.nan  # fixed points do not move
    return {**out, "external_m": np.where(np.isfinite(external), external, np.nan), **unseen}


def _unbounded(values: Array) -> Array:
    """Return the largest value of each row; inf if a value of the row is unknown."""
    return np.asarray(np.where(np.isnan(values).any(axis=1), np.inf, np.nan_to_num(values).max(axis=1, initial=0.0)))


# --- outlier tests ----------------------------------------------------------------------------------


def tests_of(solution: Solution) -> OutlierTests | None:
    """Test all observations with the options of the block; None if this is impossible or if a loss is used."""
    return None if unavailable(solution) or solution.weights is not None else solution.outlier_tests()


def outlier_records(solution: Solution) -> dict[str, Any]:
    """Return the record's entries on outlier tests: the test of all observations, and the searches."""
    tests = tests_of(solution)
    judged = solution.weights is None and np.isfinite(solution.sigma0_interval[0])  # false with variance components
    whole = solution.global_test() if judged else None
    return {
        "global_test": None if whole is None else {**asdict(whole), "accepted": whole.accepted},
        "outlier_tests": None if tests is None else {
            "test": tests.test, "multiple_testing": tests.control, "level": tests.level,
            "level_each": tests.level_each, "n_tested": tests.n_tested,
            "n_not_checkable": int(np.count_nonzero(tests.dimension == 0)),
        },
        "suspicious_observations": None if tests is None else [_test_record(test) for test in tests.suspicious()],
        "snooping": search_record(solution),
        "median_rejection": None if solution.block.options.median_rejection is None else list(solution.rejected),
    }  # fmt: skip


def missing_tests(solution: Solution) -> list[Finding]:
    """Return the reasons why figures of the outlier tests are null."""
    whole, single = "global_test", ("outlier_tests", "suspicious_observations")
    if solution.weights is not None:
        return [finding("absent.loss", figures=[whole, *single])]
    why = "absent.no_unit_weight" if solution.redundancy <= 0 else "absent.not_converged"
    why = why if solution.components is None else "absent.components"
    out = [] if np.isfinite(solution.sigma0_interval[0]) else [finding(why, figures=[whole])]
    tests = unavailable(solution, *single)
    return out if tests is None else [*out, tests]


def _test_record(test: GroupTest) -> dict[str, Any]:
    """Return the record of one test."""
    return {
        "image": test.image or None, "id": test.point, "part": test.part, "error": test.error.tolist(),
        "symbol": test.symbol, "statistic": test.statistic, "limit": test.critical, "probability": test.probability,
        "inseparable": list(test.inseparable), "sentence": test.sentence(),
    }  # fmt: skip


def search_record(solution: Solution) -> dict[str, Any] | None:
    """Return the rounds of the search and the observations that it excluded; None if there was no search."""
    search = solution.snooping
    if search is None:
        return None
    return {
        "n_left_out": len(search.left_out), "given_up": search.given_up and search.given_up.message,
        "went_with": list(search.went_with), "check_points_lost": list(search.check_points),
        "rounds": [asdict(r) | {"left_out": r.left_out or None, "put_back": r.put_back or None} for r in search.rounds],
        "found": [
            {"round": f.round, **_test_record(f.test), "left_out_with_it": list(f.with_it), "readmitted": f.readmitted,
             "sentence": f.sentence()}
            for f in search.found
        ],
    }  # fmt: skip


def outlier_table(search: Search) -> Table:
    """Return the table ``outliers``: all observations that were excluded at any time, in the order of exclusion."""
    rows = []
    for one in search.found:
        test, error = one.test, np.full(5, np.nan)
        error[list(_ERRORS[test.part])] = test.error
        cells = (
            one.round, test.part, test.image, test.point, *one.pixel, test.symbol, test.dimension, test.statistic,
            test.critical, test.probability, test.level, *error.tolist(), "; ".join(test.inseparable),
            "; ".join(one.with_it), one.readmitted,
            *((None, None) if one.fit is None else (one.fit.statistic, one.fit.probability)),
        )  # fmt: skip
        rows.append(cells)
    return table_of_rows(OUTLIER_COLUMNS, rows)
