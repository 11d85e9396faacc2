"""Adjust a close-range bundle: self-calibration, observed unknowns, constraints.

The bundle is converted to a block of the common adjustment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.loop import Callback
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import bundle_checks as checks
from fg_orient.closerange.bundle_block import Built, build
from fg_orient.closerange.bundle_result import BundleResult, result_of, without_rejected
from fg_orient.closerange.fitting import as_points, as_positions, as_sigmas
from fg_orient.closerange.options import COMMON, DEFAULTS
from fg_orient.closerange.photo import NAMES, PhotoInterior
from fg_orient.closerange.resection import LEAST_TESTED, other_readings
from fg_orient.model.arrays import array, names, wrong
from fg_orient.model.block import Options
from fg_orient.model.constraint import Constraint
from fg_orient.model.declaration import require_declared
from fg_orient.model.errors import InputError, NoSolutionError, RankDeficientError
from fg_orient.model.names import Status
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution

Residual = Literal["image", "condition"]


@dataclass(frozen=True)
class BundlePhoto:
    """Photo of a bundle: start values, unknowns and observations.

    Parameters
    ----------
    name : str
    interior : PhotoInterior
        Start values.
    rotation : (3, 3) array
        Start rotation: camera axes from ground axes.
    centre_m : (3,) array
        Start of the projection centre.
    unknown : tuple of str
        Camera parameters of this photo only (photo-variant): c, x0, y0, the names of
        ``factors.cameras.image_corrections``, a1 to a21 of
        ``factors.cameras.additional_parameters``, and the names of
        ``factors.cameras.image_variants``, relative to the radius of the camera's
        outermost image point. ``closerange.photo`` defines sets of them.
    camera : str
        Name of the camera; all its photos have the same ``shared`` unknowns.
    shared : tuple of str
        Unknown parameters of the camera (block-invariant), with start values of its first photo.
    observed : mapping
        Observed camera parameters by name, with value and sigma; shared ones once per camera.
    sigma_centre_m : (3,) array, optional
        Standard deviations if the centre is observed as ``observed_centre_m``, by default the start.
    sigma_turn_rad : (3,) array, optional
        Standard deviations if the start attitude is observed: rotations about the
        camera's axes X right, Y down, Z along the view.
    held : bool
        True if rotation and centre are exact.
    observed_centre_m : (3,) array, optional
        Observed centre, if it is not the start.
    """

    name: str
    interior: PhotoInterior
    rotation: Array
    centre_m: Array
    unknown: tuple[str, ...] = ()
    camera: str = ""
    shared: tuple[str, ...] = ()
    observed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sigma_centre_m: Array | None = None
    sigma_turn_rad: Array | None = None
    held: bool = False
    observed_centre_m: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", array(self.rotation, f"photo {self.name}, rotation", (3, 3)))
        object.__setattr__(self, "centre_m", as_points(self.centre_m, 3, f"photo {self.name}, centre_m")[0])
        if not np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() <= 1e-6:
            raise self.fault("rotation", self.rotation.tolist(), "a rotation matrix")
        unknown = (*self.unknown, *self.shared)
        for name in (n for n in unknown if n not in NAMES or unknown.count(n) > 1):
            raise self.fault(f"unknown {name}", name, f"different ones of {', '.join(NAMES)}")
        for name, (value, sigma) in self.observed.items():
            if name not in unknown or not (np.isfinite(value) and 0.0 < sigma < float("inf")):
                raise self.fault(f"observed {name}", f"{value} +- {sigma}", "value and sigma of unknown parameters")
        for place in ("sigma_centre_m", "sigma_turn_rad"):
            given = getattr(self, place)
            if given is not None:
                spread = np.broadcast_to(np.asarray(given, float), (3,))
                if not (np.isfinite(spread).all() and (spread > 0.0).all()):
                    raise self.fault(place, spread.tolist(), "numbers above 0")
                object.__setattr__(self, place, spread)
        if self.observed_centre_m is not None:
            seen = np.asarray(self.observed_centre_m, float)
            if self.sigma_centre_m is None or seen.shape != (3,) or not np.isfinite(seen).all():
                raise self.fault("observed_centre_m", seen.tolist(), "three numbers, together with sigma_centre_m")
            object.__setattr__(self, "observed_centre_m", seen)

    @property
    def key(self) -> str:
        """Name of the photo's camera, by default the name of the photo."""
        return self.camera or self.name

    def fault(self, place: str, value: object, expected: str) -> InputError:
        """Return the error for this photo."""
        where = f"photo {self.name}, {place}"
        return InputError.of("closerange.bundle", place=where, value=value, expected=expected)


