"""Check an RPC: denominators, agreement of its two models, extrapolation, points, and another model.

The checks use the pixels of the image and a range of heights. Residuals are projected minus observed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.cameras import rfm
from fg_orient.formats.rpc.dimap import AGREEMENT_PX
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.model.errors import Finding, InputError, finding, judged
from fg_orient.rpc.compensate import normalised, residuals
from fg_orient.rpc.doubts import of_points
from fg_orient.rpc.files import RpcFile, describe
from fg_orient.rpc.points import AXES, MeasuredPoints, statistics
from fg_orient.sensors.dem import RasterDem, range_below
from fg_orient.sensors.rpc import COORDINATES, NEAR_ZERO, RpcModel, span

Range = tuple[float, float]

#: Numbers of lines, samples and heights of the grid.
SHAPE: Final = (11, 11, 5)
#: Larger normalised coordinates lie outside the domain of the fit. The limit is above 1, because vendors round scales.
EXTRAPOLATED: Final = 1.05


def check_rpc(
    file: RpcFile, *, heights_m: Range | None = None, points: MeasuredPoints | None = None, against: Path | None = None
) -> dict[str, Any]:
    """Check a file.

    Parameters
    ----------
    file : RpcFile
    heights_m : (float, float), optional
        Range of heights of the scene, m above the ellipsoid; default the validity range.
    points : MeasuredPoints, optional
        Points to project.
    against : Path, optional
        Another RPC file, or metadata of a rigorous model.

    Returns
    -------
    dict
        Keys of :func:`fg_orient.rpc.files.describe`, and heights_m, denominators,
        image_to_ground, extrapolation, points, against; status "good" or
        "not_trustworthy" with ``findings``.

    Raises
    ------
    InputError
        Invalid heights; ``against`` is not usable or shows another part of the image.
    """
    model = file.model
    heights = _heights(model, heights_m)
    pixels = _grid(model.validity.line, model.validity.sample, heights)
    ground = np.column_stack([*model.locate(*pixels.T), pixels[:, 2]])
    record = describe(file) | {
        "heights_m": heights,
        "denominators": denominators(model, ground, heights),
        "image_to_ground": image_to_ground(model, pixels),
        "extrapolation": extrapolation(model, pixels, ground),
        "points": None if points is None else point_residuals(model, points),
        "against": None if against is None else differences(model, against, heights),
    }
    of_pixels = [] if points is None else of_points(model, points)
    return {**judged(_findings(record, of_pixels)), **record}


def _heights(model: RpcModel, given: Range | None) -> Range:
    heights = model.validity.height_m if given is None else given
    if not (np.isfinite(heights).all() and heights[0] < heights[1]):
        raise InputError.of("rpc.heights", file=model.file, option="heights", value=f"{heights[0]:g} {heights[1]:g}")
    return heights


def heights_below(file: RpcFile, dem: RasterDem) -> Range:
    """Return the lowest and highest height of a DEM below the image; only this part of the DEM is read.

    Raises
    ------
    InputError
        The DEM has no heights there.
    """
    model = file.model
    sides = [np.linspace(*ends, SHAPE[0]) for ends in (model.validity.line, model.validity.sample)]
    line, sample = (a.ravel() for a in np.meshgrid(*sides, indexing="ij"))

    def outline(height_m: float) -> tuple[Array, Array]:
        lon, lat = model.locate(line, sample, np.full(len(line), height_m))
        return lon, lat

    found = range_below(dem, outline, float(np.mean(model.validity.height_m)))
    if not np.isfinite(found).all():
        raise InputError.of("ortho.no_overlap", file=file.model.file, what=dem.path)
    return found


def _grid(line: Range, sample: Range, heights_m: Range) -> Array:
    """Return the pixels at heights (n, 3): lines, samples, heights."""
    axes = [np.linspace(low, high, n) for (low, high), n in zip((line, sample, heights_m), SHAPE, strict=True)]
    return np.column_stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")])


def denominators(model: RpcModel, ground: Array, heights_m: Range) -> dict[str, Any]:
    """Return the smallest denominators at ground points (n, 3), and the place of a pole if there is one.

    A pixel without a ground point has nan.
    """
    seen, least, pole = np.isfinite(ground[:, 0]), [float("nan")] * 2, None
    if seen.any():
        least = rfm.denominators(model.coefficients, normalised(model, ground[seen])).min(axis=0).tolist()
    try:
        replace(model, stated_validity=model.validity._replace(height_m=heights_m)).require_no_pole()
    except InputError as error:
        pole = f"{error.problems[0].place} {error.problems[0].value}"
    return {
        "least_line": least[0],
        "least_sample": least[1],
        "pole": pole,
        "pixels_without_ground": int((~seen).sum()),
        "pixels": len(seen),
    }


def image_to_ground(model: RpcModel, pixels: Array) -> dict[str, Any] | None:
    """Locate pixels by the file's inverse model, project them back and subtract the pixels; None without this model."""
    if model.direct is None:
        return None
    back = np.stack(model.project(*model.locate_directly(*pixels.T), pixels[:, 2]), axis=1)
    return statistics(back - pixels[:, :2])


