"""The mistakes of the detection study, their sizes and the three blocks were fixed before any run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from benchmarks.drawn import Drawn
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.quality import mended
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.mixed import MixedOptions, mixed_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Change = Callable[[Drawn, Any, np.random.Generator], Block]
BOTH: Final = (Role.CONTROL, Role.CHECK)


@dataclass(frozen=True)
class Mistake:
    """A mistake of the study.

    Parameters
    ----------
    what : str
    sizes : tuple
        Three sizes; the table writes ``unit`` after each.
    unit : str
    change : callable
        Function that returns the block with the mistake from a drawn block, a size and random
        numbers.
    named : tuple of str
        Parts of the text of the first cause or of the gross error that name the mistake or
        its class; the causes of a class cannot be distinguished by any data.
    """

    what: str
    sizes: tuple[Any, Any, Any]
    unit: str
    change: Change
    named: tuple[str, ...]


# --- blocks ---------------------------------------------------------------------------------------


@lru_cache(maxsize=3)
def base(name: str) -> tuple[Block, Array]:
    """Return a block and its true ground points: a SPOT-5 pair, four SPOT-5 images or a pair of RPC images."""
    if name == "pair":
        block, truth = zonguldak_block(ZonguldakOptions(errors="none"))
    elif name == "four":
        block, truth = grid_block(BlockOptions(points=60, control_share=0.25, check_share=0.2, errors="none"))
    else:
        block, truth = mixed_block(MixedOptions(points=60, control=12, check=12, errors="none"))
        rows = np.isin(block.observations.image, [2, 3])
        o = block.observations.take(rows)
        block = replace(block, images=block.images[2:4], observations=replace(o, image=o.image - 2))
    return block, truth.ecef_m


BLOCKS: Final = {
    "pair": "two SPOT-5 images, 37 control and 10 check points",
    "four": "four SPOT-5 images, 15 control, 12 check and 33 tie points",
    "rpc": "two images of 0.7 m with RPC, 12 control, 12 check and 36 tie points",
}


# --- changes of coordinates -----------------------------------------------------------------------


def some(share: float, rng: np.random.Generator, n: int) -> npt.NDArray[np.bool_]:
    """Return a random share of n indices, at least one."""
    return np.isin(np.arange(n), rng.permutation(n)[: max(1, round(share * n))])


def tables(
    roles: tuple[Role, ...], change: Callable[[Array, Any], Array], *, share: bool = False
) -> Change:  # fmt: skip
    """Return a mistake in coordinates of control or check points. With ``share`` the size is the share of points."""

    def made(drawn: Drawn, size: Any, rng: np.random.Generator) -> Block:
        seed = int(rng.integers(2**32))

        def part(ecef_m: Array) -> Array:
            moved = change(ecef_m, size)
            if not share:
                return moved
            return np.where(some(size, np.random.default_rng(seed), len(ecef_m))[:, None], moved, ecef_m)

        return mended.with_measured(drawn.block, roles, part)

    return made


def geodetic(reading: Callable[..., tuple[Array, Array, Array]]) -> Callable[[Array, Any], Array]:
    """Return a change of longitude, latitude and height by ``reading(lon, lat, height, size)``."""
    return lambda ecef_m, size: geodetic_to_ecef(*reading(*ecef_to_geodetic(ecef_m), size))


def times(factor: float) -> Callable[[Array, Any], Array]:
    return geodetic(lambda x, y, h, _: (x, y, h * factor))


def lower(ecef_m: Array, size: float) -> Array:
    return geodetic(lambda x, y, h, _: (x, y, h - size))(ecef_m, size)


def moved(direction: tuple[float, float, float]) -> Callable[[Array, Any], Array]:
    """Return a constant shift by the size along a direction East, North, Up."""

    def change(ecef_m: Array, size: float) -> Array:
        lon, lat, _ = ecef_to_geodetic(ecef_m)
        return np.asarray(ecef_m + np.einsum("nji,j->ni", enu_from_ecef(lon, lat), size * np.array(direction)))

    return change


def turned(ecef_m: Array, _: Any) -> Array:
    """Exchange East and North in a local map system whose origin is 1 km south-west of the points."""
    middle = ecef_m.mean(axis=0)
    axes = enu_from_ecef(*(float(a[0]) for a in ecef_to_geodetic(middle)[:2]))[0]
    place = (ecef_m - middle) @ axes.T
    low = place[:, :2].min(axis=0) - 1000.0
    place[:, :2] = (place[:, :2] - low)[:, ::-1] + low
    return np.asarray(middle + place @ axes)


def packed(decimals: int) -> Callable[[Array, Any], Array]:
    """Return degrees whose decimals are minutes (2) or minutes and seconds (4)."""

    def one(angle: Array) -> Array:
        degrees = np.floor(angle)
        minutes = 60.0 * (angle - degrees)
        whole = minutes if decimals == 2 else np.floor(minutes) + 0.6 * (minutes - np.floor(minutes))
        return np.asarray(degrees + whole / 100.0)

    return geodetic(lambda x, y, h, _: (one(x), one(y), h))


def ed50(ecef_m: Array, _: Any) -> Array:
    """Read ED50 as WGS84: at these blocks EPSG:1784 shifts the points by 31.2 m East and 105.4 m North."""
    return moved((31.2, 105.4, 0.0))(ecef_m, 1.0)


# --- changes of image points ----------------------------------------------------------------------


def pixels(reading: Callable[[Array, Array, Any], tuple[Array, Array]]) -> Change:
    """Return a mistake that changes line and sample for a share of the image points of the first image."""

    def made(drawn: Drawn, size: float, rng: np.random.Generator) -> Block:
        block = drawn.block
        o, rows = block.observations, np.flatnonzero(block.observations.image == 0)
        rows = rows[some(size, rng, len(rows))]
        line, sample = o.line.copy(), o.sample.copy()
        line[rows], sample[rows] = reading(o.line[rows], o.sample[rows], block.images[0].sensor)
        return replace(block, observations=replace(o, line=line, sample=sample))

    return made


def mirrored_line(line: Array, sensor: Any) -> Array:
    return np.asarray(sensor.first_line + sensor.last_line - line)


def mirrored_sample(sample: Array, sensor: Any) -> Array:
    return np.asarray(sensor.first_sample + sensor.last_sample - sample)


def origin(every: bool) -> Change:
    """Return a mistake that adds the size to lines and samples of all images or of the first one."""
    return lambda drawn, size, rng: mended.with_shifted_pixels(
        drawn.block, range(len(drawn.block.images)) if every else (0,), (size, size)
    )


def pair_of(drawn: Drawn, size: str) -> tuple[int, int]:
    """Return the nearest, a middle or the farthest pair of control points."""
    control = drawn.block.points.where(Role.CONTROL)
    place = drawn.truth_m[control]
    a, b = np.triu_indices(len(control), 1)
    order = np.argsort(np.linalg.norm(place[a] - place[b], axis=1))
    k = order[{"nearest": 0, "median": len(order) // 2, "farthest": -1}[size]]
    return int(control[a[k]]), int(control[b[k]])


PAIRS: Final = ("nearest", "median", "farthest")


def exchanged_ids(drawn: Drawn, size: str, rng: np.random.Generator) -> Block:
    a, b = (drawn.block.points.ids[j] for j in pair_of(drawn, size))
    return mended.with_coordinates_of(drawn.block, {a: b, b: a})


def copied(drawn: Drawn, size: str, rng: np.random.Generator) -> Block:
    a, b = (drawn.block.points.ids[j] for j in pair_of(drawn, size))
    return mended.with_coordinates_of(drawn.block, {a: b})


def exchanged_in_image(drawn: Drawn, size: str, rng: np.random.Generator) -> Block:
    """Exchange two control points in the first image that shows both."""
    o, (a, b) = drawn.block.observations, pair_of(drawn, size)
    line, sample = o.line.copy(), o.sample.copy()
    for k in range(len(drawn.block.images)):
        one, two = (np.flatnonzero((o.image == k) & (o.point == j)) for j in (a, b))
        if len(one) and len(two):
            rows, other = np.concatenate([one, two]), np.concatenate([two, one])
            line[rows], sample[rows] = o.line[other], o.sample[other]
            break
    return replace(drawn.block, observations=replace(o, line=line, sample=sample))


def measured_again(drawn: Drawn, size: str, rng: np.random.Generator) -> Block:
    """Give one control point the image points of another one in each image that shows both."""
    o, (a, b) = drawn.block.observations, pair_of(drawn, size)
    line, sample = o.line.copy(), o.sample.copy()
    for k in range(len(drawn.block.images)):
        mine, other = (np.flatnonzero((o.image == k) & (o.point == j)) for j in (a, b))
        if len(mine) and len(other):
            noise = rng.standard_normal(2) * o.sigma_line_px[mine]
            line[mine], sample[mine] = o.line[other] + noise[0], o.sample[other] + noise[1]
    return replace(drawn.block, observations=replace(o, line=line, sample=sample))


def two_points(drawn: Drawn, size: float, rng: np.random.Generator) -> Block:
    """Move half of the rays of the point with the most rays, no control point, to a point at this distance."""
    block, o = drawn.block, drawn.block.observations
    rays = np.bincount(o.point, minlength=len(block.points.ids))
    rays[block.points.where(Role.CONTROL)] = 0
    rows = np.flatnonzero(o.point == int(np.argmax(rays)))
    rows = rows[(len(rows) + 1) // 2 :]
    return shown_elsewhere(drawn, rows, size * np.array([0.7, -0.5, 0.5]))


def shown_elsewhere(drawn: Drawn, rows: Index, away_m: Array) -> Block:
    o = drawn.block.observations
    line, sample = o.line.copy(), o.sample.copy()
    for row in rows.tolist():
        sensor, place = drawn.block.images[o.image[row]].sensor, drawn.truth_m[o.point[row]]
        shown = np.stack(sensor.project(np.stack([place, place + away_m]), drawn.corrections[o.image[row]]))
        line[row], sample[row] = np.array([line[row], sample[row]]) + shown[:, 1] - shown[:, 0]
    return replace(drawn.block, observations=replace(o, line=line, sample=sample))


def image_names(drawn: Drawn, size: float, rng: np.random.Generator) -> Block:
    """Exchange the names of the first two images for a share of the points that both show."""
    o = drawn.block.observations
    common = np.intersect1d(o.point[o.image == 0], o.point[o.image == 1])
    wrong = common[some(size, rng, len(common))]
    line, sample = o.line.copy(), o.sample.copy()
    for j in wrong.tolist():
        a, b = (int(np.flatnonzero((o.image == k) & (o.point == j))[0]) for k in (0, 1))
        line[[a, b]], sample[[a, b]] = o.line[[b, a]], o.sample[[b, a]]
    return replace(drawn.block, observations=replace(o, line=line, sample=sample))


def metadata(drawn: Drawn, size: str, rng: np.random.Generator) -> Block:
    """Exchange the metadata of the first two images, or give one of them the metadata of the other."""
    one, two, *rest = drawn.block.images
    first = replace(one, sensor=two.sensor) if size != "in the second" else one
    second = replace(two, sensor=one.sensor) if size != "in the first" else two
    return replace(drawn.block, images=(first, second, *rest))


# --- gross errors and sigmas ----------------------------------------------------------------------


def in_control(direction: tuple[float, float, float], count: int = 1) -> Change:
    """Return a gross error of the size, in sigmas, in randomly drawn control points."""

    def made(drawn: Drawn, size: float, rng: np.random.Generator) -> Block:
        known = drawn.block.points.known
        rows = rng.permutation(drawn.block.points.where(Role.CONTROL))[:count]
        ecef = known.ecef_m.copy()
        lon, lat, _ = ecef_to_geodetic(ecef[rows])
        error = size * np.array(direction) * known.sigma_enu_m[rows]
        ecef[rows] += np.einsum("nji,nj->ni", enu_from_ecef(lon, lat), error)
        return replace(drawn.block, points=replace(drawn.block.points, known=replace(known, ecef_m=ecef)))

    return made


def in_image(role: Role, most_rays: bool = False) -> Change:
    """Return a gross error of the size, in sigmas, in a randomly drawn ray of a point with this role."""

    def made(drawn: Drawn, size: float, rng: np.random.Generator) -> Block:
        o, points = drawn.block.observations, drawn.block.points
        rays = np.bincount(o.point, minlength=len(points.ids))
        wanted = points.where(role) if len(points.where(role)) else points.where(Role.CHECK)
        if most_rays:
            wanted = wanted[rays[wanted] == rays[wanted].max()]
        rows = np.flatnonzero(np.isin(o.point, wanted))
        row, line, sample = int(rng.choice(rows)), o.line.copy(), o.sample.copy()
        line[row] += 0.6 * size * o.sigma_line_px[row]
        sample[row] += 0.8 * size * o.sigma_sample_px[row]
        return replace(drawn.block, observations=replace(o, line=line, sample=sample))

    return made


def stated(group: str, image: int | None = None) -> Change:
    """Return a mistake that divides the stated sigmas of a group by the size, or those of one image."""

    def made(drawn: Drawn, size: float, rng: np.random.Generator) -> Block:
        if image is None:
            return mended.with_sigmas(drawn.block, group, 1.0 / size)
        o = drawn.block.observations
        mine = o.image == image
        sigma = (np.where(mine, s / size, s) for s in (o.sigma_line_px, o.sigma_sample_px))
        return replace(drawn.block, observations=replace(o, **dict(zip(("sigma_line_px", "sigma_sample_px"), sigma,
                                                                       strict=True))))  # fmt: skip

    return made


CONTROL, CHECK = (Role.CONTROL,), (Role.CHECK,)
SHARES: Final = (0.25, 0.5, 1.0)
GROSS: Final = (4.0, 8.0, 20.0)

MISTAKES: Final = (
    Mistake(
        "heights of the control points lowered (orthometric)",
        (4.0, 12.0, 36.0),
        "m",
        tables(CONTROL, lower),
        ("heights of the control points", "heights of the check points"),
    ),
    Mistake(
        "heights of the check points lowered (orthometric)",
        (4.0, 12.0, 36.0),
        "m",
        tables(CHECK, lower),
        ("heights of the control points", "heights of the check points"),
    ),
    Mistake(
        "heights of control and check points lowered (orthometric)",
        (4.0, 12.0, 36.0),
        "m",
        tables(BOTH, lower),
        ("heights of the control and check points",),
    ),
    Mistake(
        "heights of control points in feet",
        SHARES,
        "of the points",
        tables(CONTROL, times(1 / 0.3048), share=True),
        ("feet",),
    ),
    Mistake(
        "heights of check points in feet",
        SHARES,
        "of the points",
        tables(CHECK, times(1 / 0.3048), share=True),
        ("feet",),
    ),
    Mistake(
        "heights of control and check points in feet",
        SHARES,
        "of the points",
        tables(BOTH, times(1 / 0.3048), share=True),
        ("feet",),
    ),
    Mistake(
        "US survey feet taken for feet", SHARES, "of the points", tables(BOTH, times(1 + 2e-6), share=True), ("feet",)
    ),
    Mistake(
        "heights of control points in kilometres",
        SHARES,
        "of the points",
        tables(CONTROL, times(1e-3), share=True),
        ("kilometres",),
    ),
    Mistake(
        "heights of check points in kilometres",
        SHARES,
        "of the points",
        tables(CHECK, times(1e-3), share=True),
        ("kilometres",),
    ),
    Mistake(
        "heights of control and check points in kilometres",
        SHARES,
        "of the points",
        tables(BOTH, times(1e-3), share=True),
        ("kilometres",),
    ),
    Mistake(
        "East and North of control points exchanged (local system)",
        SHARES,
        "of the points",
        tables(CONTROL, turned, share=True),
        (),
    ),
    Mistake(
        "longitude and latitude exchanged",
        SHARES,
        "of the control points",
        tables(CONTROL, geodetic(lambda x, y, h, _: (y, x, h)), share=True),
        ("longitude and latitude exchanged",),
    ),
    Mistake(
        "longitude and latitude in gon",
        SHARES,
        "of the control points",
        tables(CONTROL, geodetic(lambda x, y, h, _: (x / 0.9, y / 0.9, h)), share=True),
        ("in gon",),
    ),
    Mistake(
        "longitude and latitude in radians",
        SHARES,
        "of the control points",
        tables(CONTROL, geodetic(lambda x, y, h, _: (np.radians(x), np.radians(y), h)), share=True),
        ("in radians",),
    ),
    Mistake(
        "packed degrees and minutes",
        SHARES,
        "of the control points",
        tables(CONTROL, packed(2), share=True),
        ("packed degrees and minutes",),
    ),
    Mistake(
        "packed degrees, minutes and seconds",
        SHARES,
        "of the control points",
        tables(CONTROL, packed(4), share=True),
        ("packed degrees, minutes and seconds",),
    ),
    Mistake(
        "line and sample exchanged",
        SHARES,
        "of an image",
        pixels(lambda line, sample, s: (sample, line)),
        ("line and sample exchanged",),
    ),
    Mistake(
        "lines counted from the last one (mirrored)",
        SHARES,
        "of an image",
        pixels(lambda line, sample, s: (mirrored_line(line, s), sample)),
        ("lines counted from",),
    ),
    Mistake(
        "samples counted from the last one (mirrored)",
        SHARES,
        "of an image",
        pixels(lambda line, sample, s: (line, mirrored_sample(sample, s))),
        ("samples counted from",),
    ),
    Mistake(
        "image turned by half a turn",
        SHARES,
        "of an image",
        pixels(lambda line, sample, s: (mirrored_line(line, s), mirrored_sample(sample, s))),
        ("half a turn",),
    ),
    Mistake(
        "image turned by a quarter",
        SHARES,
        "of an image",
        pixels(lambda line, sample, s: (sample, mirrored_line(line, s))),
        ("by a quarter",),
    ),
    Mistake("origin of the pixels of all images", (0.5, 1.0, 2.0), "px", origin(every=True), ("origin of the pixels",)),
    Mistake("origin of the pixels of one image", (0.5, 1.0, 2.0), "px", origin(every=False), ("origin of the pixels",)),
    Mistake("ids of two control points exchanged", PAIRS, "pair", exchanged_ids, ("ids of the control points",)),
    Mistake("ids of two control points exchanged in one image", PAIRS, "pair", exchanged_in_image, ("point",)),
    Mistake("one control point measured under two ids", PAIRS, "pair", measured_again, ("under two ids",)),
    Mistake("coordinates of one control point under two ids", PAIRS, "pair", copied, ("under two ids",)),
    Mistake("two points under one id", (20.0, 100.0, 400.0), "m", two_points, ("two points under", "gross error")),
    Mistake("names of two images exchanged", SHARES, "of their points", image_names, ("metadata of image",)),
    Mistake(
        "metadata of another image", ("in the first", "in the second", "in both"), "", metadata, ("metadata of image",)
    ),
    Mistake(
        "constant shift of control points",
        (0.5, 5.0, 50.0),
        "m",
        tables(CONTROL, moved((0.8, -0.6, 0.0))),
        ("constant shift of the control", "constant shift of the check"),
    ),
    Mistake(
        "constant shift of check points",
        (0.5, 5.0, 50.0),
        "m",
        tables(CHECK, moved((0.8, -0.6, 0.0))),
        ("constant shift of the control", "constant shift of the check"),
    ),
    Mistake(
        "constant shift of control and check points",
        (0.5, 5.0, 50.0),
        "m",
        tables(BOTH, moved((0.8, -0.6, 0.0))),
        ("constant shift of the control and check",),
    ),
    Mistake(
        "control points in ED50",
        SHARES,
        "of the points",
        tables(CONTROL, ed50, share=True),
        ("ED50", "constant shift of the"),
    ),
    Mistake(
        "control and check points in ED50",
        SHARES,
        "of the points",
        tables(BOTH, ed50, share=True),
        ("ED50", "constant shift of the"),
    ),
    Mistake(
        "control points in ETRS89 for ITRF (plate motion)",
        (0.25, 0.5, 1.0),
        "m",
        tables(CONTROL, moved((-0.85, -0.53, 0.0))),
        ("constant shift of the",),
    ),
    Mistake(
        "gross error, control point horizontally",
        GROSS,
        "sigmas",
        in_control((0.8, 0.6, 0.0)),
        ("gross error: position",),
    ),
    Mistake(
        "gross error, control point vertically", GROSS, "sigmas", in_control((0.0, 0.0, 1.0)), ("gross error: height",)
    ),
    Mistake(
        "gross errors, two control points horizontally",
        GROSS,
        "sigmas",
        in_control((0.8, 0.6, 0.0), 2),
        ("gross error: position",),
    ),
    Mistake(
        "gross error, image point of a control point", GROSS, "sigmas", in_image(Role.CONTROL), ("gross error: point",)
    ),
    Mistake("gross error, image point of a tie point", GROSS, "sigmas", in_image(Role.TIE), ("gross error: point",)),
    Mistake(
        "gross error, tie point with the most rays",
        GROSS,
        "sigmas",
        in_image(Role.TIE, most_rays=True),
        ("gross error: point",),
    ),
    Mistake(
        "stated sigmas of image points too small",
        (1.25, 1.5, 3.0),
        "times",
        stated("image points"),
        ("sigmas of image points",),
    ),
    Mistake(
        "stated sigmas of one image too small",
        (1.25, 1.5, 3.0),
        "times",
        stated("image points", 0),
        ("sigmas of image points",),
    ),
    Mistake(
        "stated sigmas of control points horizontally too small",
        (1.5, 3.0, 10.0),
        "times",
        stated("control points horizontally"),
        ("sigmas of control points horizontally",),
    ),
    Mistake(
        "stated sigmas of control points vertically too small",
        (1.5, 3.0, 10.0),
        "times",
        stated("control points vertically"),
        ("sigmas of control points vertically",),
    ),
    Mistake(
        "stated sigmas of image points too large",
        (1.5, 2.0, 3.0),
        "times",
        lambda d, s, r: mended.with_sigmas(d.block, "image points", s),
        (),
    ),
)
