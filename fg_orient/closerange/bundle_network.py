"""Photos, points and constraints of a bundle as variables and observations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from factors.cameras.extended_collinearity import CAMERA, EXTENDED_COLLINEARITY, NAMES, image_record, image_setup
from factors.cameras.frame_camera import rotated
from factors.conditions.control import CONTROL_POINT
from factors.conditions.control import POINT as PLACE
from fg_orient.adjustment.constraint_kinds import FIGURES, OF_PHOTOS, Constraint
from fg_orient.adjustment.network import Network, NetworkRows, Observation, Variable
from fg_orient.closerange.constraints import (
    figure_of,
    figure_parts,
    observed_element,
    plain_observation,
    require_one_value,
)
from fg_orient.closerange.photo import PhotoInterior
from fg_orient.model.errors import InputError, NoSolutionError

if TYPE_CHECKING:
    from fg_orient.closerange.bundle import BundlePhoto

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Control = Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]]

TURNS: Final = ("turn_x", "turn_y", "turn_z")
CENTRE: Final = ("X0", "Y0", "Z0")
POINT: Final = ("X", "Y", "Z")
_NONE: Final = np.zeros((2, 0))


@dataclass
class Built:
    """Network of a bundle, and the positions of its unknowns. Coordinates are relative to ``origin``."""

    photos: tuple[BundlePhoto, ...]
    ids: tuple[str, ...]
    start: Array
    origin: Array
    extent: float
    variables: list[Variable] = field(default_factory=list)
    observations: list[Observation] = field(default_factory=list)
    steps_of: list[Array] = field(default_factory=list)
    offset_of: list[Array] = field(default_factory=list)
    own: list[int | Array] = field(default_factory=list)
    shared: list[int | Array] = field(default_factory=list)
    turns: list[int | Array] = field(default_factory=list)
    centres: list[int | Array] = field(default_factory=list)
    points: list[int | Array] = field(default_factory=list)
    rims: dict[str, float] = field(default_factory=dict)
    camera_variables: dict[str, int] = field(default_factory=dict)
    figure_variables: list[int] = field(default_factory=list)

    def add(self, variable: Variable, offset: Array, steps: Array | None = None) -> int:
        """Add a variable and return its number.

        Parameters
        ----------
        variable : Variable
        offset : (k,) array
            Values for users are ``offset + steps * unknowns``.
        steps : (k,) array, optional
            By default 1.
        """
        self.variables.append(variable)
        self.steps_of.append(np.ones(len(offset)) if steps is None else steps)
        self.offset_of.append(offset)
        return len(self.variables) - 1

    @property
    def point_variables(self) -> dict[int, int]:
        """Variables of the unknown points, by the number of the point."""
        return {j: k for j, k in enumerate(self.points) if not isinstance(k, np.ndarray)}

    def at(self, unknown: int | Array, state: Array) -> Array:
        """Constant, or a variable's part of a state."""
        return unknown if isinstance(unknown, np.ndarray) else state[self.network.part(unknown)]

    @cached_property
    def network(self) -> Network:
        """Network, at first use, when it is complete."""
        return Network(tuple(self.variables), tuple(self.observations))

    def elements(self, variables: Iterable[int]) -> Index:
        """Positions (k,) of the elements of some variables in a state."""
        parts = [range(*self.network.first[k : k + 2]) for k in variables]
        return np.array([element for part in parts for element in part], np.intp)

    @property
    def steps(self) -> Array:
        """Units of the unknowns (u,)."""
        return np.concatenate(self.steps_of)

    def values(self, state: Array) -> Array:
        """Values (u,) in the user's units and coordinates."""
        return np.asarray(np.concatenate(self.offset_of) + self.steps * state)

    @property
    def photo_variables(self) -> list[list[int]]:
        """Variables of each photo: own parameters, turns, centre."""
        parts = zip(self.own, self.turns, self.centres, strict=True)
        return [[k for k in part if not isinstance(k, np.ndarray)] for part in parts]

    @property
    def observed(self) -> Array:
        """Whether an unknown is observed directly (u,)."""
        out = np.zeros(self.network.n_unknowns, bool)
        for o in self.observations:
            if o.equation is not EXTENDED_COLLINEARITY and not o.hard and len(o.unknowns) == 1:
                _, design = self.network.evaluated(o, self.network.start, jacobian=True)
                out |= (design != 0.0).any(axis=0)
        return out

    def units(self, rows: NetworkRows) -> Array:
        """Accuracy (u,) of each unknown from one image observation; a figure has the accuracy of its points."""
        seen = rows.design[: 2 * self.n_images]
        count = np.maximum(np.count_nonzero(seen, axis=0), 1)
        length = np.linalg.norm(seen, axis=0) / np.sqrt(count)
        out = np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 0.0)
        ground = np.concatenate([out[self.network.part(k)] for k in self.point_variables.values()] or [np.ones(1)])
        typical = float(np.median(ground[ground > 0.0])) if (ground > 0.0).any() else 1.0
        for k in self.figure_variables:
            slopes = [name.startswith(("tilt", "slope")) for name in self.variables[k].labels]
            out[self.network.part(k)] = np.where(slopes, typical / self.extent, typical)
        return np.where(out > 0.0, out, typical)

    @property
    def n_images(self) -> int:
        """Number of image observations, which are the first ones."""
        return sum(o.equation is EXTENDED_COLLINEARITY for o in self.observations)

    def rotation(self, k: int, state: Array) -> Array:
        """Rotation (3, 3) of a photo at a state."""
        return rotated(self.photos[k].rotation, self.at(self.turns[k], state))

    def place(self, unknown: int | Array, state: Array) -> Array:
        """Centre or point (3,) at a state, in the user's coordinates."""
        return np.asarray(self.at(unknown, state) + self.origin)

    def oriented(self, state: Array) -> tuple[list[PhotoInterior], list[Array], list[Array]]:
        """Interiors, rotations, centres of the photos at a state."""
        values, interiors = self.values(state), []
        for photo, own, shared in zip(self.photos, self.own, self.shared, strict=True):
            camera = camera_of(photo.interior)
            for unknown, names in ((shared, photo.shared), (own, photo.unknown)):
                camera[[NAMES.index(n) for n in names]] = self.at(unknown, values)
            c, principal, corrections = float(camera[CAMERA.c]), camera[CAMERA.principal], camera[CAMERA.lens]
            interiors.append(PhotoInterior(c, principal, corrections, photo.interior.y_axis))
        every = range(len(self.photos))
        return interiors, [self.rotation(k, state) for k in every], [self.place(c, state) for c in self.centres]

    def require_in_front(self, state: Array, which: Index, of: Index) -> None:
        """Raise NoSolutionError for a point behind a photo."""
        for k in np.unique(which):
            axis, centre = self.rotation(int(k), state)[2], self.place(self.centres[k], state)
            for j in of[which == k]:
                if axis @ (self.place(self.points[j], state) - centre) <= 0.0:
                    where = f"point {self.ids[j]} in photo {self.photos[k].name}"
                    raise NoSolutionError.of("closerange.behind", place=where)


