"""Writer of DIMAP metadata for simulated images: SPOT-5 (DIMAP 1.1) and Pléiades-like (DIMAP 2.0).

Only elements that a reader of the rigorous model needs are written, under a head that
names the software as producer, so that no simulated file passes for a real one. Every
number is printed with the digits that identify the float (17 where needed), times
likewise: reading a written file gives the same records bit by bit.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from decimal import Decimal
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import numpy.typing as npt

from fg_orient.formats.atomic import write_text
from fg_orient.formats.dimap1 import ATTITUDE_SIGN, FRAME_HEIGHT_M
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.model.errors import InputError, finding
from fg_orient.sensors.metadata import (
    AngleAttitude,
    FramePoint,
    LookAnglePolynomial,
    LookAngleTable,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)

Array = npt.NDArray[np.float64]

_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
PRODUCER = "fg_orient simulator"


def write_dimap1(path: str | os.PathLike[str], metadata: PushbroomMetadata, *, dataset_name: str = "SIMULATED") -> None:
    """Write a SPOT-5 level 1A metadata file, DIMAP 1.1, atomically.

    Parameters
    ----------
    path : path
        Target file; an existing one is replaced.
    metadata : PushbroomMetadata
        SPOT 5, attitude as angles, look angles as a table that reaches from the first to the
        last sample. Frame points are written as corners; one with id ``centre`` as
        Scene_Center. Roll and pitch get the sign of the file.
    dataset_name : str
        DATASET_NAME of the file.

    Raises
    ------
    InputError
        The metadata does not fit the format, or the file cannot be written.
    """
    if metadata.mission != "SPOT 5" or not isinstance(metadata.attitude, AngleAttitude):
        raise _misfit(path, metadata, "DIMAP 1.1", "needed: SPOT 5 with corrected attitude angles")
    look = metadata.look
    if not isinstance(look, LookAngleTable) or not np.array_equal(look.sample, np.round(look.sample)):
        raise _misfit(path, metadata, "DIMAP 1.1", "needed: look angles as a table of whole detector numbers")
    centre = metadata.timing.reference_line + DIMAP_FIRST_PIXEL
    strip = _tag("Data_Strip", [
        _tag("Ephemeris", _tag("Points", map(_point1, *_states(metadata)))),
        _tag("Satellite_Attitudes", _tag("Corrected_Attitudes", [
            _leaf("STAR_TRACKER_USED", "Y"),
            _tag("Corrected_Attitude", _angles(metadata.epoch, metadata.attitude)),
        ])),
        _tag("Sensor_Configuration", [
            _tag("Time_Stamp", [
                _leaf("LINE_PERIOD", _number(metadata.timing.line_period_s)),
                _leaf("SCENE_CENTER_TIME", _time(metadata.epoch, metadata.timing.reference_time_s)),
                _leaf("SCENE_CENTER_LINE", _number(centre)),
                _leaf("SCENE_CENTER_COL", metadata.n_samples // 2 + DIMAP_FIRST_PIXEL),
            ]),
            _tag("Instrument_Look_Angles_List", _tag("Instrument_Look_Angles", [
                _leaf("BAND_INDEX", 1), _tag("Look_Angles_List", _look_rows(look)),
            ])),
        ]),
    ])  # fmt: skip
    body = [*_head1(metadata, dataset_name), *_frame1(metadata.frame_points), *_scene1(metadata), strip]
    write_text(path, _HEAD + _tag("Dimap_Document", body) + "\n")


def write_dimap2(path: str | os.PathLike[str], metadata: PushbroomMetadata, *, dataset_name: str = "SIMULATED") -> None:
    """Write a DIMAP 2.0 sensor product file (Pléiades, SPOT 6/7), atomically.

    No command calls it: it is for tests and for users who make test data of these missions,
    as ``examples/pleiades_pair.py`` does.

    Parameters
    ----------
    path : path
        Target file; an existing one is replaced.
    metadata : PushbroomMetadata
        Attitude as quaternions (sampled or polynomial), look angles as polynomials, reference
        line 0. SPOT 6 and SPOT 7 get their profile, any other mission PHR_SENSOR.
    dataset_name : str
        DATASET_NAME of the file.

    Raises
    ------
    InputError
        The metadata does not fit the format, or the file cannot be written.
    """
    look, timing = metadata.look, metadata.timing
    if isinstance(metadata.attitude, AngleAttitude) or not isinstance(look, LookAnglePolynomial):
        raise _misfit(path, metadata, "DIMAP 2.0", "needed: quaternions and look angle polynomials")
    if timing.reference_line != 0.0 or not look.origin_sample.is_integer():
        raise _misfit(path, metadata, "DIMAP 2.0", "needed: times counted from line 0, columns from a whole number")
    end = timing.reference_time_s + timing.line_period_s * (metadata.n_lines - 1)
    limits = [
        _leaf("START", _time(metadata.epoch, timing.reference_time_s) + "Z"),
        _leaf("END", _time(metadata.epoch, end) + "Z"),
    ]
    model = _tag("Refined_Model", [
        _leaf("MODEL_USED", "SENSOR"),
        _tag("Time", [
            _tag("Time_Range", limits),
            _tag("Time_Stamp", _leaf("LINE_PERIOD", _number(timing.line_period_s), unit="s")),
        ]),
        _tag("Ephemeris", _tag("Point_List", map(_point2, *_states(metadata)))),
        _tag("Attitudes", _quaternions(metadata.epoch, metadata.attitude)),
        _tag("Geometric_Calibration", _tag("Instrument_Calibration", _look_polynomial(look, metadata.n_samples))),
    ])  # fmt: skip
    body = [*_head2(metadata, dataset_name), _tag("Geometric_Data", model), *_sources2(metadata.mission)]
    write_text(path, _HEAD + _tag("Dimap_Document", body) + "\n")


# --- elements --------------------------------------------------------------------------------


def _leaf(name: str, value: object, **attributes: str) -> str:
    return f"<{name}{_attributes(attributes)}>{escape(str(value))}</{name}>"


def _tag(name: str, children: str | Iterable[str], **attributes: str) -> str:
    inner = children if isinstance(children, str) else "\n".join(children)
    return f"<{name}{_attributes(attributes)}>\n{inner}\n</{name}>"


def _attributes(attributes: dict[str, str]) -> str:
    return "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items())


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _time(epoch: np.datetime64, seconds: float) -> str:
    """Print a time with all digits of the float, at least six after the point."""
    days, rest = divmod(Decimal(repr(float(seconds))), 86400)
    if rest < 0:
        days, rest = days - 1, rest + 86400
    hour, rest = divmod(rest, 3600)
    minute, second = divmod(rest, 60)
    date = epoch.astype("datetime64[D]") + np.timedelta64(int(days), "D")
    whole, _, digits = f"{second:f}".partition(".")
    return f"{date}T{int(hour):02d}:{int(minute):02d}:{int(whole):02d}.{digits:0<6}"


def _misfit(path: str | os.PathLike[str], metadata: PushbroomMetadata, target: str, needed: str) -> InputError:
    kinds = f"{metadata.mission}, {type(metadata.attitude).__name__}, {type(metadata.look).__name__}"
    return InputError(finding("dimap.not_writable", file=os.fspath(path), value=kinds, target=target, needed=needed))


def _states(metadata: PushbroomMetadata) -> tuple[list[str], Array, Array]:
    orbit = metadata.ephemeris
    return [_time(metadata.epoch, t) for t in orbit.time_s], orbit.position_m, orbit.velocity_m_s


# --- DIMAP 1.1 -------------------------------------------------------------------------------


def _head1(metadata: PushbroomMetadata, dataset_name: str) -> list[str]:
    return [
        _tag("Metadata_Id", [
            _leaf("METADATA_FORMAT", "DIMAP", version="1.1"), _leaf("METADATA_PROFILE", "SPOTSCENE_1A"),
        ]),
        _tag("Dataset_Id", [
            _leaf("DATASET_NAME", dataset_name), _leaf("COPYRIGHT", "simulated, no real image"),
        ]),
        _tag("Production", [
            _leaf("PRODUCT_INFO", "Simulated scene level 1A"), _leaf("DATASET_PRODUCER_NAME", PRODUCER),
        ]),
    ]  # fmt: skip


def _frame1(points: tuple[FramePoint, ...]) -> list[str]:
    if not points:
        return []

    def vertex(point: FramePoint) -> str:
        return _tag("Scene_Center" if point.id == "centre" else "Vertex", [
            _leaf("FRAME_LON", _number(point.lon_deg)), _leaf("FRAME_LAT", _number(point.lat_deg)),
            _leaf("FRAME_ROW", _number(point.line + DIMAP_FIRST_PIXEL)),
            _leaf("FRAME_COL", _number(point.sample + DIMAP_FIRST_PIXEL)),
        ])  # fmt: skip

    def tie(point: FramePoint) -> str:
        return _tag("Tie_Point", [
            _leaf("TIE_POINT_CRS_X", _number(point.lon_deg)), _leaf("TIE_POINT_CRS_Y", _number(point.lat_deg)),
            _leaf("TIE_POINT_CRS_Z", _number(FRAME_HEIGHT_M)),
            _leaf("TIE_POINT_DATA_X", _number(point.sample + DIMAP_FIRST_PIXEL)),
            _leaf("TIE_POINT_DATA_Y", _number(point.line + DIMAP_FIRST_PIXEL)),
        ])  # fmt: skip

    return [
        _tag("Dataset_Frame", map(vertex, points)),
        _tag("Coordinate_Reference_System", _tag("Horizontal_CS", _leaf("HORIZONTAL_CS_CODE", "epsg:4326"))),
        _tag("Geoposition", _tag("Geoposition_Points", [tie(p) for p in points if p.id != "centre"])),
    ]


def _scene1(metadata: PushbroomMetadata) -> list[str]:
    date, clock = _time(metadata.epoch, metadata.timing.reference_time_s).split("T")
    instrument, _, index = metadata.instrument.partition(" ")
    source = [
        _leaf("IMAGING_DATE", date), _leaf("IMAGING_TIME", clock[:8]),
        _leaf("MISSION", "SPOT"), _leaf("MISSION_INDEX", 5),
        _leaf("INSTRUMENT", instrument or "HRG"), _leaf("INSTRUMENT_INDEX", index or 1),
    ]  # fmt: skip
    return [
        _tag("Raster_CS", [_leaf("RASTER_CS_TYPE", "POINT"), _leaf("PIXEL_ORIGIN", DIMAP_FIRST_PIXEL)]),
        _tag("Dataset_Sources", _tag("Source_Information", [
            _leaf("SOURCE_TYPE", "SCENE"), _tag("Scene_Source", source),
        ])),
        _raster_dimensions(metadata),
        _tag("Data_Processing", [_leaf("PROCESSING_LEVEL", "1A"), _leaf("GEOMETRIC_PROCESSING", "RAW")]),
    ]  # fmt: skip


def _raster_dimensions(metadata: PushbroomMetadata) -> str:
    sizes = (("NCOLS", metadata.n_samples), ("NROWS", metadata.n_lines), ("NBANDS", 1))
    return _tag("Raster_Dimensions", [_leaf(name, value) for name, value in sizes])


def _point1(time: str, position: Array, velocity: Array) -> str:
    groups = (("Location", position), ("Velocity", velocity))
    parts = [
        _tag(name, [_leaf(axis, _number(v)) for axis, v in zip("XYZ", vector, strict=True)]) for name, vector in groups
    ]
    return _tag("Point", [*parts, _leaf("TIME", time)])


def _angles(epoch: np.datetime64, attitude: AngleAttitude) -> Iterable[str]:
    for t, (roll, pitch, yaw) in zip(attitude.time_s, ATTITUDE_SIGN * attitude.angles_rad, strict=True):
        yield _tag("Angles", [
            _leaf("TIME", _time(epoch, t)), _leaf("YAW", _number(yaw)), _leaf("PITCH", _number(pitch)),
            _leaf("ROLL", _number(roll)), _leaf("OUT_OF_RANGE", "N"),
        ])  # fmt: skip


def _look_rows(look: LookAngleTable) -> Iterable[str]:
    for sample, psi_x, psi_y in zip(look.sample, look.psi_x_rad, look.psi_y_rad, strict=True):
        yield _tag("Look_Angles", [
            _leaf("DETECTOR_ID", int(sample) + DIMAP_FIRST_PIXEL),
            _leaf("PSI_X", _number(psi_x)), _leaf("PSI_Y", _number(psi_y)),
        ])  # fmt: skip


# --- DIMAP 2.0 -------------------------------------------------------------------------------

_PROFILES = {"SPOT 6": "S6_SENSOR", "SPOT 7": "S7_SENSOR"}


def _head2(metadata: PushbroomMetadata, dataset_name: str) -> list[str]:
    corners = [
        _tag("Center" if p.id == "centre" else "Vertex", [
            _leaf("LON", _number(p.lon_deg)), _leaf("LAT", _number(p.lat_deg)),
            _leaf("COL", _number(p.sample + DIMAP_FIRST_PIXEL)), _leaf("ROW", _number(p.line + DIMAP_FIRST_PIXEL)),
        ])
        for p in metadata.frame_points
    ]  # fmt: skip
    extent = [_tag("Dataset_Content", _tag("Dataset_Extent", corners))] if corners else []
    return [
        _tag("Metadata_Identification", [
            _leaf("METADATA_FORMAT", "DIMAP", version="2.0"),
            _leaf("METADATA_PROFILE", _PROFILES.get(metadata.mission, "PHR_SENSOR")),
            _leaf("METADATA_SUBPROFILE", "PRODUCT"),
        ]),
        _tag("Dataset_Identification", _leaf("DATASET_NAME", dataset_name)),
        *extent,
        _tag("Product_Information", _tag("Producer_Information", _leaf("PRODUCER_NAME", PRODUCER))),
        _tag("Geoposition", _tag("Raster_CS", _leaf("PIXEL_ORIGIN", DIMAP_FIRST_PIXEL))),
        _tag("Raster_Data", _raster_dimensions(metadata)),
    ]  # fmt: skip


def _sources2(mission: str) -> list[str]:
    """Strip_Source of a mission with an index ("PHR 1A", "SPOT 6")."""
    name, _, index = mission.partition(" ")
    if not index:
        return []
    strip = [_leaf("MISSION", name), _leaf("MISSION_INDEX", index), _leaf("INSTRUMENT", name)]
    source = _tag("Strip_Source", [*strip, _leaf("INSTRUMENT_INDEX", index)])
    return [_tag("Dataset_Sources", _tag("Source_Identification", source))]


def _point2(time: str, position: Array, velocity: Array) -> str:
    return _tag("Point", [
        _leaf("LOCATION_XYZ", _numbers(position), unit="m"), _leaf("VELOCITY_XYZ", _numbers(velocity), unit="m/s"),
        _leaf("TIME", time + "Z"),
    ])  # fmt: skip


def _quaternions(epoch: np.datetime64, attitude: QuaternionList | QuaternionPolynomial) -> str:
    if isinstance(attitude, QuaternionList):
        return _tag("Quaternion_List", [
            _tag("Quaternion", [
                _leaf("Q_STATUS", "NOMINAL"),
                *(_leaf(f"Q{j}", _number(value)) for j, value in enumerate(q)),
                _leaf("TIME", _time(epoch, t) + "Z"),
            ])
            for t, q in zip(attitude.time_s, attitude.quaternion, strict=True)
        ])  # fmt: skip
    rows = [
        _tag(f"Q{j}", [_leaf("DEGREE", len(row) - 1), _leaf("COEFFICIENTS", _numbers(row))])
        for j, row in enumerate(attitude.coefficients)
    ]
    scaling = [_leaf("OFFSET", _number(attitude.offset_s)), _leaf("SCALE", _number(attitude.scale_s))]
    return _tag("Polynomial_Quaternions", [*scaling, *rows])


def _look_polynomial(look: LookAnglePolynomial, n_samples: int) -> str:
    swath = [_leaf("FIRST_COL", int(look.origin_sample) + DIMAP_FIRST_PIXEL), _leaf("LAST_COL", n_samples)]
    rows = [
        _leaf(f"{name}_{k}", _number(value))
        for name, row in (("XLOS", look.tan_psi_y), ("YLOS", look.tan_psi_x))
        for k, value in enumerate(row)
    ]
    band = [_leaf("BAND_ID", "P"), _tag("Swath_Range", swath), _tag("Polynomial_Look_Angles", rows)]
    return _tag("Band_Calibration_List", _tag("Band_Calibration", band))
