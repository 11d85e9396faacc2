"""An RPC file with its own count of pixels, and the same model written in another format."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.cameras.rfm_project import RANGE
from fg_orient.formats.registry import formats
from fg_orient.formats.rpc import read_rpc, rpc_writer
from fg_orient.formats.rpc.fields import USUAL_ORDER
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel, RpcValidity

Array = npt.NDArray[np.float64]

#: Ends of the names of RPC files that GDAL prefers to the tags of the image beside them.
SIDECARS: Final = ("_RPC.TXT", "_rpc.txt", ".RPB", ".rpb")
#: Values per axis of the cube of normalised coordinates in which two models are compared.
CUBE: Final = 7


@dataclass(frozen=True)
class RpcFile:
    """A model and the pixel coordinate that its file gives the centre of the first pixel."""

    model: RpcModel
    first_pixel: float


def open_rpc(path: str | os.PathLike[str], *, order: str = USUAL_ORDER, first_pixel: float | None = None) -> RpcFile:
    """Read a file and tell where it counts its pixels from.

    Parameters
    ----------
    path, order, first_pixel
        See :func:`fg_orient.formats.rpc.read_rpc`.

    Raises
    ------
    InputError
        The file is not usable.
    """
    model = read_rpc(path, order=order, first_pixel=first_pixel)
    if first_pixel is not None:
        return RpcFile(model, first_pixel)
    # read as if it counted from 0, the offsets are those of the file
    raw = read_rpc(path, order=order, first_pixel=0.0)
    return RpcFile(model, round(float(raw.offsets[RANGE.line] - model.offsets[RANGE.line]), 6))


def target_of(name: str | None, out: Path) -> str:
    """Name of the format to write: as given, or by the end of the file's name.

    Raises
    ------
    InputError
        No such format, or the name of the file does not say one.
    """
    if name is None:
        return rpc_writer(out).name
    known = [f.name for f in formats("rpc").values() if f.write_rpc]
    if name not in known:
        raise InputError.of("rpc.target_name", option="to", value=name, known=", ".join(known))
    return name


def require_free(out: Path, overwrite: bool) -> None:
    """Refuse an existing output.

    Raises
    ------
    InputError
        It exists and ``overwrite`` is False.
    """
    if out.exists() and not overwrite:
        raise InputError.of("output.exists", file=out, option="out")


def write_as(model: RpcModel, out: Path, target: str, *, overwrite: bool = False) -> dict[str, Any]:
    """Write a model whole or not at all, read it back and compare.

    Parameters
    ----------
    model : RpcModel
    out : Path
        For "geotiff-tags" an existing image, whose tags are replaced.
    target : str
        Name of a format.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    dict
        file, format, first_pixel; round_trip_line_px, round_trip_sample_px: largest differences of projected points;
        not_kept: what the format has no place for.

    Raises
    ------
    InputError
        The file exists, or cannot be written, or an RPC file beside the image would hide its tags.
    """
    require_free(out, overwrite)
    if target == "geotiff-tags":
        _require_no_sidecar(out)
    write = formats("rpc")[target].write_rpc
    assert write is not None
    write(out, model)
    back = open_rpc(out)
    line, sample = np.abs(projected_differences(model, back.model)).max(axis=0)
    return {
        "file": str(out), "format": back.model.format, "first_pixel": back.first_pixel,
        "round_trip_line_px": float(line), "round_trip_sample_px": float(sample),
        "not_kept": not_kept(model, back.model),
    }  # fmt: skip


def _require_no_sidecar(image: Path) -> None:
    """Refuse tags that nobody would read: GDAL prefers RPC files beside an image.

    Raises
    ------
    InputError
        Names the file.
    """
    for end in SIDECARS:
        beside = image.with_name(image.stem + end)
        if beside.exists():
            raise InputError.of("rpc.sidecar", file=image, value=beside.name)


def projected_differences(one: RpcModel, other: RpcModel) -> Array:
    """Pixels of the first model minus those of the second on a grid over the first one's cube: (n, 2)."""
    u = np.stack([a.ravel() for a in np.meshgrid(*[np.linspace(-1.0, 1.0, CUBE)] * 3)])
    ground = one.offsets[RANGE.ground, None] + one.scales[RANGE.ground, None] * u
    return np.stack(one.project(*ground), axis=1) - np.stack(other.project(*ground), axis=1)


def not_kept(model: RpcModel, back: RpcModel) -> list[str]:
    """What a written file does not hold of the model, in words."""
    out = []
    if (model.err_bias_m and not back.err_bias_m) or (model.err_rand_m and not back.err_rand_m):
        out.append("error estimates")
    if model.direct is not None and back.direct is None:
        out.append("coefficients from image to ground")
    if not _same_ranges(model.validity, back.validity):
        out.append("validity range")
    return out


def _same_ranges(one: RpcValidity, other: RpcValidity) -> bool:
    a, b = (np.array([v.line, v.sample, v.lon_deg, v.lat_deg, v.height_m]) for v in (one, other))
    return bool(np.allclose(a, b, rtol=1e-12, atol=1e-9))


def describe(file: RpcFile) -> dict[str, Any]:
    """What a file is: format, pixel count, validity, offsets, scales, notes."""
    m = file.model
    v = m.validity
    names = ("line_px", "sample_px", "lon_deg", "lat_deg", "height_m")
    return {
        "file": m.file, "format": m.format, "first_pixel": file.first_pixel,
        "n_lines": m.n_lines, "n_samples": m.n_samples,
        "offsets": _named(names, m.offsets), "scales": _named(names, m.scales),
        "validity": dict(zip(names, (v.line, v.sample, v.lon_deg, v.lat_deg, v.height_m), strict=True)),
        "validity_stated": m.stated_validity is not None,
        "err_bias_m": m.err_bias_m, "err_rand_m": m.err_rand_m,
        "image_to_ground": m.direct is not None,
        "common_denominator": bool(np.array_equal(m.coefficients[1], m.coefficients[3])),
        "notes": list(map(str, m.notes)),
    }  # fmt: skip


def _named(names: Sequence[str], values: Array) -> dict[str, float]:
    return dict(zip(names, map(float, values), strict=True))
