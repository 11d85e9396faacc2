"""Joint cofactor matrix of the images and ground points of a result, with the names of their unknowns.

The next adjustment of the same images uses it as a prior (``fg_orient.orientation.earlier``).
The matrix already contains the priors of the images and the control coordinates. The next
adjustment observes both again. Therefore the record lists them, so that they are not counted
twice.
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

#: Maximum number of unknowns in the file (18 MB). If there are more, the tie points are
#: left out; if there are still too many, the file is not written.
LIMIT: Final = 1500
_AXES: Final = "xyz"


@dataclass(frozen=True, eq=False)
class JointCofactors:
    """Adjusted values of the unknowns of images and points, with their joint cofactor matrix.

    Parameters
    ----------
    names : tuple of str
        Names such as "image:left.roll_0", "shared:CAMERA.focal" and "point:12.x". Images
        share an unknown "shared" under an id. The three unknowns of a point follow each
        other.
    values : (u,) array
        Corrections of the images in physical units; ECEF coordinates of the points, m.
    cofactors : (u, u) array
        Cofactor matrix in physical units, prior scale (sigma0 = 1).
    prior_sigma : (u,) array
        Prior standard deviations of image unknowns. They are nan for unknowns without a prior, and for
        points.
    control : tuple of str
        Ids of the control points whose coordinates are observed, not constant.
    control_m : (c, 3) array
        Their control coordinates, ECEF m.
    control_information : (c, 3, 3) array
        Inverse covariance matrices of these coordinates, ECEF, 1 / m^2.
    """

    names: tuple[str, ...]
    values: Array
    cofactors: Array
    prior_sigma: Array
    control: tuple[str, ...]
    control_m: Array
    control_information: Array

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the content of ``covariance.npz``."""
        own = vars(self).items()
        return {name: np.array(part, dtype=str) if isinstance(part, tuple) else part for name, part in own}

    @staticmethod
    def of_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> JointCofactors:
        """Read the content of ``covariance.npz``.

        Raise KeyError or ValueError if it is another file.
        """
        names, control = (tuple(map(str, arrays[name])) for name in ("names", "control"))
        shapes = {"values": (u := len(names),), "cofactors": (u, u), "prior_sigma": (u,),
                  "control_m": (c := len(control), 3), "control_information": (c, 3, 3)}  # fmt: skip
        own = {name: np.asarray(arrays[name], float).reshape(shape) for name, shape in shapes.items()}
        return JointCofactors(names=names, control=control, **own)


def unknown_names(image: str, names: tuple[str, ...], shared: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the unknowns of an image.

    ``shared`` contains the shared id of each unknown, "" if it is not shared; () if no unknown is shared.
    """
    owners = [f"shared:{group}" if group else f"image:{image}" for group in shared or ("",) * len(names)]
    return tuple(f"{owner}.{name}" for owner, name in zip(owners, names, strict=True))


def points_within(solution: Solution, limit: int, common: Index | None = None) -> Index | None:
    """Select unknown points (of ``common``) for a maximum number of unknowns.

    The result contains all points, or the control points only; it is None if these are still too many.
    """
    problem = solution.problem
    among = np.ones(len(problem.active), bool) if common is None else np.isin(np.arange(len(problem.active)), common)
    for wanted in (problem.active & among, problem.observed & among):
        if problem.n_free_unknowns + 3 * int(wanted.sum()) <= limit:
            return np.flatnonzero(wanted)
    return None


def joint_cofactors_of(solution: Solution, points: Index) -> JointCofactors | None:
    """Return the joint cofactors of all images and some unknown points; None if they cannot serve as a prior.

    With inner constraints, the cofactor matrix is singular. It then refers to a datum of the
    block, not to the Earth.
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
