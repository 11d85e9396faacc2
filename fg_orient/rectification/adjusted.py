"""Corrections of images from a result folder of ``adjust``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fg_orient.formats.table_write import table_file
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.model.options import Options
from fg_orient.result.plain import read_table
from fg_orient.result.record import RESULT_FILE, read_record
from fg_orient.sensors.base import Sensor


def read_correction(folder: Path, sensor: Sensor, image: str = "") -> Any:
    """Read the adjusted correction of one image.

    Parameters
    ----------
    folder : Path
        Result folder: table ``eop`` and ``result.json``.
    sensor : Sensor
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
        eop = read_table(table_file(folder, "eop"))
        values: dict[str, dict[str, float]] = {name: {} for name in files}
        columns = (eop.words["image"], eop.words["parameter"], eop.figures["value_per_tau"].tolist())
        for image_id, parameter, value in zip(*columns, strict=True):
            values[image_id][parameter] = value
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError.of("ortho.result", file=folder, known="-") from None
    name = _chosen(files, folder, Path(sensor.file), image)
    try:
        return sensor.correction_of(values[name], Options(small_angle=small_angle, curve_intervals=n_curves))
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
    digest = sha256_of(metadata) if metadata.is_file() else ""
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
