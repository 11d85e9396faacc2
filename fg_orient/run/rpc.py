"""Corrected RPC files of a run: the adjusted compensation inside the model, for other programs."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fg_orient.io.rpc import write_rpc
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_corrected import corrected, is_exact
from fg_orient.sensors.rpc_sensor import RpcSensor

if TYPE_CHECKING:
    from fg_orient.solution import Solution


def write_corrected_rpc(folder: Path, solution: Solution) -> None:
    """Write ``<image>_RPC.TXT`` of every RPC image whose compensation goes into the model exactly.

    Parameters
    ----------
    folder : Path
        Made if there is anything to write.
    solution : Solution
    """
    used: set[str] = set()
    for name, model, compensation in _rpc_images(solution):
        if not is_exact(model, compensation):
            continue
        folder.mkdir(exist_ok=True)
        stem = plain = re.sub(r"[^\w.-]", "_", name)
        while stem in used:
            stem = f"{plain}_{len(used)}"
        used.add(stem)
        write_rpc(folder / f"{stem}_RPC.TXT", corrected(model, compensation))


def left_out(solution: Solution) -> list[str]:
    """Name the RPC images without a corrected file, and why."""
    return [
        f"image {name}: no corrected RPC file, its compensation has mixed terms that need a new fit of the model"
        for name, model, compensation in _rpc_images(solution)
        if not is_exact(model, compensation)
    ]


def _rpc_images(solution: Solution) -> Iterator[tuple[str, RpcModel, npt.NDArray[np.float64]]]:
    for image in solution.block.images:
        if isinstance(image.sensor, RpcSensor):
            yield image.id, image.sensor.model, solution.correction(image.id)
