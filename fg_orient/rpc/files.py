"""Read and write RPC files: pixel origin, conversion to another format, and inclusion of a compensation.

A compensation is written exactly if the form allows it, otherwise approximately with a stated error::

    line = off + c0 + scale (f1 (1 + c2/scale))/f2 + c4 f3/f4

Shifts are added to the offsets. The drift of a coordinate with itself changes its numerator. The last
term needs f3 f2/f4, which is a cubic polynomial only if both denominators are equal; otherwise a cubic
polynomial is fitted to it. The denominators are not changed, so there is no new pole.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras.rfm import terms
from factors.cameras.rfm_project import COMPENSATION, RANGE
from fg_orient.formats.atomic import outputs
from fg_orient.formats.registry import formats
from fg_orient.formats.rpc import read_rpc, rpc_writer
from fg_orient.formats.rpc.fields import USUAL_ORDER
from fg_orient.formats.rpc.gdal import write_rpc_copy
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.rpc.points import statistics
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution

#: Suffixes of RPC files beside an image that GDAL prefers to the tags of the image.
SIDECARS: Final = ("_RPC.TXT", "_rpc.txt", ".RPB", ".rpb")
#: Formats that are a raster with RPC, and their suffixes.
IMAGES: Final = {"geotiff-tags": ".tif", "vrt": ".vrt"}
#: Two models are compared on a cube of normalised coordinates with this number of values per axis.
CUBE: Final = 7
#: A written file that differs by this from its model is wrong: formats store all digits.
ROUND_TRIP_PX: Final = 1e-3


@dataclass(frozen=True)
class RpcFile:
    """Model, and the coordinate of the centre of the first pixel in its file."""

    model: RpcModel
    first_pixel: float


def open_rpc(path: str | os.PathLike[str], *, order: str = USUAL_ORDER, first_pixel: float | None = None) -> RpcFile:
    """Read a file and find the coordinate of the first pixel in it.

    Parameters
    ----------
    path, order, first_pixel
        See :func:`fg_orient.formats.rpc.read_rpc`.

    Raises
    ------
    InputError
        The file cannot be used.
    """
    model = read_rpc(path, order=order, first_pixel=first_pixel)
    if first_pixel is not None:
        return RpcFile(model, first_pixel)
    # with first_pixel = 0 the offsets of the model equal the offsets in the file
    raw = read_rpc(path, order=order, first_pixel=0.0)
    return RpcFile(model, round(float(raw.offsets[RANGE.line] - model.offsets[RANGE.line]), 6))


def target_of(name: str | None, out: Path) -> str:
    """Return the name of the format to write: as given, or by the suffix of the file name.

    Raises
    ------
    InputError
        No such format, or the end of the name belongs to no format.
    """
    if name is None:
        by_end = next((name for name, end in IMAGES.items() if out.suffix.lower() == end), None)
        return by_end or rpc_writer(out).name
    known = [f.name for f in formats("rpc").values() if f.write_rpc or f.name in IMAGES]
    if name not in known:
        raise InputError.of("rpc.target_name", option="to", value=name, known=", ".join(known))
    return name


def write_as(
    model: RpcModel, out: Path, target: str, *, overwrite: bool = False, image: Path | None = None
) -> dict[str, Any]:
    """Write a model completely or not at all, read it back and compare.

    Parameters
    ----------
    model : RpcModel
    out : Path
        For "geotiff-tags" without ``image``, it is an existing image whose tags are replaced.
    target : str
        Name of a format.
    overwrite : bool
        Replace an existing file.
    image : Path, optional
        Raster to which the tags belong: it is copied, or a virtual raster refers to it.

    Returns
    -------
    dict
        file, format, first_pixel; round_trip_line_px, round_trip_sample_px: largest
        differences of projected points; not_kept: content that the format cannot store.

    Raises
    ------
    InputError
        The file exists, or cannot be written, or an RPC file beside the image would hide
        its tags, or a virtual raster has no image.
    """
    with outputs(out, overwrite=overwrite):
        return write_alone(model, out, target, image=image)


def write_alone(model: RpcModel, out: Path, target: str, *, image: Path | None = None) -> dict[str, Any]:
    """Write a model as :func:`write_as` does, if the block of the caller has the output (``atomic.outputs``)."""
    if target == "geotiff-tags":
        for beside in (out.with_name(out.stem + end) for end in SIDECARS):
            if beside.exists():
                raise InputError.of("rpc.sidecar", file=out, value=beside.name)
    write = formats("rpc")[target].write_rpc
    if image is not None and target in IMAGES:
        write_rpc_copy(out, model, image)
    elif write is None:
        raise InputError.of("handover.needs_image", file=out, option="image", format=target)
    else:
        write(out, model)
    back = open_rpc(out)
    line, sample = np.abs(projected_differences(model, back.model)).max(axis=0)
    return {
        "file": str(out),
        "format": back.model.format,
        "first_pixel": back.first_pixel,
        "round_trip_line_px": float(line),
        "round_trip_sample_px": float(sample),
        "not_kept": not_kept(model, back.model),
    }


def disagreement(written: Iterable[Mapping[str, Any]]) -> list[Finding]:
    """Return a doubt for each written file that, read again, differs from its model by ``ROUND_TRIP_PX`` or more."""
    names = ("round_trip_line_px", "round_trip_sample_px")
    largest = [float(np.max([one[name] for name in names])) for one in written if names[0] in one]
    return [finding("rpc.round_trip", largest_px=value) for value in largest if not value < ROUND_TRIP_PX]


def projected_differences(one: RpcModel, other: RpcModel) -> Array:
    """Subtract pixels of the second model from the first, on a grid over the cube of the first model: (n, 2)."""
    u = np.stack([a.ravel() for a in np.meshgrid(*[np.linspace(-1.0, 1.0, CUBE)] * 3)])
    ground = one.offsets[RANGE.ground, None] + one.scales[RANGE.ground, None] * u
    return np.stack(one.project(*ground), axis=1) - np.stack(other.project(*ground), axis=1)


def not_kept(model: RpcModel, back: RpcModel) -> list[str]:
    """Return the parts of the model that a written file does not contain, in words."""
    out = []
    if (model.err_bias_m and not back.err_bias_m) or (model.err_rand_m and not back.err_rand_m):
        out.append("error estimates")
    if model.direct is not None and back.direct is None:
        out.append("coefficients from image to ground")
    if not np.allclose(model.validity, back.validity, rtol=1e-12, atol=1e-9):
        out.append("validity range")
    return out


def describe(file: RpcFile) -> dict[str, Any]:
    """Return the description of a file: format, pixel count, validity, offsets, scales, notes."""
    m = file.model
    names = ("line_px", "sample_px", "lon_deg", "lat_deg", "height_m")
    return {
        "file": m.file,
        "format": m.format,
        "first_pixel": file.first_pixel,
        "n_lines": m.n_lines,
        "n_samples": m.n_samples,
        "offsets": dict(zip(names, m.offsets.tolist(), strict=True)),
        "scales": dict(zip(names, m.scales.tolist(), strict=True)),
        "validity": dict(zip(names, m.validity, strict=True)),
        "validity_stated": m.stated_validity is not None,
        "err_bias_m": m.err_bias_m,
        "err_rand_m": m.err_rand_m,
        "image_to_ground": m.direct is not None,
        "common_denominator": bool(np.array_equal(m.coefficients[1], m.coefficients[3])),
        "notes": list(map(str, m.notes)),
    }


#: Number of Chebyshev nodes per axis of normalised coordinates for the fit of a product.
NODES: Final = 9
#: Independent points at which the written model is compared with the compensated one.
N_CHECK: Final = 2000


@dataclass(frozen=True)
class Corrected:
    """Model that contains its compensation.

    Parameters
    ----------
    model : RpcModel
        Model without the vendor's error estimates, which are no longer valid.
    exact : bool
        True if no polynomial was fitted.
    errors : dict
        Statistics (px) of compensated minus written at independent points.
    """

    model: RpcModel
    exact: bool
    errors: dict[str, Any]


def corrected(model: RpcModel, values: npt.ArrayLike) -> Corrected:
    """Put a compensation into a model.

    Parameters
    ----------
    model : RpcModel
    values : (6,) array_like
        Pixels, see ``factors.cameras.rfm_project``.
    """
    values = np.asarray(values, float)
    scale_l, scale_s = model.scales[RANGE.image]
    offsets, c = model.offsets.copy(), model.coefficients.copy()
    offsets[RANGE.image] += values[[COMPENSATION.line, COMPENSATION.sample]]
    common = bool(np.array_equal(c[1], c[3]))
    f = model.coefficients
    c[0] = f[0] * (1.0 + values[COMPENSATION.line_l] / scale_l)
    c[2] = f[2] * (1.0 + values[COMPENSATION.sample_s] / scale_s)
    if values[COMPENSATION.line_s] != 0.0:
        c[0] += values[COMPENSATION.line_s] / scale_l * (f[2] if common else _product(f[2], f[1], f[3]))
    if values[COMPENSATION.sample_l] != 0.0:
        c[2] += values[COMPENSATION.sample_l] / scale_s * (f[0] if common else _product(f[0], f[3], f[1]))
    direct = None if model.direct is None else _direct(model, values)
    new = replace(
        model,
        offsets=offsets,
        coefficients=c,
        direct=direct,
        err_bias_m=None,
        err_rand_m=None,
        notes=(*model.notes, finding("rpc.compensated")),
    )
    exact = common or not values[[COMPENSATION.sample_l, COMPENSATION.line_s]].any()
    return Corrected(new, exact, _errors(model, values, new))


def corrected_models(solution: Solution) -> dict[str, Corrected]:
    """Return the model of every RPC image of a solution with its compensation included, by image id."""
    sensors = {image.id: image.sensor for image in solution.block.images if isinstance(image.sensor, RpcSensor)}
    return {name: corrected(sensor.model, solution.correction(name)) for name, sensor in sensors.items()}


def _nodes(count: int) -> Array:
    """Return the points of the cube of normalised coordinates: (count^3, 3)."""
    axis = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.stack([a.ravel() for a in np.meshgrid(axis, axis, axis)], axis=1)


def _product(f: Array, above: Array, below: Array) -> Array:
    """Return the cubic polynomial p (20,) with p/above closest to f/below over the cube."""
    m = terms(_nodes(NODES))
    weight = 1.0 / (m @ above)
    return np.asarray(np.linalg.lstsq(m * weight[:, None], (m @ f) / (m @ below), rcond=None)[0])


def _direct(model: RpcModel, values: Array) -> Array:
    """Return exact coefficients from image to ground for compensated pixels, as the map of the pixels is affine."""
    assert model.direct is not None
    scale_l, scale_s = model.scales[RANGE.image]
    matrix = np.array([
        [scale_l + values[COMPENSATION.line_l], values[COMPENSATION.line_s]],
        [values[COMPENSATION.sample_l], scale_s + values[COMPENSATION.sample_s]],
    ])  # fmt: skip
    new = _nodes(4)  # nodes: sample, line and height in the new normalised coordinates
    l, s = np.linalg.solve(matrix, np.stack([new[:, 1] * scale_l, new[:, 0] * scale_s]))  # noqa: E741
    old = terms(np.column_stack([s, l, new[:, 2]]))
    rows = np.linalg.lstsq(terms(new), old @ model.direct.T, rcond=None)[0].T
    for k in (0, 2):
        rows[k : k + 2] /= rows[k + 1, 0]
        rows[k + 1, 0] = 1.0
    return np.ascontiguousarray(rows)


def _errors(model: RpcModel, values: Array, new: RpcModel) -> dict[str, Any]:
    """Return the statistics of compensated minus written pixels at random pixels and heights of the image."""
    v, rng = model.validity, np.random.default_rng(1)
    line, sample, height = (rng.uniform(low, high, N_CHECK) for low, high in (v.line, v.sample, v.height_m))
    lon, lat = model.locate(line, sample, height)
    seen = np.isfinite(lon)
    ground = lon[seen], lat[seen], height[seen]
    d = np.stack(model.project(*ground, values), axis=1) - np.stack(new.project(*ground), axis=1)
    return statistics(d) or {}
