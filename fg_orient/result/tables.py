"""Tables and arrays of the result folder; numbers have all their digits.

RMSE, sigma0 and redundancy can be recomputed from ``points.csv``, ``residuals.csv``,
``eop.csv`` and the input::

    chi2 = sum weight (v/sigma)^2                residuals.csv, both coordinates
         + sum weight (difference/own sigma)^2   points.csv, East, North, Up of control points not fixed
         + sum (value_per_tau/prior sigma)^2  eop.csv, unless without priors; of those with the same parameter and
                                              the same word in column shared one row counts
         + sum of extra observations          in no table: squared whitened residuals of Block.extra

Control points that are ``fixed`` are constants. They have no residual, because their
standard deviation is 0. They count neither as observations nor as unknowns. The columns
``weight`` exist only with a robust loss. Otherwise all weights are 1.

Standard deviations are posterior, ``sqrt(cofactor) sigma0``, if there is redundancy and
no loss. Otherwise they are in prior scale. The column ``sigma_scale`` names the scale.
The option ``statistics`` adds columns of redundancy and reliability
(``fg_orient.result.statistics``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from factors.geometry import ellipsoid
from fg_orient.formats.table_write import Column
from fg_orient.quality.jitter_record import COLUMNS as JITTER_COLUMNS
from fg_orient.result import statistics
from fg_orient.result.plain import Table, of_axes, table_of_rows
from fg_orient.result.record import START_POINTS, TABLES

if TYPE_CHECKING:
    from fg_orient.adjustment.problem import Problem
    from fg_orient.model.block import Block
    from fg_orient.orientation.solution import Solution

EOP_COLUMNS: Final = (
    "image", "parameter", "component", "degree", "unit", "value_per_tau", "sigma", "prior_sigma", "sigma_scale",
    "per_line_value", "per_line_sigma", "per_line_unit", "shared",
)  # fmt: skip
_ENU = ("east", "north", "up")
#: Rows and columns of the covariances East-North, East-Up and North-Up in a (3, 3) matrix.
PAIRS: Final = (np.array([0, 0, 1]), np.array([1, 2, 2]))


def tables_of(solution: Solution, cofactors: Array) -> dict[str, Table]:
    """Make the tables ``eop``, ``points``, ``residuals``; ``outliers`` after a search, ``jitter`` if it was found.

    The cofactors of the points come from :func:`point_cofactors`.
    """
    weights = solution.weights
    of_points, of_rays = ({}, {}) if weights is None else ({"weight": weights.control}, {"weight": weights.image})
    tables = {
        "eop": table_of_rows(EOP_COLUMNS, eop_rows(solution)),
        "points": Table({**point_columns(solution, cofactors), **statistics.point_columns(solution), **of_points}),
        "residuals": Table({**residual_columns(solution), **statistics.image_columns(solution), **of_rays}),
    }
    if solution.snooping is not None:
        tables["outliers"] = statistics.outlier_table(solution.snooping)
    if solution.jitter is not None and solution.jitter.curves:
        tables["jitter"] = table_of_rows(JITTER_COLUMNS, solution.jitter.rows())
    return tables


def start_points(problem: Problem) -> dict[str, Table]:
    """Return the table of the points' start values.

    A block that was not adjusted has only this table.
    """
    points, ground = problem.block.points, problem.start.ground + problem.origin_m
    lon, lat, _ = _geodetic_deg(ground, problem.block).T
    columns = (points.ids, [role.value for role in points.roles], _ray_counts(problem), lon, lat)
    return {START_POINTS: Table(dict(zip(TABLES[START_POINTS], columns, strict=True)))}


def _ray_counts(problem: Problem) -> Index:
    """Return the number of image points of each ground point."""
    return np.bincount(problem.block.observations.point, minlength=len(problem.block.points.ids))


def _geodetic_deg(ground_m: Array, block: Block) -> Array:
    """Convert ECEF coordinates to longitude, latitude (degrees) and height, m: (N, 3).

    Missing points are nan.
    """
    out = np.full_like(ground_m, np.nan)
    known = np.isfinite(ground_m).all(axis=1)
    body = block.body
    if body is not None and known.any():
        out[known] = body.coordinates(ground_m[known])
    elif block.georeferenced and known.any():
        out[known] = ellipsoid.geodetic_array(np.ascontiguousarray(ground_m[known]))
        out[:, :2] = np.degrees(out[:, :2])
    return out


def sigma_scale(solution: Solution) -> tuple[float, str]:
    """Return the factor that converts the root of a cofactor to a standard deviation, and the name of the scale."""
    posterior = solution.redundancy > 0 and solution.weights is None
    return (solution.sigma0, "posterior") if posterior else (1.0, "prior")


def image_cofactors(solution: Solution) -> list[Array]:
    """Return the cofactors (k, k) of each image's unknowns in physical units, prior scale; nan if unavailable."""
    out = []
    for i, parameters in enumerate(solution.problem.parameters):
        scale = np.outer(parameters.sigma, parameters.sigma)
        known = np.full(scale.shape, np.nan) if solution.cofactors is None else solution.cofactors.image(i)
        out.append(known * scale)
    return out


