"""The record of an adjustment: the keys of ``result.json``.

The keys are stable (docs/results.md); lengths are metres, times seconds. A figure that does not
exist is null and a finding says why.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.model.errors import Finding, as_record, finding
from fg_orient.model.names import EOP_SETS, Status
from fg_orient.quality.deficiency import DEFICIENT
from fg_orient.quality.parallax import rms_px, y_parallaxes
from fg_orient.quality.verdict import DOWN, points_on_one_ray, points_without_ray, turned_down_images
from fg_orient.run import outliers
from fg_orient.run.prediction import prediction_records
from fg_orient.run.statistics import correlation_record, missing, reliability_record

if TYPE_CHECKING:
    from fg_orient.model.block import Block, Options
    from fg_orient.model.errors import RankDeficientError
    from fg_orient.orientation.solution import Solution
    from fg_orient.quality.accuracy import PointDifferences


#: Image points of least weight that are named.
MAX_NAMED: Final = 50


def summary(solution: Solution) -> dict[str, Any]:
    """Give the record of a solution; ``seconds`` and ``out`` are added by the run.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    dict
        The keys of ``result.json``; numbers may be nan, which :mod:`fg_orient.run.json`
        turns into null.
    """
    problem, options = solution.problem, solution.block.options
    n, iterations = len(problem.observations), solution.iterations
    work = n * (iterations - solution.resumed_at)
    return {
        "status": str(solution.status),
        "reason": solution.reason,
        "ended": solution.ended,
        **as_record([*solution.findings, *solution.withheld, *_missing(solution)]),
        "backend": solution.backend,
        "solver": solution.solver or None,
        **_choices(options),
        "iterations": iterations,
        "n_image_points": n,
        "n_observations": problem.n_observations,
        "n_unknowns": problem.n_unknowns,
        "redundancy": solution.redundancy,
        "chi2": solution.chi2,
        "sigma0": solution.sigma0,
        "sigma0_interval_99_9": list(solution.sigma0_interval),
        "rank_defect": solution.rank_defect,
        "unobservable": list(solution.unobservable),
        "accuracy": {
            "control": solution.accuracy.control.statistics(),
            "check": {**_check(solution.accuracy.check), **prediction_records(solution)},
        },
        "robust": _robust(solution),
        "regularisation": None if solution.regularisation is None else solution.regularisation.as_dict(),
        "variance_components": None if solution.components is None else solution.components.as_dict(),
        "resumed_at_iteration": solution.resumed_at or None,
        "us_per_observation_iteration": 1e6 * solution.seconds.solve / work if work else float("nan"),
        "memory": None if solution.memory is None else solution.memory.as_dict(),
        **outliers.outlier_records(solution),
        "reliability": reliability_record(solution),
        "correlations": correlation_record(solution),
        **_parallax(solution),
    }


def _robust(solution: Solution) -> dict[str, Any] | None:
    """What the loss has turned down, least weight first; null without a loss."""
    weights, problem = solution.weights, solution.problem
    if weights is None:
        return None
    down, control = np.flatnonzero(weights.image < DOWN), np.flatnonzero(weights.control < DOWN)
    o, ids = problem.observations, problem.block.points.ids
    named = down[np.argsort(weights.image[down], kind="stable")][:MAX_NAMED]
    return {
        "n_image_points_below_half": len(down),
        "n_control_points_below_half": len(control),
        "control_points_below_half": [ids[j] for j in control],
        "images_below_half": [name for name, _, _ in turned_down_images(problem, weights)],
        "points_without_ray": points_without_ray(problem, weights)[:MAX_NAMED],
        "points_on_one_ray": points_on_one_ray(problem, weights)[:MAX_NAMED],
        "scale_image": weights.scale[0],
        "scale_control": weights.scale[1],
        "least": [
            {"image": problem.block.images[o.image[r]].id, "id": ids[o.point[r]], "weight": float(weights.image[r])}
            for r in named
        ],
    }


def _parallax(solution: Solution) -> dict[str, Any]:
    """y-parallaxes before and after a relative adjustment, which has no other result; else nothing."""
    if solution.block_view is None or not solution.block_view.relative:
        return {}
    problem = solution.problem
    points, before = y_parallaxes(problem, problem.start)
    _, after = y_parallaxes(problem, solution.state)
    return {"y_parallax": {"n": len(points), "rms_before_px": rms_px(before), "rms_after_px": rms_px(after)}}


def _check(points: PointDifferences) -> dict[str, Any]:
    """Statistics of the check points and the ones a reader should look at."""
    suspicious = [
        {"id": name, "axis": axis, "difference_m": difference, "ratio": ratio}
        for name, axis, difference, ratio in points.suspicious()
    ]
    largest = [
        {"id": name, "difference_east_m": east, "difference_north_m": north, "difference_up_m": up,
         "length_m": float(np.sqrt(east**2 + north**2 + up**2))}
        for name, east, north, up in points.largest()
    ]  # fmt: skip
    beyond = points.beyond().as_dict()
    return {**points.statistics(), "suspicious": suspicious, "beyond_3_sigma": beyond, "largest": largest}


def _missing(solution: Solution) -> list[Finding]:
    """Tell why a figure is null."""
    out, interval = [], ["sigma0_interval_99_9"]
    if solution.redundancy <= 0:
        out.append(finding("absent.no_redundancy", figures=["sigma0"]))
    elif solution.weights is not None:
        out.append(finding("absent.loss", figures=interval))
    elif solution.components is not None:
        out.append(finding("absent.components", figures=interval))
    elif not np.isfinite(solution.sigma0_interval[0]):
        out.append(finding("absent.not_converged", figures=interval))
    if solution.block_view is not None and solution.block_view.counts is None:
        out.append(finding("absent.whole_block", figures=["block_observability"]))
    if not solution.problem.n_images * solution.iterations:
        out.append(finding("absent.no_iteration", figures=["us_per_observation_iteration"]))
    return [*out, *outliers.missing(solution), *missing(solution)]


def deficient_summary(error: RankDeficientError, block: Block) -> dict[str, Any]:
    """Give the record of a block whose unknowns nothing determines.

    Parameters
    ----------
    error : RankDeficientError
        Its problems name the directions, one each.
    block : Block
        What could not be adjusted.

    Returns
    -------
    dict
        The keys of :func:`summary` that exist without a solution, and ``errors``.
    """
    sentences = [p.place for p in error.problems if p.code in DEFICIENT]
    return {
        "status": str(Status.RANK_DEFICIENT),
        "reason": "some unknowns are determined neither by observations nor by priors",
        **as_record([finding("absent.nothing_adjusted", figures=["sigma0", "accuracy"])]),
        **_choices(block.options),
        "backend": block.options.backend,
        "solver": block.options.solver,
        "iterations": 0,
        "n_image_points": len(block.observations),
        **error.counts,
        "sigma0": None,
        "rank_defect": dict(error.rank_defect),
        "unobservable": sentences or [p.message for p in error.problems],
        "accuracy": {"control": None, "check": None},
        "us_per_observation_iteration": None,
        "errors": [p.as_dict() for p in error.problems],
        "out": None,
    }


def _choices(options: Options) -> dict[str, Any]:
    """Options that decide on the result."""
    names = ("optimizer", "loss", "gnc", "robust_start", "robust_scale", "eop_set", "look_polynomial", "priors",
             "check_points", "rpc_compensation", "datum")  # fmt: skip
    return {
        **{name: getattr(options, name) for name in names},
        "eop_set_name": EOP_SETS[options.eop_set].name,
        "image_unknowns": list(options.image_unknowns) or None,
    }
