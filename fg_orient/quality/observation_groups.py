"""Groups of observations with a common variance: image points, control points by axes, priors by kind.

A grouping is a tuple of words of :data:`GROUPINGS`. Other observations are ungrouped and keep their sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fg_orient.adjustment.problem import Problem
from fg_orient.model.arrays import Array, Index
from fg_orient.model.block import Block, Coordinates
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.model.options import USUAL_GROUPS, Options
from fg_orient.model.parameters import N_EOP, parameter_name

#: Groupings of image points (one of them) and of control points: all axes, or position and height.
IMAGE_GROUPINGS: Final = ("image", "image_by_role", "image_by_image", "image_by_sensor")
GROUPINGS: Final = (*IMAGE_GROUPINGS, "control", "position", "height", "priors")


@dataclass(frozen=True, eq=False)
class Groups:
    """Group of each observation of a block; -1: none.

    Parameters
    ----------
    names : tuple of str
    image : (n,) int array
        Group of each of ``block.observations``.
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
            "statistics.groups", option="variance_components", value=", ".join(wrong) or "none",
            known=", ".join(GROUPINGS),
        )  # fmt: skip
    image = [name for name in groups if name in IMAGE_GROUPINGS]
    control = [name for name in groups if name in ("control", "position", "height")]
    for several in (image if len(image) > 1 else [], control if "control" in control and len(control) > 1 else []):
        if several:
            raise InputError.of("statistics.groups_overlap", option="variance_components", value=", ".join(several))


def groups_of(problem: Problem, groups: tuple[str, ...] = USUAL_GROUPS) -> Groups:
    """Group the observations of a problem; errors as of :func:`require_groups`."""
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
    """Name of the group of every image point."""
    o = block.observations
    if "image_by_image" in groups:
        return [f"image {block.images[k].id}" for k in o.image]
    if "image_by_sensor" in groups:
        sensors = [_sensor_name(image.sensor) for image in block.images]
        return [f"image points of {sensors[k]}" for k in o.image]
    if "image_by_role" in groups:
        measured = np.array([role is Role.CONTROL for role in block.points.roles])
        return ["image, control points" if known else "image, other points" for known in measured[o.point]]
    return ["image" if "image" in groups else None] * len(o)


def _sensor_name(sensor: Any) -> str:
    """Mission and instrument of a rigorous model, the kind of sensor otherwise."""
    metadata = getattr(sensor, "metadata", None)
    if metadata is not None:
        return f"{metadata.mission} {metadata.instrument}".strip()
    return type(sensor).__name__.removesuffix("Sensor")


def _prior_kinds() -> dict[str, str]:
    """Kind of prior of each named unknown, without the unknowns of frame cameras."""
    eop = ("prior position", "prior velocity", "prior attitude")
    out = {parameter_name(code): eop[code // 9] for code in range(N_EOP)}
    out |= {parameter_name(code): "prior look angles" for code in range(N_EOP, N_EOP + 12)}
    out |= dict.fromkeys(("line_0", "sample_0"), "prior RPC shift")
    return out | dict.fromkeys(("line_l1", "sample_l1", "line_s1", "sample_s1"), "prior RPC linear")


_PRIOR_KIND: Final = _prior_kinds()


def scaled(block: Block, groups: Groups, factor: Array) -> Block:
    """The block with the sigmas of its groups multiplied by their factors (g,)."""
    by_group = np.append(factor, 1.0)  # -1 is the last
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
        block, observations=observations, points=replace(block.points, known=coordinates),
        options=replace(options, **changed),
    )  # fmt: skip
