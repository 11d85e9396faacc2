"""Common parts of the frame states and line-scan states of the Community Sensor Model (USGSCSM)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from fg_orient.formats.json_files import JsonFile
from fg_orient.formats.registry import read_bytes
from fg_orient.model.errors import InputError
from fg_orient.sensors.focal_plane import Distortion

FRAME_MODEL: Final = "USGS_ASTRO_FRAME_SENSOR_MODEL"
LINE_SCAN_MODEL: Final = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
#: A state names its distortion model by one of these numbers.
DISTORTIONS: Final = {0: "radial", 1: "transverse", 7: "radtan"}
RADTAN: Final = 7
#: Maximum difference of the norm of a quaternion from 1.
UNIT: Final = 1e-3


def distortion_fields(distortion: Distortion) -> dict[str, Any]:
    """Fields of a distortion, without one radial coefficients of zero; inverse of :func:`distortion_of`."""
    kind = {name: number for number, name in DISTORTIONS.items()}.get(distortion.model, 0)
    c = distortion.coefficients or (0.0, 0.0, 0.0)
    return {"m_distortionType": kind, "m_opticalDistCoeffs": list(c[:-1] if kind == RADTAN else c)}


def open_state(path: Path, model: str) -> JsonFile:
    """Read the values of a state, which is a JSON object. A line with the name of the model may precede it.

    Raises
    ------
    InputError
        The file cannot be read, or it contains a state of another model.
    """
    state = JsonFile.read(path, skip=0 if read_bytes(path, 200).lstrip()[:1] == b"{" else 1)
    if state.text("m_modelName") != model:
        raise InputError.of("isd.model", file=path, place="m_modelName", value=state.text("m_modelName"), known=model)
    return state


def distortion_of(state: JsonFile) -> Distortion:
    """Return the distortion of a state.

    The coordinates of the distortion ``radtan`` are divided by the focal length of the state.
    InputError: the distortion is not one of :data:`DISTORTIONS`, or its coefficients are impossible.
    """
    kind = int(state.number("m_distortionType", 0))
    if kind not in DISTORTIONS:
        raise InputError.of("isd.distortion", file=state.path, place="m_distortionType", value=kind,
                            known=", ".join(f"{k} ({name})" for k, name in DISTORTIONS.items()))  # fmt: skip
    try:
        c = state.numbers("m_opticalDistCoeffs", -1).tolist()
        return Distortion(DISTORTIONS[kind], (*c, state.number("m_focalLength")) if kind == RADTAN else tuple(c))
    except InputError as error:
        problem = error.problems[0]
        raise InputError.of(problem.code, file=state.path, place="m_opticalDistCoeffs", value=problem.value,
                            **dict(problem.data)) from None  # fmt: skip
