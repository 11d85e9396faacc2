"""Corrections of images out of a result folder of ``adjust``."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.errors import InputError
from fg_orient.parameters import N_EOP, parameter_name
from fg_orient.raster.models import Sensor
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]

#: Names of the compensation of an RPC image, in the order of ``factors.rfm_project``.
COMPENSATION = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")
#: Highest power of the sample in a look-angle polynomial.
LOOK_DEGREES = 10


def read_correction(folder: Path, sensor: Sensor, image: str = "") -> Correction | Array:
    """Read the adjusted correction of one image.

    Parameters
    ----------
    folder : Path
        Result folder: ``eop.csv`` and ``result.json``.
    sensor : PushbroomSensor or RpcSensor
        Of this image.
    image : str
        Image id; default the image whose metadata file has the sensor's name.

    Raises
    ------
    InputError
        No such folder or image, or the unknowns of another kind of sensor.
    """
    try:
        record = json.loads((folder / "result.json").read_text("utf-8"))
        small_angle = bool(record["provenance"]["options"]["small_angle"])
        files = {str(entry["id"]): str(entry["file"]) for entry in record["images"]}
        with (folder / "eop.csv").open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        values: dict[str, dict[str, float]] = {name: {} for name in files}
        for row in rows:
            values[row["image"]][row["parameter"]] = float(row["value_per_tau"])
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError.of("ortho.result", file=folder, known="-") from None
    name = image or next((key for key, file in files.items() if file == Path(sensor.file).name), "")
    if name not in files:
        raise InputError.of("ortho.result", file=folder, value=image or Path(sensor.file).name, known=", ".join(files))
    try:
        return _correction(values[name], sensor, small_angle)
    except KeyError:
        raise InputError.of("ortho.other_sensor", file=folder, place=f"image {name}", value=sensor.file) from None


def _correction(values: dict[str, float], sensor: Sensor, small_angle: bool) -> Correction | Array:
    """What ``sensor.project`` takes; KeyError for names of another kind of sensor."""
    if not isinstance(sensor, PushbroomSensor):
        out = np.zeros(len(COMPENSATION))
        _place(out, values, {name: k for k, name in enumerate(COMPENSATION)})
        return out
    codes = {parameter_name(code): code for code in range(N_EOP + 2 * (LOOK_DEGREES + 1))}
    every = np.zeros(len(codes))
    _place(every, values, codes)
    used = max((codes[name] for name in values), default=0) + 1
    look = every[N_EOP : max(used + (used - N_EOP) % 2, N_EOP)]
    return Correction(every[:N_EOP].reshape(9, 3), np.ascontiguousarray(look.reshape(-1, 2).T), small_angle)


def _place(out: Any, values: dict[str, float], places: dict[str, int]) -> None:
    for name, value in values.items():
        out[places[name]] = value
