"""Adjustment of a block that grows: images and image points are added and removed, and the solution is updated.

Ground points are in groups of a few images (:mod:`fg_orient.adjustment.optimisers`). A change replaces the groups of
the affected points, and iSAM2 updates everything that depends on them. Images and points that are not yet determined
wait outside the equations: :attr:`Incremental.waiting` names them with the reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.rows import image_models
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.block import Block, Coordinates, GroundPoints, Image, ImagePoints
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.model.parameters import with_options
from fg_orient.orientation.solution import Solution
from fg_orient.orientation.waiting import (
    determined_images,
    excluded_points,
    image_waits,
    judged_points,
    local_block,
    undetermined,
)

if TYPE_CHECKING:
    from fg_orient.adjustment.optimisers import IncrementalGraph, LocalGroup
    from fg_orient.sensors.base import ImageModel


#: Maximum number of images of a group, unless more images see a single point. In larger groups, images
#: without a common point would be coupled.
GROUP_IMAGES: Final = 6
#: Maximum number of waiting images and ground points that an error names.
WAITING_SHOWN: Final = 10


class Incremental:
    """Adjustment that follows a growing block.

    After each change, the unknowns of the tested blocks agree with the unknowns of :func:`fg_orient.adjust` to 1e-4 of
    their standard deviations (thresholds and measured differences: docs/incremental.md). Only groups that changed, or
    whose images moved, are evaluated. :meth:`solution` removes the remaining difference and computes all statistics.

    Parameters
    ----------
    block : Block
        Initial block, which may have no images. Its options (unknowns, priors, datum "control" or "priors")
        apply to all later changes. Robust losses and extra observations are not supported.

    Raises
    ------
    InputError
        An option is not supported, or as of :meth:`add`.
    """

    def __init__(self, block: Block) -> None:
        _require_supported(with_options(block, "Incremental"))
        none = np.zeros(0, np.intp)
        self._block = replace(block, images=(), observations=block.observations.take(none))
        self._models: tuple[ImageModel, ...] = ()
        self._groups: tuple[LocalGroup, ...] = ()
        self._graph: IncrementalGraph | None = None
        self._used_image, self._used_point = np.zeros(0, bool), np.zeros(len(block.points.ids), bool)
        self._waiting: dict[str, Finding] = {}
        self.add(images=block.images, observations=block.observations)

    def __repr__(self) -> str:
        return f"<Incremental adjustment of {self._block!r}: {len(self._waiting)} images and points wait>"

    @property
    def block(self) -> Block:
        """All images, ground points and image points so far."""
        return self._block

    @property
    def waiting(self) -> tuple[Finding, ...]:
        """Images and ground points that are not determined yet, each with the reason."""
        return tuple(self._waiting[name] for name in sorted(self._waiting))

    def add(
        self,
        images: Sequence[Image] = (),
        points: GroundPoints | None = None,
        observations: ImagePoints | None = None,
    ) -> None:
        """Add images, ground points and image points.

        Parameters
        ----------
        images : sequence of Image, optional
        points : GroundPoints, optional
            New ground points; an id that the block has is an error.
        observations : ImagePoints, optional
            Positions refer to the images and ground points of ``block`` after this call: earlier ones come first.

        Raises
        ------
        InputError
            An id exists already, or an image point names an image or a ground point that does not exist. The object
            remains as it was.
        NoSolutionError
            Rays do not intersect, or the equations have no solution. The object remains as it was.
        """
        block = self._block
        ids = [image.id for image in block.images] + [image.id for image in images]
        _require_unique(ids, "images")
        known = block.points if points is None else _joined(block.points, points)
        _require_unique(known.ids, "points")
        rows = block.observations if observations is None else _stacked(block.observations, observations)
        _require_positions(rows, len(ids), len(known.ids))
        touched = np.zeros(len(known.ids), bool)
        if observations is not None:
            touched[observations.point] = True
        grown = replace(block, images=(*block.images, *images), points=known, observations=rows)
        self._change(grown, touched, removed=False)

    def remove(self, observations: Iterable[tuple[str, str]]) -> None:
        """Remove image points, for instance gross errors.

        Parameters
        ----------
        observations : iterable of (image id, point id)

        Raises
        ------
        InputError
            There is no such image point. The object remains as it was.
        NoSolutionError
            See :meth:`add`.
        """
        block, gone = self._block, set(observations)
        o, ids, names = block.observations, block.points.ids, [image.id for image in block.images]
        own = [(names[i], ids[j]) for i, j in zip(o.image.tolist(), o.point.tolist(), strict=True)]
        for image, point in sorted(gone - set(own)):
            raise InputError.of(
                "incremental.no_image_point (failure): there is no such image point"
                " -> give the ids of image and ground point",
                place=f"image {image}, point {point}",
            )
        keep = np.array([pair not in gone for pair in own], bool)
        touched = np.zeros(len(ids), bool)
        touched[o.point[~keep]] = True
        self._change(replace(block, observations=o.take(keep)), touched, removed=True)

    def unknowns(self, image: str) -> Array:
        """Return the unknowns (k,) of an image in prior sigmas, in the order of ``solution().problem.parameters``.

        Raise InputError if the image is unknown, or if it waits.
        """
        names = [i.id for i in self._block.images]
        self._require_known(image in names and self._used_image[names.index(image)], f"image {image}")
        k = names.index(image)
        parameters = self._models[k].parameters
        out = np.zeros(len(parameters))
        out[parameters.own] = self._vector(f"image:{image}", int(parameters.own.sum()))
        shared: dict[str, list[tuple[int, int]]] = {}
        for j in np.flatnonzero(~parameters.own).tolist():
            shared.setdefault(parameters.shared[j], []).append((parameters.codes[j], j))
        for name, places in shared.items():
            out[[j for _, j in sorted(places)]] = self._vector(f"shared:{name}", len(places))
        return out

    def correction(self, image: str) -> Any:
        """Return the correction of an image in physical units; see ``Solution.correction``."""
        k = [i.id for i in self._block.images].index(image)
        return self._models[k].correction(self.unknowns(image))

    def ground_m(self, point: str) -> Array:
        """Return the ground point (3,), ECEF m. InputError if the point is unknown, or if it waits."""
        ids = self._block.points.ids
        self._require_known(point in ids and self._used_point[ids.index(point)], f"point {point}")
        j = ids.index(point)
        for group in self._groups:
            if j in group.points and self._graph is not None:
                state = group.state(self._graph.unknowns)
                return np.asarray(state.ground[group.points.index(j)] + group.problem.origin_m)
        return np.array(self._block.points.known.ecef_m[j])

    def solution(self) -> Solution:
        """Adjust the whole block from the present unknowns; return the solution with all statistics.

        Its findings include :attr:`waiting`; waiting images and ground points are not part of the adjusted block.

        Raises
        ------
        InputError, RankDeficientError
            InputError, RankDeficientError :: Errors of :func:`fg_orient.adjust`.
        """
        from fg_orient.orientation.orient import adjust_from

        block = self._block
        if not self._used_image.any():
            raise InputError(
                finding(
                    "incremental.nothing (failure): no image is determined yet"
                    " -> add image points of control points, or set priors",
                    place=block.name,
                ),
                *self.waiting[:WAITING_SHOWN],
            )
        o, place = block.observations, np.cumsum(self._used_image) - 1
        own = o.take(self._used_image[o.image] & (self._used_point | excluded_points(block))[o.point])
        images = tuple(image for image, used in zip(block.images, self._used_image, strict=True) if used)
        used = replace(
            block,
            images=images,
            observations=ImagePoints(
                place[own.image], own.point, own.line, own.sample, own.sigma_line_px, own.sigma_sample_px
            ),
        )
        solution = adjust_from(used, self._start)
        return replace(solution, findings=(*solution.findings, *self.waiting))

    def _start(self, problem: Problem) -> State:
        """Return the present unknowns as the start of a problem."""
        image, ground = problem.start.image.copy(), problem.start.ground.copy()
        for k, own in enumerate(problem.block.images):
            if len(problem.parameters[k]):
                image[k, : len(problem.parameters[k])] = self.unknowns(own.id)
        for group in self._groups:
            assert self._graph is not None
            active = group.problem.active
            state = group.state(self._graph.unknowns)
            number = np.array(group.points)[active]
            ground[number] = state.ground[active] + group.problem.origin_m - problem.origin_m
        return State(image, ground)

    def _vector(self, name: str, size: int) -> Array:
        return np.zeros(0) if not size or self._graph is None else self._graph.unknowns[name]

    def _require_known(self, known: bool, place: str) -> None:
        if not known:
            raise InputError.of(
                "incremental.not_there (failure): there is no such image or ground point, or it waits"
                " -> see the property waiting",
                place=place,
            )

    # ``add`` and ``remove`` change the block by this method

    def _change(self, block: Block, touched: Mask, *, removed: bool) -> None:
        """Replace the groups of touched ground points (N,); nothing changes if this fails."""
        before = dict(self.__dict__)
        try:
            with one_blas_thread():
                self._changed(block, touched, removed=removed)
        except BaseException as error:
            broken = self._graph is not None and self._graph.broken
            self.__dict__.update(before)
            if broken:
                self._rebuild()
            if isinstance(error, RuntimeError):
                why = " ".join(str(error).split())[:160]
                raise NoSolutionError.of("adjust.broken_down", place=block.name, why=why) from error
            raise

    def _rebuild(self) -> None:
        """Make graph and groups again."""
        self._graph, self._groups = None, ()
        self._used_image, self._used_point = self._used_image & False, self._used_point & False
        self._changed(self._block, np.ones(len(self._block.points.ids), bool), removed=False)

    def _changed(self, block: Block, touched: Mask, *, removed: bool) -> None:
        from fg_orient.adjustment.optimisers import IncrementalGraph

        self._models += image_models(block.images[len(self._models) :], block.options)
        graph = self._graph or IncrementalGraph(block.options.priors)
        self._graph = graph
        o, participates = block.observations, ~excluded_points(block)
        old_image, old_point = (
            np.append(used, np.zeros(n - len(used), bool))
            for used, n in ((self._used_image, len(block.images)), (self._used_point, len(participates)))
        )
        usable = np.ones(len(old_image), bool)
        if not block.options.priors:
            known = old_image & (not removed)
            usable = determined_images(block, ~known, known, lambda rows, new: self._loose(block, graph, rows, new))
        touched = touched.copy()
        touched[o.point[(usable != old_image)[o.image]]] = True
        touched &= participates
        points, good, reasons = judged_points(block, np.flatnonzero(touched[o.point]), usable)
        point = old_point & ~touched
        point[points[good]] = True
        image = np.zeros(len(usable), bool)
        image[o.image[point[o.point] & usable[o.image]]] = True
        rest = {f"point {block.points.ids[j]}" for j in np.flatnonzero(touched).tolist()}
        waiting = {name: one for name, one in self._waiting.items() if name.startswith("point") and name not in rest}
        rays = np.bincount(o.image[point[o.point]], minlength=len(image))
        for k in np.flatnonzero(~image).tolist():
            one = image_waits(block, k, len(self._models[k].parameters), int(rays[k]))
            waiting[one.place] = one
        gone, new = self._regrouped(block, touched, image, point)
        if gone or new:
            graph.update(gone, new, graph.start(new), self._names(block, image))
        lost = set(gone)
        self._groups = (*(group for group in self._groups if group not in lost), *new)
        self._block, self._used_image, self._used_point = block, image, point
        self._waiting = waiting | reasons

    def _loose(self, block: Block, graph: IncrementalGraph, rows: Index, new: Mask) -> Mask:
        """Return the new images (M,) whose image points do not determine all unknowns without priors."""
        from fg_orient.adjustment.optimisers import LocalGroup

        small, images, points = local_block(block, rows)
        group = LocalGroup(compile_problem(small), tuple(points.tolist()))
        known = set(self._names(block, self._used_image & ~new[: len(self._used_image)]))
        added = [(name, part) for name, part in group.vectors if name not in known]
        columns = np.concatenate([np.zeros(0, np.intp), *(np.arange(part.start, part.stop) for _, part in added)])
        bad = undetermined(group.normal(graph.start([group]))[np.ix_(columns, columns)])
        lost = {name for name, part in added if bad[np.isin(columns, np.arange(part.start, part.stop))].any()}
        out = np.zeros(len(block.images), bool)
        for k in images.tolist():
            out[k] = not lost.isdisjoint(self._names_of(block, k))
        return out

    def _names_of(self, block: Block, k: int) -> list[str]:
        """Return the names of the vectors of an image."""
        parameters = self._models[k].parameters
        own = [f"image:{block.images[k].id}"] if parameters.own.any() else []
        return own + [f"shared:{parameters.shared[j]}" for j in np.flatnonzero(~parameters.own).tolist()]

    def _names(self, block: Block, images: Mask) -> list[str]:
        """Return the names of the vectors of some images (M,)."""
        return [name for k in np.flatnonzero(images).tolist() for name in self._names_of(block, k)]

    def _regrouped(
        self, block: Block, touched: Mask, image: Mask, point: Mask
    ) -> tuple[list[LocalGroup], list[LocalGroup]]:
        """Return the groups with touched points, and the groups that replace them."""
        from fg_orient.adjustment.optimisers import LocalGroup

        gone = [group for group in self._groups if touched[list(group.points)].any()]
        o, mine = block.observations, touched.copy()
        mine[[j for group in gone for j in group.points]] = True
        mine &= point
        rows = np.flatnonzero(mine[o.point] & image[o.image])
        rows = rows[np.argsort(o.point[rows], kind="stable")]
        numbers, first = np.unique(o.point[rows], return_index=True)
        rays = dict(zip(numbers.tolist(), np.split(rows, first[1:]), strict=False))
        seen = {j: frozenset(o.image[own].tolist()) for j, own in rays.items()}
        new = []
        for part in _clusters(seen):
            small, _, points = local_block(block, np.sort(np.concatenate([rays[j] for j in part])))
            if any(len(self._models[k].parameters) for k in set().union(*(seen[j] for j in part))):
                new.append(LocalGroup(compile_problem(small), tuple(points.tolist())))
        return gone, new


def _clusters(images: dict[int, frozenset[int]]) -> list[list[int]]:
    """Group ground points, given with the images that see them; a group has at most :data:`GROUP_IMAGES` images.

    A point joins the first group that sees one of its images and remains small enough.
    """
    hosts: list[set[int]] = []
    members: list[list[int]] = []
    by_image: dict[int, list[int]] = {}
    kinds: dict[frozenset[int], list[int]] = {}
    for j, seen in images.items():
        kinds.setdefault(seen, []).append(j)
    for seen in sorted(kinds, key=lambda s: (sorted(s), -len(s))):
        near = sorted({g for k in seen for g in by_image.get(k, ())})
        place = next((g for g in near if len(hosts[g] | seen) <= max(GROUP_IMAGES, len(seen))), len(hosts))
        if place == len(hosts):
            hosts.append(set())
            members.append([])
        hosts[place] |= seen
        members[place] += kinds[seen]
        for k in seen:
            if place not in by_image.setdefault(k, []):
                by_image[k].append(place)
    return members


def _require_supported(block: Block) -> None:
    """Raise InputError for options and observations that iSAM2 over groups does not support."""
    options = block.options
    for option, value, good in (
        ("loss", options.loss, options.loss == "none"),
        ("datum", options.datum, options.datum in ("auto", "control", "priors")),
        ("snoop", options.snoop, not options.snoop),
        ("regularisation", options.regularisation, options.regularisation == "none"),
        ("extra", f"{len(block.extra)} observations", not block.extra),
    ):
        if not good:
            raise InputError.of(
                "incremental.unsupported (failure): an incremental adjustment does not support this"
                " -> use fg_orient.adjust",
                place=option,
                value=value,
            )


def _require_unique(ids: Sequence[str], place: str) -> None:
    if len(set(ids)) < len(ids):
        twice = next(name for n, name in enumerate(ids) if name in ids[:n])
        raise InputError.of(
            "incremental.twice (failure): this id exists already -> give each id once", place=place, value=twice
        )


def _require_positions(rows: ImagePoints, n_images: int, n_points: int) -> None:
    for numbers, n, place in ((rows.image, n_images, "images"), (rows.point, n_points, "points")):
        wrong = numbers[(numbers < 0) | (numbers >= n)]
        if len(wrong):
            raise InputError.of(
                "incremental.position (failure): an image point names a position that does not exist; there are {n}"
                " -> count the images and ground points of the block after the addition",
                place=place,
                value=int(wrong[0]),
                n=n,
            )


def _joined(a: GroundPoints, b: GroundPoints) -> GroundPoints:
    """Join two sets of ground points."""
    known = Coordinates(*(
        np.concatenate([getattr(a.known, name), getattr(b.known, name)]) for name in ("ecef_m", "sigma_enu_m", "fixed")
    ))  # fmt: skip
    return GroundPoints((*a.ids, *b.ids), (*a.roles, *b.roles), known)


def _stacked(a: ImagePoints, b: ImagePoints) -> ImagePoints:
    """Join two sets of image points."""
    names = ("image", "point", "line", "sample", "sigma_line_px", "sigma_sample_px")
    return ImagePoints(*(np.concatenate([getattr(a, name), getattr(b, name)]) for name in names))
