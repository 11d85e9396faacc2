"""The module makes blocks of real RPC products: Pléiades image 1, the Pléiades Neo pair, the SPOT-7 pair."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fg_orient.formats.rpc import read_rpc
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.block import Block, Coordinates, GroundPoints, Image, ImagePoints, WithheldCoordinates
from fg_orient.model.names import Role
from fg_orient.sensors.rpc_sensor import RpcSensor


def rows(path: Path) -> list[dict[str, str]]:
    """Return a CSV table, compressed or not."""
    opened = gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else path.open(encoding="utf-8")
    with opened as stream:
        return list(csv.DictReader(stream))


def numbers(table: Sequence[dict[str, str]], *names: str) -> np.ndarray:
    """Return the columns as numbers (n, k)."""
    return np.array([[float(row[name]) for name in names] for row in table])


def spread(pixels: np.ndarray, count: int) -> list[int]:
    """Choose well-spread points without looking at residuals: one is the central one, more are farthest apart."""
    u = (pixels - pixels.mean(axis=0)) / np.ptp(pixels, axis=0)
    from_centre = np.linalg.norm(u, axis=1)
    if count == 1:
        return [int(np.argmin(from_centre))]
    chosen = [int(np.argmax(from_centre))]
    while len(chosen) < count:
        nearest = np.linalg.norm(u[:, None] - u[None, chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(nearest)))
    return chosen


def block_of(
    name: str, images: tuple[Image, ...], ids: tuple[str, ...], known: Coordinates, observations: ImagePoints
) -> Block:
    """Make all points with coordinates control points, and the others tie points."""
    roles = tuple(Role.TIE if np.isnan(x).any() else Role.CONTROL for x in known.ecef_m)
    empty = Coordinates(np.empty((0, 3)), np.empty((0, 3)), np.zeros(0, bool))
    return Block(name, images, GroundPoints(ids, roles, known), observations, WithheldCoordinates((), lambda: empty))


def with_roles(block: Block, control: Collection[int], left_out: Collection[str] = ()) -> Block:
    """Return the block with these control points and all others as check points.

    Points left out lose their observations.
    """
    points, o = block.points, block.observations
    roles = tuple(Role.CONTROL if j in control else Role.CHECK for j in range(len(points.ids)))
    is_control = np.array([r is Role.CONTROL for r in roles])
    check, known = np.flatnonzero(~is_control), points.known
    sealed = Coordinates(known.ecef_m[check], known.sigma_enu_m[check], known.fixed[check])
    kept = Coordinates(np.where(is_control[:, None], known.ecef_m, np.nan),
                       np.where(is_control[:, None], known.sigma_enu_m, np.nan), known.fixed & is_control)  # fmt: skip
    gone = np.array([j for j, name in enumerate(points.ids) if name in left_out], dtype=int)
    return replace(
        block, points=GroundPoints(points.ids, roles, kept), observations=o.take(~np.isin(o.point, gone)),
        withheld=WithheldCoordinates(tuple(points.ids[j] for j in check), lambda: sealed),
    )  # fmt: skip


def pleiades_1(folder: Path) -> Block:
    """Return the 86 surveyed points as constants in image 1, vendor RPC; pixels of the file count from 1."""
    source = folder / "geoetrim-pleiades"
    image = Image("1", RpcSensor(read_rpc(source / "PHR1A_img1_RPC.txt", first_pixel=1.0)))
    table = rows(source / "points_img1.csv")
    n, pixel = len(table), numbers(table, "line", "col") - 1.0
    ecef = numbers(table, "X_ecef_m", "Y_ecef_m", "Z_ecef_m")
    known = Coordinates(ecef, np.full((n, 3), np.nan), np.ones(n, bool))
    half = np.full(n, 0.5)
    o = ImagePoints(np.zeros(n, int), np.arange(n), pixel[:, 0], pixel[:, 1], half, half)
    return block_of("Pléiades 1", (image,), tuple(row["point_id"] for row in table), known, o)


def pleiades_neo(folder: Path, pixel_factor: float = 1.0, position_factor: float = 1.0) -> Block:
    """Return the Pléiades Neo pair with its control points; the stated sigmas times the factors."""
    source = folder / "micmac-pneo-pair"
    images = tuple(Image(p.name[4:25], RpcSensor(read_rpc(p))) for p in sorted(source.glob("RPC_*.XML")))
    ground = {row["gcp_id"]: row for row in rows(source / "gcp_ground.csv")}
    seen = [row for row in rows(source / "gcp_image.csv") if row["gcp_id"] in ground]
    ids = tuple(dict.fromkeys(row["gcp_id"] for row in seen))
    table = [ground[name] for name in ids]
    sigma = numbers(table, "sigma_x_m", "sigma_y_m", "sigma_z_m") * [position_factor, position_factor, 1.0]
    ecef = geodetic_to_ecef(*numbers(table, "lon_deg", "lat_deg", "h_m").T)
    names = [image.id for image in images]
    s = numbers(seen, "sigma_line_px", "sigma_col_px") * pixel_factor
    o = ImagePoints(
        np.array([names.index(row["image"]) for row in seen]), np.array([ids.index(row["gcp_id"]) for row in seen]),
        *numbers(seen, "line", "col").T, s[:, 0], s[:, 1],
    )  # fmt: skip
    return block_of("Pléiades Neo", images, ids, Coordinates(ecef, sigma, np.zeros(len(ids), bool)), o)


def spot7(folder: Path, count: int, sigma_px: float = 0.5) -> Block:
    """Return the SPOT-7 pair with every k-th of its 115109 tie points; x is the sample, y the line."""
    source = folder / "micmac-spot7-rpc"
    images = tuple(Image(name, RpcSensor(read_rpc(source / f"RPC_{name}.xml"))) for name in ("1A", "1B"))
    tables = [{row["Id"]: row for row in rows(source / f"PMUL-SPOT_{i.id}.csv.gz")} for i in images]
    both = [name for name in tables[0] if name in tables[1]]
    ids = tuple(both[:: len(both) // count][:count])
    pixel = np.concatenate([numbers([table[name] for name in ids], "Pt.y", "Pt.x") for table in tables])
    nothing = Coordinates(np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.zeros(count, bool))
    sigma = np.full(2 * count, sigma_px)
    o = ImagePoints(np.repeat([0, 1], count), np.tile(np.arange(count), 2), pixel[:, 0], pixel[:, 1], sigma, sigma)
    return block_of("SPOT-7", images, ids, nothing, o)