def eop_rows(solution: Solution) -> list[tuple[object, ...]]:
    """Return the rows of the table ``eop``: one correction for each image and parameter.

    A correction is a coefficient of a polynomial in tau. It is also given per line about the
    same line. The polynomials of an RPC image depend on its normalised line (degree 1:
    ``line_l1``, ``sample_l1``) and sample (``.._s1``).
    """
    problem, (factor, name) = solution.problem, sigma_scale(solution)
    rows: list[tuple[object, ...]] = []
    for i, (image, q) in enumerate(zip(solution.block.images, image_cofactors(solution), strict=True)):
        parameters = problem.parameters[i]
        sigmas = factor * np.sqrt(np.maximum(np.diag(q), 0.0))
        priors = parameters.sigma if solution.block.options.priors else np.full(len(parameters), np.nan)
        values = problem.unknowns(solution.state, i) * parameters.sigma
        change, line_units = problem.models[i].per_line()
        for j, parameter in enumerate(parameters.names):
            component, degree = component_and_degree(parameter)
            rows.append((
                image.id, parameter, component, degree, parameters.units[j], values[j], sigmas[j],
                priors[j], name, values[j] * change[j], sigmas[j] * change[j], line_units[j],
                parameters.shared[j] if parameters.shared else "",
            ))  # fmt: skip
    return rows


def component_and_degree(parameter: str) -> tuple[str, float]:
    """Return the component of an unknown and its power of tau.

    For example, "roll_1" has degree 1 of the component roll. "focal" has no power (nan).
    """
    component, _, degree = parameter.rpartition("_")
    power = degree.lstrip("cls")
    return (component, int(power)) if component and power.isdigit() else (parameter, float("nan"))


def point_columns(solution: Solution, cofactors: Array) -> dict[str, Column]:
    """Return adjusted coordinates, their standard deviations, and differences at control and check points."""
    points, ground = solution.block.points, solution.ground_m
    factor, name = sigma_scale(solution)
    sigma = factor * np.sqrt(np.maximum(np.einsum("nii->ni", cofactors), 0.0))
    enu, ecef, own = (np.full_like(ground, np.nan) for _ in range(3))
    for group in (solution.accuracy.control, solution.accuracy.check):
        enu[group.index], ecef[group.index] = group.enu_m, group.ecef_m
        own[group.index] = group.own_sigma_enu_m
    complete = np.asarray(np.isfinite(sigma).all(axis=1))
    scales = [name if whole else "" for whole in complete.tolist()]
    lon, lat, height = _geodetic_deg(ground, solution.block).T
    return {
        "id": points.ids, "role": [role.value for role in points.roles], "n_rays": _ray_counts(solution.problem),
        "lon_deg": lon, "lat_deg": lat, "height_m": height, **of_axes("{}_m", "xyz", ground),
        **of_axes("sigma_{}_m", _ENU, sigma), "sigma_scale": scales, **of_axes("difference_{}_m", _ENU, enu),
        **of_axes("difference_{}_m", "xyz", ecef), **of_axes("own_sigma_{}_m", _ENU, own),
    }  # fmt: skip


