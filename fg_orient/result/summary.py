"""Make the record of an adjustment, which is the content of ``result.json``.

The keys do not change between versions (docs/results.md). Lengths are in metres, times in
seconds. A figure that does not exist is null, and a finding gives the reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.adjustment.robust import DOWN
from fg_orient.formats.rpc.text import format_rpc_text
from fg_orient.model.declaration import declared
from fg_orient.model.errors import Finding, NoSolutionError, as_record, finding
from fg_orient.model.names import EOP_SETS, Status
from fg_orient.model.options import Options
from fg_orient.quality.accuracy import rms_px, y_parallaxes
from fg_orient.quality.deficiency import DEFICIENT, Evidence, judge_observability
from fg_orient.quality.elimination import UNOBSERVABLE
from fg_orient.quality.features import feature_records
from fg_orient.quality.figures import constraint_records
from fg_orient.quality.verdict import points_with_rays, turned_down_images
from fg_orient.result.joint import LIMIT, joint_cofactors_of, points_within
from fg_orient.result.plain import plain
from fg_orient.result.provenance import provenance
from fg_orient.result.record import Result
from fg_orient.result.statistics import (
    correlation_record,
    missing,
    missing_tests,
    outlier_records,
    reliability_record,
    unavailable,
    unseen_record,
)
from fg_orient.result.tables import arrays_of, point_cofactors, start_points, tables_of

if TYPE_CHECKING:
    from fg_orient.adjustment.problem import Problem
    from fg_orient.model.block import Block
    from fg_orient.model.errors import RankDeficientError
    from fg_orient.orientation.solution import Solution
    from fg_orient.quality.accuracy import PointDifferences
    from fg_orient.rpc.files import Corrected


SCHEMA_VERSION: Final = 1
#: Maximum number of image points listed in the record; the points with the smallest weights are listed.
MAX_NAMED: Final = 50
#: Maximum number of singular values in the record; the smallest ones are kept.
KEPT: Final = 1000
#: Maximum length of a file name made from an image id, bytes; a number and the end of the name are added to it.
LONGEST_STEM: Final = 150


def result_of(
    solution: Solution, models: Mapping[str, Corrected], *, folder: Path = Path(), out: str = "",
    command: Sequence[str] = (),
) -> Result:  # fmt: skip
    """Make the result of a solution. A run adds its own options and the times of its phases.

    Parameters
    ----------
    solution : Solution
    models : mapping
        Corrected RPC of each image; see :func:`fg_orient.rpc.files.corrected_models`.
    folder : Path
        Folder of the project; inputs are named relative to it.
    out : str
        Name of the result folder.
    command : sequence of str
        Words of the command line.
    """
    view, about = solution.block_view, _about(solution.problem, folder, out, command)
    fitted = [
        finding("rpc.fitted_correction", place=f"image {name}", line_px=model.errors["max_line_px"],
                sample_px=model.errors["max_sample_px"])
        for name, model in models.items() if not model.exact
    ]  # fmt: skip
    record = {
        "schema": SCHEMA_VERSION, "name": solution.block.name, **summary(solution), **about,
        "notes": [*about["notes"], *map(str, fitted)],
        "observability": [o.as_dict() for o in solution.observability],
        "block_observability": None if view is None else view.as_dict(),
        "seconds": asdict(solution.seconds) | {"total": solution.seconds.total},
    }  # fmt: skip
    files = {f"rpc/{stem}_RPC.TXT": format_rpc_text(models[name].model).encode("ascii")
             for name, stem in file_stems(models).items()}  # fmt: skip
    iterations = tuple(plain(asdict(iteration)) for iteration in solution.log)
    points = None if unavailable(solution) else points_within(solution, LIMIT)
    joint = None if points is None else joint_cofactors_of(solution, points)
    cofactors = point_cofactors(solution)
    tables, arrays = tables_of(solution, cofactors), arrays_of(solution, cofactors)
    return Result(plain(record), tables, iterations, arrays, files, joint)


def deficient_result(
    error: RankDeficientError, problem: Problem, folder: Path, out: str, command: Sequence[str]
) -> Result:
    """Make the result of a block whose unknowns are not determined.

    It contains the undetermined directions, the singular values and the start values.
    """
    evidence = error.evidence
    assert isinstance(evidence, Evidence)
    images, view = evidence.observability or judge_observability(evidence.problem), evidence.view
    block = None
    if view is not None:
        block = {**view.as_dict(), "singular_values": view.singular_values[-KEPT:], "limit": UNOBSERVABLE}
    record = {
        "schema": SCHEMA_VERSION, "name": problem.block.name, **deficient_summary(error, problem.block),
        **_about(problem, folder, out, command), "observability": [o.as_dict() for o in images],
        "block_observability": block,
    }  # fmt: skip
    return Result(plain(record), start_points(problem))


def _about(problem: Problem, folder: Path, out: str, command: Sequence[str]) -> dict[str, Any]:
    """Return the part of a record that describes the block."""
    block = problem.block
    return {
        "out": out,
        "notes": [
            str(replace(note, file=note.file.removeprefix(f"{folder.absolute()}/").removeprefix(f"{folder}/")))
            for note in block.notes
        ],
        "images": [
            {"id": image.id, "file": Path(image.sensor.file).name, "n_lines": image.sensor.n_lines,
             "n_samples": image.sensor.n_samples, "notes": list(map(str, image.sensor.notes)),
             "footprint_lon_lat_deg": image.sensor.footprint().tolist(), **model.facts()}
            for image, model in zip(block.images, problem.models, strict=True)
        ],
        "body": None if block.body is None else {"name": block.body.name, "radii_m": list(block.body.radii_m)},
        "provenance": provenance(block, folder, command),
    }  # fmt: skip


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Make a file name from each image id.

    Unsafe characters become ``_``; long names are cut; equal names get numbers.
    """
    stems: dict[str, str] = {}
    for name in names:
        # letters of any script may have several bytes
        stem = safe = re.sub(r"[^\w.-]", "_", name).encode()[:LONGEST_STEM].decode(errors="ignore")
        while stem.lower() in map(str.lower, stems.values()):
            stem = f"{safe}_{len(stems)}"
        stems[name] = stem
    return stems


