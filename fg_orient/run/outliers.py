"""Gross errors in the results of a run: suspicious observations, the search and its table."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.model.errors import Finding, finding
from fg_orient.run.statistics import withheld

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution
    from fg_orient.quality.outliers import GroupTest, OutlierTests
    from fg_orient.quality.search import Found

#: Columns of ``outliers.csv``; errors in the order of ``_ERRORS``.
OUTLIER_COLUMNS: Final = (
    "round", "part", "image", "id", "test", "dimension", "statistic", "limit", "probability", "level",
    "error_line_px", "error_sample_px", "error_east_m", "error_north_m", "error_up_m", "inseparable",
    "left_out_with_it", "readmitted", "statistic_without", "probability_without",
)  # fmt: skip
#: Where the error of each part stands among the five.
_ERRORS: Final = {"image": (0, 1), "position": (2, 3), "height": (4,), "point": ()}


def tests_of(solution: Solution) -> OutlierTests | None:
    """Tests of all observations as the options say; None where they are withheld, or a loss is set."""
    return None if withheld(solution) or solution.weights is not None else solution.outlier_tests()


def outlier_records(solution: Solution) -> dict[str, Any]:
    """Give ``global_test``, ``outlier_tests``, ``suspicious_observations`` and ``snooping`` of the record."""
    tests = tests_of(solution)
    judged = solution.weights is None and np.isfinite(solution.sigma0_interval[0])  # not with variance components
    whole = solution.global_test() if judged else None
    return {
        "global_test": None if whole is None else {**asdict(whole), "accepted": whole.accepted},
        "outlier_tests": None if tests is None else {
            "test": tests.test, "multiple_testing": tests.control, "level": tests.level,
            "level_each": tests.level_each, "n_tested": tests.n_tested,
            "n_not_checkable": int(np.count_nonzero(tests.dimension == 0)),
        },
        "suspicious_observations": None if tests is None else [_record(test) for test in tests.suspicious()],
        "snooping": _search_record(solution),
    }  # fmt: skip


def missing(solution: Solution) -> list[Finding]:
    """Tell why figures of this module are null."""
    whole, single = "global_test", ("outlier_tests", "suspicious_observations")
    if solution.weights is not None:
        return [finding("absent.loss", figures=[whole, *single])]
    why = "absent.no_unit_weight" if solution.redundancy <= 0 else "absent.not_converged"
    why = why if solution.components is None else "absent.components"
    out = [] if np.isfinite(solution.sigma0_interval[0]) else [finding(why, figures=[whole])]
    tests = withheld(solution, *single)
    return out if tests is None else [*out, tests]


def _record(test: GroupTest) -> dict[str, Any]:
    """One test."""
    return {
        "image": test.image or None, "id": test.point, "part": test.part, "error": test.error.tolist(),
        "symbol": test.symbol, "statistic": test.statistic, "limit": test.critical, "probability": test.probability,
        "inseparable": list(test.inseparable), "sentence": test.sentence(),
    }  # fmt: skip


def _search_record(solution: Solution) -> dict[str, Any] | None:
    """Rounds of the search and what it left out; null without a search."""
    search = solution.snooping
    if search is None:
        return None
    return {
        "n_left_out": len(search.left_out), "given_up": search.given_up and search.given_up.message,
        "went_with": list(search.went_with), "check_points_lost": list(search.check_points),
        "rounds": [asdict(r) | {"left_out": r.left_out or None, "put_back": r.put_back or None} for r in search.rounds],
        "found": [
            {"round": f.round, **_record(f.test), "left_out_with_it": list(f.with_it), "readmitted": f.readmitted,
             "sentence": f.sentence()}
            for f in search.found
        ],
    }  # fmt: skip


def outlier_rows(solution: Solution) -> list[tuple[object, ...]]:
    """Rows of ``outliers.csv``: all that the search ever left out, in the order in which it was found."""
    return [] if solution.snooping is None else [_row(found) for found in solution.snooping.found]


def _row(found: Found) -> tuple[object, ...]:
    """One row."""
    test, fit = found.test, found.fit
    error = np.full(5, np.nan)
    error[list(_ERRORS[test.part])] = test.error
    without = (None, None) if fit is None else (fit.statistic, fit.probability)
    cells = (
        found.round, test.part, test.image, test.point, test.symbol, test.dimension, test.statistic, test.critical,
        test.probability, test.level, *error.tolist(), "; ".join(test.inseparable), "; ".join(found.with_it),
        found.readmitted, *without,
    )  # fmt: skip
    return tuple("" if cell is None else cell for cell in cells)