def point_cofactors(solution: Solution) -> Array:
    """Return the cofactors (N, 3, 3) East, North, Up of the points, m^2, in prior scale.

    They are nan if they are unavailable or if the point is not determined.
    """
    known = np.asarray(~np.isnan(solution.ground_m).any(axis=1))
    out = np.full((len(known), 3, 3), np.nan)
    if solution.cofactors is None:
        return out
    rows = np.flatnonzero(known)
    turn = solution.problem.axes(np.ascontiguousarray(solution.ground_m[rows]))
    # if the observations have statistics, the cofactors of all points are known
    every = statistics.unavailable(solution) is None
    own = solution.residual_cofactors.rays.points[rows] if every else solution.cofactors.points(rows)
    out[rows] = turn @ own @ np.swapaxes(turn, 1, 2)
    check = solution.accuracy.check
    out[check.index] = check.cofactors_enu_m2  # an excluded point is not an unknown: its cofactors are propagated
    return out


def residual_columns(solution: Solution) -> dict[str, Column]:
    """Return observed pixels, residuals v = adjusted minus observed, and their standard deviations."""
    o, block = solution.problem.observations, solution.block
    return {
        "image": [block.images[k].id for k in o.image.tolist()],
        "id": [block.points.ids[k] for k in o.point.tolist()],
        "line": o.line, "sample": o.sample, **of_axes("v_{}_px", ("line", "sample"), solution.residuals_px),
        "sigma_line_px": o.sigma_line_px, "sigma_sample_px": o.sigma_sample_px,
    }  # fmt: skip


def arrays_of(solution: Solution, points: Array) -> dict[str, npt.NDArray[Any]]:
    """Return the state, the adjusted points and the cofactors (prior scale) as arrays without Python objects.

    ``points`` is the result of :func:`point_cofactors`. The arrays also contain the
    covariances that the table of points does not contain. They have the scale of the standard
    deviations in the table.

    If images have different unknowns, the arrays of the unknowns have one row for each
    image. Rows are filled with nan (numbers) and "" (names). ``n_parameters`` is the
    number of unknowns of each image.
    """
    problem, (factor, _) = solution.problem, sigma_scale(solution)
    k = solution.state.image.shape[1]
    cofactors = np.full((problem.n_images, k, k), np.nan)
    sigma = np.full((problem.n_images, k), np.nan)
    names, units = (np.full((problem.n_images, k), "", dtype="U16") for _ in range(2))
    for i, (parameters, q) in enumerate(zip(problem.parameters, image_cofactors(solution), strict=True)):
        n = len(parameters)
        cofactors[i, :n, :n], sigma[i, :n] = q, parameters.sigma
        names[i, :n], units[i, :n] = parameters.names, parameters.units
    one = len({p.setup.tobytes() + " ".join(p.names).encode() for p in problem.parameters}) == 1
    row = 0 if one else slice(None)
    return {
        "image_ids": np.array([image.id for image in solution.block.images], dtype=str),
        "point_ids": np.array(solution.block.points.ids, dtype=str),
        "parameter_names": names[row], "parameter_units": units[row], "prior_sigma": sigma[row],
        "n_parameters": np.diff(problem.first), "state_image": solution.state.image,
        "state_ground_m": solution.state.ground, "origin_m": problem.origin_m, "ground_m": solution.ground_m,
        "residuals_px": solution.residuals_px, "image_cofactors": cofactors, "image_covariance": cofactors * factor**2,
        "point_covariance_m2": points[:, *PAIRS] * factor**2,
    }  # fmt: skip
