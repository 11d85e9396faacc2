"""Base classes of sensors: one class contains all methods for one kind of image.

A new sensor is one file with subclasses of :class:`Sensor` and :class:`ImageModel`.
Commands, backends, observability, covariance, tables and report use only the methods of
these two classes. A format (``fg_orient.formats.registry``) reads the metadata. Pixels
are (line, sample); (0, 0) is the centre of the first pixel. Ground points are ECEF, m. If
the sensor is not georeferenced, they refer to a local Cartesian system, m.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from factors.geometry import ellipsoid
from fg_orient.model.arrays import array, wrong
from fg_orient.model.errors import Finding, InputError, OutOfImage, finding
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.surface import landed

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.geodesy.bodies import Body
    from fg_orient.model.block import ImagePoints, Options
    from fg_orient.model.jitter import JitterCurve
    from fg_orient.model.parameters import ImageParameters
    from fg_orient.sensors.metadata import FramePoint


class ImageModel(ABC):
    """One image in an adjustment: its sensor, its unknowns and its observation equation.

    The arguments of the equation are the image unknowns and the ground point.

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
        """Return the whitened constants (n, d) of image points; the equation's residual is then in standard deviations.

        To first order, it is ``v / sigma``, where v = adjusted - observed is the residual
        in all results. ``ground_m`` (n, 3) are ECEF coordinates, m, near the observed
        points. ``origin_m`` (3,) is the local origin of the ground unknowns.
        """

    @abstractmethod
    def correction(self, x: Array) -> Any:
        """Convert unknowns (k,) in prior sigmas to a correction that the methods of the sensor accept."""

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """Return mission, instrument, format and further entries for the report and the record of a run."""

    def silent_directions(self) -> list[tuple[str, Array]]:
        """Return directions that the image cannot observe: sentences and unit vectors (k,) in prior sigmas."""
        return []

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Return factors (k,) that convert unknowns in physical units to coefficients per line, and their units.

        A factor is nan if an unknown has no such form.
        """
        return np.full(len(self.parameters), np.nan), ("",) * len(self.parameters)

    @property
    def raw_sigma(self) -> Array:
        """Return the prior sigmas (k,) of the coefficients per line.

        If an unknown has no such form, its prior sigma is in physical units.
        """
        factors = self.per_line()[0]
        return np.asarray(self.parameters.sigma * np.where(np.isfinite(factors), factors, 1.0))

    def add_jitter(self, curves: tuple[JitterCurve, ...]) -> None:
        """Add the unknowns of jitter curves of this image; InputError if the kind of image has none."""
        kind = self.facts().get("model", type(self).__name__)
        raise InputError.of("jitter.kind", option="jitter_curves", value=str(curves[0]), kind=kind)

    def is_valid(self, ground_m: Array) -> Mask:
        """Return a mask (n,) of the ground points (n, 3), ECEF m, at which the sensor's model is valid."""
        return np.ones(len(ground_m), bool)


class Sensor(ABC):
    """Sensor of an image. It gives the centres of the first and last line and sample.

    Attributes
    ----------
    file : str
        Name of the metadata file.
    georeferenced : bool
        True: ground points are Earth-fixed or fixed to ``body``. False: they refer to a
        local Cartesian system, m.
    body : Body or None
        Another body than the Earth, to whose axes the ground points refer.
    serial : str
        Name of the image in networks of other programs; "" if there is none.
    orients : bool
        The metadata contain the position of the image. They define the datum of a block without control points.
    notes : tuple of Finding
        Remarks of the reader.
    frame_points : tuple of FramePoint
        Points whose ground position is in the metadata. If they do not agree with the
        model, ``frame_note`` explains the reason.
    mean_height_m : float
        Ellipsoidal height at which footprint and image centre are computed.
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
        """Return points (N, 3), m, on the lines of sight above the ground, and unit directions (N, 3).

        Parameters
        ----------
        line, sample : (N,) array_like
            Pixels, from 0 at the centre of the first pixel.
        correction : object, optional
            Correction of the orientation, from :meth:`correction_of`.
        """

    @abstractmethod
    def project(self, ground_m: npt.ArrayLike, correction: Any = None) -> tuple[Array, Array]:
        """Project ground points (N, 3), m, into the image: line and sample (N,); nan for invisible points.

        Parameters
        ----------
        ground_m : (N, 3) array_like
            ECEF, m.
        correction : object, optional
            Correction of the orientation, from :meth:`correction_of`.
        """

    @abstractmethod
    def image_model(self, options: Options) -> ImageModel:
        """Return the image model: the unknowns and the equation of the image in an adjustment with these options."""

    def locate(
        self,
        line: npt.ArrayLike,
        sample: npt.ArrayLike,
        *,
        height_m: npt.ArrayLike | None = None,
        dem: HeightSurface | None = None,
        correction: Any = None,
    ) -> Array:
        """Return the ground points (N, 3), ECEF m, of N pixels at ellipsoidal heights (default 0) or on a DEM.

        Parameters
        ----------
        line, sample : (N,) array_like
            Pixels, from 0 at the centre of the first pixel.
        height_m : float or (N,) array_like, optional
            Ellipsoidal heights, m.
        dem : object, optional
            Elevation model that is used instead of ``height_m``.
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
        """Return the ground points of pixels (N,) inside the image."""
        p, u = self.rays(line, sample, correction)
        return landed(p, u, height_m, dem, (line, sample), self.file, self.body)

    def correction_of(self, values: Mapping[str, float], options: Options) -> Any:
        """Make a correction from the values of the unknowns by name.

        The values are in physical units, as in a result folder.

        Raises
        ------
        KeyError
            A name is not the name of an unknown of this sensor.
        """
        model = self.image_model(options)
        x = placed(values, model.parameters.names)
        return model.correction(x / model.parameters.sigma)

    def shared_starts(self) -> dict[tuple[str, str], float]:
        """Return the start values of unknowns that other images share, by (shared id, name).

        All these images must have the same start values.
        """
        return {}

    @cached_property
    def centre_m(self) -> Array:
        """Return the ground point (3,), m, of the image centre."""
        middle = 0.5 * (self.first_line + self.last_line), 0.5 * (self.first_sample + self.last_sample)
        return np.asarray(self.locate(*middle, height_m=self.mean_height_m)[0])

    def footprint(self) -> Array:
        """Return the corners in the order of the image, clockwise: (4, 2) longitude, latitude, degrees.

        If the sensor is not georeferenced, the shape is (0, 2).
        """
        if not self.georeferenced and self.body is None:
            return np.zeros((0, 2))
        corners = self.locate(*self.corners(), height_m=self.mean_height_m)
        if self.body is not None:
            return self.body.coordinates(corners)[:, :2]
        return np.degrees(ellipsoid.geodetic_array(corners)[:, :2])

    def is_inside(self, line: Array, sample: Array) -> Mask:
        """Return a mask (N,) of the pixels that lie in the image.

        The border of half a pixel belongs to the image.
        """
        inside = (line >= self.first_line - 0.5) & (line <= self.last_line + 0.5)
        return np.asarray(inside & (sample >= self.first_sample - 0.5) & (sample <= self.last_sample + 0.5))

    def require_inside(self, line: Array, sample: Array) -> None:
        """Raise OutOfImage if a pixel lies outside the image.

        The message names the first one and the range.
        """
        bad = np.flatnonzero(~self.is_inside(line, sample))
        if len(bad):
            raise OutOfImage.of(
                "sensor.pixel_outside", file=self.file, place=f"line {line[bad[0]]:g}, sample {sample[bad[0]]:g}",
                value=f"{len(bad)} pixel(s)", first_line=self.first_line - 0.5, last_line=self.last_line + 0.5,
                first_sample=self.first_sample - 0.5, last_sample=self.last_sample + 0.5,
            )  # fmt: skip

    def grid(self, count: int) -> tuple[Array, Array]:
        """Return lines and samples (count * count,) of a grid over the image."""
        axes = (self.first_line, self.last_line), (self.first_sample, self.last_sample)
        line, sample = np.meshgrid(*(np.linspace(*ends, count) for ends in axes), indexing="ij")
        return line.ravel(), sample.ravel()

    def corners(self) -> tuple[Array, Array]:
        """Return lines and samples (4,) of the corners in the order of the image, clockwise."""
        line = np.array([self.first_line, self.first_line, self.last_line, self.last_line])
        return line, np.array([self.first_sample, self.last_sample, self.last_sample, self.first_sample])


