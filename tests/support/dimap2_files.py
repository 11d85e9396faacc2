"""The module writes DIMAP 2.0 sensor products (Pléiades, SPOT 6/7) for tests of the reader."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.dimap_write import PRODUCER, _from_1, _size, _states, _time, _write
from fg_orient.sensors.metadata import (
    AngleAttitude,
    LookAnglePolynomial,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)

_PROFILES = {"SPOT 6": "S6_SENSOR", "SPOT 7": "S7_SENSOR"}


def write_dimap2(path: Path, metadata: PushbroomMetadata) -> None:
    """Write attitude as quaternions and look angles as polynomials; profile of SPOT 6 or 7, else PHR_SENSOR."""
    look, timing = metadata.look, metadata.timing
    assert not isinstance(metadata.attitude, AngleAttitude) and isinstance(look, LookAnglePolynomial)
    assert timing.reference_line == 0.0
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
    extent: list[tuple[str, Any]] = [
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
        "Dataset_Identification": {"DATASET_NAME": "SIMULATED"},
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


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
