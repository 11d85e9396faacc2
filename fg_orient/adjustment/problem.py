"""Adjustment problem: block, parameters and start values compiled to arrays.

The unit of every residual is one sigma: image points in pixel sigmas (whitened by the image's model:
``fg_orient.sensors.base``), control points ``W (G - G_0)``, priors ``x`` (unknowns in prior sigmas). All backends
use this object and differ only in the solver. Images of different kinds can be combined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.conditions.control import POINT
from factors.geometry import ellipsoid
from fg_orient import geodesy
from fg_orient.adjustment.regularised import Regularisation
from fg_orient.adjustment.rows import (
    computed_by,
    image_models,
    recomputed,
    release,
    residuals,
    unchanged_rows,
    whitened_records,
)
from fg_orient.adjustment.ties import Ties, ties_of
from fg_orient.model.block import Block, ExtraObservation, ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.model.parameters import ImageParameters
from fg_orient.sensors import initial
from fg_orient.sensors.base import ImageModel
from fg_orient.sensors.latitudinal import observed_by_angles
from fg_orient.sensors.lines import on_features

#: One ground point by its number, or several by numbers or by a mask.
Points = int | npt.NDArray[np.intp] | npt.NDArray[np.bool_]

#: Damping of a free datum: it equals the weight of priors with a thousand times the given sigmas. It changes steps, not
#: the solution; smaller values lose digits. The images fix the datum, so ground points need almost no damping.
FREE_DAMPING: Final = 1e-6
FREE_POINT_DAMPING: Final = 1e-12


@dataclass(frozen=True)
class State:
    """Unknowns: ``image`` (M, k) in prior sigmas, short rows end with zeros; ``ground`` (N, 3) m in the local frame."""

    image: Array
    ground: Array


@dataclass(frozen=True)
class ExtraArgument:
    """Argument of an extra observation: image or ground point number ``index``, a vector of length ``size``.

    ``constant`` contains the local coordinates (3,) of a point that is not an unknown.
    """

    is_image: bool
    index: int
    size: int
    constant: Array | None = None


@recomputed("records")
@dataclass(frozen=True)
class Problem:
    """Least-squares problem for a backend.

    Parameters
    ----------
    block : Block
    models : tuple of ImageModel
        Equation and unknowns of each image.
    observations : ImagePoints
        Image points of the adjustment.
    records : (n, d) array
        Whitened constants of the equation of each image point; shorter records end with zeros.
    origin_m : (3,) array
        Local origin, ECEF; unknown ground points are relative to it, axes parallel to ECEF.
    start : State
    active, observed : (N,) bool arrays
        Points that are unknowns; unknown points that have control-point equations.
    control_records : (N, 12) array
        Records of the control-point equation, in the rows of observed points.
    regularisation : Regularisation, optional
        Regularisation whose penalties are among the extra observations.
    """

    block: Block
    models: tuple[ImageModel, ...]
    observations: ImagePoints
    records: Array
    origin_m: Array
    start: State
    active: npt.NDArray[np.bool_]
    observed: npt.NDArray[np.bool_]
    control_records: Array
    regularisation: Regularisation | None = None

    @property
    def n_images(self) -> int:
        """Number of images."""
        return len(self.block.images)

    @property
    def has_control(self) -> bool:
        """True if any image shows a control point or a control feature."""
        return bool(self.on_features or np.isin(self.block.points.where(Role.CONTROL), self.observations.point).any())

    @cached_property
    def on_features(self) -> dict[str, tuple[str, Array]]:
        """Feature, and its chord (3,), by the id of each ground point on a line or spline."""
        return on_features(self.block.extra)

    @cached_property
    def parameters(self) -> tuple[ImageParameters, ...]:
        """Unknowns of each image."""
        return tuple(model.parameters for model in self.models)

    @cached_property
    def first(self) -> npt.NDArray[np.intp]:
        """First unknown of each image among the unknowns of all images; the last entry is their number (M + 1,)."""
        return np.concatenate([[0], np.cumsum([len(p) for p in self.parameters])]).astype(np.intp)

    @cached_property
    def ties(self) -> Ties | None:
        """Unknowns shared by images, or None."""
        return ties_of(self.parameters, [image.id for image in self.block.images])

    @property
    def n_image_unknowns(self) -> int:
        """Number of unknowns of all images; a shared unknown counts in each image."""
        return int(self.first[-1])

    @property
    def n_free_unknowns(self) -> int:
        """Number of unknowns of all images; a shared unknown counts once."""
        return self.n_image_unknowns if self.ties is None else len(self.ties)

    def unknowns(self, state: State, k: int) -> Array:
        """Return the unknowns of an image (as many as it has), prior sigmas."""
        return np.ascontiguousarray(state.image[k, : len(self.parameters[k])])

    def image_columns(self, state: State) -> Array:
        """Return the unknowns of all images, one after the other, in the order of ``first``."""
        return np.asarray(state.image[self._exists])

    def image_vector(self, state: State) -> Array:
        """Return the unknowns of all images, one after the other; shared unknowns once, as ``ties`` numbers them."""
        return self.free(self.image_columns(state))

    def free(self, wide: Array) -> Array:
        """Return the rows of all image unknowns; rows of shared unknowns occur once, as ``ties`` numbers them."""
        return wide if self.ties is None else np.asarray(wide[self.ties.place])

    def image_matrix(self, vector: Array) -> Array:
        """Convert a vector as from :meth:`image_vector` to the matrix ``State.image``."""
        out = np.zeros(self._exists.shape)
        out[self._exists] = vector if self.ties is None else vector[self.ties.of]
        return out

    def prior_squares(self, state: State) -> float:
        """Return the sum of squares of the image unknowns; a shared unknown counts once."""
        unknowns = state.image if self.ties is None else self.image_vector(state)
        return float(np.vdot(unknowns, unknowns))

    @cached_property
    def _exists(self) -> npt.NDArray[np.bool_]:
        """Elements (M, k) of ``State.image`` that are unknowns."""
        size = np.diff(self.first)
        return np.asarray(np.arange(size.max()) < size[:, None])

    @cached_property
    def columns(self) -> npt.NDArray[np.intp]:
        """Column (M, k) of each element of ``State.image``; ``n_image_unknowns`` for unused elements."""
        wide = self.first[:-1, None] + np.arange(self._exists.shape[1])
        return np.where(self._exists, wide, self.n_image_unknowns)

    @property
    def n_columns(self) -> int:
        """Columns of the Jacobian of all observations: unknowns of all images, three per unknown ground point."""
        return self.n_image_unknowns + 3 * int(self.active.sum())

    @cached_property
    def point_columns(self) -> npt.NDArray[np.intp]:
        """First column (N,) of each unknown ground point; other elements have no meaning."""
        return np.asarray(self.n_image_unknowns + 3 * (np.cumsum(self.active) - 1), np.intp)

    def image_slice(self, k: int) -> slice:
        """Return the columns of an image."""
        return slice(int(self.first[k]), int(self.first[k + 1]))

    def point_slice(self, j: int) -> slice:
        """Return the columns of an unknown ground point."""
        return slice(int(self.point_columns[j]), int(self.point_columns[j]) + 3)

    def vector(self, state: State) -> Array:
        """Return the unknowns of a state as one vector (n_columns,)."""
        return np.concatenate([self.image_columns(state), state.ground[self.active].ravel()])

    def moved(self, state: State, step: Array) -> State:
        """Return the state after a step (n_columns,)."""
        image, ground = state.image.copy(), state.ground.copy()
        image[self._exists] += step[: self.n_image_unknowns]
        ground[self.active] += step[self.n_image_unknowns :].reshape(-1, 3)
        return State(image, ground)

    def control_weights(self, points: Points) -> Array:
        """Return square roots W (3, 3), or (m, 3, 3), of weights of control points: W^T W inverts their covariance."""
        records = self.control_records[points]
        return np.asarray(records[..., POINT.whitening].reshape(*records.shape[:-1], 3, 3))

    def control_residuals(self, state: State, points: Points) -> Array:
        """Return the whitened residuals of control points (3,), or (m, 3): adjusted minus measured."""
        difference = state.ground[points] - self.control_records[points, POINT.place]
        return np.asarray(np.einsum("...ij,...j->...i", self.control_weights(points), difference))

    def point_normals(self, points: npt.NDArray[np.intp], d_ground: Array) -> Array:
        """Return the normal matrices (N, 3, 3) of the ground points with images held fixed.

        ``points`` (n,) are the ground points of image points, ``d_ground`` (n, 2, 3) their whitened Jacobians.
        """
        normal = np.zeros((len(self.active), 3, 3))
        np.add.at(normal, points, np.einsum("nri,nrj->nij", d_ground, d_ground))
        w = self.control_weights(self.observed)
        normal[self.observed] += np.einsum("nri,nrj->nij", w, w)
        return normal

    @property
    def least_damping(self) -> float:
        """Minimum damping of the normal equations: positive if the datum is not fixed."""
        options = self.block.options
        return FREE_DAMPING if options.datum == "free" and not options.priors else 0.0

    def point_damping(self, damping: float) -> float:
        """Return the relative increase of the diagonal of the normal equations of each ground point by a damping.

        A relative increase (Marquardt 1963) does not depend on the unit of length. Distant points, which their rays
        hardly determine, can still move along the rays.
        """
        least = self.least_damping
        return max(damping - least, FREE_POINT_DAMPING) if least > 0.0 else damping

    @property
    def n_unknowns(self) -> int:
        """Number of image unknowns, plus three per unknown ground point."""
        return self.n_free_unknowns + 3 * int(self.active.sum())

    @property
    def n_observations(self) -> int:
        """Number of equations: two per image point, three per observed control point, one per prior, and extra ones."""
        priors = self.n_free_unknowns if self.block.options.priors else 0
        extra = sum(e.n_residuals for e in self.block.extra)
        return 2 * len(self.observations) + 3 * int(self.observed.sum()) + priors + extra

    @property
    def redundancy(self) -> float:
        """Observations minus unknowns; with a penalty, observations minus the trace of their hat matrix."""
        whole, penalty = self.n_observations - self.n_unknowns, 0.0
        if self.regularisation is not None:
            penalty = self.regularisation.redundancy
        return whole - penalty if penalty else whole

    def axes(self, ground_m: Array) -> Array:
        """Return rotations (N, 3, 3) to East, North, Up at ECEF coordinates (N, 3); identities in a local system."""
        return _axes(self.block, ground_m)

    @property
    def axis_names(self) -> tuple[str, str, str]:
        """Names of these axes."""
        local = not self.block.georeferenced and self.block.body is None
        return ("X", "Y", "Z") if local else ("East", "North", "Up")

    def label(self, row: int) -> str:
        """Return the name of an image point for messages."""
        block, o = self.block, self.observations
        return f"image {block.images[o.image[row]].id}, point {block.points.ids[o.point[row]]}"

    def named_points(self) -> list[int]:
        """Return the numbers of the unknown ground points that extra observations name, ascending."""
        arguments = (a for extra in self.block.extra for a in self.extra_arguments(extra))
        return sorted({a.index for a in arguments if not a.is_image and a.constant is None})

    def extra_arguments(self, extra: ExtraObservation) -> list[ExtraArgument]:
        """Return the arguments of an extra observation; points that are not unknowns are constants.

        InputError: a name does not exist, is of the wrong kind or has no image point; there are no unknowns.
        """
        arguments: list[ExtraArgument] = []
        for name, argument in zip(extra.unknowns, extra.equation.arguments, strict=True):
            if argument.is_point != name.startswith("point:"):
                raise InputError.of("adjust.extra_kind", place=extra.label, value=name, argument=argument.name)
            place = self.block.find(name)
            if place is None:
                raise InputError.of("adjust.extra_unknown", place=extra.label, value=name)
            kind, j = place
            if kind == "image":
                arguments.append(ExtraArgument(True, j, len(self.parameters[j])))
                continue
            constant = np.ascontiguousarray(self.start.ground[j])
            if np.isnan(constant).any() and self.block.points.known.fixed[j]:
                constant = self.block.points.known.ecef_m[j] - self.origin_m
            if np.isnan(constant).any():
                raise InputError.of("adjust.extra_unused", place=extra.label, value=name)
            arguments.append(ExtraArgument(False, j, 3, None if self.active[j] else constant))
        if all(argument.constant is not None for argument in arguments):
            raise InputError.of("adjust.extra_constant", place=extra.label, value=", ".join(extra.unknowns))
        return arguments

    def extra_setup(self, extra: ExtraObservation) -> Array:
        """Return the setup of an extra observation: the given one, or the setup of its first image."""
        if extra.setup is not None:
            return extra.setup
        return self.parameters[next(a.index for a in self.extra_arguments(extra) if a.is_image)].setup

    def corrections(self, state: State) -> list[Any]:
        """Return the corrections of all images: ``Correction``, or RPC compensation (6,) px."""
        return [model.correction(self.unknowns(state, k)) for k, model in enumerate(self.models)]

    def pixel_residuals(self, state: State, whitened: Array | None = None) -> Array:
        """Return residuals adjusted - observed (n, 2): line, sample, px; from ``whitened`` residuals if given."""
        o, v = self.observations, residuals(self, state) if whitened is None else whitened
        return v * np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)


def compile_problem(block: Block, like: Problem | None = None) -> Problem:
    """Compile the adjustment problem of a block.

    Parameters
    ----------
    block : Block
    like : Problem, optional
        Problem of a similar block, from which equal constants are copied (``rows.unchanged_rows``).

    Raises
    ------
    InputError
        There is no control point (unless priors or an image without unknowns fix the datum, or it is free) or no
        unknown; a sensor has no image model; coordinate systems differ; points cannot be intersected.
    """
    options = block.options
    control_rows = block.points.where(Role.CONTROL)
    seen = np.flatnonzero(np.bincount(block.observations.point, minlength=len(block.points.ids)))
    if options.datum in ("priors", "vendor") and not options.priors:
        raise InputError.of("adjust.relative_priors", file=block.name, place="priors", value="false")
    if like is not None:
        same_block = like.block.images is block.images and like.block.options == options
        like = like if same_block and like.block.points.ids == block.points.ids else None
    models = image_models(block.images, options) if like is None else like.models
    held = any(not model.parameters.own.any() for model in models)
    if not np.isin(control_rows, seen).any() and options.datum in ("auto", "control") and not held and not block.extra:
        raise InputError.of("block.no_control", file=block.name, place="points", value=f"{len(control_rows)} measured")
    if not any(len(model.parameters) for model in models):
        raise InputError.of("frame.nothing_unknown", file=block.images[0].sensor.file, place="sigma")
    keep = participates(block)
    observations = block.observations if keep.all() else block.observations.take(keep)
    if not len(observations):
        raise InputError.of("block.no_rays", file=block.name, place="image points", value=0)
    if not block.georeferenced and any(image.sensor.georeferenced for image in block.images):
        raise InputError.of("frame.mixed", file=block.name, place="images")
    origin = initial.local_origin(block.images)
    known = block.points.known
    start_ecef = known.ecef_m.copy()
    same = np.full(len(observations), -1) if like is None else unchanged_rows(like, block, observations)
    if like is not None:
        old = observations.point[(same >= 0) & initial.missing_rows(start_ecef)[observations.point]]
        start_ecef[old] = like.start.ground[old] + origin
    part = np.isin(np.arange(len(start_ecef)), observations.point)
    wanted = part & initial.missing_rows(start_ecef)
    fill = np.where((part & ~wanted)[:, None], start_ecef, 0.0)
    fill[wanted] = np.nan
    start_ecef[part] = initial.ground_points(block.images, observations, block.points.ids, fill)[part]
    is_control = np.isin(np.arange(len(part)), control_rows)
    active = part & ~(is_control & known.fixed)
    observed = active & is_control & ~observed_by_angles(block)
    records = np.empty((0, 0)) if like is None else _records(models, observations, start_ecef, origin, same, like)
    image = np.zeros((len(models), max(len(model.parameters) for model in models)))
    start = State(image, np.where(part[:, None], start_ecef - origin, np.nan))
    out = Problem(
        block, models, observations, records, origin, start, active, observed,
        _control_records(block, start_ecef, origin, observed),
    )  # fmt: skip
    if like is None:  # the largest array: all its rows are computed at the first use, or only the rows that are used
        computed_by(out, "records", partial(_new_records, models, observations, start_ecef, origin))
        release(out, "records")
    return out


def _new_records(
    models: Sequence[ImageModel], observations: ImagePoints, ground_m: Array, origin_m: Array,
    rows: npt.NDArray[np.intp] | slice | None,
) -> Array:  # fmt: skip
    """Return the whitened records of some image points, or of all."""
    return whitened_records(models, observations if rows is None else observations.take(rows), ground_m, origin_m)


def _records(
    models: Sequence[ImageModel], observations: ImagePoints, ground_m: Array, origin_m: Array,
    same: npt.NDArray[np.intp], like: Problem,
) -> Array:  # fmt: skip
    """Return the whitened records, with the rows ``same`` (n,) of another problem copied."""
    old, new = np.flatnonzero(same >= 0), np.flatnonzero(same < 0)
    made = like.records[:0]
    if len(new):
        made = whitened_records(models, observations.take(new), ground_m, origin_m)
    out = np.zeros((len(same), max(made.shape[1], like.records.shape[1])))
    out[old, : like.records.shape[1]], out[new, : made.shape[1]] = like.records[same[old]], made
    return out


def no_point_is_named(block: Block) -> bool:
    """Return whether no extra observation names a ground point: all points can then be eliminated."""
    return all(name.startswith("image:") for extra in block.extra for name in extra.unknowns)


def participates(block: Block) -> npt.NDArray[np.bool_]:
    """Return a mask (n,) of the image points of the adjustment: all, or all except image points of check points."""
    if block.options.check_points == "use":
        return np.ones(len(block.observations), bool)
    return ~np.isin(block.observations.point, block.points.where(Role.CHECK))


def _control_records(block: Block, ecef_m: Array, origin_m: Array, observed: npt.NDArray[np.bool_]) -> Array:
    """Return the records (N, 12) of the control-point equations: W for ECEF axes from E/N/U sigmas."""
    out, rows = np.full((len(ecef_m), POINT.size), np.nan), np.flatnonzero(observed)
    # W^T W = C^-1 by QR of the scaled axes; without a covariance matrix any ratio of sigmas is exact
    w = np.linalg.qr(_axes(block, ecef_m[rows]) / block.points.known.sigma_enu_m[rows][:, :, None]).R
    w *= np.where(np.einsum("nii->ni", w) < 0.0, -1.0, 1.0)[:, :, None]
    out[rows] = POINT.pack(whitening=w.reshape(-1, 9), place=ecef_m[rows] - origin_m)
    return out


def _axes(block: Block, ground_m: Array) -> Array:
    """See :meth:`Problem.axes`."""
    body = block.body
    if body is not None:
        return body.axes(ground_m)
    if not block.georeferenced:
        return np.tile(np.eye(3), (len(ground_m), 1, 1))
    lon, lat, _ = np.degrees(ellipsoid.geodetic_array(np.ascontiguousarray(ground_m))).T
    return geodesy.enu_from_ecef(lon, lat)