def same_length(*values: npt.ArrayLike, place: str = "line, sample") -> list[Array]:
    """Expand scalars and arrays to arrays (N,) of the same length in C order.

    InputError: they are not numbers, have several dimensions, or have other lengths; ``place`` names them.
    """
    given = [np.atleast_1d(array(v, place)) for v in values]
    lengths = {len(v) for v in given} - {1}
    if len(lengths) > 1 or any(v.ndim > 1 for v in given):
        seen = ", ".join(f"shape {v.shape}" for v in given)
        raise wrong(place, seen, "numbers, or arrays (n,) of the same length")
    return [np.ascontiguousarray(a) for a in np.broadcast_arrays(*given)]


def ground_rows(ground_m: npt.ArrayLike) -> Array:
    """Return ground points as an array (N, 3); a single point (3,) is one row.

    InputError: they are not numbers or have another shape.
    """
    given = np.atleast_2d(array(ground_m, "ground_m"))
    if given.ndim != 2 or given.shape[1] != 3:
        raise wrong("ground_m", f"shape {given.shape}", "numbers of shape (n, 3)")
    return given


def placed(values: Mapping[str, float], names: tuple[str, ...]) -> Array:
    """Arrange values (n,) in the order of n names.

    The value of a missing name is 0. KeyError: a name is not among the n names.
    """
    out, place = np.zeros(len(names)), {name: k for k, name in enumerate(names)}
    for name, value in values.items():
        out[place[name]] = value
    return out


class OrientedSensor:
    """Sensor that always uses one correction; all its other attributes come from the original sensor.

    Parameters
    ----------
    sensor : PushbroomSensor, RpcSensor or FrameSensor
    correction : Correction or array
        Correction that its methods use, for example ``solution.correction("left")``.
    doubts : sequence of Finding
        Doubts on the adjustment, which come first among the notes.
    """

    def __init__(self, sensor: Any, correction: Any, doubts: Sequence[Finding] = ()) -> None:
        self.sensor, self.correction = sensor, correction
        self.notes: tuple[Finding, ...] = (*doubts, *sensor.notes, finding("image.adjusted"))

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the sensor."""
        return getattr(self.sensor, name)

    def rays(self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: None = None) -> tuple[Array, Array]:
        """Return points (N, 3), m, on the lines of sight, and unit directions (N, 3), ECEF."""
        centre, direction = self.sensor.rays(line, sample, self.correction)
        return centre, direction

    def locate(self, line: npt.ArrayLike, sample: npt.ArrayLike, **surface: Any) -> Array:
        """Return ground points (N, 3), ECEF m; for ``height_m`` and ``dem`` see :meth:`Sensor.locate`."""
        return np.asarray(self.sensor.locate(line, sample, **surface, correction=self.correction))

    def project(self, ground_m: npt.ArrayLike, correction: None = None) -> tuple[Array, Array]:
        """Project ECEF points (N, 3) into the image: line and sample (N,)."""
        line, sample = self.sensor.project(ground_m, self.correction)
        return line, sample
