"""Result folder of a block that nothing determines: what was asked, what is missing, and where the points lie.

Nothing was adjusted, so none of the tables of a result is there: ``start_points.csv`` holds the start values of the
points, under a name that nobody takes for adjusted coordinates.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.geometry import ellipsoid
from fg_orient.adjustment.problem import Problem
from fg_orient.quality.deficiency import Evidence, judge_observability
from fg_orient.quality.motions import UNOBSERVABLE
from fg_orient.report.deficient import START_COLUMNS, START_POINTS
from fg_orient.run.columns import write_columns
from fg_orient.run.json import dumps, plain

Array = npt.NDArray[np.float64]
#: Singular values of a block that the record keeps, the least ones.
KEPT: Final = 1000


def spectra(evidence: Evidence) -> dict[str, Any]:
    """Singular values and their sentences, of the images and, where they were computed, of the whole block.

    Parameters
    ----------
    evidence : Evidence
        What the refusal was judged by.

    Returns
    -------
    dict
        ``observability`` as in every result; ``block_observability`` with ``singular_values`` (the least 1000) besides,
        or None.
    """
    images = evidence.observability or judge_observability(evidence.problem)
    view = evidence.view
    block = None
    if view is not None:
        block = {**view.as_dict(), "singular_values": view.singular_values[-KEPT:], "limit": UNOBSERVABLE}
    return {"observability": plain([o.as_dict() for o in images]), "block_observability": plain(block)}


def write_deficient(folder: Path, problem: Problem, record: dict[str, Any]) -> None:
    """Write the start values of the points, the record and the report.

    Parameters
    ----------
    folder : Path
        Existing folder.
    problem : Problem
        The compiled block.
    record : dict
        ``result.json``.
    """
    from fg_orient.report import write_report

    points = problem.block.points
    rays: npt.NDArray[np.intp] = np.bincount(problem.block.observations.point, minlength=len(points.ids))
    columns = [points.ids, [role.value for role in points.roles], rays, *_geodetic_deg(problem).T]
    write_columns(folder / START_POINTS, dict(zip(START_COLUMNS, columns, strict=True)))
    (folder / "result.json").write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
    write_report(folder)


def _geodetic_deg(problem: Problem) -> Array:
    """Longitude and latitude (N, 2) of the start values, degrees; nan where there is none."""
    ground = problem.start.ground + problem.origin_m
    out = np.full((len(ground), 2), np.nan)
    known = np.isfinite(ground).all(axis=1)
    if problem.block.georeferenced and known.any():
        out[known] = np.degrees(ellipsoid.geodetic_array(np.ascontiguousarray(ground[known]))[:, :2])
    return out