def camera_of(interior: PhotoInterior) -> Array:
    """Camera parameters (40,) of an interior orientation."""
    out = np.zeros(CAMERA.size)
    out[CAMERA.c], out[CAMERA.principal], out[CAMERA.lens] = interior.focal, interior.principal, interior.corrections
    return out


def build(
    photos: Sequence[BundlePhoto], ids: tuple[str, ...], start: Array, which: Index, of: Index, image: Array,
    sigma: Array, control: Control, constraints: Sequence[Constraint], is_condition: bool,
    begin: tuple[Built, Array] | None = None,
) -> Built:  # fmt: skip
    """Network of a bundle; see :func:`fg_orient.closerange.bundle.adjust_bundle`.

    ``begin``: the same bundle with fewer constraints, and the start (u,) of its unknowns.
    """
    rows = (len(image),)
    fits = which.shape == rows and of.shape == rows and len(ids) == len(start) and len(photos) > 0
    if not fits or min(which.min(), of.min()) < 0 or which.max() >= len(photos) or of.max() >= len(ids):
        raise InputError.of("closerange.bundle", place="photo, point", value=f"shapes {which.shape}, {of.shape}",
                            expected="one photo and one point of those given for each image point")  # fmt: skip
    for place, names in (("photos", [p.name for p in photos]), ("ids", list(ids))):
        if len(set(names)) != len(names):
            raise InputError.of("closerange.bundle", place=place, value="a name twice", expected="different names")
    origin = start.mean(axis=0)
    extent = float(np.linalg.norm(start - origin, axis=1).max()) or 1.0
    built = Built(tuple(photos), ids, start.copy(), origin, extent)
    reduced = [image[which == k] - p.interior.principal for k, p in enumerate(photos)]
    reach = [float(np.abs(xy).max(initial=1e-9)) for xy in reduced]
    for photo, xy in zip(photos, reduced, strict=True):
        rim = float(np.linalg.norm(xy, axis=1).max(initial=1e-9))
        built.rims[photo.key] = max(rim, built.rims.get(photo.key, 0.0))
    extras: list[Observation] = []
    setups = [_add_photo(built, photo, size, extras) for photo, size in zip(photos, reach, strict=True)]
    _add_points(built, control, extras)
    for k, j, xy, s in zip(which.tolist(), of.tolist(), image, sigma, strict=True):
        built.observations.append(_image_point(built, k, j, xy, s, setups[k], is_condition))
    built.observations += extras
    if begin is not None:  # the variables of figures follow those of photos and points
        other, state = begin
        for k, variable in enumerate(built.variables):
            built.variables[k] = replace(variable, start=state[other.network.part(k)])
        for j, k in built.point_variables.items():
            built.start[j] = built.variables[k].start + built.origin
    require_one_value(constraints)
    for constraint in constraints:
        _add_constraint(built, constraint)
    return built


