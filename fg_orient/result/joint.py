"""Joint cofactors of the images and ground points of a result, with the names of their unknowns.

The next adjustment of the same images uses them as a prior (``fg_orient.orientation.earlier``). They contain the
priors of the images and the control coordinates, which that adjustment observes again: the record lists both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution

#: Unknowns up to which the file is written: 18 MB. Beyond it the tie points are left out, then the whole file.
LIMIT: Final = 1500
_AXES: Final = "xyz"


@dataclass(frozen=True, eq=False)
class JointCofactors:
    """Adjusted values of image and point unknowns with their joint cofactors.

    Parameters
    ----------
    names : tuple of str
        "image:left.roll_0", "shared:CAMERA.focal" (an unknown that images share under an id), "point:12.x"; the three
        unknowns of a point follow each other.
    values : (u,) array
        Corrections of the images in physical units; ECEF coordinates of the points, m.
    cofactors : (u, u) array
        Physical units, prior scale (sigma0 = 1).
    prior_sigma : (u,) array
        Prior sigmas of image unknowns; nan without priors, and for points.
    control : tuple of str
        Ids of the points with control coordinates that are no constants.
    control_m : (c, 3) array
        These coordinates, ECEF m.
    control_information : (c, 3, 3) array
        Inverse of their covariance, ECEF, 1 / m^2.
    """

    names: tuple[str, ...]
    values: Array
    cofactors: Array
    prior_sigma: Array
    control: tuple[str, ...]
    control_m: Array
    control_information: Array

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Content of ``covariance.npz``."""
        own = vars(self).items()
        return {name: np.array(part, dtype=str) if isinstance(part, tuple) else part for name, part in own}

    @staticmethod
    def of_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> JointCofactors:
        """Read the content of ``covariance.npz``; KeyError or ValueError if it is another file."""
        names, control = (tuple(map(str, arrays[name])) for name in ("names", "control"))
        shapes = {"values": (u := len(names),), "cofactors": (u, u), "prior_sigma": (u,),
                  "control_m": (c := len(control), 3), "control_information": (c, 3, 3)}  # fmt: skip
        own = {name: np.asarray(arrays[name], float).reshape(shape) for name, shape in shapes.items()}
        return JointCofactors(names=names, control=control, **own)


def unknown_names(image: str, names: tuple[str, ...], shared: tuple[str, ...]) -> tuple[str, ...]:
    """Return names of the unknowns of an image; ``shared``: the shared id of each unknown, "" if not shared, or ()."""
    owners = [f"shared:{group}" if group else f"image:{image}" for group in shared or ("",) * len(names)]
    return tuple(f"{owner}.{name}" for owner, name in zip(owners, names, strict=True))


def points_within(solution: Solution, limit: int, common: Index | None = None) -> Index | None:
    """Select unknown points (of ``common``) up to a number of unknowns: all points, control points only, or None."""
    problem = solution.problem
    among = np.ones(len(problem.active), bool) if common is None else np.isin(np.arange(len(problem.active)), common)
    for wanted in (problem.active & among, problem.observed & among):
        if problem.n_free_unknowns + 3 * int(wanted.sum()) <= limit:
            return np.flatnonzero(wanted)
    return None


def joint_cofactors_of(solution: Solution, points: Index) -> JointCofactors | None:
    """Joint cofactors of all images and of some unknown points; None if the covariance cannot be a prior.

    With inner constraints the cofactors are singular: they refer to a datum, not to the Earth.
    """
    from factors.conditions.control import POINT

    problem = solution.problem
    if solution.cofactors is None or problem.block.options.datum == "inner":
        return None
    ids, parameters = problem.block.points.ids, problem.parameters
    wide = [name for image, p in zip(problem.block.images, parameters, strict=True)
            for name in unknown_names(image.id, p.names, p.shared)]  # fmt: skip
    n, chosen = len(wide), np.arange(len(wide)) if problem.ties is None else problem.ties.place
    at = np.concatenate([chosen, n + np.arange(3 * len(points))]).astype(np.intp)
    sigma = np.concatenate([*(p.sigma for p in parameters), np.ones(3 * len(points))])[at]
    q = solution.cofactors.joint(tuple(range(problem.n_images)), tuple(points.tolist()))[np.ix_(at, at)]
    ground = (solution.state.ground[points] + problem.origin_m).ravel()
    prior = np.full(len(at), np.nan)
    if problem.block.options.priors:
        prior[: len(chosen)] = sigma[: len(chosen)]
    observed = points[problem.observed[points]]
    w = problem.control_weights(observed).reshape(-1, 3, 3)
    return JointCofactors(
        (*(wide[k] for k in chosen.tolist()), *(f"point:{ids[j]}.{axis}" for j in points.tolist() for axis in _AXES)),
        np.concatenate([problem.image_vector(solution.state) * sigma[: len(chosen)], ground]),
        q * np.outer(sigma, sigma), prior, tuple(ids[j] for j in observed.tolist()),
        problem.control_records[observed, POINT.place] + problem.origin_m, np.swapaxes(w, 1, 2) @ w,
    )  # fmt: skip
