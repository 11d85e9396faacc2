"""Tie points of other programs as surveys: image points without coordinates on the ground."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.tracks import conflicts, join
from fg_orient.formats.frame_model import FrameModel
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


def tie_survey(
    images: Sequence[str], ids: Sequence[str], image: Index, point: Index, line: Array, sample: Array,
    notes: Sequence[Finding] = (), sigma_px: Array | None = None,
) -> Survey:  # fmt: skip
    """Make the survey of tie points.

    Parameters
    ----------
    images, ids : sequences of str
        Of the images and the points.
    image, point : (n,) int arrays
        Positions in these.
    line, sample : (n,) arrays
        Pixels, (0, 0) in the centre of the first one.
    notes : sequence of Finding
    sigma_px : (n,) array, optional
        Standard deviation of line and sample; unknown if left out.
    """
    none = np.full((len(ids), 3), np.nan)
    sigma = np.full(len(line), np.nan) if sigma_px is None else sigma_px
    return Survey(
        "", tuple(ids), (Role.TIE,) * len(ids), none, none, np.zeros(len(ids), bool), tuple(images),
        ImagePoints(image, point, line, sample, sigma, sigma), notes=tuple(notes),
    )  # fmt: skip


def matched_survey(
    images: Sequence[str], image: Index, line: Array, sample: Array, matches: Index, notes: Sequence[Finding] = ()
) -> Survey:
    """Make the survey of matched keypoints; see :func:`fg_orient.formats.exchange.tracks.join`.

    Tie points are named by numbers from 1; those with two places in one image are left out, and a note says so.
    """
    tracks = join(image, line, sample, matches)
    told = conflicts(tracks, images, image, line, sample)
    k = tracks.keypoint
    ids = tuple(map(str, range(1, tracks.n_tracks + 1)))
    return tie_survey(images, ids, image[k], tracks.track, line[k], sample[k], (*notes, *told))


def pairs_of(image: Index, point: Index) -> dict[tuple[int, int], Index]:
    """Pairs of images that see the same points, with the rows (k, 2) of both image points of each.

    Parameters
    ----------
    image, point : (n,) int arrays
        Image and point of each row; a point occurs once in an image.

    Returns
    -------
    dict of (int, int) to (k, 2) int array
        By first and second image, the first one being smaller; sorted.
    """
    order = np.lexsort((image, point))
    p, found = point[order], []
    for step in range(1, len(order)):
        same = np.flatnonzero(p[step:] == p[:-step])
        if not len(same):
            break
        found.append(np.column_stack([order[same], order[same + step]]))
    rows = np.concatenate(found) if found else np.empty((0, 2), np.intp)
    first, second = image[rows[:, 0]], image[rows[:, 1]]
    rows = rows[np.lexsort((rows[:, 0], second, first))]
    keys = np.column_stack([image[rows[:, 0]], image[rows[:, 1]]])
    new = np.flatnonzero((np.diff(keys, axis=0) != 0).any(axis=1)) + 1
    parts = np.split(rows, new) if len(rows) else []
    return {(int(image[own[0, 0]]), int(image[own[0, 1]])): own for own in parts}


def model_survey(model: FrameModel) -> Survey:
    """Tie points of a frame model; its cameras, poses and coordinates have no place in a survey."""
    left_out = finding("points.model_left_out", poses=len(model.poses), cameras=len(model.cameras),
                       points=len(model.point_ids))  # fmt: skip
    return tie_survey(
        tuple(pose.name for pose in model.poses), model.point_ids, model.image, model.point, model.line, model.sample,
        (*model.notes, left_out),
    )  # fmt: skip
