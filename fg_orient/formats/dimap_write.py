"""Write DIMAP 1.1 metadata of simulated SPOT-5 images.

The file contains only the elements that the rigorous model needs. Its head names this
program as producer. Therefore nobody can take a simulated file for a real one. Numbers
and times are written with all digits of the double (up to 17). When the file is read
again, the records are the same bit by bit. :func:`fg_orient.formats.xml.element` makes
the XML tree.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from decimal import Decimal
from typing import Any, Final

import numpy as np
from lxml import etree

from factors.arrays import Array
from fg_orient.formats.atomic import write_text
from fg_orient.formats.dimap1 import ATTITUDE_SIGN, FRAME_HEIGHT_M
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.xml import element
from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.sensors.metadata import AngleAttitude, FramePoint, LookAngleTable, PushbroomMetadata

_HEAD: Final = '<?xml version="1.0" encoding="UTF-8"?>\n'
PRODUCER: Final = "fg_orient simulator"


def write_dimap1(path: str | os.PathLike[str], metadata: PushbroomMetadata, *, dataset_name: str = "SIMULATED") -> None:
    """Write a SPOT-5 level 1A metadata file, DIMAP 1.1, atomically.

    Parameters
    ----------
    path : path
        Target file; an existing file is replaced.
    metadata : PushbroomMetadata
        Metadata of SPOT 5 with the attitude as angles. The table of look angles must
        reach from the first to the last sample. Frame points are written as corners, the
        point ``centre`` as Scene_Center. Roll and pitch get the signs of the file.
    dataset_name : str
        Value of DATASET_NAME.

    Raises
    ------
    InputError
        The metadata does not fit the format, or the file cannot be written.
    """
    look, attitude = metadata.look, metadata.attitude
    if metadata.mission != "SPOT 5" or not isinstance(attitude, AngleAttitude):
        raise _misfit(path, metadata, "needed: SPOT 5 with corrected attitude angles")
    if not isinstance(look, LookAngleTable) or not np.array_equal(look.sample, np.round(look.sample)):
        raise _misfit(path, metadata, "needed: look angles as a table of whole detector numbers")
    timing, day = metadata.timing, metadata.epoch
    points = [
        {"Location": dict(zip("XYZ", p, strict=True)), "Velocity": dict(zip("XYZ", v, strict=True)), "TIME": time}
        for time, p, v in _states(metadata)
    ]
    angles = [
        {"TIME": _time(day, t), "YAW": yaw, "PITCH": pitch, "ROLL": roll, "OUT_OF_RANGE": "N"}
        for t, (roll, pitch, yaw) in zip(attitude.time_s, ATTITUDE_SIGN * attitude.angles_rad, strict=True)
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
        "Metadata_Id": {"METADATA_FORMAT version=1.1": "DIMAP", "METADATA_PROFILE": "SPOTSCENE_1A"},
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
    """Write the frame points, if there are any, as corners and as tie points."""
    if not points:
        return {}
    vertices: list[tuple[str, Any]] = [
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


def _write(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    root = element("Dimap_Document", content)
    etree.indent(root, space="")
    write_text(path, _HEAD + etree.tostring(root, encoding="unicode") + "\n")


def _from_1(pixel: float) -> float:
    """Convert a line or sample to the numbers of the file, which start at 1."""
    return float(pixel + DIMAP_FIRST_PIXEL)


def _size(metadata: PushbroomMetadata) -> dict[str, int]:
    return {"NCOLS": metadata.n_samples, "NROWS": metadata.n_lines, "NBANDS": 1}


def _time(epoch: np.datetime64, seconds: float) -> str:
    """Format a time with all digits of the double and at least six digits after the point."""
    days, rest = divmod(Decimal(repr(float(seconds))), 86400)
    if rest < 0:
        days, rest = days - 1, rest + 86400
    hour, rest = divmod(rest, 3600)
    minute, second = divmod(rest, 60)
    date = epoch.astype("datetime64[D]") + np.timedelta64(int(days), "D")
    whole, _, digits = f"{second:f}".partition(".")
    return f"{date}T{int(hour):02d}:{int(minute):02d}:{int(whole):02d}.{digits:0<6}"


def _misfit(path: str | os.PathLike[str], metadata: PushbroomMetadata, needed: str) -> FgOrientError:
    kinds = f"{metadata.mission}, {type(metadata.attitude).__name__}, {type(metadata.look).__name__}"
    return InputError.of("dimap.not_writable", file=os.fspath(path), value=kinds, target="DIMAP 1.1", needed=needed)


def _states(metadata: PushbroomMetadata) -> Iterator[tuple[str, Array, Array]]:
    """Return the elements of each state vector: time, position and velocity."""
    orbit = metadata.ephemeris
    for t, position, velocity in zip(orbit.time_s, orbit.position_m, orbit.velocity_m_s, strict=True):
        yield _time(metadata.epoch, t), position, velocity
