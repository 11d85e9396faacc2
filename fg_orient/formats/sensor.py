"""Make sensors from metadata files of any format."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from fg_orient.formats.registry import Format, format_claiming, formats
from fg_orient.formats.toml import parse_toml
from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.model.paths import require_path
from fg_orient.model.plugins import raised_in, told

MODELS: Final = ("auto", "rigorous", "rpc")


def read_sensor(
    path: str | Path, *, model: str = "auto", extrapolate_attitude_s: float = 0.0, light: tuple[str, ...] = ()
) -> Any:
    """Read a metadata file of any supported format and bind it to its sensor model.

    Parameters
    ----------
    path : str or Path
        ``METADATA.DIM`` of a SPOT 1-5 level 1A scene, ``DIM_*.XML`` of a Pléiades or SPOT
        6/7 sensor product, a PHR_DIMAP; a file with RPC (see
        :func:`fg_orient.formats.rpc.read_rpc`); a sensor description (TOML,
        :mod:`fg_orient.formats.metadata.pushbroom`); its states are never extrapolated; a
        frame image (TOML, :mod:`fg_orient.formats.metadata.frame`); a file of a format
        that the user has registered.
    model : {"auto", "rigorous", "rpc"}
        Model to use. ``"auto"`` selects the rigorous model if the file contains it.
    extrapolate_attitude_s : float
        If attitudes do not cover the image, they are extrapolated with the last rate by
        at most this time, s (:class:`fg_orient.sensors.pushbroom.PushbroomSensor`). RPC
        ignore it.
    light : tuple of str
        Effects on light that replace the default effects of the format: "aberration",
        "light_time", "refraction", or "none". Formats with fixed effects ignore it.

    Returns
    -------
    PushbroomSensor, RpcSensor, FrameSensor, or the sensor of a user's format
        Its pixels are (line, sample); (0, 0) is the centre of the first pixel. Ground coordinates are ECEF, m.

    Raises
    ------
    InputError
        The file cannot be used or does not contain the requested model. The message names
        file, line, value and remedy.
    """
    path = Path(path)
    require_path(path)
    if model not in MODELS:
        raise InputError.of("sensor.model", file=path, place="model", value=model, known=", ".join(MODELS))
    form = format_claiming(path, "image")
    if form is not None and (model != "rpc" or not form.beside_rpc):
        return _read(form, path, extrapolate_attitude_s, light)
    if form is None and path.suffix.lower() == ".toml":
        known = " or ".join(f'"{f.name}"' for f in formats("image").values() if ".toml" in f.suffixes)
        value = repr(parse_toml(path).get("kind"))
        raise InputError.of("sensor.toml", file=path, place="kind", value=value, known=known)
    from fg_orient.formats.rpc import read_rpc, rpc_format

    rpc = rpc_format(path)
    if model == "rigorous" and rpc is not None:
        raise InputError.of("sensor.only_rpc", file=path, place="model", value=rpc.title)
    if model == "rpc" or rpc is not None:
        from fg_orient.sensors.rpc_sensor import RpcSensor

        return RpcSensor(read_rpc(path))
    from fg_orient.formats.metadata.dimap import read_sensor as read_dimap_sensor

    return read_dimap_sensor(path)  # raises an error that names the kind of the file


def _read(form: Format, path: Path, extrapolate_attitude_s: float, light: tuple[str, ...]) -> Any:
    """Read an image.

    If a user's own reader raises an unexpected exception, the error names its file and line.
    """
    assert form.read_image is not None  # a format of images
    how: dict[str, Any] = {"extrapolate_attitude_s": extrapolate_attitude_s} if form.extrapolates else {}
    how |= {"light": light} if form.chooses_light else {}
    if form.read_image.__module__.startswith("fg_orient."):
        return form.read_image(path, **how)
    if not path.exists():
        raise InputError.of("sensor.missing", file=path, place="metadata")
    try:
        return form.read_image(path, **how)
    except FgOrientError:
        raise
    except Exception as error:
        code = getattr(form.read_image, "__code__", None)
        where = form.read_image.__qualname__ if code is None else raised_in(error, code.co_filename)
        raise InputError.of(
            "sensor.own_reader", file=path, place=f"reader {form.name}", value=told(error), where=where
        ) from error
