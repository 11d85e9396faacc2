"""What takes map coordinates and heights to pixels: a sensor with its correction, or a transformation by points."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import ecef_to_geodetic, from_geographic, geodetic_to_ecef, same_crs, to_geographic
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import FrameSensor
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.simulate.quick_projection import QuickProjection

if TYPE_CHECKING:
    from fg_orient.rectification.transformation import Transformation

Array = npt.NDArray[np.float64]
Sensor = PushbroomSensor | RpcSensor | FrameSensor

#: Pixels along each side of an image whose places give its outline on the map.
BORDER: Final = 9
NEWTON_STEPS: Final = 30
#: A place is found when a step is shorter, by its size (1 and more: pixels, metres).
LAST_STEP: Final = 1e-9


class MapModel(Protocol):
    """Image geometry as rectification sees it."""

    needs_heights: bool
    #: Lines and samples of the image; None where the model does not know.
    size: tuple[int, int] | None

    def pixels(self, x: Array, y: Array, height_m: Array) -> Array:
        """Line and sample (n, 2) of n places of the map; nan where there is none."""
        ...

    def outline(self, size: tuple[int, int], heights_m: tuple[float, float]) -> tuple[Array, Array]:
        """Map coordinates of border pixels of an image of this size, at both heights."""
        ...


def border_pixels(size: tuple[int, int]) -> tuple[Array, Array]:
    """Lines and samples along the outer border of an image and in its middle."""
    lines, samples = (np.linspace(-0.5, n - 0.5, BORDER) for n in size)
    grid_l, grid_s = (a.ravel() for a in np.meshgrid(lines, samples, indexing="ij"))
    return grid_l, grid_s


class SensorModel:
    """A sensor with its correction (see ``MapModel``).

    Parameters
    ----------
    sensor : PushbroomSensor, RpcSensor or FrameSensor
    correction : Correction, (6,) or (15,) array, optional
        As ``sensor.project`` takes it.
    crs : str
        Of the map.
    top_m : float
        Largest height that is common: up to it the projection is quick.
    """

    needs_heights = True

    def __init__(self, sensor: Sensor, correction: Any, crs: str, top_m: float) -> None:
        self.sensor, self.correction, self.crs = sensor, correction, crs
        self.size: tuple[int, int] | None = (sensor.n_lines, sensor.n_samples)
        self._quick: QuickProjection | None = None
        if isinstance(sensor, PushbroomSensor):
            from fg_orient.sensors.correction import Correction

            self.correction = correction or Correction()
            self._quick = QuickProjection(sensor, self.correction, top_m)

    def pixels(self, x: Array, y: Array, height_m: Array) -> Array:
        """See ``MapModel``."""
        lon, lat = to_geographic(self.crs, x, y)
        out, good = np.full((len(lon), 2), np.nan), np.flatnonzero(np.isfinite(lon) & np.isfinite(height_m))
        if len(good):
            h = np.ascontiguousarray(height_m[good])
            ground = geodetic_to_ecef(lon[good], lat[good], h)
            if self._quick is not None:
                out[good] = self._quick.project(ground, h)
            else:
                out[good] = np.stack(self.sensor.project(ground, self.correction), axis=1)
        return out

    def outline(self, size: tuple[int, int], heights_m: tuple[float, float]) -> tuple[Array, Array]:
        """See ``MapModel``."""
        line, sample = border_pixels(size)
        found = []
        for height in heights_m:
            if isinstance(self.sensor, RpcSensor):
                ground = self.sensor.locate(line, sample, height_m=height, compensation=self.correction)
            else:
                ground = self.sensor.locate(line, sample, height_m=height, correction=self.correction)
            lon, lat, _ = ecef_to_geodetic(ground)
            found.append(np.stack(from_geographic(self.crs, lon, lat)))
        x, y = np.concatenate(found, axis=1)
        return x, y


class PointModel:
    """A transformation of ``rectify fit`` (see ``MapModel``); its map coordinates must be those of the grid.

    Parameters
    ----------
    transformation : Transformation
    """

    size: tuple[int, int] | None = None

    def __init__(self, transformation: Transformation) -> None:
        self._t = transformation
        self._forward = transformation.source_names == ("sample", "line")
        self.needs_heights = transformation.model.dimension == 3

    def pixels(self, x: Array, y: Array, height_m: Array) -> Array:
        """See ``MapModel``; the inverse of image-to-map by Newton's method."""
        if self.needs_heights:
            return self._t.apply(np.stack([x, y, height_m], axis=1))
        plane = np.stack([x, y], axis=1)
        return (self._inverse(plane) if self._forward else self._t.apply(plane))[:, ::-1]

    def _inverse(self, plane: Array) -> Array:
        """Sample and line (n, 2) whose map coordinates these are; from the centre of the control points."""
        t = self._t
        return solved(t.apply, plane, t.source.offset, t.source.scale)

    def outline(self, size: tuple[int, int], heights_m: tuple[float, float]) -> tuple[Array, Array]:
        """See ``MapModel``; without heights only for image-to-map, else the border is searched for by Newton.

        Raises
        ------
        InputError
            A pixel of the border is not found on the map.
        """
        line, sample = border_pixels(size)
        pixel = np.stack([sample, line], axis=1)
        if self._forward:
            x, y = self._t.apply(pixel).T
            return x, y
        found = [self._ground(pixel, height) for height in (heights_m if self.needs_heights else heights_m[:1])]
        x, y = np.concatenate(found).T
        return x, y

    def _ground(self, pixel: Array, height_m: float) -> Array:
        """Map coordinates (n, 2) of (sample, line) at a height; from the centre of the control points."""
        t = self._t

        def image(place: Array) -> Array:
            return self.pixels(place[:, 0], place[:, 1], np.full(len(place), height_m))[:, ::-1]

        place = solved(image, pixel, t.source.offset[:2], t.source.scale[:2])
        lost = np.flatnonzero(np.isnan(place).any(axis=1))
        if len(lost):
            sample, line = pixel[lost[0]]
            raise InputError.of("ortho.outline", place=f"line {line:g}, sample {sample:g}")
        return place