def extrapolation(model: RpcModel, pixels: Array, ground: Array) -> dict[str, float]:
    """Return the largest absolute normalised coordinates over image and heights; 1 is the border of the model."""
    values = np.column_stack([pixels[:, :2], ground]) - model.offsets
    values[:, 2] -= 360.0 * np.round(values[:, 2] / 360.0)
    with np.errstate(invalid="ignore"):
        largest = np.abs(values / model.scales).max(axis=0, where=np.isfinite(values), initial=0.0)
    return dict(zip(COORDINATES, map(float, largest), strict=True))


def point_residuals(model: RpcModel, measured: MeasuredPoints) -> dict[str, Any]:
    """Return the residuals of points with statistics; ``outside``: names of points outside the validity range."""
    lon, lat, height = measured.ground.T
    v = residuals(model, measured)
    inside = model.inside(lon, lat, height)
    return {
        "statistics": statistics(v),
        "outside": [name for name, good in zip(measured.ids, inside, strict=True) if not good],
        "residuals": [
            {"id": name, "line_px": float(a), "sample_px": float(b), "inside": bool(good)}
            for name, (a, b), good in zip(measured.ids, v, inside, strict=True)
        ],
    }


def differences(model: RpcModel, other: Path, heights_m: Range) -> dict[str, Any]:
    """Return the pixels of the model minus pixels of another model, at ground points that the other model locates.

    Raises
    ------
    InputError
        The other file is not usable, or the pixels of both do not overlap.
    """
    sensor = read_sensor(other)
    its = ((sensor.first_line, sensor.n_lines - 1.0), (sensor.first_sample, sensor.last_sample))
    mine = (model.validity.line, model.validity.sample)
    ends = [(max(a, low), min(b, high)) for (a, b), (low, high) in zip(its, mine, strict=True)]
    if any(not low < high for low, high in ends):
        raise InputError.of(
            "rpc.no_overlap", file=other, value=", ".join(map(span, its)), mine=", ".join(map(span, mine))
        )
    line, sample, height = (np.ascontiguousarray(column) for column in _grid(ends[0], ends[1], heights_m).T)
    here = np.stack(model.project(*ecef_to_geodetic(sensor.locate(line, sample, height_m=height))), axis=1)
    d = here - np.column_stack([line, sample])
    worst = int(np.nanargmax(np.abs(d).max(axis=1))) if np.isfinite(d).any() else 0
    return {
        "file": str(other),
        "model": type(sensor).__name__,
        "statistics": statistics(d),
        "worst": {
            "line": float(line[worst]),
            "sample": float(sample[worst]),
            "height_m": float(height[worst]),
            "line_px": float(d[worst, 0]),
            "sample_px": float(d[worst, 1]),
        },
    }


def _disagreement(other: dict[str, Any]) -> list[Finding]:
    """Report a doubt if the pixels of two models differ by more than the limit for the two models of one file."""
    worst, figures = other["worst"], other["statistics"]
    largest = max(abs(worst["line_px"]), abs(worst["sample_px"]))
    if largest <= AGREEMENT_PX:
        return []
    mean = [figures[f"mean_{axis}_px"] for axis in AXES]
    rms = [figures[f"rms_{axis}_px"] for axis in AXES]
    apart = max(abs(worst[f"{axis}_px"] - m) for axis, m in zip(AXES, mean, strict=True))
    constant = max(r**2 - m**2 for r, m in zip(rms, mean, strict=True)) <= AGREEMENT_PX**2 and apart <= AGREEMENT_PX
    return [
        finding(
            "rpc.against",
            other=Path(other["file"]).name,
            largest_px=largest,
            rms_px=rms if np.isfinite(rms).all() else "",
            limit=AGREEMENT_PX,
            where=f"line {worst['line']:.0f}, sample {worst['sample']:.0f}, height {worst['height_m']:.0f} m",
            constant_px=mean if constant else "",
        )
    ]


def _findings(record: dict[str, Any], of_pixels: list[Finding]) -> list[Finding]:
    """Return the findings on a model, doubts first; ``of_pixels``: those from measured points."""
    out, below = [], record["denominators"]
    least = min(below["least_line"], below["least_sample"])
    if below["pole"] is not None:
        out.append(finding("rpc.pole_inside", where=below["pole"]))
    elif least < NEAR_ZERO:
        out.append(finding("rpc.near_zero_inside", least=least))
    if below["pixels_without_ground"]:
        out.append(finding("rpc.pixels_without_ground", n=below["pixels_without_ground"], pixels=below["pixels"]))
    back = record["image_to_ground"]
    if back is not None:
        largest = max(back["max_line_px"], back["max_sample_px"])
        if not largest <= AGREEMENT_PX:
            out.append(finding("rpc.directions_disagree", largest_px=largest))
    points = record["points"]
    if points is not None and points["outside"]:
        out.append(finding("rpc.points_outside", n=len(points["outside"]), points=points["outside"]))
    out += of_pixels if record["against"] is None else [*_disagreement(record["against"]), *of_pixels]
    out.sort(key=lambda f: f.severity != "doubt")
    used = record["extrapolation"].items()
    out += [finding("rpc.extrapolated", coordinate=name, used=value) for name, value in used if value > EXTRAPOLATED]
    low, high = record["validity"]["height_m"]
    if record["heights_m"][0] < low or record["heights_m"][1] > high:
        out.append(finding("rpc.heights_beyond", low=low, high=high))
    return out