def adjust_bundle(
    photos: Sequence[BundlePhoto],
    ids: Sequence[str],
    start_m: npt.ArrayLike,
    photo: npt.ArrayLike,
    point: npt.ArrayLike,
    image: npt.ArrayLike,
    *,
    sigma: npt.ArrayLike = 1.0,
    control: Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]] | None = None,
    constraints: Sequence[Constraint] = (),
    residual: Residual = "image",
    backend: str = "auto",
    optimizer: str = DEFAULTS["optimizer"],
    callback: Callback | None = None,
    **more: Any,
) -> BundleResult:
    """Adjust photos and points together.

    Parameters
    ----------
    photos : sequence of BundlePhoto
    ids : sequence of str
        Ids of the points.
    start_m : (n, 3) array
        Start coordinates.
    photo, point : (m,) int arrays
        Photo and point of each observation, from 0.
    image : (m, 2) array
        Measured x, y.
    sigma : float or array that fits (m, 2)
        Standard deviations of the corrected image coordinates, or of the conditions
        (image unit times m) with ``residual="condition"``.
    control : mapping, optional
        Observed points: coordinates and standard deviations, m. Points with standard
        deviation 0 are held fixed.
    constraints : sequence of Constraint
    residual : "image" or "condition"
        Least squares of the image residuals, or of the conditions F = e R3 (Ayhan 1996,
        eq. 77), with weights that do not depend on the depth.
    backend : "auto", "dense", "graph" or "schur"
        Full matrices, GTSAM, or our own loop on arrays; auto: full matrices up to 2000 unknowns, else GTSAM.
    optimizer : str
        "levenberg-marquardt", "gauss-newton" or "dogleg".
    callback : callable, optional
        Function that receives an ``IterationRecord`` after each iteration.
    **more
        Other options of the adjustment, of a robust loss and of the search for gross
        errors: those fields of :class:`fg_orient.Options` that
        ``closerange.options.COMMON`` names.

    Returns
    -------
    BundleResult

    Raises
    ------
    InputError
        Sizes or values are invalid; points have less than two rays; motions of the whole
        block are undetermined; other unknowns are undetermined (without a prior, their standard
        deviation exceeds 1000 standard deviations of their observations), named with their direction;
        hard constraints depend on or contradict each other; full matrices would have more than 2000
        unknowns.
    NoSolutionError
        The iteration does not converge, or a point lies behind a photo.
    TypeError
        An argument is not an option.
    """
    measured = as_points(image, 2, "image")
    given, points = as_sigmas(sigma, measured), names(ids, "ids")
    start = as_points(start_m, 3, "points")
    if len(start) != len(points):
        raise wrong("ids", len(points), f"a name for each of the {len(start)} start coordinates")
    if not photos:
        raise wrong("photos", 0, "one or more")
    which = as_positions(photo, "photo", measured, len(photos))
    of = as_positions(point, "point", measured, len(points))
    if residual not in get_args(Residual):
        raise wrong("residual", residual, f"one of {', '.join(get_args(Residual))}")
    n_unknowns = 3 * len(ids) + sum(6 + len(p.unknown) for p in photos)
    chosen = backend if backend != "auto" else "dense" if n_unknowns <= MAX_UNKNOWNS else "graph"
    require_declared(more, "adjust_bundle", Options, only=COMMON)
    common = DEFAULTS | {"optimizer": optimizer} | {name: value for name, value in more.items() if value is not None}
    options = Options(backend=chosen, priors=False, **common)  # type: ignore[arg-type]
    with one_blas_thread():
        built = build(
            photos,
            points,
            start,
            which,
            of,
            measured,
            given,
            control or {},
            constraints,
            residual == "condition",
            options,
        )
        try:
            return result_of(built, _solved(built, callback))
        except NoSolutionError as error:
            known = np.isin(points, list(control or {}))
            tested = (_tested(p, which == k, of, known, start, measured, points) for k, p in enumerate(photos))
            raise NoSolutionError(*other_readings(tested), *error.problems) from None


def _tested(
    photo: BundlePhoto, own: Mask, of: Index, known: Mask, start: Array, image: Array, ids: Sequence[str]
) -> tuple[str, PhotoInterior, Array, Array, list[str]]:
    """Return the points of a photo with which its image coordinates are tested: control points, if there are enough."""
    rows = np.flatnonzero(own & known[of])
    rows = rows if len(rows) >= LEAST_TESTED else np.flatnonzero(own)
    return photo.name, photo.interior, start[of[rows]], image[rows], [ids[j] for j in of[rows].tolist()]


def _solved(built: Built, callback: Callback | None) -> Solution:
    """Return the solution of the block."""
    checks.require_rays(built)
    try:
        solution = adjust(built.block, callback=callback)
    except (InputError, RankDeficientError) as error:
        raise checks.of_close_range(error) from None
    if solution.status is Status.NOT_CONVERGED:
        raise NoSolutionError.of("closerange.not_converged", place="bundle", reason=solution.ended + built.missed())
    if solution.cofactors is None:
        raise NoSolutionError(*solution.unavailable)
    without_rejected(built, solution).require_in_front(solution.state)
    return solution
