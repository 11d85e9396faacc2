"""Run the commands of rectification: fit a table of points, study designs, read tested points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.formats.atomic import require_free, staged_folder, writing
from fg_orient.formats.tables import require_table
from fg_orient.model.errors import InputError
from fg_orient.model.installation import stamp
from fg_orient.rectification.folder import CONTENTS, read_record
from fg_orient.rectification.options import PointOptions, StudyOptions
from fg_orient.rectification.points import DIRECTIONS, fit_points, observations, read_map_points
from fg_orient.rectification.record import record_of, write_folder
from fg_orient.rectification.study import Cell, design_study, pair_distances
from fg_orient.rectification.transformation import find_model
from fg_orient.rpc.points import ids_and_checks


def rectify_fit(
    path: Path, options: PointOptions, *, out: Path | None = None, overwrite: bool = False, command: Sequence[str] = ()
) -> dict[str, Any]:
    """Fit a transformation to a table of points and write the result folder.

    Parameters
    ----------
    path : Path
        Table of points.
    options : PointOptions
    out : Path, optional
        Folder to write.
    overwrite : bool
        Replace an existing result.
    command : sequence of str
        Words of the command line, for the record.

    Returns
    -------
    dict
        See :func:`fg_orient.rectification.record.record_of`.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.rectification.points.read_map_points` and ``fit``.
    """
    model = find_model(options.model or ("affine" if options.degree is None else "polynomial"), options.degree)
    if out is not None:
        require_free(out, overwrite=overwrite, contents=CONTENTS)
    points, distances = read_map_points(path, options.crs or ""), None
    with one_blas_thread():
        fitted = fit_points(points, model, options.direction, prune_to=options.prune_to, prune_by=options.prune_by)
    if options.pixel_size_m is not None:
        rows = np.isin(np.array(points.ids, dtype=object), np.array(fitted.fit.points.ids, dtype=object))
        distances = pair_distances(points.image[rows] * options.pixel_size_m, points.ground[rows, :2])
    record = record_of(fitted, distances)
    record |= {
        "input": {"file": path.name, "sha256": points.sha256},
        **stamp(command),
        "out": None if out is None else str(out),
    }
    if out is not None:
        with staged_folder(out, overwrite=overwrite, contents=CONTENTS) as folder, writing(out):
            write_folder(folder, fitted, record)
    return record


def read_differences(path: Path) -> tuple[Array, str]:
    """Return the differences (n, 2), m, of tested points from a table or a result folder, and their origin in words.

    A table has the columns id and easting_m, northing_m, true_easting_m, true_northing_m,
    or residual_easting_m, residual_northing_m. A result folder gives its check points, or
    its control points if it has no check points.

    Raises
    ------
    InputError
        The file has errors, which are all listed. Or the result was edited, or its
        residuals are in pixels. Or the result has no check points and its control points
        were selected by their residuals (pruning): such residuals do not measure the
        accuracy of the map.
    """
    return _of_folder(path) if path.is_dir() else (_of_table(path), "points of the table")


def _of_table(path: Path) -> Array:
    measured, true = ("easting_m", "northing_m"), ("true_easting_m", "true_northing_m")
    residual = ("residual_easting_m", "residual_northing_m")
    table = require_table(path, [("id", *measured, *true), ("id", *residual)])
    names = residual if residual[0] in table.columns else (*measured, *true)
    values = table.numbers(*names)
    ids_and_checks(table)
    table.require_valid()
    return values if len(names) == 2 else values[:, :2] - values[:, 2:]


def _of_folder(path: Path) -> tuple[Array, str]:
    record = read_record(path)
    try:
        rows, way, pruning = record["points"], record["direction"], record["pruning"]
        if way != DIRECTIONS[0]:
            raise InputError.of("rectify.direction", file=path, value=f"{way}: residuals in pixels")
        check = [row for row in rows if row["role"] == "check"]
        chosen = not check and pruning is not None and len(pruning["dropped"]) > 0
        used = [[row["residual_easting_m"], row["residual_northing_m"]] for row in check or rows]
        differences = np.array(used, float)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        raise InputError.of("rectify.result", file=path) from None
    if chosen:
        raise InputError.of("rectify.pruned", file=path, value=f"{len(pruning['dropped'])} point(s) left out")
    return differences, "check points" if check else "control points, because there are no check points"


def study_points(path: Path, counts: Sequence[int], degrees: Sequence[int], options: StudyOptions) -> tuple[Cell, ...]:
    """Compare designs of the control points of a table at its check points.

    Raises
    ------
    InputError
        See :func:`fg_orient.rectification.points.read_map_points` and ``design_study``; or there are no check points.
    """
    points = read_map_points(path, options.crs or "")
    if not points.check.any() or points.check.all():
        raise InputError.of("rectify.no_check_points", file=path, place="column role")
    every = observations(points, find_model("affine"), DIRECTIONS[0])
    control, test = every.take(~points.check), every.take(points.check)
    with one_blas_thread():
        return design_study(control, test, counts, degrees, layouts=options.layouts, seed=options.seed)