def summary(solution: Solution) -> dict[str, Any]:
    """Make the record of a solution. The run adds ``seconds`` and ``out``.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    dict
        Content of ``result.json``. Numbers may be nan; :mod:`fg_orient.result.plain` converts
        them to null.
    """
    problem, options, choice = solution.problem, solution.block.options, solution.reduced_system
    n, iterations = len(problem.observations), solution.iterations
    work = n * (iterations - solution.resumed_at)
    return {
        "status": str(solution.status),
        "reason": solution.reason,
        "ended": solution.ended,
        **as_record([*solution.findings, *solution.unavailable, *_missing(solution)]),
        "backend": solution.backend,
        "solver": solution.solver or None,
        "reduced_system": None
        if choice is None
        else {
            "method": choice.kind,
            "predicted_operations": choice.work,
            "predicted_bytes": choice.memory,
            "largest_front": choice.front or None,
        },
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
            "check": {**_check(solution.accuracy.check), **_prediction(solution)},
        },
        "robust": robust_record(solution),
        "regularisation": solution.regularisation,
        "jitter": None if solution.jitter is None else solution.jitter.as_dict(),
        "variance_components": None if solution.components is None else solution.components.as_dict(),
        "stated_sigmas": [one.as_dict() for one in solution.sigmas],
        "resumed_at_iteration": solution.resumed_at or None,
        "us_per_observation_iteration": 1e6 * solution.seconds.solve / work if work else float("nan"),
        "memory": None if solution.memory is None else solution.memory.as_dict(),
        "constraints": constraint_records(problem, solution.state),
        "figures": None if solution.cofactors is None else [figure.as_dict() for figure in solution.figures()],
        **outlier_records(solution),
        "reliability": reliability_record(solution),
        "unseen": unseen_record(solution),
        "features": feature_records(solution),
        "correlations": correlation_record(solution),
        **_parallax(solution),
    }


