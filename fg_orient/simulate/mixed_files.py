"""Writes a mixed block in the real file formats of its images: DIMAP 1.1, ``_RPC.TXT``, frame and camera files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from fg_orient.formats.metadata.frame import write_camera, write_frame_file
from fg_orient.formats.rpc import write_rpc
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.frame import FrameSensor
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.simulate.files import ImageWriter, eop_rows, simulate_to, write_dimaps
from fg_orient.simulate.mixed import (
    CAMERA_FILE,
    FRAME_SIGMA,
    OPTIONS,
    MixedOptions,
    MixedSimulation,
    simulate,
)
from fg_orient.simulate.simulation import Truth

#: Compensation of an RPC image in the order of its codes, as far as it is simulated.
COMPENSATION: Final = ("line_0", "sample_0", "line_l1", "sample_l1")
#: Units of a frame's unknowns by the first part of their names.
UNITS: Final = {"rotation": "rad", "centre": "m", "focal": "px", "principal": "px"}


def simulate_mixed(out: str | Path, options: MixedOptions | None = None, *, overwrite: bool = False) -> Path:
    """Write a mixed block: metadata, RPC, camera and frame files, points, observations, project file and ``truth/``.

    Parameters
    ----------
    out : str or Path
        Folder to make.
    options : MixedOptions, optional
    overwrite : bool
        Replace a folder that an earlier simulation wrote.

    Returns
    -------
    Path
        The project file.

    Raises
    ------
    InputError
        The folder exists (without ``overwrite``) or cannot be written.
    """
    chosen = options or MixedOptions()
    form = ImageWriter(_write_images, _orientation, OPTIONS)
    return simulate_to(out, lambda: simulate(chosen), chosen, "simulate mixed", overwrite=overwrite, writer=form)


def _write_images(folder: Path, simulation: MixedSimulation) -> list[tuple[str, str]]:
    """Write one metadata file for each image, and the camera of the frames; give ids and file names."""
    write_dimaps(folder, simulation.name, simulation.metadata)
    write_camera(folder / CAMERA_FILE, simulation.interior)
    out = []
    for image in simulation.images:
        sensor = image.sensor
        if isinstance(sensor, RpcSensor):
            write_rpc(folder / sensor.file, sensor.model)
        elif isinstance(sensor, FrameSensor):
            write_frame_file(folder / sensor.file, sensor, CAMERA_FILE)
        out.append((image.id, sensor.file))
    return out


def _orientation(truth: Truth) -> list[list[str]]:
    """True minus metadata of what is unknown of each image; of an RPC its compensation."""
    rows: list[list[str]] = []
    for image, correction in zip(truth.image_ids, truth.corrections, strict=True):
        if isinstance(correction, Correction):
            rows += eop_rows(replace(truth, image_ids=(image,), corrections=(correction,)))
            continue
        names = COMPENSATION if len(correction) == 6 else tuple(FRAME_SIGMA)
        for name, value in zip(names, correction.tolist(), strict=False):
            unit = "px" if len(correction) == 6 else UNITS[name.split("_")[0]]
            rows.append([image, name, name, "", unit, repr(value)])
    return rows
