"""Simulated images, ground points and image points with their truth; fast projection of many points.

Truth is exact in the model of the adjustment. The sensor **as read from the metadata file**, with the
correction *true minus metadata*, projects the true points. Noise is added afterwards. With true
unknowns every noise-free condition is therefore zero.

``PushbroomSensor.project`` needs about 25 evaluations of the conditions per point: it starts at the image centre and
computes derivatives by differences at each step. :class:`QuickProjection` starts from polynomials of the ground
coordinates, which give line and sample within a fraction of a pixel, and the derivatives of the conditions. Iteration
with these fixed derivatives then needs two or three evaluations of the same conditions per point. The sensor projects
the points that do not converge in this way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.arrays import having_role
from fg_orient.model.block import (
    Block,
    Coordinates,
    GroundPoints,
    Image,
    ImagePoints,
    Options,
    WithheldCoordinates,
)
from fg_orient.model.names import Progress, Role
from fg_orient.sensors.correction import Correction, Wave
from fg_orient.sensors.interior import Interior
from fg_orient.sensors.metadata import PushbroomMetadata
from fg_orient.sensors.projection import STEP_PX, conditions, pixel_derivative
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.scene import Scene, as_read

#: Numbers of nodes of the fit along line, sample and height, and largest sum of the powers of East and North.
NODES = 9
HEIGHTS = 3
DEGREE = 5
MAX_STEPS = 10
#: Points farther than this from the rectangle of the nodes are outside the image.
BORDER_M = 500.0


class QuickProjection:
    """Polynomials of one sensor with one correction, for heights from 0 to a maximum.

    Parameters
    ----------
    sensor : PushbroomSensor
    correction : Correction
    max_height_m : float
        Largest ellipsoidal height of the points, whose smallest height is 0. Points outside this range take longer.
    """

    def __init__(self, sensor: PushbroomSensor, correction: Correction, max_height_m: float) -> None:
        self.sensor, self.correction = sensor, correction
        self._top_m = max(max_height_m, 1.0)
        lon, lat, _ = ecef_to_geodetic(sensor.centre_m)
        self._plane = enu_from_ecef(float(lon[0]), float(lat[0]))[0, :2]
        line, sample, height = (
            grid.ravel()
            for grid in np.meshgrid(
                _nodes(0.0, sensor.n_lines - 1.0, NODES),
                _nodes(sensor.first_sample, sensor.last_sample, NODES),
                _nodes(0.0, self._top_m, HEIGHTS),
                indexing="ij",
            )
        )
        ground = sensor.locate(line, sample, height_m=height, correction=correction)
        east_north = self._east_north(ground)
        self._low, self._high = east_north.min(axis=0), east_north.max(axis=0)
        j = pixel_derivative(sensor, line, sample, ground, correction)
        wanted = np.column_stack([line, sample, np.linalg.inv(j).reshape(-1, 4)])
        terms = self._terms(east_north, height)
        q, r = np.linalg.qr(terms)
        self._coefficients = np.linalg.solve(r, q.T @ wanted)
        difference = np.abs(terms @ self._coefficients - wanted).max(axis=0)
        self.error_px = float(difference[:2].max())
        slopes = np.abs(wanted[:, 2:]).max()
        # after a step with these derivatives, this share of the distance remains
        self._rest = max(float(difference[2:].max() / slopes), 1e-7)

    def _east_north(self, ground_m: Array) -> Array:
        """Return East and North (n, 2) m of ECEF points in the plane at the image centre."""
        return np.asarray((ground_m - self.sensor.centre_m) @ self._plane.T)

    def _terms(self, east_north: Array, height_m: Array) -> Array:
        """Return the products of powers (n, t), arguments scaled to [-1, 1] inside the image."""
        half = (self._high - self._low) / 2.0
        x, y = ((east_north - self._low) / half - 1.0).T
        h = 2.0 * height_m / self._top_m - 1.0
        powers = [np.vander(a, DEGREE + 1, increasing=True) for a in (x, y)]
        plane = [powers[0][:, a] * powers[1][:, b] for a in range(DEGREE + 1) for b in range(DEGREE + 1 - a)]
        low = [powers[0][:, a] * powers[1][:, b] for a in range(3) for b in range(3 - a)]
        return np.column_stack([*plane, *(h * p for p in low), *(h * h * p for p in low[:1])])

    def near(self, ground_m: Array) -> Index:
        """Return indices (n,) of ECEF points (N, 3) that may lie in the image; all are on this side of the Earth."""
        e = self._east_north(ground_m)
        return np.flatnonzero(((e > self._low - BORDER_M) & (e < self._high + BORDER_M)).all(axis=1))

    def estimate(self, ground_m: Array, height_m: Array) -> Array:
        """Return line and sample (n, 2) of the polynomials; the error at the nodes is at most ``error_px``."""
        return np.asarray(self._terms(self._east_north(ground_m), height_m) @ self._coefficients[:, :2])

    def project(self, ground_m: Array, height_m: Array) -> Array:
        """Return line and sample (n, 2) of ECEF points (n, 3) with ellipsoidal heights (n,) m.

        They agree with ``PushbroomSensor.project`` to the rounding of a time of day (1e-8 px).
        """
        start = self._terms(self._east_north(ground_m), height_m) @ self._coefficients
        pixels, inverse = np.ascontiguousarray(start[:, :2]), start[:, 2:].reshape(-1, 2, 2)
        todo = np.flatnonzero(self.sensor.is_inside(pixels[:, 0], pixels[:, 1]))
        left = np.setdiff1d(np.arange(len(pixels)), todo)
        for _ in range(MAX_STEPS):
            if not len(todo):
                break
            f = conditions(self.sensor, pixels[todo, 0], pixels[todo, 1], ground_m[todo], self.correction)
            step = np.einsum("nij,nj->ni", inverse[todo], f)
            pixels[todo] -= step
            length = np.abs(step).max(axis=1)
            inside = self.sensor.is_inside(pixels[todo, 0], pixels[todo, 1])
            left = np.concatenate([left, todo[~inside]])
            todo = todo[inside & (length * self._rest > STEP_PX)]
        left = np.concatenate([left, todo])
        if len(left):
            pixels[left] = np.stack(self.sensor.project(ground_m[left], self.correction), axis=1)
        return pixels


def _nodes(low: float, high: float, n: int) -> Array:
    """Return Chebyshev points including both ends, so that a polynomial through them is accurate up to the border."""
    return np.asarray(low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * np.arange(n) / (n - 1))))


#: Sigma of image points for the adjustment if the simulated noise is zero.
NOMINAL_IMAGE_SIGMA_PX = 0.3
#: Sigmas East, North, Up of ground points for the adjustment if their noise is zero.
NOMINAL_GROUND_SIGMA_M = (0.06, 0.06, 1.0)

#: Independent random streams of a simulation; the order is part of the definition of a seed.
STREAMS = ("points", "roles", "orientation", "image_noise", "ground_noise", "jitter")
CONSTANT_POSITION_M = 5.0
CONSTANT_ATTITUDE_RAD = 20e-6


def random_streams(seed: int) -> dict[str, np.random.Generator]:
    """Return independent generators by name; draws from one do not change the numbers of another."""
    children = np.random.SeedSequence(seed).spawn(len(STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(STREAMS, children, strict=True)}


def draw_errors(kind: str, rng: np.random.Generator, n_images: int) -> Array:
    """Return true minus metadata of the EOP coefficients of n images: (n, 9, 3), physical units.

    "constant": 5 m per ECEF axis of the position and 20 microrad per angle, with random signs; "prior": every
    coefficient normal with the default prior sigma; "none": zero.
    """
    out = np.zeros((n_images, 9, 3))
    if kind == "constant":
        sign = rng.choice([-1.0, 1.0], size=(n_images, 6))
        out[:, 0:3, 0] = CONSTANT_POSITION_M * sign[:, :3]
        out[:, 6:9, 0] = CONSTANT_ATTITUDE_RAD * sign[:, 3:]
    elif kind == "prior":
        usual = Options()
        sigmas = np.array([usual.position_sigma_m, usual.velocity_sigma_m_s, usual.attitude_sigma_rad])
        out = rng.standard_normal((n_images, 9, 3)) * np.repeat(sigmas, 3, axis=0)
    return out


@dataclass(frozen=True)
class Truth:
    """True values of a simulated block.

    Parameters
    ----------
    image_ids : tuple of str
    corrections : tuple of Correction or arrays
        True minus metadata, per image, in the form of its sensor. The files do not contain the look-angle part.
    point_ids : tuple of str
    lon_lat_height : (n, 3) array
        Degrees, degrees, m.
    ecef_m : (n, 3) array
    pixels : (k, 2) array
        Line and sample of each image observation without noise.
    """

    image_ids: tuple[str, ...]
    corrections: tuple[Any, ...]
    point_ids: tuple[str, ...]
    lon_lat_height: Array
    ecef_m: Array
    pixels: Array

    @classmethod
    def of(cls, ground: Ground, image_ids: Iterable[str], corrections: tuple[Any, ...], pixels: Array) -> Truth:
        """Return the truth of ground points and images."""
        return cls(tuple(image_ids), corrections, ground.ids, ground.lon_lat_height, ground.ecef_m, pixels)


@dataclass(frozen=True)
class Ground:
    """Ground points of a simulation.

    Parameters
    ----------
    ids : tuple of str
    roles : tuple of Role
    lon_lat_height : (n, 3) array
        True coordinates: degrees, degrees, m.
    noise_enu_m : (n, 3) array
        Noise of the measured coordinates.
    sigma_enu_m : (3,) tuple
        Sigmas that the adjustment uses.
    """

    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    lon_lat_height: Array
    noise_enu_m: Array
    sigma_enu_m: tuple[float, float, float]

    @cached_property
    def ecef_m(self) -> Array:
        """True ECEF coordinates (n, 3)."""
        return geodetic_to_ecef(*self.lon_lat_height.T)

    @cached_property
    def known(self) -> Mask:
        """True if a point has measured coordinates (n,): all except the tie points."""
        return ~having_role(self.roles, Role.TIE)

    @cached_property
    def measured(self) -> Array:
        """Measured longitude, latitude (degrees), height (m): (n, 3), also of tie points."""
        enu = enu_from_ecef(self.lon_lat_height[:, 0], self.lon_lat_height[:, 1])
        return np.stack(ecef_to_geodetic(self.ecef_m + np.einsum("nji,nj->ni", enu, self.noise_enu_m)), axis=1)


@dataclass(frozen=True)
class Simulation:
    """Simulated block: the content of its files.

    Parameters
    ----------
    name : str
    metadata : tuple of PushbroomMetadata
        Metadata, as written, of the images with DIMAP files. These images are the first ones.
    ground : Ground
    image, point : (k,) arrays
        Image and ground point of each observation.
    observed : (k, 2) array
        Line and sample with noise.
    sigma_px : array
        Sigmas of the image coordinates that the adjustment uses; its shape broadcasts to (k, 2).
    truth : Truth
    others : tuple of Image
        Images with other files; their sensors are as read from these files.
    interior : Interior or None
        Interior orientation of the frame images, as written.
    options : Options or None
        Options of the project file; None: all at their defaults.
    """

    name: str
    metadata: tuple[PushbroomMetadata, ...]
    ground: Ground
    image: Index
    point: Index
    observed: Array
    sigma_px: Array
    truth: Truth
    others: tuple[Image, ...] = ()
    interior: Interior | None = None
    options: Options | None = None

    @property
    def images(self) -> tuple[Image, ...]:
        """All images, with sensors as read from the files."""
        of_dimap = zip(self.truth.image_ids, self.metadata, strict=False)
        return (*(Image(name, as_read(metadata)) for name, metadata in of_dimap), *self.others)

    def block(self) -> Block:
        """Return the block, equal to a block read from the written files (without sources and notes)."""
        sigma = np.broadcast_to(self.sigma_px, self.observed.shape)
        points, check = points_of(self.ground)
        observations = ImagePoints(self.image, self.point, *self.observed.T, *sigma.T)
        return Block(self.name, self.images, points, observations, check, self.options or Options())


def points_of(ground: Ground) -> tuple[GroundPoints, WithheldCoordinates]:
    """Return control points with coordinates, other points without, and sealed coordinates of the check points."""
    has = {role: np.array([r is role for r in ground.roles]) for role in Role}
    ecef = geodetic_to_ecef(*ground.measured.T)
    control = has[Role.CONTROL][:, None]
    sigma = np.broadcast_to(np.array(ground.sigma_enu_m), ecef.shape)
    none_fixed = np.zeros(len(ecef), bool)
    known = Coordinates(np.where(control, ecef, np.nan), np.where(control, sigma, np.nan), none_fixed)
    rows = np.flatnonzero(has[Role.CHECK])
    sealed = Coordinates(ecef[rows], sigma[rows].copy(), none_fixed[rows])
    ids = tuple(ground.ids[k] for k in rows)
    return GroundPoints(ground.ids, ground.roles, known), WithheldCoordinates(ids, lambda: sealed)


def observe(
    name: str,
    scenes: Sequence[Scene],
    ground: Ground,
    visible: Mask,
    errors: Array,
    look: Array,
    noise_px: float,
    rng: np.random.Generator,
    max_height_m: float | None = None,
    progress: Progress | None = None,
    waves: Sequence[tuple[Wave, ...]] = (),
) -> Simulation:
    """Simulate pushbroom images: metadata with errors, true pixels of this metadata with its corrections, noise.

    Parameters
    ----------
    visible : (n_images, n_points) bool array
        Points that are measured in each image.
    errors : (n_images, 9, 3) array
        True minus metadata.
    look : (2, k) array
        True look-angle polynomial of every image, not in the files.
    noise_px : float
        Sigma of the noise of line and of sample.
    max_height_m : float, optional
        Largest height of the points, whose smallest height is 0. If it is given, :class:`QuickProjection` projects; it
        is faster for more than some thousand points per image.
    progress : callable, optional
        Function that is called with (done, of, text) before each image.
    waves : sequence of tuples of Wave
        True jitter of each image, not in the files; empty: none.
    """
    metadata = tuple(scene.metadata(error) for scene, error in zip(scenes, errors, strict=True))
    of_images = waves or [()] * len(scenes)
    corrections = tuple(Correction(error, look, waves=own) for error, own in zip(errors, of_images, strict=True))
    image, point = (a.astype(np.intp) for a in np.nonzero(visible))
    pixels = np.empty((len(image), 2))
    for k, (written, correction) in enumerate(zip(metadata, corrections, strict=True)):
        if progress is not None:
            progress(k, len(metadata), "images taken")
        rows = image == k
        sensor, seen = as_read(written), point[rows]
        if max_height_m is None:
            pixels[rows] = np.stack(sensor.project(ground.ecef_m[seen], correction), axis=1)
        else:
            camera = QuickProjection(sensor, correction, max_height_m)
            pixels[rows] = camera.project(ground.ecef_m[seen], ground.lon_lat_height[seen, 2])
    truth = Truth.of(ground, [scene.id for scene in scenes], corrections, pixels)
    return Simulation(name, metadata, ground, image, point, *with_noise(pixels, noise_px, rng), truth)


def with_noise(pixels: Array, noise_px: npt.ArrayLike, rng: np.random.Generator) -> tuple[Array, Array]:
    """Add noise to pixels (k, 2) with a sigma that broadcasts to them; also return the sigma for the adjustment."""
    sigma = np.asarray(noise_px)
    observed = pixels + sigma * rng.standard_normal(pixels.shape)
    return observed, np.where(sigma > 0.0, sigma, NOMINAL_IMAGE_SIGMA_PX)


def ground_points(
    ids: tuple[str, ...],
    roles: tuple[Role, ...],
    lon_lat_height: Array,
    noise_enu_m: tuple[float, float, float],
    rng: np.random.Generator,
) -> Ground:
    """Draw the noise of ground points; their sigmas are the sigmas of the noise, or nominal ones if it is zero."""
    noise = np.array(noise_enu_m) * rng.standard_normal(lon_lat_height.shape)
    east, north, up = (s or nominal for s, nominal in zip(noise_enu_m, NOMINAL_GROUND_SIGMA_M, strict=True))
    return Ground(ids, roles, lon_lat_height, noise, (east, north, up))


def numbered(count: int) -> tuple[str, ...]:
    """Return the ids of points: numbers from 1 with leading zeros."""
    return tuple(f"{k + 1:0{len(str(count))}d}" for k in range(count))


def roles_in_order(order: Index, control: int, check: int) -> tuple[Role, ...]:
    """Return the roles of points by rank (n,): the first ranks are control points, then check and tie points follow."""
    return tuple(Role.CONTROL if k < control else Role.CHECK if k < control + check else Role.TIE for k in order)