def camera_steps(names: Sequence[str], reach: float) -> Array:
    """Units of camera parameters, which move a point at the edge of the image by about 1/1000 of its distance."""
    power = {"c": 0, "x0": 0, "y0": 0, "k1": 3, "k2": 5, "k3": 7, "p1": 2, "p2": 2, "affinity_a": 1, "affinity_b": 1}
    brown = (1, 1, 2, 2, 3, 3, 4, 2, 2, 3, 3, 4, 2, 4, 4, 3, 5, 7, 0, 0, 0)
    power |= {f"a{j + 1}": p for j, p in enumerate(brown)}
    power |= {f"radial_{j}": j for j in (1, 2, 4, 6)} | {f"orthogonal_{i}": 0 for i in (1, 2, 3)}
    power |= {"film_xx": 1, "film_yx": 1}
    return np.array([1e-3 * reach ** (1 - power[name]) for name in names])


def _add_photo(built: Built, photo: BundlePhoto, reach: float, extras: list[Observation]) -> tuple[Array, Array]:
    """Add the variables of a photo; setup (2, k + 6) and camera (40,) of the equations of its image points."""
    start, key, name = camera_of(photo.interior), photo.key, f"photo {photo.name}"
    none: int | Array = np.zeros(0)
    own = _camera_variable(built, name, photo.unknown, reach, photo, extras) if photo.unknown else none
    if photo.shared and key not in built.camera_variables:
        built.camera_variables[key] = _camera_variable(built, f"camera {key}", photo.shared, reach, photo, extras)
    steps = camera_steps(photo.unknown, reach)
    if photo.shared:
        common = built.camera_variables[key]
        known = built.variables[common].labels
        if known != photo.shared:
            raise photo.fault("shared", ", ".join(photo.shared), f"those of the camera: {', '.join(known)}")
        steps = np.append(steps, built.steps_of[common])
        # all photos of a camera start from the values of its first photo
        start[[NAMES.index(n) for n in photo.shared]] = built.offset_of[common]
    built.own.append(own)
    built.shared.append(built.camera_variables[key] if photo.shared else none)
    codes = [NAMES.index(n) for n in (*photo.unknown, *photo.shared)]
    setup = image_setup(np.array(codes, np.intp), steps)
    centre = photo.centre_m - built.origin
    if photo.held:
        built.turns.append(np.zeros(3))
        built.centres.append(centre)
        return setup, start
    turn = built.add(Variable(name, np.zeros(3), TURNS), np.zeros(3))
    place = built.add(Variable(name, centre, CENTRE, True), built.origin)
    built.turns.append(turn)
    built.centres.append(place)
    if photo.sigma_centre_m is not None:
        seen = centre if photo.observed_centre_m is None else photo.observed_centre_m - built.origin
        extras.append(observed_place(place, seen, photo.sigma_centre_m, f"{name}: observed centre"))
    if photo.sigma_turn_rad is not None:
        extras += [observed_element(turn, j, 0.0, float(s), f"{name}: observed attitude")
                   for j, s in enumerate(photo.sigma_turn_rad)]  # fmt: skip
    return setup, start


def _camera_variable(
    built: Built, name: str, names: tuple[str, ...], reach: float, photo: BundlePhoto, extras: list[Observation]
) -> int:
    """Number of a variable of camera parameters; ``extras`` receives observations of some of them."""
    steps, offset = camera_steps(names, reach), camera_of(photo.interior)[[NAMES.index(n) for n in names]]
    k = built.add(Variable(name, np.zeros(len(names)), names), offset, steps)
    for j, n in enumerate(names):
        if n in photo.observed:
            value, sigma = photo.observed[n]
            extras.append(
                observed_element(k, j, (value - offset[j]) / steps[j], sigma / steps[j], f"{name}: observed {n}")
            )
    return k


def observed_place(k: int, at: Array, sigma: Array, label: str) -> Observation:
    """Observation of the point or centre of variable number ``k``."""
    record = PLACE.pack(whitening=np.diag(1.0 / sigma).ravel(), place=at)
    return Observation(CONTROL_POINT, (k,), record, _NONE, 3, label)


