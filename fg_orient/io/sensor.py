"""From a metadata file to a sensor: the one door that every command and script goes through."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fg_orient.sensors.pushbroom import PushbroomSensor
    from fg_orient.sensors.rpc_sensor import RpcSensor


def read_sensor(path: str | Path) -> PushbroomSensor | RpcSensor:
    """Read a metadata file of any supported format and bind it to its sensor model.

    Parameters
    ----------
    path : str or Path
        ``METADATA.DIM`` of a SPOT 1-5 level 1A scene, or ``DIM_*.XML`` of a Pléiades or
        SPOT 6/7 sensor product; or a file with RPC (see :func:`fg_orient.io.rpc.read_rpc`).

    Returns
    -------
    PushbroomSensor or RpcSensor
        Pixels (line, sample) with (0, 0) = centre of the first pixel, ECEF metres.

    Raises
    ------
    InputError
        The file is not usable; the message names file, line, value and remedy.
    """
    from fg_orient.io.rpc import read_rpc, rpc_format

    if rpc_format(path) is not None:
        from fg_orient.sensors.rpc_sensor import RpcSensor

        return RpcSensor(read_rpc(path))
    from fg_orient.io.dimap import read_dimap
    from fg_orient.sensors.pushbroom import PushbroomSensor

    return PushbroomSensor(read_dimap(path))
