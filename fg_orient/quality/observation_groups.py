"""Groups of observations with a common variance: image points, control points by axes, priors by kind.

A grouping is a tuple of words of :data:`GROUPINGS`. All other observations keep their sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, participates
from fg_orient.model.arrays import having_role
from fg_orient.model.block import Block, Coordinates
from fg_orient.model.declaration import declared
from fg_orient.model.distributions import chi_square_median
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.model.options import USUAL_GROUPS, Options
from fg_orient.model.parameters import N_EOP, parameter_name
from fg_orient.quality.hypotheses import CHECKED
from fg_orient.quality.residuals import LARGEST, GroupCofactors, ResidualCofactors, cost

#: Groupings of image points (select one of them) and of control points: all axes, or position and height.
IMAGE_GROUPINGS: Final = ("image", "image_by_role", "image_by_image", "image_by_sensor")
GROUPINGS: Final = (*IMAGE_GROUPINGS, "control", "position", "height", "priors")


@dataclass(frozen=True, eq=False)
class Groups:
    """Numbers of the groups to which the observations of a block belong; -1 means no group.

    Parameters
    ----------
    names : tuple of str
    image : (n,) int array
        Group of each row of ``block.observations``.
    axes : (3,) int array
        Groups of East, North, Up of every control point.
    prior : tuple of (u_k,) int arrays
        Groups of the unknowns of each image; empty without priors.
    """

    names: tuple[str, ...]
    image: Index
    axes: Index
    prior: tuple[Index, ...]


def require_groups(groups: tuple[str, ...]) -> None:
    """Raise InputError for words that do not exist or exclude each other."""
    wrong = [name for name in groups if name not in GROUPINGS]
    if wrong or not groups:
        raise InputError.of(
            "statistics.groups",
            option="variance_components",
            value=", ".join(wrong) or "none",
            known=", ".join(GROUPINGS),
        )
    image = [name for name in groups if name in IMAGE_GROUPINGS]
    control = [name for name in groups if name in ("control", "position", "height")]
    for several in (image if len(image) > 1 else [], control if "control" in control and len(control) > 1 else []):
        if several:
            raise InputError.of("statistics.groups_overlap", option="variance_components", value=", ".join(several))


def groups_of(problem: Problem, groups: tuple[str, ...] = USUAL_GROUPS) -> Groups:
    """Group the observations of a problem; it raises the same errors as :func:`require_groups`."""
    require_groups(groups)
    image, prior = _image_labels(problem.block, groups), list[list[str | None]]()
    axes: list[str | None] = [None] * 3
    if problem.observed.any():
        control = "control" if "control" in groups else None
        axes = [part if part in groups else control for part in ("position", "position", "height")]
    if problem.block.options.priors:
        kinds = _PRIOR_KIND if "priors" in groups else {}
        prior = [[kinds.get(name) for name in p.names] for p in problem.parameters]
    labels = (image, axes, *prior)
    names = tuple(dict.fromkeys(label for part in labels for label in part if label is not None))
    place: dict[str | None, int] = {None: -1, **{name: k for k, name in enumerate(names)}}
    of_image, of_axes, *of_priors = (np.array([place[label] for label in part], np.intp) for part in labels)
    return Groups(names, of_image, of_axes, tuple(of_priors))


def _image_labels(block: Block, groups: tuple[str, ...]) -> list[str | None]:
    """Return the name of the group of every image point."""
    o = block.observations
    if "image_by_image" in groups:
        return [f"image {block.images[k].id}" for k in o.image]
    if "image_by_sensor" in groups:
        sensors = [_sensor_name(image.sensor) for image in block.images]
        return [f"image points of {sensors[k]}" for k in o.image]
    if "image_by_role" in groups:
        measured = having_role(block.points.roles, Role.CONTROL)
        return ["image, control points" if known else "image, other points" for known in measured[o.point]]
    return ["image" if "image" in groups else None] * len(o)


def _sensor_name(sensor: Any) -> str:
    """Return the mission and instrument of a rigorous model, otherwise the kind of sensor."""
    metadata = getattr(sensor, "metadata", None)
    if metadata is not None:
        return f"{metadata.mission} {metadata.instrument}".strip()
    return type(sensor).__name__.removesuffix("Sensor")


def _prior_kinds() -> dict[str, str]:
    """Return the kind of prior of each named unknown, without the unknowns of frame cameras."""
    eop = ("prior position", "prior velocity", "prior attitude")
    out = {parameter_name(code): eop[code // 9] for code in range(N_EOP)}
    out |= {parameter_name(code): "prior look angles" for code in range(N_EOP, N_EOP + 12)}
    out |= dict.fromkeys(("line_0", "sample_0"), "prior RPC shift")
    return out | dict.fromkeys(("line_l1", "sample_l1", "line_s1", "sample_s1"), "prior RPC linear")


_PRIOR_KIND: Final = _prior_kinds()


def scaled(block: Block, groups: Groups, factor: Array) -> Block:
    """Return the block with the sigmas of its groups multiplied by their factors (g,)."""
    by_group = np.append(factor, 1.0)  # the index -1 (no group) selects the last element
    o, known, options = block.observations, block.points.known, block.options
    image = by_group[groups.image]
    observations = replace(o, sigma_line_px=o.sigma_line_px * image, sigma_sample_px=o.sigma_sample_px * image)
    coordinates = Coordinates(known.ecef_m, known.sigma_enu_m * by_group[groups.axes], known.fixed)
    changed: dict[str, Any] = {}
    for option, declaration in declared(Options).items():
        if declaration.component in groups.names:
            f, given = float(by_group[groups.names.index(declaration.component)]), getattr(options, option)
            changed[option] = tuple(f * x for x in given) if isinstance(given, tuple) else f * given
    return replace(
        block,
        observations=observations,
        points=replace(block.points, known=coordinates),
        options=replace(options, **changed),
    )


# --- residuals of a solution by groups -----------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class GroupedResiduals:
    """Residuals of a solution by any backend, with the groups of its observations.

    Parameters
    ----------
    known : ResidualCofactors
    groups : Groups
    largest : int, optional
        Maximum number of elements of the matrices of all groups; larger matrices are not computed.
    """

    known: ResidualCofactors
    groups: Groups
    largest: int | None = None

    @cached_property
    def labels(self) -> Index:
        """Group of every row: image points, control points, priors, extra observations."""
        g, problem = self.groups, self.known.problem
        prior = np.concatenate([*g.prior, np.zeros(0, np.intp)])
        if len(prior) and problem.ties is not None:
            prior = prior[problem.ties.place]  # the prior of a shared unknown is one observation
        n_extra = sum(e.n_residuals for e in problem.block.extra)
        return np.concatenate([
            np.repeat(g.image[participates(problem.block)], 2), np.tile(g.axes, len(self.known.v_control)), prior,
            np.full(n_extra, -1),
        ]).astype(np.intp)  # fmt: skip

    def sums(self) -> tuple[Array, Array, Index]:
        """Return the sums of squares q, redundancies r and numbers of rows of all groups."""
        known = self.known
        v = np.concatenate([known.v_image.ravel(), known.v_control.ravel(), known.v_prior])
        blocks = (known.image, known.control)
        r = np.concatenate([*(np.einsum("nii->ni", block).ravel() for block in blocks), known.prior])
        rows, size = self.labels[: len(v)], len(self.groups.names)
        named = rows >= 0
        q, total = (np.bincount(rows[named], w[named], size).astype(float) for w in (v**2, r))
        return q, total, np.bincount(rows[named], minlength=size)

    @cached_property
    def parts(self) -> GroupCofactors | None:
        """Compute the contributions of the groups to the cofactors; None if the block is too large."""
        if cost(self.known.problem, len(self.groups.names)) > (LARGEST if self.largest is None else self.largest):
            return None
        return GroupCofactors(self.known, self.labels, len(self.groups.names))

    def medians(self) -> Array:
        """Return each group's median of quadratic forms divided by the chi-square median; nan without redundancy.

        Points with a single image point are left out: their quadratic form is the same for image and ground.
        """
        known, parts = self.known, dict[int, list[float]]()
        problem, o = known.problem, known.problem.observations
        many = np.bincount(o.point, minlength=len(problem.active)) > 1
        rays, seen = many[o.point], many[problem.observed]
        image, prior = self.labels[: 2 * len(o)].reshape(-1, 2), self.labels[2 * len(o) + known.v_control.size :]
        for labels, v, q in (
            (image[rays], known.v_image[rays], known.image[rays]),
            (np.tile(self.groups.axes, (int(seen.sum()), 1)), known.v_control[seen], known.control[seen]),
            (prior[:, None], known.v_prior[:, None], known.prior[:, None, None]),
        ):
            for unit in zip(labels, v, q, strict=False):  # extra observations belong to no group
                _add(parts, *unit)
        return np.array([np.median(parts[g]) if g in parts else np.nan for g in range(len(self.groups.names))])


def _add(parts: dict[int, list[float]], labels: Index, v: Array, q: Array) -> None:
    """Add the quadratic form of one observation, divided by the median of chi-square, to the lists of its groups."""
    for label in set(labels.tolist()) - {-1}:
        mine = np.flatnonzero(labels == label)
        size, axes = np.linalg.eigh(q[np.ix_(mine, mine)])
        if size[0] > CHECKED:
            form = float(np.sum((axes.T @ v[mine]) ** 2 / size))
            parts.setdefault(label, []).append(form / float(chi_square_median(len(mine))))
