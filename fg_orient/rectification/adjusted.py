"""Corrections of images from a result folder of ``adjust``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.models.contract import own_model
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.model.options import Options
from fg_orient.model.parameters import CURVE, CURVES, N_EOP, parameter_name
from fg_orient.rectification.ortho_models import Sensor
from fg_orient.result.plain import read_table
from fg_orient.result.record import RESULT_FILE, read_record
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.frame import UNKNOWNS, FrameSensor
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]

#: Names of the compensation of an RPC image, in the order of ``factors.cameras.rfm_project``.
COMPENSATION = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")
#: Highest power of the sample in a look-angle polynomial.
LOOK_DEGREES = 10


def read_correction(folder: Path, sensor: Sensor, image: str = "") -> Correction | Array:
    """Read the adjusted correction of one image.

    Parameters
    ----------
    folder : Path
        Result folder: ``eop.csv`` and ``result.json``.
    sensor : PushbroomSensor, RpcSensor or FrameSensor
        Of this image.
    image : str
        Image id; default the image with the sensor's metadata file, compared by content if the result recorded it,
        else by name.

    Raises
    ------
    InputError
        No such folder or image; an image with other metadata than the sensor's, several images with the same, or
        unknowns of another kind of sensor.
    """
    try:
        record = read_record(folder) if (folder / RESULT_FILE).is_file() else {}
        if record["status"] == Status.RANK_DEFICIENT:
            raise InputError.of("report.nothing_adjusted", file=folder, place=RESULT_FILE, value=record["status"])
        options = record["provenance"]["options"]
        small_angle, n_curves = bool(options["small_angle"]), int(options.get("curve_intervals", 0))
        files = _files(record)
        eop = read_table(folder / "eop.csv")
        values: dict[str, dict[str, float]] = {name: {} for name in files}
        columns = (eop.words["image"], eop.words["parameter"], eop.figures["value_per_tau"].tolist())
        for image_id, parameter, value in zip(*columns, strict=True):
            values[image_id][parameter] = value
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError.of("ortho.result", file=folder, known="-") from None
    name = _chosen(files, folder, Path(sensor.file), image)
    try:
        return _correction(values[name], sensor, small_angle, n_curves)
    except KeyError:
        raise InputError.of("ortho.other_sensor", file=folder, place=f"image {name}", value=sensor.file) from None


def _files(record: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Name and SHA-256 of the metadata file of each image; "" if unavailable.

    The inputs of a run are its project file, then one metadata file per image.
    """
    names = [(str(entry["id"]), str(entry["file"])) for entry in record["images"]]
    inputs = record["provenance"].get("inputs", [])[1 : 1 + len(names)]
    digests = [str(source["sha256"]) for source in inputs] if len(inputs) == len(names) else [""] * len(names)
    return {image: (file, digest) for (image, file), digest in zip(names, digests, strict=True)}


def _chosen(files: dict[str, tuple[str, str]], folder: Path, metadata: Path, image: str) -> str:
    """Image id by content, because products of one mission often have the same file name; else by name."""
    digest = hashlib.sha256(metadata.read_bytes()).hexdigest() if metadata.is_file() else ""
    same = [key for key, (file, known) in files.items()
            if (known == digest if known and digest else file == metadata.name)]  # fmt: skip
    if image in files:
        if image not in same:
            raise InputError.of("ortho.other_image", file=metadata, option="image_id", image=image,
                                known=files[image][0])  # fmt: skip
        return image
    named = [key for key, (file, _) in files.items() if file == metadata.name]
    if image or not (same or named):
        raise InputError.of("ortho.result", file=folder, value=image or metadata.name, known=", ".join(files))
    if not same:
        raise InputError.of("ortho.other_image", file=metadata, option="result", image=named[0],
                            known=f"{files[named[0]][0]} of another content")  # fmt: skip
    if len(same) > 1:
        raise InputError.of("ortho.which_image", file=metadata, option="image_id", known=" or ".join(same))
    return same[0]


def _correction(values: dict[str, float], sensor: Sensor, small_angle: bool, n_curves: int) -> Correction | Array:
    """Correction for ``sensor.project``; KeyError for names of another kind of sensor."""
    own = own_model(sensor, Options())
    if own is not None:
        return np.asarray(own.correction(_placed(values, own.parameters.names) / own.parameters.sigma))
    if not isinstance(sensor, PushbroomSensor):
        return _placed(values, UNKNOWNS if isinstance(sensor, FrameSensor) else COMPENSATION)
    names = [parameter_name(CURVE + k) for k in range(9 * CURVES)]
    curve = _placed({name: value for name, value in values.items() if name in names}, names)
    values = {name: value for name, value in values.items() if name not in names}
    codes = [parameter_name(code) for code in range(N_EOP + 2 * (LOOK_DEGREES + 1))]
    every = _placed(values, codes)
    used = max((codes.index(name) for name in values), default=0) + 1
    look = every[N_EOP : max(used + (used - N_EOP) % 2, N_EOP)]
    look = np.ascontiguousarray(look.reshape(-1, 2).T)
    return Correction(every[:N_EOP].reshape(9, 3), look, small_angle, curve.reshape(9, CURVES)[:, :n_curves])


def _placed(values: dict[str, float], names: Sequence[str]) -> Array:
    """Values in the order of names; 0 for missing ones, KeyError for others."""
    if unknown := set(values).difference(names):
        raise KeyError(unknown)
    return np.array([values.get(name, 0.0) for name in names])
