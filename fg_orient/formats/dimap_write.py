"""Writer of DIMAP metadata for simulated images: SPOT-5 (DIMAP 1.1) and Pléiades-like (DIMAP 2.0).

Only elements that a reader of the rigorous model needs are written, under a head that names the software as producer,
so that no simulated file passes for a real one. Every number is printed with the digits that identify the float (17
where needed), times likewise: reading a written file gives the same records bit by bit.

The writers make trees of dictionaries: the value of an element name is its text, its children, or a list of these for
an element that repeats; a list of pairs is children in order.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal
from typing import Any, Final
from xml.sax.saxutils import escape

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
Pairs = list[tuple[str, Any]]

_HEAD: Final = '<?xml version="1.0" encoding="UTF-8"?>\n'
PRODUCER: Final = "fg_orient simulator"
_PROFILES: Final = {"SPOT 6": "S6_SENSOR", "SPOT 7": "S7_SENSOR"}


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
    timing, day = metadata.timing, metadata.epoch
    points = [
        {"Location": dict(zip("XYZ", p, strict=True)), "Velocity": dict(zip("XYZ", v, strict=True)), "TIME": time}
        for time, p, v in _states(metadata)
    ]
    angles = [
        {"TIME": _time(day, t), "YAW": yaw, "PITCH": pitch, "ROLL": roll, "OUT_OF_RANGE": "N"}
        for t, (roll, pitch, yaw) in zip(
            metadata.attitude.time_s, ATTITUDE_SIGN * metadata.attitude.angles_rad, strict=True
        )
    ]
    stamp = {
        "LINE_PERIOD": float(timing.line_period_s), "SCENE_CENTER_TIME": _time(day, timing.reference_time_s),
        "SCENE_CENTER_LINE": _from_1(timing.reference_line),
        "SCENE_CENTER_COL": metadata.n_samples // 2 + DIMAP_FIRST_PIXEL,
    }  # fmt: skip
    looks = {"Instrument_Look_Angles": {"BAND_INDEX": 1, "Look_Angles_List": {"Look_Angles": _look_rows(look)}}}
    date, clock = _time(day, timing.reference_time_s).split("T")
    instrument, _, index = metadata.instrument.partition(" ")
    scene = {
        "IMAGING_DATE": date, "IMAGING_TIME": clock[:8], "MISSION": "SPOT", "MISSION_INDEX": 5,
        "INSTRUMENT": instrument or "HRG", "INSTRUMENT_INDEX": index or 1,
    }  # fmt: skip
    _write(path, {
        "Metadata_Id": {'METADATA_FORMAT version="1.1"': "DIMAP", "METADATA_PROFILE": "SPOTSCENE_1A"},
        "Dataset_Id": {"DATASET_NAME": dataset_name, "COPYRIGHT": "simulated, no real image"},
        "Production": {"PRODUCT_INFO": "Simulated scene level 1A", "DATASET_PRODUCER_NAME": PRODUCER},
        **_frame1(metadata.frame_points),
        "Raster_CS": {"RASTER_CS_TYPE": "POINT", "PIXEL_ORIGIN": DIMAP_FIRST_PIXEL},
        "Dataset_Sources": {"Source_Information": {"SOURCE_TYPE": "SCENE", "Scene_Source": scene}},
        "Raster_Dimensions": _size(metadata),
        "Data_Processing": {"PROCESSING_LEVEL": "1A", "GEOMETRIC_PROCESSING": "RAW"},
        "Data_Strip": {
            "Ephemeris": {"Points": {"Point": points}},
            "Satellite_Attitudes": {
                "Corrected_Attitudes": {"STAR_TRACKER_USED": "Y", "Corrected_Attitude": {"Angles": angles}}
            },
            "Sensor_Configuration": {"Time_Stamp": stamp, "Instrument_Look_Angles_List": looks},
        },
    })  # fmt: skip


def _look_rows(look: LookAngleTable) -> list[dict[str, Any]]:
    return [
        {"DETECTOR_ID": int(sample) + DIMAP_FIRST_PIXEL, "PSI_X": psi_x, "PSI_Y": psi_y}
        for sample, psi_x, psi_y in zip(look.sample, look.psi_x_rad, look.psi_y_rad, strict=True)
    ]


def _frame1(points: tuple[FramePoint, ...]) -> dict[str, Any]:
    """Frame points as corners and as tie points; nothing if there are none."""
    if not points:
        return {}
    vertices: Pairs = [
        ("Scene_Center" if p.id == "centre" else "Vertex", {
            "FRAME_LON": float(p.lon_deg), "FRAME_LAT": float(p.lat_deg), "FRAME_ROW": _from_1(p.line),
            "FRAME_COL": _from_1(p.sample),
        })
        for p in points
    ]  # fmt: skip
    ties = [
        {"TIE_POINT_CRS_X": float(p.lon_deg), "TIE_POINT_CRS_Y": float(p.lat_deg), "TIE_POINT_CRS_Z": FRAME_HEIGHT_M,
         "TIE_POINT_DATA_X": _from_1(p.sample), "TIE_POINT_DATA_Y": _from_1(p.line)}
        for p in points if p.id != "centre"
    ]  # fmt: skip
    return {
        "Dataset_Frame": vertices,
        "Coordinate_Reference_System": {"Horizontal_CS": {"HORIZONTAL_CS_CODE": "epsg:4326"}},
        "Geoposition": {"Geoposition_Points": {"Tie_Point": ties}},
    }


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
    limits = {name: _time(metadata.epoch, t) + "Z" for name, t in (("START", timing.reference_time_s), ("END", end))}
    points = [
        {'LOCATION_XYZ unit="m"': _numbers(p), 'VELOCITY_XYZ unit="m/s"': _numbers(v), "TIME": time + "Z"}
        for time, p, v in _states(metadata)
    ]
    angles = {
        f"{name}_{k}": value
        for name, row in (("XLOS", look.tan_psi_y), ("YLOS", look.tan_psi_x))
        for k, value in enumerate(row)
    }
    band = {
        "BAND_ID": "P",
        "Swath_Range": {"FIRST_COL": int(look.origin_sample) + DIMAP_FIRST_PIXEL, "LAST_COL": metadata.n_samples},
        "Polynomial_Look_Angles": angles,
    }  # fmt: skip
    model = {
        "MODEL_USED": "SENSOR",
        "Time": {"Time_Range": limits, "Time_Stamp": {'LINE_PERIOD unit="s"': float(timing.line_period_s)}},
        "Ephemeris": {"Point_List": {"Point": points}},
        "Attitudes": _quaternions(metadata.epoch, metadata.attitude),
        "Geometric_Calibration": {"Instrument_Calibration": {"Band_Calibration_List": {"Band_Calibration": band}}},
    }
    extent: Pairs = [
        ("Center" if p.id == "centre" else "Vertex", {
            "LON": float(p.lon_deg), "LAT": float(p.lat_deg), "COL": _from_1(p.sample), "ROW": _from_1(p.line),
        })
        for p in metadata.frame_points
    ]  # fmt: skip
    profile = _PROFILES.get(metadata.mission, "PHR_SENSOR")
    name, _, index = metadata.mission.partition(" ")
    strip = {"MISSION": name, "MISSION_INDEX": index, "INSTRUMENT": name, "INSTRUMENT_INDEX": index}
    _write(path, {
        "Metadata_Identification": {
            'METADATA_FORMAT version="2.0"': "DIMAP", "METADATA_PROFILE": profile, "METADATA_SUBPROFILE": "PRODUCT",
        },
        "Dataset_Identification": {"DATASET_NAME": dataset_name},
        **({"Dataset_Content": {"Dataset_Extent": extent}} if extent else {}),
        "Product_Information": {"Producer_Information": {"PRODUCER_NAME": PRODUCER}},
        "Geoposition": {"Raster_CS": {"PIXEL_ORIGIN": DIMAP_FIRST_PIXEL}},
        "Raster_Data": {"Raster_Dimensions": _size(metadata)},
        "Geometric_Data": {"Refined_Model": model},
        **({"Dataset_Sources": {"Source_Identification": {"Strip_Source": strip}}} if index else {}),
    })  # fmt: skip


def _quaternions(epoch: np.datetime64, attitude: QuaternionList | QuaternionPolynomial) -> dict[str, Any]:
    if isinstance(attitude, QuaternionList):
        return {"Quaternion_List": {"Quaternion": [
            {"Q_STATUS": "NOMINAL", **{f"Q{j}": value for j, value in enumerate(q)}, "TIME": _time(epoch, t) + "Z"}
            for t, q in zip(attitude.time_s, attitude.quaternion, strict=True)
        ]}}  # fmt: skip
    rows = {
        f"Q{j}": {"DEGREE": len(row) - 1, "COEFFICIENTS": _numbers(row)} for j, row in enumerate(attitude.coefficients)
    }
    return {"Polynomial_Quaternions": {"OFFSET": float(attitude.offset_s), "SCALE": float(attitude.scale_s), **rows}}


# --- text ----------------------------------------------------------------------------------------


def _write(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    write_text(path, _HEAD + "\n".join(_elements([("Dimap_Document", content)])) + "\n")


def _elements(pairs: Iterable[tuple[str, Any]]) -> Iterator[str]:
    """Lines of elements, given by name with attributes and content."""
    for tag, value in pairs:
        for content in value if _repeats(value) else [value]:
            if isinstance(content, Mapping | list):
                yield f"<{tag}>"
                yield from _elements(content.items() if isinstance(content, Mapping) else content)
                yield f"</{tag.partition(' ')[0]}>"
            else:
                text = repr(float(content)) if isinstance(content, float) else escape(str(content))
                yield f"<{tag}>{text}</{tag.partition(' ')[0]}>"


def _repeats(value: object) -> bool:
    """Tell a list of contents of one element from a list of pairs."""
    return isinstance(value, list) and not (value and isinstance(value[0], tuple))


def _from_1(pixel: float) -> float:
    """Line or sample in the count of the file."""
    return float(pixel + DIMAP_FIRST_PIXEL)


def _size(metadata: PushbroomMetadata) -> dict[str, int]:
    return {"NCOLS": metadata.n_samples, "NROWS": metadata.n_lines, "NBANDS": 1}


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


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


def _states(metadata: PushbroomMetadata) -> Iterator[tuple[str, Array, Array]]:
    """Time, position and velocity of each state vector."""
    orbit = metadata.ephemeris
    for t, position, velocity in zip(orbit.time_s, orbit.position_m, orbit.velocity_m_s, strict=True):
        yield _time(metadata.epoch, t), position, velocity
