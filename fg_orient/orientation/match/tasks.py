"""Tasks of matching for this or other processes: pairs on the coarse level, and cells at full resolution.

A process reads the project and opens the rasters once. A task returns only arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from math import ceil
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.project import read_images
from fg_orient.formats.rasters import Place, Raster
from fg_orient.model.block import Image, Options
from fg_orient.orientation.match.blocks import Counts, Expected, Matches, Window, joined, match_block
from fg_orient.orientation.match.coarse import Coarse, match_coarse
from fg_orient.orientation.match.epipolar import Pair, dem_range, parallax_sigma_px
from fg_orient.orientation.match.options import MatchOptions

#: Largest edge of a window at full resolution, and least edge of a task, px.
LARGEST: Final = 400
LEAST: Final = 256
#: A cell is matched until it has this multiple of the requested points, because some matches
#: fail the tests of the whole pair.
SURPLUS: Final = 1.3
#: Number of prior standard deviations within which the y-parallax is searched.
PRIOR_SIGMAS: Final = 3.0


@dataclass(frozen=True)
class Setup:
    """Data common to all tasks of a run; each process reads them again.

    Parameters
    ----------
    project : str
    places : tuple of Place
        Raster of each image.
    low_m, high_m : float
        Heights of the ground.
    options : MatchOptions
    extrapolate_attitude_s : float or None
        Option for reading the metadata.
    dem, vertical_crs : str
        File of a DEM, "" without DEM; its vertical CRS.
    """

    project: str
    places: tuple[Place, ...]
    low_m: float
    high_m: float
    options: MatchOptions
    dem: str = ""
    vertical_crs: str = ""


class Work:
    """Sensors and rasters of a run, in one process."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        read = read_images(setup.project)
        self.images: tuple[Image, ...] = read.images
        self.options: Options = read.options
        self.rasters = tuple(Raster(place) for place in setup.places)
        self.dem: Any = None
        if setup.dem:
            from fg_orient.sensors.surface import RasterDem

            self.dem = RasterDem(setup.dem, vertical_crs=setup.vertical_crs)

    def pair(self, a: int, b: int) -> Pair:
        """Return the pair of two images."""
        return Pair(self.images[a].sensor, self.images[b].sensor, self.setup.low_m, self.setup.high_m)


@lru_cache(maxsize=1)
def work_of(setup: Setup) -> Work:
    """Return the sensors and rasters of a run, which are made once in a process."""
    return Work(setup)


def coarse_task(setup: Setup, a: int, b: int) -> tuple[Coarse, float]:
    """Return the coarse level of a pair, and the prior standard deviation of its y-parallax."""
    work, pair, place = work_of(setup), work_of(setup).pair(a, b), setup.places[a]
    sigma = parallax_sigma_px(pair, work.options, *place.centre)
    return match_coarse(work.rasters[a], work.rasters[b], pair, PRIOR_SIGMAS * sigma, setup.options), sigma


def cell_windows(place: Place, cells: int) -> list[Window]:
    """Return the windows of the tasks of an image: cells, or several small cells together."""
    edges = []
    for size in (place.rows, place.columns):
        count = min(cells, max(1, size // LEAST))
        edges.append(np.linspace(0, size, count + 1).astype(int).tolist())
    rows, columns = edges
    return [Window(r, c, r_end - r, c_end - c) for (r, r_end), (c, c_end) in product(pairwise(rows), pairwise(columns))]


def parts_of(window: Window) -> list[Window]:
    """Return parts of a window that are matched one after the other, in an order that spreads them over the window."""
    rows, columns = (
        pairwise(np.linspace(0, size, ceil(size / LARGEST) + 1).astype(int).tolist())
        for size in (window.rows, window.columns)
    )
    parts = [
        Window(window.row + r, window.column + c, r_end - r, c_end - c)
        for (r, r_end), (c, c_end) in product(rows, columns)
    ]
    return [parts[k] for k in np.random.default_rng(len(parts)).permutation(len(parts))]


def cell_task(
    setup: Setup, a: int, window: Window, others: tuple[tuple[int, Coarse], ...]
) -> list[tuple[Matches, Counts]]:
    """Match a cell of image a with other images, part by part, until there are enough matches with each of them."""
    work, place = work_of(setup), setup.places[a]
    cell = max(place.rows * place.columns / setup.options.cells**2, 1.0)
    wanted = SURPLUS * setup.options.points_per_cell * max(window.rows * window.columns / cell, 1.0)
    first = np.array([place.line + window.row, place.sample + window.column])
    last = first + np.array([window.rows - 1, window.columns - 1])
    pairs = [
        (work.pair(a, b), work.rasters[b], _expected(work, work.pair(a, b), coarse, first, last))
        for b, coarse in others
    ]
    found: list[list[Matches]] = [[] for _ in others]
    counts = [Counts() for _ in others]
    for part in parts_of(window):
        open_ = [k for k in range(len(others)) if sum(len(m.t) for m in found[k]) < wanted]
        if not open_:
            break
        limit = max(4, ceil(wanted * part.rows * part.columns / (window.rows * window.columns)))
        results = match_block(work.rasters[a], part, [pairs[k] for k in open_], setup.options, 2 * limit)
        for k, (matches, count) in zip(open_, results, strict=True):
            found[k].append(matches)
            counts[k] = counts[k].plus(count)
    return [(joined(m), c) for m, c in zip(found, counts, strict=True)]


def _expected(work: Work, pair: Pair, coarse: Coarse, first: Array, last: Array) -> Expected:
    """Return the heights and y-parallaxes of a cell, from the coarse level and the DEM."""
    assert coarse.trend is not None
    low, high = coarse.t_range(first, last)
    if work.dem is not None:
        line, sample = (
            a.ravel() for a in np.meshgrid(*(np.linspace(f, e, 5) for f, e in zip(first, last, strict=True)))
        )
        span = dem_range(work.dem, pair, line, sample, work.setup.options.dem_sigma_m)
        if span is not None:
            t_low, t_high = pair.t_of(span[0]), pair.t_of(span[1])
            if max(low, t_low) < min(high, t_high):
                low, high = max(low, t_low), min(high, t_high)
    return Expected(low, high, coarse.trend, coarse.width_px())