def _add_points(built: Built, control: Control, extras: list[Observation]) -> None:
    unknown = [name for name in control if name not in built.ids]
    if unknown:
        raise InputError.of("closerange.member", place="control", value=unknown[0], known=", ".join(built.ids[:10]))
    for j, name in enumerate(built.ids):
        sigma = None
        if name in control:
            at, sigma = (np.broadcast_to(np.asarray(v, float), (3,)) for v in control[name])
            if not (np.isfinite(at).all() and np.isfinite(sigma).all() and ((sigma > 0.0).all() or not sigma.any())):
                raise InputError.of("closerange.sigma", place=f"control {name}", value=sigma.tolist())
            if not sigma.any():
                built.start[j] = at
                built.points.append(at - built.origin)
                continue
        k = built.add(Variable(f"point {name}", built.start[j] - built.origin, POINT, True), built.origin)
        built.points.append(k)
        if sigma is not None:
            extras.append(observed_place(k, at - built.origin, sigma, f"point {name}: control"))


def _image_point(
    built: Built, k: int, j: int, image: Array, sigma: Array, equation: tuple[Array, Array], is_condition: bool
) -> Observation:
    """Observation of point ``j`` in photo ``k``; ``equation``: setup and camera of the photo."""
    photo, (setup, camera) = built.photos[k], equation
    record = image_record(
        camera, line=image[1], sample=image[0], a_line=1.0 / sigma[1], a_sample=1.0 / sigma[0], w12=0.0,
        power=is_condition, sign=photo.interior.sign, nominal=photo.interior.focal, rotation=np.ravel(photo.rotation),
        radius=built.rims[photo.key],
    )  # fmt: skip
    unknowns = (built.own[k], built.shared[k], built.turns[k], built.centres[k], built.points[j])
    if all(isinstance(u, np.ndarray) for u in unknowns):
        raise photo.fault(f"point {built.ids[j]}", "photo and point held", "a point or a photo that is unknown")
    label = f"photo {photo.name}, point {built.ids[j]}"
    return Observation(EXTENDED_COLLINEARITY, unknowns, record, setup, 2, label)


def _add_constraint(built: Built, constraint: Constraint) -> None:
    of_photos = constraint.kind in OF_PHOTOS
    known = [p.name for p in built.photos] if of_photos else list(built.ids)
    for name in constraint.members:
        if name not in known:
            raise InputError.of("closerange.member", place=constraint.label, value=name, known=", ".join(known[:10]))
    members = [known.index(name) for name in constraint.members]
    if constraint.kind in FIGURES:
        figure = figure_of(constraint, built.start[members] - built.origin, _accuracy(built, members))
        base = np.array([built.origin[POINT.index(n.upper())] if n in ("x", "y", "z") else 0.0 for n in figure.names])
        points = [built.points[j] for j in members]
        variable, rows = figure_parts(constraint, figure, len(built.variables), points)
        built.figure_variables.append(built.add(variable, base + figure.offset[: len(base)]))
        built.observations += rows
        return
    if constraint.kind == "equal attitude":
        unknowns, start = [built.turns[j] for j in members], [built.photos[j].rotation for j in members]
    else:
        unknowns = [(built.centres if of_photos else built.points)[j] for j in members]
        start = [] if of_photos else [built.start[j] for j in members]
    if all(isinstance(u, np.ndarray) for u in unknowns):
        raise constraint.fault("members", "all held", "a point or a photo that is unknown")
    built.observations.append(plain_observation(constraint, unknowns, start))


def _accuracy(built: Built, members: Sequence[int]) -> Array | None:
    """Standard deviations (n, 1) of points from their observations with fixed photos; None if one is undetermined.

    Root mean square of the three axes. A fixed point has the smallest value of the others.
    """
    variables = [k for j in members if not isinstance(k := built.points[j], np.ndarray)]
    normal = {k: np.zeros((3, 3)) for k in variables}
    for o in built.observations:
        for place, k in enumerate(o.unknowns):
            if not isinstance(k, np.ndarray) and k in normal and not o.hard:
                x = [u if isinstance(u, np.ndarray) else built.variables[u].start for u in o.unknowns]
                design = o.equation.kernel(o.record, o.setup, *x, True)[1 + place]
                normal[k] += design.T @ design
    if any(np.linalg.matrix_rank(n) < 3 for n in normal.values()) or not normal:
        return None
    sd = {k: float(np.sqrt(np.trace(np.linalg.inv(n)) / 3.0)) for k, n in normal.items()}
    return np.array([sd.get(k, min(sd.values())) if not isinstance(k, np.ndarray) else min(sd.values())
                     for k in (built.points[j] for j in members)])[:, None]  # fmt: skip
