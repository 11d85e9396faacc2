"""Image geometry of a rectification: a sensor with its adjusted correction, or a fitted transformation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np

from factors.arrays import Array
from fg_orient.formats.table_write import table_file
from fg_orient.formats.text_files import sha256_of
from fg_orient.geodesy import ecef_to_geodetic, from_geographic, geodetic_to_ecef, to_geographic
from fg_orient.model.errors import Finding, InputError
from fg_orient.model.names import Status
from fg_orient.model.options import Options
from fg_orient.result.plain import read_table
from fg_orient.result.record import RESULT_FILE, doubts_about, read_record
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.simulation import QuickProjection

if TYPE_CHECKING:
    from fg_orient.rectification.transformation import Transformation


class AdjustedOrientation(NamedTuple):
    """Correction of a sensor from a result folder, and the doubts on the adjustment; by default none."""

    correction: Any = None
    doubts: Sequence[Finding] = ()


def read_orientation(folder: Path | None, sensor: Sensor, image: str = "") -> AdjustedOrientation:
    """Read the adjusted correction of one image, and the doubts on the adjustment.

    Parameters
    ----------
    folder : Path or None
        Result folder: table ``eop`` and ``result.json``. Without one there is no correction and no doubt.
    sensor : Sensor
        Sensor of this image.
    image : str
        Image id. Default: the image with the sensor's metadata file, compared by content
        if the result recorded it, else by name.

    Raises
    ------
    InputError
        The folder or image does not exist; the image has other metadata than the sensor;
        several images have the same metadata; or the unknowns belong to another kind of
        sensor.
    """
    if folder is None:
        return AdjustedOrientation()
    try:
        record = read_record(folder)
        if record["status"] == Status.RANK_DEFICIENT:
            raise InputError.of("report.nothing_adjusted", file=folder, place=RESULT_FILE, value=record["status"])
        options = record["provenance"]["options"]
        small_angle, n_curves = bool(options["small_angle"]), int(options.get("curve_intervals", 0))
        jitter = tuple(options.get("jitter_curves", ()))
        files = _files(record)
        eop = read_table(table_file(folder, "eop"))
        values: dict[str, dict[str, float]] = {name: {} for name in files}
        columns = (eop.words["image"], eop.words["parameter"], eop.figures["value_per_tau"].tolist())
        for image_id, parameter, value in zip(*columns, strict=True):
            values[image_id][parameter] = value
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError.of("ortho.result", file=folder, known="-") from None
    name = _chosen(files, folder, Path(sensor.file), image)
    _require_light(record, name, sensor)
    try:
        chosen = Options(small_angle=small_angle, curve_intervals=n_curves, jitter_curves=jitter)
        return AdjustedOrientation(sensor.correction_of(values[name], chosen), doubts_about(record, folder))
    except KeyError:
        raise InputError.of("ortho.other_sensor", file=folder, place=f"image {name}", value=sensor.file) from None


def _require_light(record: dict[str, Any], image: str, sensor: Any) -> None:
    """Refuse a sensor with other effects on light than in the adjustment.

    The correction of the adjustment contains the difference between the effects.
    """
    stated = next((entry.get("light") for entry in record["images"] if str(entry["id"]) == image), None)
    effects = getattr(sensor.metadata, "effects", None) if stated else None
    if stated is None or effects is None:
        return
    wrong = [one["effect"] for one in stated if bool(one["applied"]) != getattr(effects, one["effect"])]
    if wrong:
        used = ",".join(one["effect"] for one in stated if one["applied"]) or "none"
        raise InputError.of("ortho.light (failure): the image was adjusted with other effects on light -> give <light> "
                            "{used}", file=sensor.file, value=", ".join(wrong), used=used)  # fmt: skip


def _files(record: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Return the name and SHA-256 of the metadata file of each image; "" if unavailable.

    The inputs of a run are its project file, then one metadata file per image.
    """
    names = [(str(entry["id"]), str(entry["file"])) for entry in record["images"]]
    inputs = record["provenance"].get("inputs", [])[1 : 1 + len(names)]
    digests = [str(source["sha256"]) for source in inputs] if len(inputs) == len(names) else [""] * len(names)
    return {image: (file, digest) for (image, file), digest in zip(names, digests, strict=True)}


def _chosen(files: dict[str, tuple[str, str]], folder: Path, metadata: Path, image: str) -> str:
    """Find the image id by the content of the metadata file; if the content is not recorded, by its name.

    Products of one mission often have the same file name.
    """
    digest = sha256_of(metadata) if metadata.is_file() else ""
    same = [
        key for key, (file, known) in files.items() if (known == digest if known and digest else file == metadata.name)
    ]
    if image in files:
        if image not in same:
            raise InputError.of(
                "ortho.other_image", file=metadata, option="image_id", image=image, known=files[image][0]
            )
        return image
    named = [key for key, (file, _) in files.items() if file == metadata.name]
    if image or not (same or named):
        raise InputError.of("ortho.result", file=folder, value=image or metadata.name, known=", ".join(files))
    if not same:
        raise InputError.of(
            "ortho.other_image",
            file=metadata,
            option="result",
            image=named[0],
            known=f"{files[named[0]][0]} of another content",
        )
    if len(same) > 1:
        raise InputError.of("ortho.which_image", file=metadata, option="image_id", known=" or ".join(same))
    return same[0]


