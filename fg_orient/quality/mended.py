"""Copies of blocks in which a supposed mistake in the measured coordinates is corrected."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, Coordinates
from fg_orient.model.names import Role
from fg_orient.quality.stated_sigmas import WORDS


def with_measured(
    block: Block, roles: Collection[Role], change: Callable[[Array], Array], only: Collection[str] = ()
) -> Block:
    """Return the block in which the measured coordinates (n, 3) m of control or check points are changed.

    Parameters
    ----------
    block : Block
    roles : collection of Role
        Control, check, or both roles. Coordinates of check points are changed when they are opened.
    change : callable
    only : collection of str
        Ids of the points; default: all of these roles.
    """
    known, withheld = block.points.known, block.withheld
    rows = block.points.where(Role.CONTROL)

    def changed(ecef_m: Array, ids: Collection[str]) -> Array:
        mine = np.isin(list(ids), list(only)) if only else np.ones(len(ecef_m), bool)
        out = ecef_m.copy()
        if mine.any():
            out[mine] = change(ecef_m[mine])
        return out

    ecef = known.ecef_m.copy()
    if Role.CONTROL in roles:
        ecef[rows] = changed(ecef[rows], [block.points.ids[j] for j in rows])

    def opened() -> Coordinates:
        given = withheld.open()
        return replace(given, ecef_m=changed(given.ecef_m, withheld.ids))

    points = replace(block.points, known=replace(known, ecef_m=ecef))
    check = Role.CHECK in roles and bool(withheld.ids)
    return replace(block, points=points, withheld=replace(withheld, reader=opened) if check else withheld)


def shifted(block: Block, roles: Collection[Role], error_m: Array, only: Collection[str] = ()) -> Block:
    """Remove a constant error (3,) m East, North, Up (or along the local axes) from measured coordinates."""

    def change(ecef_m: Array) -> Array:
        if not block.georeferenced:
            return ecef_m - error_m
        lon, lat, _ = ecef_to_geodetic(ecef_m)
        return np.asarray(ecef_m - np.einsum("nji,j->ni", enu_from_ecef(lon, lat), error_m))

    return with_measured(block, roles, change, only)


def heights_times(block: Block, roles: Collection[Role], factor: float, only: Collection[str] = ()) -> Block:
    """Return the block with the measured heights of these points multiplied by a factor."""

    def change(ecef_m: Array) -> Array:
        if not block.georeferenced:
            return np.asarray(ecef_m * np.array([1.0, 1.0, factor]))
        lon, lat, height = ecef_to_geodetic(ecef_m)
        up = enu_from_ecef(lon, lat)[:, 2]
        return np.asarray(ecef_m + up * ((factor - 1.0) * height)[:, None])

    return with_measured(block, roles, change, only)


def with_sigmas(block: Block, group: str, factor: float) -> Block:
    """Return block with the standard deviations of a group multiplied by a factor; see :data:`stated_sigmas.WORDS`."""
    o, known = block.observations, block.points.known
    words = {word: name for name, (word, _) in WORDS.items()}
    if words[group] == "image":
        line, sample = factor * o.sigma_line_px, factor * o.sigma_sample_px
        return replace(block, observations=replace(o, sigma_line_px=line, sigma_sample_px=sample))
    axes = np.array([factor, factor, 1.0] if words[group] == "position" else [1.0, 1.0, factor])
    coordinates = replace(known, sigma_enu_m=known.sigma_enu_m * axes)
    return replace(block, points=replace(block.points, known=coordinates))


def with_coordinates_of(block: Block, points: dict[str, str]) -> Block:
    """Return a block in which control points have the coordinates of other control points, by their ids."""
    place = {name: k for k, name in enumerate(block.points.ids)}
    ecef = block.points.known.ecef_m.copy()
    for name, other in points.items():
        ecef[place[name]] = block.points.known.ecef_m[place[other]]
    return replace(block, points=replace(block.points, known=replace(block.points.known, ecef_m=ecef)))


def with_shifted_pixels(block: Block, images: Collection[int], shift_px: tuple[float, float]) -> Block:
    """Return the block with line and sample of the image points of some images shifted."""
    o = block.observations
    mine = np.isin(o.image, list(images))
    line, sample = (np.where(mine, x + d, x) for x, d in zip((o.line, o.sample), shift_px, strict=True))
    return replace(block, observations=replace(o, line=line, sample=sample))


def with_split_point(block: Block, point: int, images: Collection[int]) -> Block:
    """Return the block in which the image points of a ground point in some images belong to another, new tie point."""
    o, points, known = block.observations, block.points, block.points.known
    name = points.ids[point]
    while name in points.ids:
        name += "'"
    of = o.point.copy()
    of[(of == point) & np.isin(o.image, list(images))] = len(points.ids)
    coordinates = Coordinates(
        np.vstack([known.ecef_m, np.full(3, np.nan)]), np.vstack([known.sigma_enu_m, np.full(3, np.nan)]),
        np.append(known.fixed, False),
    )  # fmt: skip
    return replace(
        block,
        observations=replace(o, point=of),
        points=replace(points, ids=(*points.ids, name), roles=(*points.roles, Role.TIE), known=coordinates),
    )
