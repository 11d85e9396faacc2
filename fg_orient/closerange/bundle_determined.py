"""What the observations of a bundle leave open: points without rays, the datum, any other unknown."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from factors.cameras.extended_collinearity import EXTENDED_COLLINEARITY
from fg_orient.adjustment.network import NetworkRows
from fg_orient.closerange.bundle_network import Built
from fg_orient.closerange.fitting import RANK_LIMIT, UNDETERMINED
from fg_orient.model.errors import InputError, finding

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Elements of a direction that are named, by the largest.
NAMED: Final = 0.3
#: Motions of a coordinate system: shifts, turns, scale.
MOTIONS: Final = ("shift X", "shift Y", "shift Z", "turn about X", "turn about Y", "turn about Z", "scale")
#: Weight of a hard condition beside observations in units of their accuracy.
HARD: Final = 1e6


def require_rays(built: Built, which: Index, of: Index) -> None:
    """Refuse points that fewer than two photos see and nothing else tells of.

    A point with an observation of its own (control) or in a constraint is judged with all other unknowns, by
    :func:`require_determined`.

    Parameters
    ----------
    which, of : (m,) int arrays
        Photo and point of each image point.

    Raises
    ------
    InputError
        Names the points and their photos.
    """
    told = {u for o in built.observations if o.equation is not EXTENDED_COLLINEARITY
            for u in o.unknowns if not isinstance(u, np.ndarray)}  # fmt: skip
    faults = []
    for j, variable in built.point_variables.items():
        photos = np.unique(which[of == j])
        if len(photos) < 2 and variable not in told:
            where = f", photo {built.photos[photos[0]].name}" if len(photos) else ""
            code = "closerange.one_ray" if len(photos) else "closerange.no_ray"
            faults.append(finding(code, place=f"point {built.ids[j]}{where}"))
    if faults:
        raise InputError(*faults)


def require_determined(built: Built, rows: NetworkRows) -> None:
    """Refuse unknowns that the rows leave open.

    Hard conditions leave a space of motions Z; the singular values of J Z, unknowns in units of the accuracy that
    their observations give them, tell how far observations determine them. A figure's unit is that of its points.

    Raises
    ------
    InputError
        Names the open motions of the coordinate system; if there are none, the unknowns and the direction.
    """
    unit = built.units(rows)
    border = rows.border * unit
    basis = np.eye(len(unit))
    if len(border):
        basis = np.linalg.svd(border / np.linalg.norm(border, axis=1, keepdims=True))[2][len(border) :].T
    design = np.linalg.qr(rows.design * unit, mode="r") @ basis  # its singular values, in a tenth of the time
    _, values, right = np.linalg.svd(design, full_matrices=len(design) < design.shape[1])
    values = np.concatenate([values, np.zeros(design.shape[1] - len(values))])
    if not len(values):
        return
    free = np.array([not known for known in built.observed])
    if values[-1] > RANK_LIMIT * values[0]:
        deviation = np.sqrt(np.sum((basis @ right.T / values) ** 2, axis=1))
        if not (deviation * free > UNDETERMINED).any():
            return
    require_datum(built, rows, unit)
    raise _open(built, basis @ right[-1], unit)


def _open(built: Built, weak: Array, unit: Array) -> InputError:
    """The unknowns of the weakest direction, in words."""
    share = np.abs(weak) / np.abs(weak).max()
    names = [built.network.labels[k] for k in np.flatnonzero(share >= NAMED)]
    top = int(np.argmax(share))
    terms = (f"{weak[k] * unit[k] / (weak[top] * unit[top]):+.3g} {built.network.labels[k]}"
             for k in np.argsort(-share)[:4])  # fmt: skip
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    return InputError.of("closerange.undetermined", place="bundle", names=shown, direction=" ".join(terms),
                         limit=UNDETERMINED)  # type: ignore[return-value]  # fmt: skip


def require_datum(built: Built, rows: NetworkRows, unit: Array) -> None:
    """Refuse a bundle that can be moved as a whole without any observation noticing.

    The seven motions are joined by what the figures can do to follow them; with hard conditions as observations of
    great weight, the small singular values of all these are the open motions.

    Raises
    ------
    InputError
        How many motions are open, and which.
    """
    length = np.linalg.norm(rows.border * unit, axis=1, keepdims=True)
    design = np.vstack([rows.design * unit, HARD * rows.border * unit / np.where(length > 0.0, length, 1.0)])
    moved = motions(built) / unit[:, None]
    figures = [i for k in built.figure_variables for i in range(*built.network.part(k).indices(len(unit)))]
    if figures:  # what figures do to follow a motion is no misfit
        follow, _ = np.linalg.qr(design[:, figures])
        felt = design @ moved - follow @ (follow.T @ (design @ moved))
    else:
        felt = design @ moved
    size = np.linalg.norm(moved, axis=0)
    if not (size > 0.0).all():  # nothing of the block moves
        return
    moved, felt = moved / size, felt / size
    _, values, right = np.linalg.svd(np.linalg.qr(felt, mode="r"))
    count = int(np.sum(np.abs(moved @ right.T).max(axis=0) > UNDETERMINED * values))
    if count:
        alone = np.abs(moved).max(axis=0) > UNDETERMINED * np.linalg.norm(felt, axis=0)
        words = [name for name, is_open in zip(MOTIONS, alone, strict=True) if is_open]
        raise InputError.of("closerange.datum", place="bundle", count=count,
                            words=f" ({', '.join(words)})" if words else "")  # fmt: skip


def motions(built: Built) -> Array:
    """What the unknowns (u, 7) do as the whole block is shifted, turned or scaled about its origin; figures stay.

    A point P moves by e, e x P or P; a photo that turns with the block by e has turned by -R e in its own axes.
    """
    state, out = built.network.start, np.zeros((built.network.n_unknowns, 7))
    for k in [*built.centres, *built.point_variables.values()]:
        if not isinstance(k, np.ndarray):
            part = built.network.part(k)
            at = state[part]
            out[part, :3], out[part, 3:6], out[part, 6] = np.eye(3), np.cross(np.eye(3), at).T, at
    for photo, k in enumerate(built.turns):
        if not isinstance(k, np.ndarray):
            out[built.network.part(k), 3:6] = -built.rotation(photo, state)
    return out
