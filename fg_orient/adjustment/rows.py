"""Whitened records, residuals and Jacobians of image points, by the compiled loops of ``fg_orient.kernels.batch``.

All image points outside the loops of the solvers are evaluated here, without a Python
call per image point. A large array can be released (:func:`recomputed`): it is computed
again at its next use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, TypeVar

import numpy as np

from factors._contract import NotFiniteError, check_blocks
from factors.arrays import Array, Index
from fg_orient.kernels.batch import batch
from fg_orient.model.errors import InputError
from fg_orient.model.jitter import jitter_by_image
from fg_orient.sensors.base import ImageModel

if TYPE_CHECKING:
    from fg_orient.adjustment.problem import Problem, State
    from fg_orient.model.block import Block, Image, ImagePoints, Options
    from fg_orient.sensors.base import ImageModel


#: Number of image points whose records are made together: more need more memory, not less time.
AT_ONCE: Final = 4096


class Rows(NamedTuple):
    """Whitened image points at a state.

    Parameters
    ----------
    residual : (n, 2) array
    image : (n, 2, k) array
        Derivatives with respect to the unknowns of the image, prior sigmas; rows end with zeros.
    ground : (n, 2, 3) array
        Derivatives with respect to the ground point, m, also of points that are not unknowns.
    """

    residual: Array
    image: Array
    ground: Array


def whitened_records(
    models: Sequence[ImageModel], observations: ImagePoints, ground_m: Array, origin_m: Array
) -> Array:
    """Return the records (n, d) of image points, whose residuals are in sigmas; ``ground_m`` (N, 3) ECEF."""
    out = np.zeros((len(observations), 0))
    for k, model in enumerate(models):
        of_image = np.flatnonzero(observations.image == k)
        for begin in range(0, len(of_image), AT_ONCE):
            rows = of_image[begin : begin + AT_ONCE]
            o = observations.take(rows)
            part = model.records(o, ground_m[o.point], origin_m)
            if part.shape[1] > out.shape[1]:
                wider = np.zeros((len(out), part.shape[1]))
                wider[:, : out.shape[1]] = out
                out = wider
            together = rows[-1] - rows[0] == len(rows) - 1  # a slice is written in half the time
            out[slice(rows[0], rows[-1] + 1) if together else rows, : part.shape[1]] = part
    return out


def unchanged_rows(like: Problem, block: Block, observations: ImagePoints) -> Index:
    """Return the rows (n,) of ``like`` with the same constants as these image points; -1 for changed constants.

    A search for gross errors compiles a block again for each excluded observation. Start
    value and whitening of an image point depend only on its sensor, and on all rays and
    the known coordinates of its ground point.
    """
    columns = np.concatenate([
        np.stack([o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px], axis=1)
        for o in (like.observations, observations)
    ])  # fmt: skip
    order = np.lexsort(columns.T)
    first = np.append(True, (np.diff(columns[order], axis=0) != 0.0).any(axis=1))
    kind, n = (np.cumsum(first) - 1)[np.argsort(order)], int(first.sum())
    before, now = np.split(kind, [len(like.observations)])
    other = np.bincount(before, minlength=n) != np.bincount(now, minlength=n)
    old, new = like.block.points.known.ecef_m, block.points.known.ecef_m
    changed = ~((old == new) | (np.isnan(old) & np.isnan(new))).all(axis=1)
    changed[columns[order[first], 1][other].astype(np.intp)] = True
    row = np.full(n, -1, np.intp)
    row[before] = np.arange(len(before))
    return np.where(changed[observations.point], -1, row[now])


def rows_by_image(problem: Problem) -> list[Index]:
    """Return the rows of ``problem.observations`` in each image, ascending."""
    image = problem.observations.image
    order = np.argsort(image, kind="stable")
    return np.split(order, np.cumsum(np.bincount(image, minlength=problem.n_images))[:-1])


def image_rows(problem: Problem, state: State, k: int, rows: Index, *, jacobian: bool) -> tuple[Array, Array, Array]:
    """Return residuals (n, 2) of image points of one image, and Jacobians (n, 2, u), (n, 2, 3), empty if not requested.

    ``rows`` (n,) are rows of ``problem.observations``, all of image k.
    """
    model, n = problem.models[k], len(rows)
    ground = np.ascontiguousarray(state.ground[problem.observations.point[rows]])
    x, records = problem.unknowns(state, k), some_rows(problem, "records", rows)
    kernel, columns = batch(model.equation, model.parameters.setup, records)
    basis, own = columns.values(records), np.arange(n, dtype=np.int32)
    wide = np.zeros((1, basis.shape[1] * columns.n_components))
    wide[0, columns.wide] = x * columns.scale
    value, d_image, d_ground = np.empty((n, 2)), np.zeros((n, 2, columns.n_components)), np.zeros((n, 2, 3))
    kernel(
        0,
        n,
        own,
        records,
        own,
        np.zeros(n, np.int32),
        own,
        columns.setup,
        basis.shape[1],
        basis,
        wide,
        ground,
        value,
        d_image,
        d_ground,
        jacobian,
    )
    if not jacobian:
        return value, np.empty((n, 2, 0)), np.empty((n, 2, 0))
    return value, d_image[:, :, columns.component] * (basis[:, columns.basis] * columns.scale)[:, None], d_ground


def refuse(problem: Problem, state: State, row: int) -> NoReturn:
    """Raise the error that the scalar kernel of its equation shows for an image point.

    Raises
    ------
    NotFiniteError
        A residual or Jacobian is not finite.
    ValueError
        The kernel returns arrays of the wrong shape or type.
    """
    o, label = problem.observations, problem.label(row)
    model, ground = problem.models[o.image[row]], np.ascontiguousarray(state.ground[o.point[row]])
    x, setup = problem.unknowns(state, int(o.image[row])), model.parameters.setup
    blocks = model.equation.kernel(problem.records[row], setup, x, ground, True)
    check_blocks(model.equation.name, label, blocks, (len(x), 3), 2)
    raise NotFiniteError(f"{label}: residual or Jacobian is not finite")


def residuals(problem: Problem, state: State) -> Array:
    """Return the whitened residuals (n, 2) of all image points."""
    out = np.empty((len(problem.observations), 2))
    for begin in range(0, len(out), AT_ONCE):
        part = slice(begin, min(begin + AT_ONCE, len(out)))
        _evaluate(problem, state, part, Rows(out[part], np.empty((0, 2, 0)), np.empty((0, 2, 3))), want=False)
    return out


def linearised(problem: Problem, state: State, rows: Index | None = None) -> Rows:
    """Evaluate image points of any images: ``rows`` (n,) of ``problem.observations``, by default all."""
    n = len(problem.observations) if rows is None else len(rows)
    out = Rows(np.empty((n, 2)), np.zeros((n, 2, int(np.diff(problem.first).max()))), np.empty((n, 2, 3)))
    _evaluate(problem, state, slice(None) if rows is None else rows, out, want=True)
    return out


def _evaluate(problem: Problem, state: State, rows: Index | slice, out: Rows, *, want: bool) -> None:
    """Compute the residuals of image points and, if requested, their Jacobians, for all images of an equation."""
    o, row = problem.observations, np.arange(len(out.residual), dtype=np.int32)
    image, point = o.image[rows], o.point[rows]
    whole = isinstance(rows, slice) and rows == slice(None)
    records = problem.records if whole else some_rows(problem, "records", rows)
    own = groups(problem.models)
    number = np.zeros(problem.n_images, np.intp)
    for g, images in enumerate(own):
        number[images] = g
    arguments = records, row, image.astype(np.int32), point.astype(np.int32)
    ground = np.ascontiguousarray(state.ground)
    for g, images in enumerate(own):
        members = row if len(own) == 1 else np.flatnonzero(number[image] == g).astype(np.int32)
        if not len(members):
            continue
        mine, parameters = records if len(own) == 1 else records[members], problem.parameters[images[0]]
        kernel, columns = batch(problem.models[images[0]].equation, parameters.setup, mine)
        values, size, c = columns.values(mine), len(parameters), columns.n_components
        basis = values if len(own) == 1 else np.empty((len(row), values.shape[1]))
        basis[members] = values
        wide = np.zeros((problem.n_images, basis.shape[1] * c))
        wide[np.array(images)[:, None], columns.wide] = state.image[images, :size] * columns.scale
        direct = columns.is_plain and c == out.image.shape[2]
        d_image = out.image if direct or not want else np.zeros((len(row), 2, c))
        kernel(
            0,
            len(members),
            members,
            *arguments,
            columns.setup,
            basis.shape[1],
            basis,
            wide,
            ground,
            out.residual,
            d_image,
            out.ground,
            want,
        )
        if want and not direct:
            factor = basis[members][:, columns.basis] * columns.scale
            out.image[members, :, :size] = d_image[members][:, :, columns.component] * factor[:, None]


def side_by_side(problem: Problem, image: Index, d_image: Array) -> tuple[Array, Index, tuple[int, ...]]:
    """Return the Jacobian (2n, u) of image points to the unknowns of all their images, one image after the other.

    ``image`` (n,) are the images of the points, ``d_image`` their Jacobians as in
    :class:`Rows`. Further results: the places (u,) of the columns among the unknowns of
    all images, and the images in the order of the columns.
    """
    images = tuple(dict.fromkeys(image.tolist()))
    parts = [np.arange(problem.first[k], problem.first[k + 1]) for k in images]
    columns = np.concatenate([np.zeros(0, np.intp), *parts])
    out, begin = np.zeros((len(image), 2, len(columns))), 0
    for k, part in zip(images, parts, strict=True):
        own, end = image == k, begin + len(part)
        out[own, :, begin:end] = d_image[own, :, : len(part)]
        begin = end
    return out.reshape(2 * len(image), len(columns)), columns, images


def image_models(images: Sequence[Image], options: Options) -> tuple[ImageModel, ...]:
    """Return the model of each image.

    InputError: a sensor has no image model; approximate values of a shared unknown
    differ; ``image_unknowns`` names an unknown that no image has, or removes all unknowns
    of an image.
    """
    starts: dict[tuple[str, str], float] = {}
    for image in images:
        image.require_model()
        for (shared, part), value in image.sensor.shared_starts().items():
            if starts.setdefault((shared, part), value) != value:
                raise InputError.of("frame.shared", place=f"image {image.id}, {part}", value=value, id=shared)
    models = tuple(image.sensor.image_model(options) for image in images)
    curves = jitter_by_image(options.jitter_curves, [image.id for image in images])
    if curves and options.curve_intervals:
        raise InputError.of("jitter.curves", option="jitter_curves", value=options.curve_intervals)
    for image, model in zip(images, models, strict=True):
        if image.id in curves:
            model.add_jitter(curves[image.id])
    for image, model in zip(images, models, strict=True):
        if image.held:
            model.parameters = model.parameters.take(np.zeros(len(model.parameters), bool))
    every = {known for model in models for known in model.parameters.names}
    wrong = [unknown for unknown in options.image_unknowns if unknown not in every]
    if wrong:
        raise InputError.of("parameters.unknown", place="image_unknowns", value=", ".join(wrong))
    return models


def groups(models: Sequence[ImageModel]) -> list[list[int]]:
    """Return the images with the same equation and the same unknowns, by number, in the order of their first image."""
    out: dict[tuple[str, bytes], list[int]] = {}
    for k, model in enumerate(models):
        out.setdefault((model.equation.name, model.parameters.setup.tobytes()), []).append(k)
    return list(out.values())


def summed(values: Array, first: Index) -> Array:
    """Sum values (n, ...) over the rays of each point (P, ...), in a tenth of the time of ``np.add.reduceat``."""
    from scipy import sparse

    n, points = len(values), len(first) - 1
    of_point = sparse.csr_array((np.ones(n), np.arange(n), first), shape=(points, n))
    return np.asarray(of_point @ values.reshape(n, -1)).reshape(points, *values.shape[1:])


#: Function that computes some rows of an array, or all of them (None).
Compute = Callable[[Index | slice | None], Array]
Kind = TypeVar("Kind", bound=type)
Owner = TypeVar("Owner")


def recomputed(name: str) -> Callable[[Kind], Kind]:
    """Decorate a dataclass so that its array ``name`` can be released."""

    def changed(kind: Kind) -> Kind:
        again = cached_property(lambda owner: vars(owner)[_function(name)](None))
        again.__set_name__(kind, name)
        setattr(kind, name, again)  # Python finds the object's own array first, until it is released
        return kind

    return changed


def computed_by(owner: Any, name: str, function: Compute) -> None:
    """Set the function that computes an array of ``owner`` again."""
    vars(owner)[_function(name)] = function


def held(owner: Owner, name: str) -> Owner:
    """Return ``owner`` with the array computed."""
    getattr(owner, name)
    return owner


def release(owner: Any, name: str) -> None:
    """Free an array of ``owner``, if a function computes it again."""
    if _function(name) in vars(owner):
        vars(owner).pop(name, None)


def replaced(owner: Owner, name: str, **changes: Any) -> Owner:
    """Replace other fields as ``dataclasses.replace``; a released array stays released."""
    if name in vars(owner):
        return replace(owner, **changes)  # type: ignore[type-var]
    out: Owner = replace(owner, **changes, **{name: np.empty((0, 0))})  # type: ignore[type-var]
    computed_by(out, name, vars(owner)[_function(name)])
    release(out, name)
    return out


def some_rows(owner: Any, name: str, rows: Index | slice) -> Array:
    """Return the rows of an array of ``owner``; of a released array only these rows are computed."""
    if name not in vars(owner):
        return vars(owner)[_function(name)](rows)  # type: ignore[no-any-return]
    return getattr(owner, name)[rows]  # type: ignore[no-any-return]


def _function(name: str) -> str:
    return f"_{name}_again"
