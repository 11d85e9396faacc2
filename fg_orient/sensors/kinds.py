"""Which kind a sensor is, for procedures that are made for one kind only."""

from __future__ import annotations

from typing import Any

from fg_orient.model.errors import InputError
from fg_orient.sensors.pushbroom import PushbroomSensor


def require_pushbroom(sensor: Any, image: str) -> PushbroomSensor:
    """Give the sensor of an image as the rigorous pushbroom sensor that it is.

    Raises
    ------
    InputError
        It is of another kind: an RPC has neither orbit nor look angles.
    """
    if not isinstance(sensor, PushbroomSensor):
        kind = type(sensor).__name__
        raise InputError.of("sensor.not_rigorous", file=sensor.file, place=f"image {image}", value=kind)
    return sensor
