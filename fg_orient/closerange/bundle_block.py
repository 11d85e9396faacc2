"""Convert photos, points, observations and constraints of a bundle to a block of the common adjustment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from factors.cameras.frame_camera import rotated
from factors.conditions.constraints import ELEMENT, OBSERVED_ELEMENT
from fg_orient.adjustment.constraint_rows import (
    FittedFigure,
    constraint_observation,
    fitted_figures,
)
from fg_orient.adjustment.constraints import missed_most, prepared
from fg_orient.adjustment.native import with_observations
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.closerange.fitting import as_points, as_sigmas
from fg_orient.closerange.photo import CAMERA, NAMES, PhotoInterior, camera_of
from fg_orient.model.arrays import array
from fg_orient.model.arrays import names as require_names
from fg_orient.model.block import (
    Block,
    Coordinates,
    ExtraObservation,
    GroundPoints,
    Image,
    ImagePoints,
    Options,
    WithheldCoordinates,
)
from fg_orient.model.constraint import MEASURED, OF_PHOTOS, SIZES, Constraint, foreign_members
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.names import Role
from fg_orient.quality.deficiency import compiled_problem
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import FURTHER
from fg_orient.sensors.frame_unknowns import NAMES as CODES

if TYPE_CHECKING:
    from fg_orient.closerange.bundle import BundlePhoto

Control = Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]]

TURNS: Final = ("turn_x", "turn_y", "turn_z")
CENTRE: Final = ("X0", "Y0", "Z0")
POINT: Final = ("X", "Y", "Z")
_TURN: Final = ("rotation_x", "rotation_y", "rotation_z")
_CENTRE: Final = ("centre_x", "centre_y", "centre_z")
#: Parameters that have another name for frame images, by their names in close range.
FRAME: Final = {
    "c": "focal", "x0": "principal_sample", "y0": "principal_line", "p1": "p2", "p2": "p1",
    **dict(zip(TURNS, _TURN, strict=True)), **dict(zip(CENTRE, _CENTRE, strict=True)),
}  # fmt: skip
OURS: Final = {frame: name for name, frame in FRAME.items()}


@dataclass(frozen=True, eq=False)
class Built:
    """Compiled block of a bundle, with the names of its unknowns.

    Parameters
    ----------
    photos : tuple of BundlePhoto
    ids : tuple of str
    start_m : (n, 3) array
    block : Block
    observed : frozenset of (str, str)
        Unknowns that are observed directly: photo, or camera with shared unknowns, and name.
    exact : tuple of Constraint
        Figures with exactly the number of points that determines them. They do not change the adjustment.
    """

    photos: tuple[BundlePhoto, ...]
    ids: tuple[str, ...]
    start_m: Array
    block: Block
    observed: frozenset[tuple[str, str]] = field(default=frozenset())
    exact: tuple[Constraint, ...] = ()

    @cached_property
    def problem(self) -> Problem:
        """Compiled block; its rows decide whether the datum is determined."""
        loose = replace(self.block, options=replace(self.block.options, datum="free"))
        return compiled_problem(with_observations(loose))

    @cached_property
    def owners(self) -> list[tuple[str, str]]:
        """Photo or camera, and name, of each unknown of the photos (z,).

        A shared unknown occurs once.
        """
        out = dict[int, tuple[str, str]]()
        for k, (photo, own) in enumerate(zip(self.photos, self.problem.parameters, strict=True)):
            shared = own.shared or ("",) * len(own)
            for j, (name, common) in enumerate(zip(own.names, shared, strict=True)):
                owner = f"camera {photo.key}" if common else f"photo {photo.name}"
                out.setdefault(self.place(k, j), (owner, OURS.get(name, name)))
        return [out[j] for j in range(len(out))]

    @cached_property
    def labels(self) -> list[str]:
        """Names of all unknowns (u,)."""
        points = [f"point {self.ids[j]} {axis}" for j in np.flatnonzero(self.problem.active) for axis in POINT]
        return [*(f"{owner} {name}" for owner, name in self.owners), *points]

    def place(self, k: int, j: int) -> int:
        """Return the number of unknown j of a photo among the unknowns of all photos."""
        column = int(self.problem.first[k]) + j
        return column if self.problem.ties is None else int(self.problem.ties.of[column])

    @property
    def is_observed(self) -> Mask:
        """True for each unknown (u,) that is observed directly."""
        points = self.problem.observed[self.problem.active]
        return np.array([*(owner in self.observed for owner in self.owners), *np.repeat(points, 3)], bool)

    @cached_property
    def steps(self) -> Array:
        """Units of the unknowns (u,)."""
        out = np.ones(len(self.labels))
        for k, own in enumerate(self.problem.parameters):
            out[[self.place(k, j) for j in range(len(own))]] = own.sigma
        return out

    def units(self, state: State) -> Array:
        """Return the accuracy (u,) of each unknown as determined by one image observation."""
        rows, o, active = linearised(self.problem, state), self.problem.observations, self.problem.active
        z = len(self.owners)
        squares, count = np.zeros(z), np.zeros(z)
        for k, own in enumerate(self.problem.parameters):
            seen = rows.image[o.image == k][:, :, : len(own)].reshape(-1, len(own))
            at = [self.place(k, j) for j in range(len(own))]
            np.add.at(squares, at, np.sum(seen**2, axis=0))
            np.add.at(count, at, np.count_nonzero(seen, axis=0))
        ground, rays = np.zeros((len(active), 3)), np.zeros((len(active), 3))
        np.add.at(ground, o.point, np.sum(rows.ground**2, axis=1))
        np.add.at(rays, o.point, np.count_nonzero(rows.ground, axis=1))
        squares = np.concatenate([squares, ground[active].ravel()])
        count = np.concatenate([count, rays[active].ravel()])
        out = np.zeros(len(squares))
        out[squares > 0.0] = np.sqrt(np.maximum(count, 1.0)[squares > 0.0] / squares[squares > 0.0])
        places = out[z:][out[z:] > 0.0]
        return np.where(out > 0.0, out, np.median(places) if len(places) else 1.0)

    def rotation(self, k: int, state: State) -> Array:
        """Return the rotation (3, 3) of a photo at a state."""
        return rotated(self.photos[k].rotation, self.turn(k, state))

    def turn(self, k: int, state: State) -> Array:
        """Return the rotation vector (3,) of a photo at a state, rad."""
        return self._part(k, _TURN, state)

    def centre(self, k: int, state: State) -> Array:
        """Return the projection centre (3,) of a photo at a state."""
        return np.asarray(self.photos[k].centre_m + self._part(k, _CENTRE, state))

    def _part(self, k: int, names: tuple[str, ...], state: State) -> Array:
        """Return the values of unknowns of a photo, by name; 0 for unknowns that it does not have."""
        own, x = self.problem.parameters[k], self.problem.unknowns(state, k)
        known = dict(zip(own.names, x * own.sigma, strict=True))
        return np.array([known.get(name, 0.0) for name in names])

    def interior(self, k: int, state: State) -> PhotoInterior:
        """Return the interior orientation of a photo at a state."""
        photo, own = self.photos[k], self.problem.parameters[k]
        camera = self.values(k)
        for name, change in zip(own.names, self._part(k, own.names, state), strict=True):
            if OURS.get(name, name) in camera:
                camera[OURS.get(name, name)] += float(change)
        known = np.array([camera[name] for name in NAMES])
        return PhotoInterior(camera["c"], known[CAMERA.principal], known[CAMERA.lens], photo.interior.y_axis)

    def values(self, k: int) -> dict[str, float]:
        """Return the start values of the camera parameters of a photo by name."""
        sensor = self.block.images[k].sensor
        assert isinstance(sensor, FrameSensor)
        camera = sensor.camera
        k1, k2, k3, p1, p2 = camera.distortion.tolist()
        line, sample = camera.principal_px.tolist()
        known = {"x0": sample, "y0": line, "k1": k1, "k2": k2, "k3": k3, "p1": p2, "p2": p1}
        known["c"] = float(camera.focal_px)
        return known | {name: float(camera.further.get(name, 0.0)) for name in NAMES if name not in known}

    def parameter(self, k: int, name: str, state: State) -> float:
        """Return the value of a camera parameter of a photo."""
        frame = FRAME.get(name, name)
        return float(self.values(k)[name] + self._part(k, (frame,), state)[0])

    def figures(self, problem: Problem, state: State) -> list[FittedFigure]:
        """Return the figures of the constraints at a solution."""
        exact = tuple(constraint_observation(c, is_exact=True) for c in self.exact)
        own = prepared(replace(problem, start=state, block=replace(problem.block, extra=exact)))
        return fitted_figures(problem, state) + (fitted_figures(own, state) if exact else [])

    def missed(self) -> str:
        """Describe the hard constraint that the start misses most; "" without one."""
        problem = self.problem
        away = problem.block.points.known.ecef_m - problem.origin_m
        ground = np.where(np.isnan(problem.start.ground), np.nan, away)
        name, value = missed_most(problem, State(0.0 * problem.start.image, ground))
        return f" (the start misses the hard constraint {name} by {value:.3g})" if name else ""

    def require_in_front(self, state: State) -> None:
        """Raise NoSolutionError for a point behind a photo."""
        o = self.problem.observations
        ground = state.ground + self.problem.origin_m
        for k in range(len(self.photos)):
            of = o.point[o.image == k]
            behind = (ground[of] - self.centre(k, state)) @ self.rotation(k, state)[2] <= 0.0
            if behind.any():
                where = f"point {self.ids[of[int(np.argmax(behind))]]} in photo {self.photos[k].name}"
                raise NoSolutionError.of("closerange.behind", place=where)


def build(
    photos: Sequence[BundlePhoto],
    ids: tuple[str, ...],
    start: Array,
    which: Index,
    of: Index,
    image: Array,
    sigma: Array,
    control: Control,
    constraints: Sequence[Constraint],
    is_condition: bool,
    options: Options,
) -> Built:
    """Return the block of a bundle; see :func:`fg_orient.closerange.bundle.adjust_bundle`."""
    require_names([p.name for p in photos], "photos")
    _require_members(photos, ids, constraints, control)
    exact = tuple(c for c in constraints if c.kind in SIZES and not c.surplus)
    constraints = [c for c in constraints if c not in exact]
    points = _points(ids, start, control)
    for k, j in zip(which.tolist(), of.tolist(), strict=True):
        photo = photos[k]
        if photo.held and not (photo.unknown or photo.shared) and points.known.fixed[j]:
            raise photo.fault(f"point {ids[j]}", "photo and point held", "a point or a photo that is unknown")
    images, extras, observed = _images(photos, which, image, is_condition)
    seen = ImagePoints(which, of, image[:, 1], image[:, 0], sigma[:, 1], sigma[:, 0])
    block = Block("bundle", images, points, seen, WithheldCoordinates(), options, extra=(*extras, *constraints))  # type: ignore[arg-type]
    return Built(tuple(photos), ids, points.known.ecef_m, block, frozenset(observed), exact)


def _require_members(
    photos: Sequence[BundlePhoto], ids: Sequence[str], constraints: Sequence[Constraint], control: Control
) -> None:
    """Refuse unknown members, constraints between fixed members, and contradictory hard lengths of the same members.

    The adjustment refuses equal hard lengths, because they are dependent. Lengths with a
    sigma are observations.
    """
    first, by_name = dict[tuple[str, frozenset[str]], Constraint](), {p.name: p for p in photos}
    foreign = foreign_members(constraints, ids, tuple(by_name))
    if foreign:
        raise InputError(*foreign)
    for c in constraints:
        if c.kind in OF_PHOTOS:
            held = all(by_name[name].held for name in c.members)
        else:
            held = all(name in control and not np.any(control[name][1]) for name in c.members)
        if held and c.kind not in SIZES:
            raise c.fault("members", "all held", "a point or a photo that is unknown")
        if c.kind in MEASURED and c.sigma is None:
            other = first.setdefault((c.kind, frozenset(c.members)), c)
            if other.value_m != c.value_m:
                names = "; ".join(f"{one.label}: {one.value_m:.10g} m" for one in (other, c))
                raise InputError.of("closerange.contradiction", place="constraints", names=names)


def _points(ids: tuple[str, ...], start: Array, control: Control) -> GroundPoints:
    """Return the points with start or control coordinates; sigma 0: fixed."""
    unknown = [name for name in control if name not in ids]
    if unknown:
        raise InputError.of("closerange.member", place="control", value=unknown[0], known=", ".join(ids[:10]))
    at, spread = start.copy(), np.full(start.shape, np.nan)
    fixed, roles = np.zeros(len(ids), bool), [Role.TIE] * len(ids)
    for j, name in enumerate(ids):
        if name in control:
            place = as_points(control[name][0], 3, f"control {name}")[0]
            given = array(control[name][1], f"control {name}")
            sigma = as_sigmas(given, place, f"control {name}") if given.any() else np.zeros(3)
            at[j], fixed[j], roles[j] = place, not sigma.any(), Role.CONTROL
            if not fixed[j]:
                spread[j] = sigma
    return GroundPoints(ids, tuple(roles), Coordinates(at, spread, fixed))


def _images(
    photos: Sequence[BundlePhoto], which: Index, image: Array, is_condition: bool
) -> tuple[tuple[Image, ...], list[ExtraObservation], set[tuple[str, str]]]:
    """Return the images, observations of their unknowns, and owner and name of these unknowns."""
    reduced = [image[which == k] - p.interior.principal for k, p in enumerate(photos)]
    rims: dict[str, float] = {}
    for photo, xy in zip(photos, reduced, strict=True):
        rim = float(np.linalg.norm(xy, axis=1).max(initial=1e-9))
        rims[photo.key] = max(rim, rims.get(photo.key, 0.0))
    images, extras, observed = [], list[ExtraObservation](), set[tuple[str, str]]()
    cameras: dict[str, tuple[tuple[str, ...], dict[str, float], dict[str, float]]] = {}
    for photo, xy in zip(photos, reduced, strict=True):
        reach = float(np.abs(xy).max(initial=1e-9))
        values = dict(zip(NAMES, camera_of(photo.interior).tolist(), strict=True))
        common = {name: values[name] for name in photo.shared}, camera_steps(photo.shared, reach)
        names, start, steps = cameras.setdefault(photo.key, (photo.shared, *common)) if photo.shared else ((), {}, {})
        if photo.shared != names:
            raise photo.fault("shared", ", ".join(photo.shared), f"those of the camera: {', '.join(names)}")
        # all photos of a camera start with the values of its first photo
        values |= start
        sigma = steps | camera_steps(photo.unknown, reach) | ({} if photo.held else dict.fromkeys(_POSE, 1.0))
        camera = FrameCamera(
            photo.rotation, photo.centre_m, values["c"], np.array([values["y0"], values["x0"]]),
            np.array([values[name] for name in ("k1", "k2", "k3", "p2", "p1")]),
            {FRAME.get(name, name): step for name, step in sigma.items()}, MEASURED_TO_IDEAL, 1.0,
            shared={FRAME.get(name, name): photo.key for name in photo.shared},
            further={name: values[name] for name in FURTHER if name in values}, lines_up=photo.interior.y_axis == "up",
            nominal_px=photo.interior.focal, radius_px=rims[photo.key], is_condition=is_condition,
        )  # fmt: skip
        images.append(Image(photo.name, FrameSensor(camera, 1, 1, georeferenced=False, file=photo.name)))
        codes = [OURS.get(name, name) for name in CODES if name in camera.sigma]
        given = [
            (name, value - values[name], spread, f"observed {name}") for name, (value, spread) in photo.observed.items()
        ]
        if photo.sigma_centre_m is not None and not photo.held:
            seen = photo.centre_m if photo.observed_centre_m is None else photo.observed_centre_m
            away = zip(CENTRE, seen - photo.centre_m, photo.sigma_centre_m, "XYZ", strict=True)
            given += [(name, float(a), float(s), f"observed centre, {axis}") for name, a, s, axis in away]
        if photo.sigma_turn_rad is not None and not photo.held:
            given += [
                (name, 0.0, float(s), "observed attitude") for name, s in zip(TURNS, photo.sigma_turn_rad, strict=True)
            ]
        for name, away_from_start, spread, words in given:
            owner = f"camera {photo.key}" if name in photo.shared else f"photo {photo.name}"
            if (owner, name) in observed:  # a shared unknown is observed once for each camera
                continue
            observed.add((owner, name))
            step = sigma[name if name in sigma else FRAME[name]]
            record = ELEMENT.pack(factor=step / spread, value=away_from_start / step, number=codes.index(name))
            extras.append(
                ExtraObservation(
                    OBSERVED_ELEMENT, (f"image:{photo.name}",), record, np.zeros((2, 0)), 1, f"{owner}: {words}"
                )
            )
    return tuple(images), extras, observed


_POSE: Final = (*_TURN, *_CENTRE)


def camera_steps(names: Sequence[str], reach: float) -> dict[str, float]:
    """Return the units of camera parameters: they move a point at the image edge by about 1/1000 of its distance."""
    power = {"c": 0, "x0": 0, "y0": 0, "k1": 3, "k2": 5, "k3": 7, "p1": 2, "p2": 2, "affinity_a": 1, "affinity_b": 1}
    brown = (1, 1, 2, 2, 3, 3, 4, 2, 2, 3, 3, 4, 2, 4, 4, 3, 5, 7, 0, 0, 0)
    power |= {f"a{j + 1}": p for j, p in enumerate(brown)}
    power |= {f"radial_{j}": j for j in (1, 2, 4, 6, 9)} | {f"orthogonal_{i}": 0 for i in (1, 2, 3)}
    power |= {"film_xx": 1, "film_yx": 1}
    return {name: 1e-3 * reach ** (1 - power[name]) for name in names}
