"""Cross-validation: control points left out of the adjustment, predicted from the rest, in image and on the ground.

A point that is left out takes no part at all: neither its coordinates nor its image points. In the image its
coordinates are projected with the adjusted orientation; on the ground its rays are intersected with it. Check points
of the block stay sealed: their rays take part as those of tie points, or not at all, as the options say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.block import Block, Coordinates, WithheldCoordinates
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.orient import adjust

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: Ground points that are left out together.
Parts = Sequence[Sequence[int]]

#: Of the draw of the parts.
SEED: Final = 1


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Prediction errors.

    Parameters
    ----------
    n_folds : int
    ids : tuple of str
        Points of the rows of ``ground_m``.
    image_px : (n, 2) array
        Predicted minus measured line and sample.
    ground_m : (p, 3) array
        Predicted minus measured East, North, Up (X, Y, Z in a local system) of points in two images or more.
    """

    n_folds: int
    ids: tuple[str, ...]
    image_px: Array
    ground_m: Array

    @property
    def image_rms(self) -> float | None:
        """RMS length of an error in the image, pixels."""
        return _rms_length(self.image_px)

    @property
    def ground_rms(self) -> float | None:
        """RMS length of an error on the ground, m; None where no point is in two images."""
        return _rms_length(self.ground_m)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        axes = {
            name: None if not len(values) else np.sqrt(np.mean(values**2, axis=0)).tolist()
            for name, values in (("image_line_sample_px", self.image_px), ("ground_east_north_up_m", self.ground_m))
        }
        return {"folds": self.n_folds, "n_image_points": len(self.image_px), "n_points": len(self.ground_m),
                "image_rms_px": self.image_rms, "ground_rms_m": self.ground_rms, **axes}  # fmt: skip


def _rms_length(errors: Array) -> float | None:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else None


def folds_of(block: Block, count: int = 0) -> Parts:
    """Divide the control points that are seen: each alone, or into ``count`` parts of about one size, drawn.

    Raises
    ------
    InputError
        There are fewer control points than parts, or a single one.
    """
    control = block.points.where(Role.CONTROL)
    control = control[np.isin(control, block.observations.point)]
    if count < 0 or count == 1 or len(control) < max(count, 2):
        raise InputError.of("statistics.folds", option="folds", value=count, control=len(control))
    if count == 0:
        return tuple((int(j),) for j in control)
    order = np.random.default_rng(SEED).permutation(control)
    return tuple(tuple(sorted(part.tolist())) for part in np.array_split(order, count))


def cross_validate(block: Block, folds: Parts, **options: Any) -> CrossValidation:
    """Leave each part out once and predict it.

    Parameters
    ----------
    block : Block
    folds : tuple of tuples of int
        Control points left out together (:func:`folds_of`).
    **options
        Of :func:`fg_orient.adjust`.

    Returns
    -------
    CrossValidation

    Raises
    ------
    InputError, RankDeficientError, NoSolutionError
        A part cannot be left out; see :func:`fg_orient.adjust`.
    """
    image, ground, ids = [np.zeros((0, 2))], [np.zeros((0, 3))], list[str]()
    check_points = options.pop("check_points", None) or block.options.check_points
    block = _without_check_points(block, keep_rays=check_points == "use")
    known, o = block.points.known.ecef_m, block.observations
    for fold in folds:
        solution = adjust(left_out(block, fold), check_points="exclude", **options)
        found = solution.accuracy.check
        ids += found.ids
        ground.append(found.enu_m)
        for k, entry in enumerate(block.images):
            rows = np.flatnonzero(np.isin(o.point, fold) & (o.image == k))
            if len(rows):
                line, sample = entry.sensor.project(known[o.point[rows]], solution.correction(entry.id))
                image.append(np.stack([line - o.line[rows], sample - o.sample[rows]], axis=1))
    return CrossValidation(len(folds), tuple(ids), np.vstack(image), np.vstack(ground))


def left_out(block: Block, fold: Sequence[int]) -> Block:
    """Make these control points check points; rays of those in a single image go, as nothing intersects there."""
    points, o, known, chosen = block.points, block.observations, block.points.known, np.array(fold, np.intp)
    gone = np.isin(np.arange(len(points.ids)), chosen)
    sealed = Coordinates(known.ecef_m[chosen], known.sigma_enu_m[chosen], known.fixed[chosen])
    single = gone & (np.bincount(o.point, minlength=len(gone)) < 2)
    ids = tuple(points.ids[j] for j in chosen)
    return replace(
        block, points=points.without_coordinates(gone, Role.CHECK), observations=o.take(~single[o.point]),
        withheld=WithheldCoordinates(ids, lambda: sealed),
    )  # fmt: skip


def _without_check_points(block: Block, *, keep_rays: bool) -> Block:
    """Check points as tie points, or without their rays; their coordinates are not opened."""
    points, check = block.points, block.points.where(Role.CHECK)
    roles = tuple(Role.TIE if role is Role.CHECK else role for role in points.roles)
    keep = ~np.isin(block.observations.point, check) | keep_rays
    nothing = Coordinates(np.empty((0, 3)), np.empty((0, 3)), np.zeros(0, bool))
    return replace(
        block, points=replace(points, roles=roles), observations=block.observations.take(keep),
        withheld=WithheldCoordinates((), lambda: nothing),
    )  # fmt: skip
