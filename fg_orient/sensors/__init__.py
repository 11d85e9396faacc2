"""Sensors: bind metadata to the observation equations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fg_orient.sensors.pushbroom import PushbroomSensor


def read_sensor(path: str | Path) -> PushbroomSensor:
    """Read a metadata file of any supported format and bind it to its sensor model.

    Raises
    ------
    InputError
        The file is not usable; the message names file, line, value and remedy.
    """
    from fg_orient.io.dimap import read_dimap
    from fg_orient.sensors.pushbroom import PushbroomSensor

    return PushbroomSensor(read_dimap(path))
