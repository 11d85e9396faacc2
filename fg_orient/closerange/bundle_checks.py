"""Refusals of a bundle: points without rays, undetermined unknowns."""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.problem import State
from fg_orient.closerange.bundle_block import CENTRE, TURNS, Built
from fg_orient.closerange.fitting import RANK_LIMIT, UNDETERMINED
from fg_orient.model.errors import InputError, finding

#: Elements of a direction above this share of the largest are named.
NAMED: Final = 0.3
#: Motions of a coordinate system: shifts, rotations, scale.
MOTIONS: Final = ("shift X", "shift Y", "shift Z", "turn about X", "turn about Y", "turn about Z", "scale")
#: Weight of a hard condition relative to observations in units of their accuracy.
HARD: Final = 1e6


def require_rays(built: Built) -> None:
    """Refuse points without rays, and points in one photo without other observations.

    A control point or a point of a constraint is checked with all other unknowns, by :func:`require_determined`.
    """
    known, o = built.block.points.known, built.block.observations
    others = {name for e in built.block.extra for name in getattr(e, "members", ())}
    faults = []
    for j, name in enumerate(built.ids):
        photos = np.unique(o.image[o.point == j])
        if not len(photos) and not known.fixed[j]:
            faults.append(finding("closerange.no_ray", place=f"point {name}"))
        elif len(photos) == 1 and not known.fixed[j] and np.isnan(known.sigma_enu_m[j]).any() and name not in others:
            where = f"point {name}, photo {built.photos[photos[0]].name}"
            faults.append(finding("closerange.one_ray", place=where))
    if faults:
        raise InputError(*faults)


def require_determined(built: Built, state: State) -> None:
    """Refuse unknowns that the observations do not determine.

    Hard constraints allow a space of motions Z. The singular values of J Z, with unknowns in units of the accuracy of
    their observations, measure how well the observations determine the unknowns. The error names undetermined motions
    of the coordinate system; otherwise the unknowns and the direction. Inner constraints determine these motions.
    """
    unit = built.units(state)
    design, _, border = built.rows(state)
    if built.block.options.datum == "inner":
        moved = motions(built, state)
        size = np.linalg.norm(moved / unit[:, None], axis=0)
        inner = (moved[:, size > 0.0] / (size[size > 0.0] * unit[:, None] ** 2)).T
        design = np.vstack([design, inner])
    border = border * unit
    basis = np.eye(len(unit))
    if len(border):
        rows = border / np.linalg.norm(border, axis=1, keepdims=True)
        basis = np.linalg.qr(rows.T, mode="complete")[0][:, len(border) :]
    reduced = np.linalg.qr(design * unit, mode="r") @ basis  # its singular values, in a tenth of the time
    _, values, right = np.linalg.svd(reduced, full_matrices=len(reduced) < reduced.shape[1])
    values = np.concatenate([values, np.zeros(reduced.shape[1] - len(values))])
    if not len(values):
        return
    if values[-1] > RANK_LIMIT * values[0]:
        deviation = np.sqrt(np.sum((basis @ right.T / values) ** 2, axis=1))
        if not (deviation * ~built.is_observed > UNDETERMINED).any():
            return
    require_datum(built, state, design, border, unit)
    weak = basis @ right[-1]
    share = np.abs(weak) / np.abs(weak).max()
    names = [built.labels[k] for k in np.flatnonzero(share >= NAMED)]
    top = int(np.argmax(share))
    terms = (f"{weak[k] * unit[k] / (weak[top] * unit[top]):+.3g} {built.labels[k]}" for k in np.argsort(-share)[:4])
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    raise InputError.of("closerange.undetermined", place="bundle", names=shown, direction=" ".join(terms),
                        limit=UNDETERMINED)  # fmt: skip


def require_figures(labels: list[str], deviation: Array) -> None:
    """Refuse figures that their points do not determine: standard deviations (f,) of their parameters in units."""
    if len(labels) and deviation.max() > UNDETERMINED:
        names = [labels[k] for k in np.flatnonzero(deviation >= NAMED * deviation.max())]
        top = int(np.argmax(deviation))
        raise InputError.of("closerange.undetermined", place="bundle", names=", ".join(names[:6]),
                            direction=f"{labels[top]}: {deviation[top]:.3g} times", limit=UNDETERMINED)  # fmt: skip


def require_datum(built: Built, state: State, design: Array, border: Array, unit: Array) -> None:
    """Refuse a bundle that can be moved as a whole without an effect on the observations.

    ``design`` (n, u), ``border`` (h, u) in ``unit`` (u,). With hard constraints as observations of large weight, small
    singular values belong to open motions.
    """
    length = np.linalg.norm(border, axis=1, keepdims=True)
    rows = np.vstack([design * unit, HARD * border / np.where(length > 0.0, length, 1.0)])
    moved = motions(built, state) / unit[:, None]
    effect, size = rows @ moved, np.linalg.norm(moved, axis=0)
    if not (size > 0.0).all():  # all points and photos are held fixed
        return
    moved, effect = moved / size, effect / size
    _, values, right = np.linalg.svd(np.linalg.qr(effect, mode="r"))
    count = int(np.sum(np.abs(moved @ right.T).max(axis=0) > UNDETERMINED * values))
    if count:
        alone = np.abs(moved).max(axis=0) > UNDETERMINED * np.linalg.norm(effect, axis=0)
        words = [name for name, is_open in zip(MOTIONS, alone, strict=True) if is_open]
        raise InputError.of("closerange.datum", place="bundle", count=count,
                            words=f" ({', '.join(words)})" if words else "")  # fmt: skip


def motions(built: Built, state: State) -> Array:
    """Changes (u, 7) of the unknowns if the block is shifted, rotated or scaled about the mean of its points.

    A point P moves by e, e x P or P; a photo that rotates with the block by e rotates by -R e in its own axes.
    """
    active = np.flatnonzero(built.problem.active)
    ground = state.ground + built.problem.origin_m
    middle = np.nanmean(ground, axis=0)
    rows = dict[tuple[str, str], Array]()
    for k, photo in enumerate(built.photos):
        rows |= _moved(f"photo {photo.name}", CENTRE, built.centre(k, state) - middle)
        turned = np.hstack([np.zeros((3, 3)), -built.rotation(k, state), np.zeros((3, 1))])
        rows |= {(f"photo {photo.name}", name): row for name, row in zip(TURNS, turned, strict=True)}
    points = [row for j in active for row in _moved("", CENTRE, ground[j] - middle).values()]
    return np.array([*(rows.get(owner, np.zeros(7)) for owner in built.owners), *points])


def _moved(owner: str, names: tuple[str, ...], at: Array) -> dict[tuple[str, str], Array]:
    """Changes (7,) of the three coordinates of a place."""
    out = np.hstack([np.eye(3), np.cross(np.eye(3), at).T, at[:, None]])
    return {(owner, name): row for name, row in zip(names, out, strict=True)}
