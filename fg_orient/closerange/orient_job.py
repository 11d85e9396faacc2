"""Run the commands ``relative`` and ``absolute``: compute model points, ground points and oriented photos."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from factors.arrays import Index
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import files
from fg_orient.closerange.assessment import assessed, tests_of
from fg_orient.closerange.job import NONE, Output, Record, exterior_record, no_redundancy, of_name
from fg_orient.closerange.minima import BENT
from fg_orient.closerange.options import ImageOptions
from fg_orient.closerange.orient_report import write_page
from fg_orient.closerange.orientation import absolute_orientation, relative_orientation
from fg_orient.closerange.photo import Photo, photo_text
from fg_orient.formats.atomic import outputs, require_free_files, write_text
from fg_orient.formats.closerange import read_photos
from fg_orient.formats.table_write import save_table
from fg_orient.model.errors import Finding, InputError, as_record, finding
from fg_orient.result.plain import plain, rows_of, table_of_rows


def run_relative(
    path: Path,
    camera: Path,
    options: ImageOptions,
    *,
    out: Path | None = None,
    photos: Path | None = None,
    output: Output = NONE,
) -> Record:
    """Return the relative orientation of the two photos of a table of image points.

    The system of the model has the first camera as origin and axes, and the base as unit.

    Parameters
    ----------
    path, camera : Path
        Table of image points; photo file with the cameras.
    options : ImageOptions
    out, photos : Path, optional
        Table of the model points, and photo file with both orientations, to write.
    output : Output
        Report to write, and whether files may be replaced.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.orientation.relative_orientation`. Also: there are
        not exactly two photos, or standard deviations differ.
    """
    overwrite = output.overwrite
    output.require_possible()
    require_free_files(out, overwrite=overwrite)
    require_free_files(photos, overwrite=overwrite, option="photos_out")
    table, cameras = files.read_image_points(path, options.sigma), files.interiors(read_photos(camera))
    names, ids, which, of = table.numbered()
    if len(names) != 2:
        raise InputError.of("closerange.two_photos", file=path, place="column photo", value=len(names))
    sigma = None if table.sigma is None else float(table.sigma.flat[0])
    if table.sigma is not None and (table.sigma != sigma).any():
        raise InputError.of("closerange.equal_sigmas", file=path, place="sigma_x, sigma_y")
    both = _in_both(which, of, len(ids))
    interior = [of_name(cameras, name, camera) for name in names]
    with one_blas_thread():
        fit = relative_orientation(interior[0], interior[1], table.image[both[0]], table.image[both[1]], sigma=sigma)
    sd = np.full(5, np.nan) if fit.sigma is None else fit.sigma
    poses = [
        Photo.of(n, own, r, c)
        for n, own, r, c in zip(names, interior, (np.eye(3), fit.rotation), (np.zeros(3), fit.base), strict=True)
    ]
    of_base = fit.base_axes.T @ fit.cofactors[3:, 3:] @ fit.base_axes
    along = (np.nan if fit.m0 is None else fit.m0) * np.sqrt(of_base.diagonal())
    record = {
        "kind": "relative",
        "weights": table.weights,
        "m0": fit.m0,
        "redundancy": fit.redundancy,
        "condition": fit.condition,
        "iterations": fit.iterations,
        "bend": fit.bend,
        "photos": names,
        "exterior": exterior_record(fit.rotation, fit.base, sd[:3], along),
        "points": rows_of(
            {
                "id": [ids[k] for k in of[both[0]]],
                "{}": fit.model,
                "distance": fit.distances,
                "redundancy": fit.redundancy_numbers,
            }
        ),
        "left_out": sorted(set(ids) - {ids[k] for k in of[both[0]]}),
        **as_record([*no_redundancy(fit.m0), *fit.second_orientation(), *_bent(fit.bend)]),
    }
    texts = [photo_text(pose, own, r) for pose, own, r in zip(poses, interior, (np.eye(3), fit.rotation), strict=True)]
    return _written(record, out, photos, "schema = 1\n\n" + "\n".join(texts), inputs=[path, camera], output=output)


def _in_both(which: Index, of: Index, n_points: int) -> list[Index]:
    """Return the rows of both photos for the points that both contain, in the order of the first."""
    at = np.full((2, n_points), -1)
    at[which, of] = np.arange(len(of))
    return list(at[:, (at >= 0).all(axis=0)])


def run_absolute(
    path: Path, control: Path, *, sigma_m: float | None = None, out: Path | None = None, output: Output = NONE
) -> Record:
    """Fit the points of a model to control points, and transform all its points.

    Parameters
    ----------
    path : Path
        Points of the model: id, x, y, z.
    control : Path
        Ground coordinates of three or more points.
    sigma_m : float, optional
        Default standard deviation of control coordinates.
    out : Path, optional
        Table of the transformed points to write.
    output : Output
        Report to write, and whether files may be replaced.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.orientation.absolute_orientation`.
    """
    output.require_possible()
    require_free_files(out, overwrite=output.overwrite)
    ids, model = files.read_model_points(path)
    ground = files.read_ground_points(control, sigma_m)
    row = {name: k for k, name in enumerate(ids)}
    known = [k for k, name in enumerate(ground.ids) if name in row]
    with one_blas_thread():
        fit = absolute_orientation(model[[row[ground.ids[k]] for k in known]].reshape(-1, 3), ground.ground[known],
                                   sigma_m=1.0 if ground.sigma is None else ground.sigma[known])  # fmt: skip
    sd = np.full(7, np.nan) if fit.sigma is None else fit.sigma
    sigmas = {} if ground.sigma is None else {"sigma_{}_m": ground.sigma[known]}
    record = {
        "kind": "absolute",
        "weights": ground.weights,
        "m0": fit.m0,
        "redundancy": fit.redundancy,
        "condition": fit.condition,
        "iterations": fit.iterations,
        "bend": fit.bend,
        "scale": fit.scale,
        "sigma_scale": fit.scale * sd[3],
        "exterior": exterior_record(fit.rotation, fit.shift_m, sd[:3], sd[4:]),
        "control": rows_of(
            {
                "id": [ground.ids[k] for k in known],
                "residual_{}_m": fit.residuals_m,
                "redundancy_{}": fit.redundancy_numbers.reshape(-1, 3),
                **sigmas,
            }
        ),
        "left_out": [name for name in ground.ids if name not in row],
        "points": rows_of({"id": ids, "{}_m": fit.apply(model)}),
        **as_record([*no_redundancy(fit.m0), *_bent(fit.bend)]),
    }
    return _written(record, out, inputs=[path, control], output=output)


def _bent(bend: float) -> Sequence[Finding]:
    """Return the warning that the joint covariance matrix is too optimistic."""
    if bend <= BENT:
        return []
    return [
        finding(
            "closerange.bent (warning): bend {size:.2g} exceeds {limit:g}: each standard deviation is right, "
            "but the joint covariance is too small -> add points, or a longer base",
            size=bend,
            limit=BENT,
        )
    ]


def _written(
    record: dict[str, Any],
    out: Path | None,
    photos: Path | None = None,
    text: str = "",
    *,
    inputs: list[Path],
    output: Output,
) -> Record:
    """Return the plain record, after its points, the photo file with ``text`` and the report are written."""
    overwrite = output.overwrite
    record = plain(
        {
            **assessed(record, tests_of(record)),
            "out": None if out is None else str(out),
            "photos_out": None if photos is None else str(photos),
        }
    )
    with outputs(out, overwrite=overwrite), outputs(photos, overwrite=overwrite, option="photos_out"):
        if photos is not None:
            write_text(photos, text)
        if out is not None:
            names = tuple(record["points"][0])
            save_table(out, table_of_rows(names, (tuple(point.values()) for point in record["points"])).columns)
    return record | {"page": write_page(record, inputs, output)}
