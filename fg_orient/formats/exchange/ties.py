"""Make surveys from tie points of other programs, and join matches of image pairs to tie points (tracks).

Two matched keypoints show the same ground point. All keypoints that match one of them show this point, too. Therefore
a track is a connected component of the graph of keypoints. Wrong matches connect different ground points. A track that
has two places in one image is a conflict. The matches do not show which connection is wrong. Therefore the whole track
is left out and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from factors.arrays import Array, Index
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.frame_model import FrameModel
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role


def tie_survey(
    images: Sequence[str], ids: Sequence[str], image: Index, point: Index, line: Array, sample: Array,
    notes: Sequence[Finding] = (),
) -> Survey:  # fmt: skip
    """Make a survey of tie points.

    Parameters
    ----------
    images, ids : sequences of str
        Names of the images and points.
    image, point : (n,) int arrays
        Positions in ``images`` and ``ids``.
    line, sample : (n,) arrays
        Pixels; (0, 0) is the centre of the first pixel.
    notes : sequence of Finding
    """
    none = np.full((len(ids), 3), np.nan)
    sigma = np.full(len(line), np.nan)
    return Survey(
        "", tuple(ids), (Role.TIE,) * len(ids), none, none, np.zeros(len(ids), bool), tuple(images),
        ImagePoints(image, point, line, sample, sigma, sigma), notes=tuple(notes),
    )  # fmt: skip


def matched_survey(
    images: Sequence[str], image: Index, line: Array, sample: Array, matches: Index, notes: Sequence[Finding] = ()
) -> Survey:
    """Make a survey of matched keypoints.

    Tie points are numbered from 1. Tie points with two places in one image are left out, and a note gives their
    number.

    Parameters
    ----------
    images : sequence of str
    image : (n,) int array
        Position of each keypoint in ``images``.
    line, sample : (n,) arrays
        Pixels; (0, 0) is the centre of the first pixel.
    matches : (m, 2) int array
        Rows of matched keypoints.
    notes : sequence of Finding
    """
    (k, track), conflicts = join(image, line, sample, matches)
    n = int(track.max(initial=-1)) + 1
    notes = (*notes, *conflict_note(n, conflicts, images, image, line, sample))
    return tie_survey(images, tuple(map(str, range(1, n + 1))), image[k], track, line[k], sample[k], notes)


def pairs_of(image: Index, point: Index) -> dict[tuple[int, int], Index]:
    """Find the pairs of images that show the same points.

    Parameters
    ----------
    image, point : (n,) int arrays
        Image and point of each row; a point occurs once in an image.

    Returns
    -------
    dict of (int, int) to (k, 2) int array
        Rows of both image points, for each pair of images. The first image has the smaller number. The pairs are
        sorted.
    """
    order = np.lexsort((image, point))
    p, parts = point[order], []
    for step in range(1, len(order)):
        same = np.flatnonzero(p[step:] == p[:-step])
        if not len(same):
            break
        parts.append(np.column_stack([order[same], order[same + step]]))
    rows = np.concatenate(parts) if parts else np.empty((0, 2), np.intp)
    first, second = image[rows[:, 0]], image[rows[:, 1]]
    rows = rows[np.lexsort((rows[:, 0], second, first))]
    keys = np.column_stack([image[rows[:, 0]], image[rows[:, 1]]])
    new = np.flatnonzero((np.diff(keys, axis=0) != 0).any(axis=1)) + 1
    parts = np.split(rows, new) if len(rows) else []
    return {(int(image[own[0, 0]]), int(image[own[0, 1]])): own for own in parts}


def model_survey(model: FrameModel) -> Survey:
    """Return the tie points of a frame model. Cameras, poses and coordinates are left out, and a note counts them."""
    left_out = finding("points.model_left_out", poses=len(model.poses), cameras=len(model.cameras),
                       points=len(model.point_ids))  # fmt: skip
    return tie_survey(
        tuple(pose.name for pose in model.poses), model.point_ids, model.image, model.point, model.line, model.sample,
        (*model.notes, left_out),
    )  # fmt: skip


def model_format(read_model: Callable[[tuple[Path, ...], Settings], FrameModel], **fields: Any) -> Format:
    """Make the registry record of a frame-model format. Its point reader returns the tie points of the model."""
    usual = {"ground_axes": "local x, y, z (left out)", "holds": TIES_ONLY}
    read = lambda paths, settings: model_survey(read_model(paths, settings))  # noqa: E731
    return Format(read_model=read_model, **{"read": read, **usual, **fields})


# --- tracks --------------------------------------------------------------------------------------


def join(image: Index, line: Array, sample: Array, matches: Index) -> tuple[tuple[Index, Index], tuple[Index, Index]]:
    """Join matches to tie points.

    Parameters
    ----------
    image : (n,) int array
        Image of each keypoint.
    line, sample : (n,) arrays
        Pixels of the keypoints. Keypoints of an image at the same pixel count as one keypoint; detectors may give a
        place several orientations.
    matches : (m, 2) int array
        Rows of matched keypoints.

    Returns
    -------
    tracks, conflicts : pairs of (k,) int arrays
        Tie points, and groups with two places in one image. Each contains the rows of keypoints, and the group of each
        row, sorted by group, then by image. Groups are numbered from 0 in the order of their first keypoints.

    Raises
    ------
    ValueError
        A match names a missing keypoint or two keypoints of one image. Readers refuse such matches before, with their
        place in the file.
    """
    image, matches = np.asarray(image, np.intp), np.asarray(matches, np.intp).reshape(-1, 2)
    if matches.size and not (0 <= matches.min() and matches.max() < len(image)):
        raise ValueError("a match names a keypoint that does not exist")
    if np.any(image[matches[:, 0]] == image[matches[:, 1]]):
        raise ValueError("a match joins two keypoints of one image")
    place = _places(image, np.asarray(line, float), np.asarray(sample, float))
    used = np.unique(place[matches])
    edges = np.searchsorted(used, place[matches])
    graph = coo_array((np.ones(len(edges), np.int8), edges.T), shape=(len(used), len(used)))
    label = connected_components(graph, directed=False)[1].astype(np.intp)
    order = np.lexsort((image[used], label))
    keypoint, label = used[order], label[order]
    twice = (label[1:] == label[:-1]) & (image[keypoint][1:] == image[keypoint][:-1])
    bad = np.isin(label, label[1:][twice])
    tracks, conflicts = ((keypoint[k], np.unique(label[k], return_inverse=True)[1]) for k in (~bad, bad))
    return tracks, conflicts


def conflict_note(
    n_tracks: int, conflicts: tuple[Index, Index], names: Sequence[str], image: Index, line: Array, sample: Array
) -> tuple[Finding, ...]:
    """Return a note with the number of omitted tie points and the first of them; empty if there is no conflict.

    ``names`` contains the names of the images; ``image``, ``line``, ``sample`` are the arguments of :func:`join`.
    """
    keypoint, track = conflicts
    if not len(keypoint):
        return ()
    n, first = int(track[-1]) + 1, keypoint[track == 0]
    doubled = int(np.flatnonzero(image[first][1:] == image[first][:-1])[0])
    one, other = ((line[k], sample[k]) for k in first[doubled : doubled + 2])
    name = names[int(image[first[doubled]])]
    return (
        finding("points.conflicts", n=n, total=n + n_tracks, image_points=len(keypoint), first=one, second=other,
                image=name),
    )  # fmt: skip


def _places(image: Index, line: Array, sample: Array) -> Index:
    """Return, for each keypoint (n,), the first keypoint of its image at the same pixel."""
    order = np.lexsort((sample, line, image))
    i, y, x = image[order], line[order], sample[order]
    new = np.ones(len(order), bool)
    new[1:] = (i[1:] != i[:-1]) | (y[1:] != y[:-1]) | (x[1:] != x[:-1])
    out = np.empty(len(order), np.intp)
    out[order] = order[new][np.cumsum(new) - 1] if len(order) else order
    return out
