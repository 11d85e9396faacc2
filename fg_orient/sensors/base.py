"""Contract of a sensor: one class has all methods for one kind of image.

A sensor is one file with subclasses of :class:`Sensor` and :class:`ImageModel`. Commands, backends, observability,
covariance, tables and report use only the methods of these two. A format (``fg_orient.formats.registry``) reads its
metadata. Pixels are (line, sample) with (0, 0) = centre of the first pixel; ground points are ECEF metres, or metres of
a local Cartesian system if the sensor is not georeferenced.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from factors.geometry import ellipsoid
from fg_orient.model.errors import Finding, InputError, OutOfImage, finding
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.surface import landed

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.geodesy.bodies import Body
    from fg_orient.model.block import ImagePoints, Options
    from fg_orient.model.parameters import ImageParameters
    from fg_orient.sensors.metadata import FramePoint


class ImageModel(ABC):
    """One image in an adjustment: a sensor and an equation with the arguments (image unknowns, ground point).

    Attributes
    ----------
    equation : Equation
    parameters : ImageParameters
        The k unknowns of the image.
    """

    equation: Equation
    parameters: ImageParameters

    @abstractmethod
    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Whitened constants (n, d) of image points of this image; the equation's residual is then in sigmas.

        To first order it is ``v / sigma``; v = adjusted - observed is the residual of all results. ``ground_m``
        (n, 3) ECEF m near the observed points; ``origin_m`` (3,): local origin of the ground unknowns.
        """

    @abstractmethod
    def correction(self, x: Array) -> Any:
        """Correction for ``rays``, ``project`` and ``locate`` of the sensor, from unknowns (k,) in prior sigmas."""

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """Mission, instrument, format and further entries for the report and the record of a run."""

    def silent_directions(self) -> list[tuple[str, Array]]:
        """Directions that are unobservable in the image: sentence and unit vector (k,) in prior sigmas."""
        return []

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Factors (k,) from the unknowns in physical units to coefficients per line, nan if not applicable; units."""
        return np.full(len(self.parameters), np.nan), ("",) * len(self.parameters)

    @property
    def raw_sigma(self) -> Array:
        """Prior sigmas (k,) of the coefficients per line; of unknowns without such a form in physical units."""
        factors = self.per_line()[0]
        return np.asarray(self.parameters.sigma * np.where(np.isfinite(factors), factors, 1.0))

    def is_valid(self, ground_m: Array) -> Mask:
        """Whether the sensor's model may be used at ground points (n, 3) ECEF m: (n,)."""
        return np.ones(len(ground_m), bool)


