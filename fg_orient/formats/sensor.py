"""From a metadata file to a sensor: the one door that every command and script goes through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.model.plugins import raised_in, told

if TYPE_CHECKING:
    from fg_orient.sensors.frame import FrameSensor
    from fg_orient.sensors.pushbroom import PushbroomSensor

MODELS: Final = ("auto", "rigorous", "rpc")


@dataclass(frozen=True)
class Reader:
    """Reader of a user's own files: ``claims(path)`` tells whether it is one, ``read(path)`` gives its sensor."""

    name: str
    claims: Callable[[Path], bool]
    read: Callable[[Path], Any]


_READERS: dict[str, Reader] = {}


def register_reader(name: str, claims: Callable[[Path], bool], read: Callable[[Path], Any]) -> None:
    """Add a reader of metadata files; it is asked before those of fg_orient. See docs/extending/sensor.md.

    Parameters
    ----------
    name : str
        Of the format, unique.
    claims : callable
        Tells, by name or first bytes, whether a path is a file of this format. It must not raise.
    read : callable
        Gives its sensor; faults of the file are ``InputError``.

    Raises
    ------
    ValueError
        Another reader has this name.
    """
    present = _READERS.get(name)
    if present is not None and present.read.__qualname__ != read.__qualname__:
        raise ValueError(f"a reader named {name!r} is registered already")
    _READERS[name] = Reader(name, claims, read)


def read_sensor(path: str | Path, *, model: str = "auto", extrapolate_attitude_s: float = 0.0) -> Any:
    """Read a metadata file of any supported format and bind it to its sensor model.

    Parameters
    ----------
    path : str or Path
        ``METADATA.DIM`` of a SPOT 1-5 level 1A scene, ``DIM_*.XML`` of a Pléiades or
        SPOT 6/7 sensor product, a PHR_DIMAP; or a file with RPC (see :func:`fg_orient.formats.rpc.read_rpc`); or a
        sensor description (TOML, :mod:`fg_orient.formats.sensor_file`), whose states are never extrapolated; or a frame
        image
        (TOML, :mod:`fg_orient.formats.frame_file`).
    model : {"auto", "rigorous", "rpc"}
        Which model of the file; ``"auto"``: the rigorous one if the file holds it.
    extrapolate_attitude_s : float
        Attitudes that do not cover the image are extrapolated by at most so many seconds with the
        last rate (:class:`fg_orient.sensors.pushbroom.PushbroomSensor`); RPC have none.

    Returns
    -------
    PushbroomSensor, RpcSensor, FrameSensor, or what a reader of your own gives (:func:`register_reader`)
        Pixels (line, sample) with (0, 0) = centre of the first pixel, ECEF metres.

    Raises
    ------
    InputError
        The file is not usable, or holds no model of the kind; the message names file, line, value and remedy.
    """
    if model not in MODELS:
        raise InputError.of("sensor.model", file=path, place="model", value=model, known=", ".join(MODELS))
    own = next((reader for reader in _READERS.values() if reader.claims(Path(path))), None)
    if own is not None:
        return _own(own, Path(path))
    if Path(path).suffix.lower() == ".toml":
        return _described(Path(path))
    from fg_orient.formats.rpc import read_rpc, rpc_format

    form = rpc_format(path)
    both = form is not None and form.name == "PHR_DIMAP" and _holds_rigorous(path)
    if model == "rigorous" and form is not None and not both:
        raise InputError.of("sensor.only_rpc", file=path, place="model", value=form.name)
    if model == "rpc" or (model == "auto" and form is not None and not both):
        from fg_orient.sensors.rpc_sensor import RpcSensor

        return RpcSensor(read_rpc(path))
    from fg_orient.formats.dimap import read_dimap
    from fg_orient.sensors.pushbroom import PushbroomSensor

    return PushbroomSensor(read_dimap(path), extrapolate_attitude_s=extrapolate_attitude_s)


def _own(reader: Reader, path: Path) -> Any:
    """Read with a user's own reader; what it raises by mistake is its fault, and told so with its file and line."""
    if not path.exists():
        raise InputError.of("sensor.missing", file=path, place="metadata")
    try:
        return reader.read(path)
    except FgOrientError:
        raise
    except Exception as error:
        code = getattr(reader.read, "__code__", None)
        where = reader.read.__qualname__ if code is None else raised_in(error, code.co_filename)
        raise InputError.of(
            "sensor.own_reader", file=path, place=f"reader {reader.name}", value=told(error), where=where
        ) from error


def _described(path: Path) -> PushbroomSensor | FrameSensor:
    """Sensor of a TOML file, by its ``kind``."""
    from fg_orient.formats.project import parse_toml

    kind = parse_toml(path).get("kind")
    if kind == "frame":
        from fg_orient.formats.frame_file import read_frame_file

        return read_frame_file(path)
    if kind not in ("pushbroom", None):
        known = '"frame" or "pushbroom"'
        raise InputError.of("sensor.toml", file=path, place="kind", value=repr(kind), known=known)
    from fg_orient.formats.sensor_file import read_sensor_file
    from fg_orient.sensors.general import GeneralPushbroom

    return GeneralPushbroom(read_sensor_file(path))


def _holds_rigorous(path: str | Path) -> bool:
    """Tell whether a PHR_DIMAP has the rigorous model beside its RPC."""
    from fg_orient.formats.dimap_phr import MODEL
    from fg_orient.formats.xml import read_xml

    return read_xml(path).maybe(MODEL) is not None
