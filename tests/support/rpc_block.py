"""The Zonguldak twin has RPC instead of its rigorous models; they are fitted and compensated here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from factors.cameras.rfm_equation import COMPENSATIONS
from fg_orient.formats.atomic import write_text
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.formats.rpc import write_rpc
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.model.block import Block, Image, Options
from fg_orient.model.names import Role
from fg_orient.sensors.rpc import RpcModel, RpcValidity
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

HEIGHTS = (-200.0, 2200.0)
SIGMA_PX = 0.3
#: Prior sigmas of the simulated compensation: shift, other terms (px).
SHIFT_PX, LINEAR_PX = 20.0, 2.0
#: Parameters in the table eop.
TERMS = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")


def terms(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the 20 monomials in RPC00B order: (n, 20)."""
    one = np.ones_like(x)
    return np.stack([one, x, y, z, x * y, x * z, y * z, x * x, y * y, z * z, x * y * z, x**3, x * y * y, x * z * z,
                     x * x * y, y**3, y * z * z, x * x * z, y * y * z, z**3], axis=1)  # fmt: skip


def fitted_rpc(sensor: Any, name: str) -> RpcModel:
    """Fit a model to a rigorous sensor on a grid of pixels and heights: linear least squares, twice weighted."""
    line, sample, h = (
        a.ravel() for a in np.meshgrid(np.linspace(0, sensor.n_lines - 1, 13),
                                       np.linspace(0, sensor.n_samples - 1, 13), np.linspace(*HEIGHTS, 5))
    )  # fmt: skip
    lon, lat, _ = ecef_to_geodetic(sensor.locate(line, sample, height_m=h))
    values = np.stack([line, sample, lon, lat, h])
    offsets, scales = 0.5 * (values.max(axis=1) + values.min(axis=1)), 0.5 * np.ptp(values, axis=1)
    n = (values - offsets[:, None]) / scales[:, None]
    m, c = terms(*n[2:]), np.zeros((4, 20))
    for k in (0, 1):
        weight = np.ones(len(m))
        for _ in range(3):
            design = np.hstack([m, -n[k][:, None] * m[:, 1:]]) * weight[:, None]
            found = np.linalg.lstsq(design, n[k] * weight, rcond=1e-12)[0]
            c[2 * k], c[2 * k + 1] = found[:20], np.concatenate([[1.0], found[20:]])
            weight = 1.0 / (m @ c[2 * k + 1])
    ranges = [(0.0, sensor.n_lines - 1.0), (0.0, sensor.n_samples - 1.0)]
    ranges += [(float(a), float(b)) for a, b in zip((offsets - scales)[2:], (offsets + scales)[2:], strict=True)]
    return RpcModel(offsets, scales, c, RpcValidity(*ranges), sensor.n_lines, sensor.n_samples, file=f"{name}_RPC.TXT")


@cache
def twin_with_models() -> tuple[Block, np.ndarray, tuple[RpcModel, ...]]:
    """Return the twin, its true ground points and one fitted model per image."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    return block, truth.ecef_m, tuple(fitted_rpc(image.sensor, image.id) for image in block.images)


@dataclass(frozen=True)
class RpcTwin:
    """A simulated block and its truth: compensation (M, 6) px, ground (N, 3) ECEF m."""

    block: Block
    compensation: np.ndarray
    ecef_m: np.ndarray


def rpc_twin(kind: str = "shift", seed: int = 1, noise_px: float = SIGMA_PX) -> RpcTwin:
    """Simulate: compensation drawn from the priors, pixels and control points with noise."""
    block, true_m, models = twin_with_models()
    rng = np.random.default_rng(seed)
    codes = list(COMPENSATIONS["drift" if kind == "shift_drift" else kind])
    compensation = np.zeros((len(models), 6))
    compensation[:, codes] = rng.normal(size=(len(models), len(codes)))
    compensation *= np.array([SHIFT_PX] * 2 + [LINEAR_PX] * 4)
    images = tuple(Image(i.id, RpcSensor(m)) for i, m in zip(block.images, models, strict=True))
    o = block.observations
    pixels = np.empty((len(o), 2))
    for k, image in enumerate(images):
        rows = o.image == k
        pixels[rows] = np.stack(image.sensor.project(true_m[o.point[rows]], compensation[k]), axis=1)
    pixels += rng.normal(scale=noise_px, size=pixels.shape)
    sigma = np.full(len(o), SIGMA_PX)
    observations = replace(o, line=pixels[:, 0], sample=pixels[:, 1], sigma_line_px=sigma, sigma_sample_px=sigma)
    options = Options(rpc_compensation=kind, rpc_shift_sigma_px=SHIFT_PX, rpc_linear_sigma_px=LINEAR_PX)
    return RpcTwin(replace(block, images=images, observations=observations, options=options), compensation, true_m)


def without_control(block: Block) -> Block:
    """Return all points as tie points."""
    known = block.points.known
    nothing = np.full_like(known.ecef_m, np.nan)
    empty = replace(known, ecef_m=nothing, sigma_enu_m=nothing, fixed=np.zeros(len(nothing), bool))
    ids = block.points.ids
    return replace(block, points=replace(block.points, roles=(Role.TIE,) * len(ids), known=empty),
                   withheld=replace(block.withheld, ids=()))  # fmt: skip


def write_folder(folder: Path, twin: RpcTwin, *, control: bool = True, datum: str = "control") -> Path:
    """Write the twin as a project, with the truth in its folder ``truth``."""
    folder.mkdir()
    block, o = twin.block, twin.block.observations
    ids = block.points.ids
    measured, sealed = block.points.known, block.withheld.open()
    ecef, sigma = measured.ecef_m.copy(), measured.sigma_enu_m.copy()
    check = [ids.index(name) for name in block.withheld.ids]
    ecef[check], sigma[check] = sealed.ecef_m, sealed.sigma_enu_m
    roles = block.points.roles if control else (Role.TIE,) * len(ids)
    coordinates = np.stack(ecef_to_geodetic(ecef), axis=1)
    if not control:
        coordinates[:], sigma[:] = np.nan, np.nan
    write_points(folder / "points.csv", ids, roles, coordinates, sigma)
    write_observations(folder / "observations.csv", [block.images[k].id for k in o.image], [ids[j] for j in o.point],
                       np.stack([o.line, o.sample], axis=1),
                       np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1))  # fmt: skip
    for image in block.images:
        write_rpc(folder / f"{image.id}_RPC.TXT", image.sensor.model)
    write_project(folder / "project.toml", name="RPC twin", images=[(i.id, f"{i.id}_RPC.TXT") for i in block.images],
                  options=replace(block.options, datum=datum))  # fmt: skip
    (folder / "truth").mkdir()
    rows = [f"{image.id},{name},{float(twin.compensation[k, j])!r}" for k, image in enumerate(block.images)
            for j, name in enumerate(TERMS)]  # fmt: skip
    write_text(folder / "truth" / "eop.csv", "\n".join(["image,parameter,value_per_tau", *rows, ""]))
    lon, lat, h = ecef_to_geodetic(twin.ecef_m)
    points = [f"{name},{float(lon[j])!r},{float(lat[j])!r},{float(h[j])!r}" for j, name in enumerate(ids)]
    write_text(folder / "truth" / "points.csv", "\n".join(["id,lon_deg,lat_deg,height_m", *points, ""]))
    return folder / "project.toml"
