"""Read and write line-scan states of the Community Sensor Model (``USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL``).

A state is the name of its model and a JSON object. In CSM, the centre of the first pixel
is (0.5, 0.5). The time of a line is a linear function in each segment. Lagrange
polynomials through eight samples interpolate positions and quaternions. A quaternion (x,
y, z, w) rotates camera axes to body-fixed axes. The line of sight in camera axes is ``(z
x, z y, focal)``, where z is ``m_zDirection``, and x, y are coordinates in the focal plane
without distortion (``fg_orient.sensors.focal_plane``). The fields follow the published
definitions. The library USGSCSM is not needed (docs/line-scan.md).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.geometry.interpolation import sign_aligned
from fg_orient.formats.csm import (
    LINE_SCAN_MODEL,
    UNIT,
    body_of,
    distortion_of,
    line_directions,
    line_timing,
    open_state,
)
from fg_orient.formats.csm_write import write_state
from fg_orient.formats.json_files import JsonFile
from fg_orient.formats.metadata.csm_frame import write_state as write_frame
from fg_orient.formats.registry import Format
from fg_orient.model.errors import InputError
from fg_orient.sensors.focal_plane import Detector
from fg_orient.sensors.framing import FramingSensor
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.light_sizes import chosen, noted
from fg_orient.sensors.metadata import (
    DirectionTable,
    Ephemeris,
    GeneralMetadata,
    LightEffects,
    LineTiming,
    QuaternionList,
)

#: Heights, m, at which a written file is compared with its image.
HEIGHTS_M: Final = (0.0, 1000.0)
#: Number of lines, and of samples, at which they are compared.
SIDE: Final = 25
#: Platform flag of satellites. Their polynomials use four samples on each side; polynomials of aircraft
#: use fewer.
_SATELLITE: Final = 1


def read_state(path: str | Path, light: tuple[str, ...] = ()) -> GeneralMetadata:
    """Read a line-scan state.

    Raises
    ------
    InputError
        A value is missing or impossible, or the state has a feature that is not
        supported: parameters that are not zero, a distortion that ``formats.csm`` does
        not have, or the interpolation for aircraft. Effects on light are chosen, and the
        body is not the Earth.
    """
    path = Path(path)
    state = open_state(path, LINE_SCAN_MODEL)
    size = state.count("m_nLines"), state.count("m_nSamples")
    _require_plain(state)
    look, mounting = _directions(state, size[1])
    body = body_of(state)
    effects = chosen(light, LightEffects())
    if body is not None and effects:
        raise InputError.of("body.light", file=path, option="light", value=body.name)
    sensor = state.text("m_sensorName", "") or state.text("m_sensorIdentifier", "")
    return GeneralMetadata(
        file=str(path), mission=state.text("m_platformIdentifier", ""), instrument=sensor, format="CSM state",
        epoch=np.datetime64("1970-01-01", "D"), n_lines=size[0], n_samples=size[1], timing=_timing(state),
        ephemeris=_ephemeris(state), attitude=_attitude(state), look=look, offset_m=np.zeros(3),
        mounting=mounting, effects=effects, body=body,
    )  # fmt: skip


def _require_plain(state: JsonFile) -> None:
    """Refuse features that are not supported."""
    changed = np.flatnonzero(state.numbers("m_currentParameterValue", -1, default=[0.0]))
    if len(changed):
        place = f"m_currentParameterValue, number {changed[0] + 1}"
        raise InputError.of("csm.parameters", file=state.path, place=place)
    flag = state.number("m_platformFlag", default=_SATELLITE)
    if flag != _SATELLITE:
        raise InputError.of("csm.aircraft", file=state.path, place="m_platformFlag", value=f"{flag:g}")


def _timing(state: JsonFile) -> LineTiming:
    """Read the times of the lines.

    A segment begins half a line before the centre of its first line.
    """
    line = state.numbers("m_intTimeLines", -1)
    start, period = (state.numbers(name, len(line)) for name in ("m_intTimeStartTimes", "m_intTimes"))
    return line_timing(line, start, period, file=state.path, places=("m_intTimes", "m_intTimeLines"))


def _listed(state: JsonFile, name: str, width: int, place: str) -> tuple[Array, Array]:
    """Read times (n,) and values (n, width) of a list with at least two entries."""
    values = state.numbers(name, -1)
    start, step = (state.number(f"m_{word}{place}") for word in ("t0", "dt"))
    n = len(values) // width
    if len(values) != n * width or n < 2 or not step > 0.0:
        value = f"{len(values)} numbers, step {step:g}"
        raise InputError.of("csm.list", file=state.path, place=name, width=width, value=value)
    return np.asarray(start + step * np.arange(n)), np.asarray(values.reshape(n, width))


def _ephemeris(state: JsonFile) -> Ephemeris:
    time_s, position = _listed(state, "m_positions", 3, "Ephem")
    velocity = state.numbers("m_velocities", position.size).reshape(-1, 3)
    return Ephemeris(time_s, position, velocity, scheme="centred")


def _attitude(state: JsonFile) -> QuaternionList:
    time_s, xyzw = _listed(state, "m_quaternions", 4, "Quat")
    away = np.abs(np.linalg.norm(xyzw, axis=1) - 1.0)
    if away.max() > UNIT:
        raise InputError.of("earth.quaternion", file=state.path, place=f"m_quaternions, record {away.argmax() + 1}",
                            value=f"{away.max():.2g} off 1")  # fmt: skip
    return QuaternionList(time_s, sign_aligned(np.roll(xyzw, 1, axis=1)), scheme="centred")


def _directions(state: JsonFile, n_samples: int) -> tuple[DirectionTable, Array]:
    """Return the directions of all samples, and the rotation from our camera axes to the axes of the state.

    The detector has only one line. The line of the image determines the time.
    """
    distortion = distortion_of(state)
    lines, samples = (tuple(state.numbers(name, 3).tolist()) for name in ("m_iTransL", "m_iTransS"))
    detector = Detector(
        (state.number("m_detectorLineOrigin"), state.number("m_detectorSampleOrigin")), lines, samples,
        (1.0, state.number("m_detectorSampleSumming", default=1.0)),
        (state.number("m_startingDetectorLine", default=0.0), state.number("m_startingDetectorSample", default=0.0)),
    )  # fmt: skip
    focal, z = state.number("m_focalLength"), state.number("m_zDirection", default=1.0)
    summing = detector.summing[1]
    if not (focal > 0.0 and abs(z) == 1.0 and summing > 0.0 and np.linalg.det(detector.per_mm) != 0.0):
        place = "m_focalLength, m_zDirection, m_detectorSampleSumming, m_iTransL, m_iTransS"
        raise InputError.of("csm.camera", file=state.path, place=place, value=f"{focal:g}, {z:g}, {summing:g}")
    sample = np.arange(n_samples, dtype=float)
    x, y = (z * distortion.ideal(detector.millimetres(np.full(n_samples, -0.5), sample)) / focal).T
    return line_directions(x, y)


def write_compared(
    path: Path, sensor: Any, correction: Any = None, columns: tuple[int, int] | None = None
) -> dict[str, Any]:  # fmt: skip
    """Write a state, read it again, and compare it with the image.

    The file converts pixels to ground points, and the image converts them back to pixels.
    A frame image is written as a frame state. ``columns``: as in :func:`fg_orient.formats.csm_write.write_state`.

    Returns
    -------
    dict
        Record of :func:`fg_orient.formats.csm_write.write_state`, and the differences
        ``largest_px`` and ``mean_px`` over image and heights.
    """
    if isinstance(sensor, FramingSensor):
        if columns is not None:
            raise InputError.of("csm.bands", file=sensor.file, option="bands", value=type(sensor).__name__)
        return write_frame(path, sensor, correction)
    record = write_state(path, sensor, correction, columns)
    written = GeneralPushbroom(read_state(path))
    line, sample = written.grid(SIDE)
    here = np.stack([line, sample + (columns[0] if columns else 0)])
    apart = [np.hypot(*(np.stack(sensor.project(written.locate(line, sample, height_m=h), correction)) - here))
             for h in HEIGHTS_M]  # fmt: skip
    return record | {"largest_px": float(np.max(apart)), "mean_px": float(np.mean(apart))}


def _is_state(_: Path, head: str) -> bool:
    return LINE_SCAN_MODEL in head[:400] and "name_model" not in head[:400]


FORMAT = Format(
    name="csm-state", title="CSM line-scan state", sniff=_is_state, chooses_light=True, write_image=write_compared,
    in_bands=True, read_image=lambda path, light=(): noted(GeneralPushbroom(read_state(path, light))),
)  # fmt: skip