def solved(map_of: Callable[[Array], Array], wanted: Array, start: Array, scale: Array) -> Array:
    """Places that a map takes to wanted values, by Newton's method with central differences.

    Parameters
    ----------
    map_of : callable
        Takes places (n, 2) to values (n, 2).
    wanted : (n, 2) array
    start, scale : (2,) arrays
        Place to begin at; differences are a thousandth of the scale wide.

    Returns
    -------
    (n, 2) array
        nan where the iteration does not end, or the derivatives vanish.
    """
    found = np.tile(start, (len(wanted), 1))
    todo = np.arange(len(wanted))
    half = 0.5e-3 * scale
    for _ in range(NEWTON_STEPS):
        if not len(todo):
            break
        at = found[todo]
        columns = [(map_of(at + d) - map_of(at - d)) / (2.0 * d.sum()) for d in np.diag(half)]
        jacobian = np.stack(columns, axis=2)
        regular = np.abs(np.linalg.det(jacobian)) > 0.0
        step = np.full_like(at, np.nan)
        miss = (wanted[todo] - map_of(at))[regular, :, None]
        step[regular] = np.linalg.solve(jacobian[regular], miss)[:, :, 0]
        found[todo] += step
        todo = todo[np.abs(step).max(axis=1) > LAST_STEP * np.maximum(1.0, np.abs(at).max(axis=1))]
    found[todo] = np.nan
    return found


def point_model(transformation: Transformation, crs: str) -> PointModel:
    """Bind a transformation to a map.

    One that was fitted without a coordinate system is taken to be in that of the map.

    Raises
    ------
    InputError
        It was fitted in another coordinate system.
    """
    if transformation.crs and not same_crs(transformation.crs, crs):
        raise InputError.of("ortho.other_crs", option="crs", fitted=transformation.crs)
    return PointModel(transformation)