def robust_record(solution: Solution) -> dict[str, Any] | None:
    """Return the observations that the loss down-weights, smallest weight first; None without a loss."""
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
        "points_without_ray": [ids[j] for j in points_with_rays(problem, weights, 0)[:MAX_NAMED]],
        "points_on_one_ray": [ids[j] for j in points_with_rays(problem, weights, 1)[:MAX_NAMED]],
        "scale_image": weights.scale[0],
        "scale_control": weights.scale[1],
        "least": [
            {"image": problem.block.images[o.image[r]].id, "id": ids[o.point[r]], "weight": float(weights.image[r])}
            for r in named
        ],
    }


def _parallax(solution: Solution) -> dict[str, Any]:
    """Return the y-parallaxes before and after a relative adjustment; {} for other adjustments."""
    if solution.block_view is None or not solution.block_view.relative:
        return {}
    problem = solution.problem
    points, before = y_parallaxes(problem, problem.start)
    _, after = y_parallaxes(problem, solution.state)
    return {"y_parallax": {"n": len(points), "rms_before_px": rms_px(before), "rms_after_px": rms_px(after)}}


def _check(points: PointDifferences) -> dict[str, Any]:
    """Return statistics of the check points, suspicious points and the largest differences."""
    suspicious = [
        {"id": name, "axis": axis, "difference_m": difference, "ratio": ratio}
        for name, axis, difference, ratio in points.suspicious()
    ]
    largest = [
        {"id": name, "difference_east_m": east, "difference_north_m": north, "difference_up_m": up,
         "length_m": float(np.sqrt(east**2 + north**2 + up**2))}
        for name, east, north, up in points.largest()
    ]  # fmt: skip
    beyond = points.beyond.as_dict()
    return {**points.statistics(), "suspicious": suspicious, "beyond_3_sigma": beyond, "largest": largest}


def _prediction(solution: Solution) -> dict[str, Any]:
    """Return the test of the predicted accuracy, and the tests of bias, drift and tilt.

    If the first test is impossible, it is None, and the reason is given.
    """
    from fg_orient.quality.accuracy import trend_tests

    test, trend, unavailable = None, None, None
    try:
        test, trend = solution.prediction_test().as_dict(), trend_tests(solution.accuracy.check)
    except NoSolutionError as error:
        unavailable = str(error)
    return {"prediction": test, "prediction_withheld": unavailable, "trend": trend}


def _missing(solution: Solution) -> list[Finding]:
    """Return the reasons why figures are null."""
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
    return [*out, *missing_tests(solution), *missing(solution)]


def deficient_summary(error: RankDeficientError, block: Block) -> dict[str, Any]:
    """Make the record of a block with unknowns that neither observations nor priors determine.

    Parameters
    ----------
    error : RankDeficientError
        Error of the adjustment; each of its problems names one undetermined direction.
    block : Block
        Block that could not be adjusted.

    Returns
    -------
    dict
        Those entries of :func:`summary` that exist without a solution, and ``errors``.
    """
    sentences = [p.place for p in error.problems if p.code in DEFICIENT]
    return {
        "status": str(Status.RANK_DEFICIENT),
        "reason": "some unknowns are determined neither by observations nor by priors",
        **as_record([finding("absent.nothing_adjusted", figures=["sigma0", "accuracy"])]),
        **_choices(block.options),
        "regularisation": None,  # nothing was adjusted
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
    """Return the options that influence the numbers of the result."""
    return {
        **{name: getattr(options, name) for name, one in declared(Options).items() if one.recorded},
        "eop_set_name": EOP_SETS[options.eop_set].name,
        "image_unknowns": list(options.image_unknowns) or None,
    }
