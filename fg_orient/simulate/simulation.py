"""What a simulator makes: scenes, points, image points and their truth; as a block or as files.

Truth is exact in the model of the adjustment: image coordinates are the projection of the
true points by the sensor **as read from the metadata file** with the correction *true minus
metadata*; noise is added afterwards. So with true unknowns every noise-free condition
vanishes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import (
    Block,
    Coordinates,
    GroundPoints,
    Image,
    ImagePoints,
    Index,
    Options,
    WithheldCoordinates,
)
from fg_orient.model.names import Progress, Role
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.metadata import PushbroomMetadata
from fg_orient.simulate.quick_projection import QuickProjection
from fg_orient.simulate.scene import Scene, as_read

Array = npt.NDArray[np.float64]

#: Sigma of image points given to the adjustment when the simulated noise is zero.
NOMINAL_IMAGE_SIGMA_PX = 0.3
#: Sigmas East, North, Up of ground points given to the adjustment when their noise is zero.
NOMINAL_GROUND_SIGMA_M = (0.06, 0.06, 1.0)

#: Independent random streams of a simulation; the order is part of the definition of a seed.
STREAMS = ("points", "roles", "orientation", "image_noise", "ground_noise")
CONSTANT_POSITION_M = 5.0
CONSTANT_ATTITUDE_RAD = 20e-6


def random_streams(seed: int) -> dict[str, np.random.Generator]:
    """Independent generators by name: drawing more from one changes nothing in the others."""
    children = np.random.SeedSequence(seed).spawn(len(STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(STREAMS, children, strict=True)}


def draw_errors(kind: str, rng: np.random.Generator, n_images: int) -> Array:
    """True minus metadata of the EOP coefficients of n images: (n, 9, 3), physical units.

    "constant": plus or minus 5 m per ECEF axis of the position, 20 microrad per angle, signs
    drawn; "prior": every coefficient normal with the default prior sigma; "none": zero.
    """
    out = np.zeros((n_images, 9, 3))
    if kind == "constant":
        sign = rng.choice([-1.0, 1.0], size=(n_images, 6))
        out[:, 0:3, 0] = CONSTANT_POSITION_M * sign[:, :3]
        out[:, 6:9, 0] = CONSTANT_ATTITUDE_RAD * sign[:, 3:]
    elif kind == "prior":
        out = rng.standard_normal((n_images, 9, 3)) * prior_sigmas(Options())
    return out


def prior_sigmas(options: Options) -> Array:
    """Prior sigmas of the EOP coefficients, (9, 3): m, m/s, rad."""
    triples = [options.position_sigma_m, options.velocity_sigma_m_s, options.attitude_sigma_rad]
    return np.repeat(np.array(triples), 3, axis=0)


@dataclass(frozen=True)
class Truth:
    """What is true of a simulated block.

    Parameters
    ----------
    image_ids : tuple of str
    corrections : tuple of Correction or arrays
        True minus metadata, per image, as its sensor takes it; the look-angle part is what the files do not contain.
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


@dataclass(frozen=True)
class Ground:
    """Ground points of a simulation before they are measured.

    ``lon_lat_height`` (n, 3) degrees, m: true; ``noise_enu_m`` (n, 3) of the measured
    coordinates; ``sigma_enu_m`` (3,) given to the adjustment.
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
    def known(self) -> npt.NDArray[np.bool_]:
        """Which points have measured coordinates: all but the tie points, (n,)."""
        return np.array([role is not Role.TIE for role in self.roles])

    @cached_property
    def measured(self) -> Array:
        """Measured longitude, latitude (degrees), height (m): (n, 3), tie points too."""
        enu = enu_from_ecef(self.lon_lat_height[:, 0], self.lon_lat_height[:, 1])
        return np.stack(ecef_to_geodetic(self.ecef_m + np.einsum("nji,nj->ni", enu, self.noise_enu_m)), axis=1)


@dataclass(frozen=True)
class Simulation:
    """A simulated block: everything its files are made of.

    Parameters
    ----------
    name : str
    metadata : tuple of PushbroomMetadata
        As written to the files.
    ground : Ground
    image, point : (k,) arrays
        Image and ground point of each observation.
    observed : (k, 2) array
        Line and sample with noise.
    sigma_px : float or (k, 2) array
        Sigma of line and of sample, given to the adjustment.
    truth : Truth
    """

    name: str
    metadata: tuple[PushbroomMetadata, ...]
    ground: Ground
    image: Index
    point: Index
    observed: Array
    sigma_px: float | Array
    truth: Truth

    def block(self) -> Block:
        """Give the block that reading the written files gives (without sources and notes)."""
        sigma = np.broadcast_to(self.sigma_px, self.observed.shape)
        points, withheld = points_of(self.ground)
        return Block(
            name=self.name,
            images=tuple(Image(i, as_read(m)) for i, m in zip(self.truth.image_ids, self.metadata, strict=True)),
            points=points,
            observations=ImagePoints(self.image, self.point, *self.observed.T, *sigma.T),
            withheld=withheld,
        )


def points_of(ground: Ground) -> tuple[GroundPoints, WithheldCoordinates]:
    """Control points with coordinates, the others without; check coordinates sealed."""
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
    visible: npt.NDArray[np.bool_],
    errors: Array,
    look: Array,
    image_noise_px: float,
    rng: np.random.Generator,
    max_height_m: float | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Take the images: metadata with errors, true pixels through them, noise.

    Parameters
    ----------
    visible : (n_images, n_points) bool array
        Which point is measured in which image.
    errors : (n_images, 9, 3) array
        True minus metadata.
    look : (2, k) array
        True look-angle polynomial of every image, not in the files.
    image_noise_px : float
        Sigma of the noise of line and of sample.
    max_height_m : float, optional
        Heights lie between 0 and this: the images are projected by polynomials and a few steps on the same conditions,
        which pays from some thousand points per image. Without it each sensor projects.
    progress : callable, optional
        Called with (done, of, text) before each image.
    """
    metadata = tuple(scene.metadata(error) for scene, error in zip(scenes, errors, strict=True))
    corrections = tuple(Correction(error, look) for error in errors)
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
    observed = pixels + image_noise_px * rng.standard_normal(pixels.shape)
    ids = tuple(scene.id for scene in scenes)
    truth = Truth(ids, corrections, ground.ids, ground.lon_lat_height, ground.ecef_m, pixels)
    sigma = image_noise_px or NOMINAL_IMAGE_SIGMA_PX
    return Simulation(name, metadata, ground, image, point, observed, sigma, truth)


def ground_points(
    ids: tuple[str, ...],
    roles: tuple[Role, ...],
    lon_lat_height: Array,
    noise_enu_m: tuple[float, float, float],
    rng: np.random.Generator,
) -> Ground:
    """Give ground points measured noise; sigmas are the noise's, or nominal where it is zero."""
    noise = np.array(noise_enu_m) * rng.standard_normal(lon_lat_height.shape)
    east, north, up = (s or nominal for s, nominal in zip(noise_enu_m, NOMINAL_GROUND_SIGMA_M, strict=True))
    return Ground(ids, roles, lon_lat_height, noise, (east, north, up))
