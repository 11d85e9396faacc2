"""Image points of a block that another one, compiled before, has alike: their constants need not be made again.

A search for gross errors compiles a block again and again, each time without or with one observation more. Start value
and whitening of an image point depend on its sensor and on all rays of its ground point, and on nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fg_orient.model.block import Block, ImagePoints

if TYPE_CHECKING:
    from fg_orient.adjustment.problem import Problem

Index = npt.NDArray[np.intp]


def comparable(like: Problem | None, block: Block) -> bool:
    """Whether a problem is of the same images, options and ground points, so that it may have rows alike."""
    if like is None:
        return False
    same = like.block.images is block.images and like.block.options == block.options
    return same and like.block.points.ids == block.points.ids


def unchanged_rows(like: Problem, block: Block, observations: ImagePoints) -> Index:
    """Rows (n,) of ``like`` with the same constants as these image points of a comparable block; -1 where none has.

    The same are image points of ground points whose image points are all the same, and their known coordinates too.
    """
    columns = [
        np.stack([o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px], axis=1)
        for o in (like.observations, observations)
    ]
    kinds, kind = np.unique(np.concatenate(columns), axis=0, return_inverse=True)
    before, now = np.split(kind.ravel(), [len(columns[0])])
    other = np.bincount(before, minlength=len(kinds)) != np.bincount(now, minlength=len(kinds))
    old, new = like.block.points.known.ecef_m, block.points.known.ecef_m
    changed = ~((old == new) | (np.isnan(old) & np.isnan(new))).all(axis=1)
    changed[kinds[other, 1].astype(np.intp)] = True
    row = np.full(len(kinds), -1, np.intp)
    row[before] = np.arange(len(before))
    return np.where(changed[observations.point], -1, row[now])
