"""Corrected RPC files of a run: the adjusted compensation inside the model, for other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from fg_orient.model.errors import Finding, finding
from fg_orient.sensors.rpc_sensor import RpcSensor

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution
    from fg_orient.rpc.corrected import Corrected


def corrected_models(solution: Solution) -> dict[str, Corrected]:
    """Model of every RPC image with its compensation put in, by image id."""
    sensors = {image.id: image.sensor for image in solution.block.images if isinstance(image.sensor, RpcSensor)}
    if not sensors:
        return {}
    from fg_orient.rpc.corrected import corrected

    return {name: corrected(sensor.model, solution.correction(name)) for name, sensor in sensors.items()}


def write_corrected_rpc(folder: Path, models: dict[str, Corrected]) -> None:
    """Write ``<image>_RPC.TXT`` of every model; the folder is made if there is any.

    Characters of an id that a file name should not have become ``_``; names that meet are numbered.
    """
    if not models:
        return
    from fg_orient.formats.rpc import write_rpc

    used: set[str] = set()
    for name, found in models.items():
        folder.mkdir(exist_ok=True)
        stem = plain = re.sub(r"[^\w.-]", "_", name)
        while stem.lower() in used:
            stem = f"{plain}_{len(used)}"
        used.add(stem.lower())
        write_rpc(folder / f"{stem}_RPC.TXT", found.model)


def fitted_notes(models: dict[str, Corrected]) -> list[Finding]:
    """Tell of models that hold their compensation approximately only how well they do."""
    return [
        finding("rpc.fitted_correction", place=f"image {name}", line_px=found.errors["max_line_px"],
                sample_px=found.errors["max_sample_px"])
        for name, found in models.items()
        if not found.exact
    ]  # fmt: skip