#: Number of pixels along each side of an image that give its outline on the map.
BORDER: Final = 9
NEWTON_STEPS: Final = 30
#: The iteration ends if a step is shorter than this, relative to the coordinates (at least 1 pixel or metre).
LAST_STEP: Final = 1e-9


class MapModel(Protocol):
    """Image geometry for rectification."""

    needs_heights: bool
    #: Number of lines and samples of the image; None if unavailable.
    size: tuple[int, int] | None
    #: Approximate height of the ground.
    mean_height_m: float

    def pixels(self, x: Array, y: Array, height_m: Array) -> Array:
        """Return line and sample (n, 2) of n points of the map; nan if there is no such pixel."""
        ...

    def outline(self, size: tuple[int, int], heights_m: tuple[float, float]) -> tuple[Array, Array]:
        """Return the map coordinates of the border pixels of an image of this size, at both heights."""
        ...


def border_pixels(size: tuple[int, int]) -> tuple[Array, Array]:
    """Return the lines and samples of a regular grid up to the outer border of an image."""
    lines, samples = (np.linspace(-0.5, n - 0.5, BORDER) for n in size)
    grid_l, grid_s = (a.ravel() for a in np.meshgrid(lines, samples, indexing="ij"))
    return grid_l, grid_s


class SensorModel:
    """Sensor with its correction (see ``MapModel``).

    Parameters
    ----------
    sensor : Sensor
    correction : Correction, (6,) or (15,) array, optional
        Correction for ``sensor.project``.
    crs : str
        Coordinate system of the map.
    top_m : float
        Largest common height, up to which the quick projection is used.
    """

    needs_heights = True

    def __init__(self, sensor: Sensor, correction: Any, crs: str, top_m: float) -> None:
        self.sensor, self.correction, self.crs = sensor, correction, crs
        self.size: tuple[int, int] | None = (sensor.n_lines, sensor.n_samples)
        self.mean_height_m = float(sensor.mean_height_m)
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
        borders = []
        for height in heights_m:
            ground = self.sensor.locate(line, sample, height_m=height, correction=self.correction)
            lon, lat, _ = ecef_to_geodetic(ground)
            borders.append(np.stack(from_geographic(self.crs, lon, lat)))
        x, y = np.concatenate(borders, axis=1)
        return x, y


class PointModel:
    """Transformation of ``rectify fit`` (see ``MapModel``) with the map coordinates of the grid.

    Parameters
    ----------
    transformation : Transformation
    """

    size: tuple[int, int] | None = None

    def __init__(self, transformation: Transformation) -> None:
        self._t = transformation
        self._forward = transformation.source_names == ("sample", "line")
        self.needs_heights = transformation.model.dimension == 3
        self.mean_height_m = float(transformation.source.offset[2]) if self.needs_heights else 0.0

    def pixels(self, x: Array, y: Array, height_m: Array) -> Array:
        """See ``MapModel``; a transformation from image to map is inverted by Newton's method."""
        if self.needs_heights:
            return self._t.apply(np.stack([x, y, height_m], axis=1))
        plane, t = np.stack([x, y], axis=1), self._t
        if not self._forward:
            return t.apply(plane)[:, ::-1]
        return solved(t.apply, plane, t.source.offset, t.source.scale)[:, ::-1]

    def outline(self, size: tuple[int, int], heights_m: tuple[float, float]) -> tuple[Array, Array]:
        """See ``MapModel``; a transformation from map to image is inverted by Newton's method.

        Raises
        ------
        InputError
            A pixel of the border has no point on the map.
        """
        line, sample = border_pixels(size)
        pixel = np.stack([sample, line], axis=1)
        if self._forward:
            x, y = self._t.apply(pixel).T
            return x, y
        borders = [self._ground(pixel, height) for height in (heights_m if self.needs_heights else heights_m[:1])]
        x, y = np.concatenate(borders).T
        return x, y

    def _ground(self, pixel: Array, height_m: float) -> Array:
        """Return map coordinates (n, 2) of (sample, line) at a height, iterated from the centre of control points."""
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
    """Return the arguments of given values of a function, by Newton's method with central differences.

    Parameters
    ----------
    map_of : callable
        Function that returns values (n, 2) of arguments (n, 2).
    wanted : (n, 2) array
        Values.
    start, scale : (2,) arrays
        First argument; differences are a thousandth of the scale.

    Returns
    -------
    (n, 2) array
        Arguments; nan if the iteration does not converge, or the derivatives vanish.
    """
    out = np.tile(start, (len(wanted), 1))
    todo = np.arange(len(wanted))
    half = 0.5e-3 * scale
    for _ in range(NEWTON_STEPS):
        if not len(todo):
            break
        at = out[todo]
        columns = [(map_of(at + d) - map_of(at - d)) / (2.0 * d.sum()) for d in np.diag(half)]
        jacobian = np.stack(columns, axis=2)
        regular = np.abs(np.linalg.det(jacobian)) > 0.0
        step = np.full_like(at, np.nan)
        miss = (wanted[todo] - map_of(at))[regular, :, None]
        step[regular] = np.linalg.solve(jacobian[regular], miss)[:, :, 0]
        out[todo] += step
        todo = todo[np.abs(step).max(axis=1) > LAST_STEP * np.maximum(1.0, np.abs(at).max(axis=1))]
    out[todo] = np.nan
    return out