class Sensor(ABC):
    """Sensor of an image, with the centres of its first and last line and sample.

    Attributes
    ----------
    file : str
        Name of the metadata file.
    georeferenced : bool
        Ground points are Earth-fixed; else metres of a local Cartesian system, or fixed to ``body``.
    body : Body or None
        Body other than the Earth, whose axes the ground points have.
    serial : str
        Name of the image in networks of other programs, if it has one.
    orients : bool
        The metadata tell where the image lies: they define the datum of a block without control points.
    notes : tuple of Finding
        Remarks of the reader.
    frame_points : tuple of FramePoint
        Points with a ground position in the metadata; ``frame_note`` explains a disagreement with the model.
    mean_height_m : float
        Ellipsoidal height of footprint and image centre.
    """

    file: str = ""
    n_lines: int
    n_samples: int
    first_line: float
    last_line: float
    first_sample: float
    last_sample: float
    georeferenced: bool = True
    body: Body | None = None
    serial: str = ""
    orients: bool = True
    notes: tuple[Finding, ...] = ()
    frame_points: tuple[FramePoint, ...] = ()
    frame_note: Finding | None = None
    mean_height_m: float = 0.0

    @abstractmethod
    def rays(self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: Any = None) -> tuple[Array, Array]:
        """Points on the lines of sight (N, 3) m, above the ground, and unit directions (N, 3).

        Parameters
        ----------
        line, sample : (N,) array_like
            Pixels, from 0 at the centre of the first pixel.
        correction : object, optional
            Correction of the orientation, from :meth:`correction_of`.
        """

    @abstractmethod
    def project(self, ground_m: npt.ArrayLike, correction: Any = None) -> tuple[Array, Array]:
        """Line and sample (N,) of ground points (N, 3) m; nan for invisible points.

        Parameters
        ----------
        ground_m : (N, 3) array_like
            ECEF, m.
        correction : object, optional
            Correction of the orientation, from :meth:`correction_of`.
        """

    @abstractmethod
    def image_model(self, options: Options) -> ImageModel:
        """Unknowns and equation of the image in an adjustment with these options."""

    def locate(
        self,
        line: npt.ArrayLike,
        sample: npt.ArrayLike,
        *,
        height_m: npt.ArrayLike | None = None,
        dem: HeightSurface | None = None,
        correction: Any = None,
    ) -> Array:
        """Ground points (N, 3) ECEF m of N pixels at ellipsoidal heights (default 0), or on a DEM.

        Parameters
        ----------
        line, sample : (N,) array_like
            Pixels, from 0 at the centre of the first pixel.
        height_m : float or (N,) array_like, optional
            Ellipsoidal heights, m.
        dem : object, optional
            Elevation model, instead of ``height_m``.
        correction : object, optional
            Correction of the orientation, from :meth:`correction_of`.

        Raises
        ------
        OutOfImage
            A pixel lies outside the image.
        OutOfTimeRange
            The attitudes do not cover a line.
        InputError
            A ray misses the surface, the DEM does not cover it, or the image is not georeferenced.
        """
        if not self.georeferenced and self.body is None:
            raise InputError.of("frame.local", file=self.file, place="locate")
        line, sample = same_length(line, sample)
        self.require_inside(line, sample)
        return self._located(line, sample, height_m, dem, correction)

    def _located(
        self, line: Array, sample: Array, height_m: npt.ArrayLike | None, dem: HeightSurface | None, correction: Any
    ) -> Array:
        """Ground points of pixels (N,) inside the image."""
        p, u = self.rays(line, sample, correction)
        return landed(p, u, height_m, dem, (line, sample), self.file, self.body)

    def correction_of(self, values: Mapping[str, float], options: Options) -> Any:
        """Correction from the values of the unknowns by name, in physical units, as in a result folder.

        Raises
        ------
        KeyError
            A name is not an unknown of this sensor.
        """
        model = self.image_model(options)
        x = placed(values, model.parameters.names)
        return model.correction(x / model.parameters.sigma)

    def shared_starts(self) -> dict[tuple[str, str], float]:
        """Start values of unknowns shared with other images, by (shared id, name): they must agree."""
        return {}

    @cached_property
    def centre_m(self) -> Array:
        """Ground point (3,) m of the image centre."""
        middle = 0.5 * (self.first_line + self.last_line), 0.5 * (self.first_sample + self.last_sample)
        return np.asarray(self.locate(*middle, height_m=self.mean_height_m)[0])

    def footprint(self) -> Array:
        """Corners in image order, clockwise: (4, 2) longitude, latitude in degrees; (0, 2) if not georeferenced."""
        if not self.georeferenced and self.body is None:
            return np.zeros((0, 2))
        corners = self.locate(*self.corners(), height_m=self.mean_height_m)
        if self.body is not None:
            return self.body.coordinates(corners)[:, :2]
        return np.degrees(ellipsoid.geodetic_array(corners)[:, :2])

    def is_inside(self, line: Array, sample: Array) -> Mask:
        """Whether pixels (N,) lie in the image, half a pixel of border included."""
        inside = (line >= self.first_line - 0.5) & (line <= self.last_line + 0.5)
        return np.asarray(inside & (sample >= self.first_sample - 0.5) & (sample <= self.last_sample + 0.5))

    def require_inside(self, line: Array, sample: Array) -> None:
        """Raise OutOfImage if a pixel lies outside the image; the message names the first one and the range."""
        bad = np.flatnonzero(~self.is_inside(line, sample))
        if len(bad):
            raise OutOfImage.of(
                "sensor.pixel_outside", file=self.file, place=f"line {line[bad[0]]:g}, sample {sample[bad[0]]:g}",
                value=f"{len(bad)} pixel(s)", first_line=self.first_line - 0.5, last_line=self.last_line + 0.5,
                first_sample=self.first_sample - 0.5, last_sample=self.last_sample + 0.5,
            )  # fmt: skip

    def grid(self, count: int) -> tuple[Array, Array]:
        """Lines and samples (count * count,) of a grid over the image."""
        axes = (self.first_line, self.last_line), (self.first_sample, self.last_sample)
        line, sample = np.meshgrid(*(np.linspace(*ends, count) for ends in axes), indexing="ij")
        return line.ravel(), sample.ravel()

    def corners(self) -> tuple[Array, Array]:
        """Lines and samples (4,) of the corners in image order, clockwise."""
        line = np.array([self.first_line, self.first_line, self.last_line, self.last_line])
        return line, np.array([self.first_sample, self.last_sample, self.last_sample, self.first_sample])


def same_length(*values: npt.ArrayLike) -> list[Array]:
    """Arrays (N,) in C order from scalars and arrays."""
    return [
        np.ascontiguousarray(a) for a in np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in values))
    ]


def placed(values: Mapping[str, float], names: tuple[str, ...]) -> Array:
    """Values (n,) in the order of n names, 0 for missing names; KeyError for other names."""
    out, place = np.zeros(len(names)), {name: k for k, name in enumerate(names)}
    for name, value in values.items():
        out[place[name]] = value
    return out


class OrientedSensor:
    """A sensor bound to a correction; all other attributes are the attributes of the sensor.

    Parameters
    ----------
    sensor : PushbroomSensor, RpcSensor or FrameSensor
    correction : Correction or array
        Argument of the sensor's methods, for instance ``solution.correction("left")``.
    """

    def __init__(self, sensor: Any, correction: Any) -> None:
        self.sensor, self.correction = sensor, correction
        self.notes: tuple[Finding, ...] = (*sensor.notes, finding("image.adjusted"))

    def __getattr__(self, name: str) -> Any:
        """Attribute of the sensor."""
        return getattr(self.sensor, name)

    def rays(self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: None = None) -> tuple[Array, Array]:
        """Points on the lines of sight (N, 3) m and unit directions (N, 3), ECEF."""
        centre, direction = self.sensor.rays(line, sample, self.correction)
        return centre, direction

    def locate(self, line: npt.ArrayLike, sample: npt.ArrayLike, **surface: Any) -> Array:
        """Ground points (N, 3) ECEF m; keywords ``height_m`` and ``dem`` as in :meth:`Sensor.locate`."""
        return np.asarray(self.sensor.locate(line, sample, **surface, correction=self.correction))

    def project(self, ground_m: npt.ArrayLike, correction: None = None) -> tuple[Array, Array]:
        """Line and sample (N,) of ECEF points (N, 3)."""
        line, sample = self.sensor.project(ground_m, self.correction)
        return line, sample
