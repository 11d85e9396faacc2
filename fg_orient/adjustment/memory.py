"""Estimate the memory of an adjustment before it is allocated, and compare it with the available memory.

The estimate includes the arrays of the problem. It also includes the larger of two parts:
the arrays of the backend, and the arrays of statistics and results, which are made after the backend is
released. If the backend exceeds the limit, ground points are adjusted in parts: their arrays are in
files, and some of them are open at the same time. If only the statistics of every observation exceed
it, they are left out. Otherwise the run is refused with both values. Constants per image point are
measured at 1e6 image points. The arrays of the dense backend and the reduced matrix are counted. The
estimate does not include the block, which is in memory already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from factors.arrays import Index
from factors.cameras import pushbroom
from factors.geometry.polynomials import MOST
from fg_orient.adjustment.cofactors import CHUNK, WHOLE_LIMIT, full_statistics
from fg_orient.adjustment.images_first import Sizes, each_of_one_image
from fg_orient.adjustment.problem import no_point_is_named
from fg_orient.adjustment.reduced_choice import (
    ITERATIVE,
    LARGEST_FULL,
    ROW_BYTES,
    choose,
    narrowest,
    pattern_of_rays,
)
from fg_orient.adjustment.rows import image_models
from fg_orient.adjustment.schur_reduced import banded_order
from fg_orient.adjustment.schur_stages import COPIED
from fg_orient.adjustment.schur_structure import LEAST_CHUNKS
from fg_orient.adjustment.solve import points_are_eliminated, suitable_backend
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.machine import allowed_bytes, in_gb
from fg_orient.model.names import Role
from fg_orient.sensors.base import ImageModel

#: Bytes per image point of three kinds: arrays of eliminated points; explicit factors of
#: GTSAM with values, linear graph and Bayes tree; start values and results (cofactors,
#: tables, report).
SCHUR: Final = 400
EXPLICIT: Final = 13_000
RESULTS: Final = 300
#: Bytes per image point of the statistics of every observation, and of the Jacobians that
#: are in memory at the same time.
STATISTICS: Final = 300
STATISTICS_CHUNK: Final = 300
#: Maximum number of image points for which the cofactors of groups of observations are
#: computed in every adjustment, and bytes of each.
EXACT_RAYS: Final = 3000
GROUPS: Final = 5000
#: Bytes per image point if images are eliminated first: rows and their columns at two
#: states. Number of arrays with a row for each image unknown and a column for each
#: unknown of the border.
IMAGES_FIRST: Final = 2000
ARRAYS: Final = 4
#: Bytes of the matrices of points in many images that are in memory at the same time, for the cofactors of groups.
MATRICES: Final = 60_000_000
#: Bytes that do not depend on the block: models, names, records of the run.
FIXED: Final = 500_000
#: Number of doubles that are stored for each ground point in problem, state and results.
PER_POINT: Final = 60

#: Default number of image points of a part. The number of parts then depends only on the
#: block. So the last bit of a result does not depend on the machine. A task costs a few
#: ms, a part of this size 10 ms.
PART_SIZE: Final = 20_000
MAX_PARTS: Final = 256


@dataclass(frozen=True)
class Need:
    """Estimated bytes of an adjustment with a backend, and its limit (None: unknown).

    ``statistics_left_out``: statistics of every observation are left out, because they
    would exceed the limit and the options leave the choice to the program. ``parts`` is
    the number of parts of the ground points, if the limit or the user requires them. At
    most ``kept`` of them are open in a process (None: all). The whole block would need
    ``whole`` bytes.
    """

    backend: str
    needed: int
    allowed: int | None
    statistics_left_out: bool = False
    parts: int | None = None
    kept: int | None = None
    whole: int | None = None

    @property
    def fits(self) -> bool:
        """True if the run may start."""
        return self.allowed is None or self.needed <= self.allowed

    def as_dict(self) -> dict[str, object]:
        """Return plain values for the record of a result."""
        return {
            "backend": self.backend,
            "needed_bytes": self.needed,
            "allowed_bytes": self.allowed,
            "statistics_left_out": self.statistics_left_out,
            "parts": self.parts,
            "open_parts": self.kept,
        }

    @property
    def note(self) -> Finding | None:
        """Return the finding on parts that the limit requires; None without parts."""
        if self.kept is None:
            return None
        return finding(
            "adjust.in_parts",
            value=in_gb(self.whole or 0),
            allowed=in_gb(self.allowed or 0),
            parts=self.parts,
            kept=self.kept,
        )

    def problem(self, name: str) -> Finding:
        """Return the error for a block of this name that does not fit."""
        return finding(
            "adjust.memory",
            file=name,
            place=f"backend {self.backend}",
            value=in_gb(self.needed),
            allowed=in_gb(self.allowed or 0),
        )


def need_of(block: Block, *, elsewhere: bool = False, open_share: float = 1.0) -> Need:
    """Estimate the memory of an adjustment, without the block itself.

    Parameters
    ----------
    block : Block
        Block with the options of the run.
    elsewhere : bool
        True if other machines eliminate the ground points; their arrays are then not in this memory.
    open_share : float
        Share of the image points whose arrays are in memory at the same time, for a block in parts.

    Raises
    ------
    InputError
        A sensor has no image model.
    """
    options = block.options
    models = image_models(block.images, options)
    sizes = [len(model.parameters) for model in models]
    n, u = len(block.observations), sum(sizes)
    records = 8 * (pushbroom.RECORD.size + (MOST if options.jitter_curves else options.curve_intervals))
    common = n * (open_share * records + 48) + len(block.points.ids) * 8 * PER_POINT
    backend = suitable_backend(block)
    border = _images_first(block, models) if backend == "graph" else None
    if border is not None:
        groups = MATRICES if n <= EXACT_RAYS else 0
        needed = FIXED + common + n * (IMAGES_FIRST + RESULTS + STATISTICS) + 8 * ARRAYS * u * border + groups
        return Need(backend, int(needed), allowed_bytes(options.memory_limit_gb))
    wide = _wide(block, np.array(sizes)) if backend != "dense" and u > ITERATIVE else None
    working = _working(backend, block, n, u, max(sizes), wide)
    if open_share < 1.0 or (backend == "schur" and elsewhere):
        working -= (1.0 - (0.0 if elsewhere else open_share)) * n * SCHUR
    elif backend != "dense" and n <= COPIED:  # for small blocks, the records are copied
        working += n * records
    limited = 0 if wide is not None and wide.selects else u  # see ``quality.covariance.gives_statistics``
    pairs = len(block.images) * (len(block.images) + 1) / 2 if wide is None else wide.blocks
    after = n * RESULTS + (_statistics(pairs, n, max(sizes)) if full_statistics(options, n, limited) else 0)
    return Need(backend, int(FIXED + common + max(working, after)), allowed_bytes(options.memory_limit_gb))


@dataclass(frozen=True)
class _Wide:
    """Reduced system of many images: number of its blocks, bytes of a factor for its inverse (0: no factor).

    ``implicit``: the system is solved without its blocks. ``selects``: see ``schur_reduced.Reduced``.
    """

    blocks: int
    inverse: float
    implicit: bool
    selects: bool


def _wide(block: Block, size: Index) -> _Wide:
    """Return the reduced system of a block from the pairs of images that share points."""
    o, free = block.observations, ~block.points.known.fixed[block.observations.point]
    pattern, first = pattern_of_rays(o.image[free], o.point[free], size), np.append(0, np.cumsum(size))
    u, order = int(first[-1]), banded_order(pattern, first)
    kind = choose(pattern, narrowest(pattern, first).band).kind
    full = 8.0 * 2.0 * u**2 if u <= LARGEST_FULL else 0.0
    implicit = kind == "implicit" and block.options.backend != "graph"
    banded = order is not None and not implicit
    inverse = 8.0 * 2.0 * u * (order.band + 1) if banded and order is not None else full
    return _Wide(len(pattern.block_row), inverse, implicit, banded or bool(full))


def _statistics(pairs: float, n: int, widest: int) -> float:
    """Return the bytes of cofactors and reliability of all image points, and of two arrays of the pairs of images."""
    groups = n * GROUPS if n <= EXACT_RAYS else 0
    return n * STATISTICS + groups + min(n, CHUNK) * STATISTICS_CHUNK + 2 * 8 * widest**2 * pairs


def _images_first(block: Block, models: Sequence[ImageModel]) -> int | None:
    """Return the number of unknowns of the border if images are eliminated first, else None."""
    extra, points = [e for e in block.extra if isinstance(e, ExtraObservation)], block.points
    parameters = [model.parameters for model in models]
    shared = {(p.shared[j], p.codes[j]) for p in parameters for j in np.flatnonzero(~p.own).tolist()}
    rays = np.bincount(block.observations.point, minlength=len(points.ids))
    names = _named(block)
    named = np.array([name in names for name in points.ids], bool) & (rays > 0)
    border = len(shared) + 3 * int(((rays > 0) & ~points.known.fixed).sum())
    widest = max(len(p) for p in parameters)
    sizes = Sizes(sum(int(p.own.sum()) for p in parameters), border, widest, rays, named)
    return border if each_of_one_image(extra) and sizes.images_first else None


def _named(block: Block) -> set[str]:
    """Return the ids of the ground points that extra observations name."""
    names = (name for e in block.extra if isinstance(e, ExtraObservation) for name in e.unknowns)
    return {name.removeprefix("point:") for name in names if name.startswith("point:")}


def _working(backend: str, block: Block, n: int, u: int, widest: int, wide: _Wide | None) -> float:
    """Return the bytes of a backend for n image points and u image unknowns, ``widest`` of them in one image."""
    images, points = len(block.images), block.points
    named = len(_named(block))
    if backend == "graph" and not points_are_eliminated(block.options, not named, named < len(points.ids)):
        return n * EXPLICIT + 2 * 8 * u**2  # GTSAM; joint cofactors of the images
    if backend != "dense":  # rows, reduced matrix with factor and inverse, blocks and sums of pairs of images
        whole = 3 * 8 * u**2 if u <= WHOLE_LIMIT else 0 if wide is None else wide.inverse
        formed = (2 + LEAST_CHUNKS) * 8 * widest**2 * (images * (images + 1) / 2 if wide is None else wide.blocks)
        if wide is not None and wide.implicit and not wide.selects:
            return n * (SCHUR + ROW_BYTES)  # neither blocks nor a factor
        return n * SCHUR + whole + formed
    fixed = int(points.known.fixed.sum())
    unknowns = u + 3 * (len(points.ids) - fixed)
    rows = 2 * n + 3 * (len(points.where(Role.CONTROL)) - fixed) + (u if block.options.priors else 0)
    return 8 * (3 * rows * unknowns + 2 * unknowns**2)  # Jacobian, scaled copy, factorisation; cofactors


def default_parts(n_image_points: int) -> int:
    """Return the number of parts of a block, from its image points."""
    return min(max(1, -(-n_image_points // PART_SIZE)), MAX_PARTS)


@dataclass(frozen=True)
class Parts:
    """Parts of a run: their number (None: chosen by the size of the block) and processes; 0: parts only if needed.

    ``elsewhere``: the parts are on other machines.
    """

    number: int | None = None
    processes: int = 0
    elsewhere: bool = False


def _in_parts(block: Block, parts: Parts) -> Need:
    """Estimate the memory of a block in parts; as many parts are open as the limit allows."""
    whole, n = need_of(block, elsewhere=parts.elsewhere), len(block.observations)
    number, processes = parts.number or default_parts(n), max(parts.processes, 1)
    if parts.elsewhere or whole.allowed is None or (whole.fits and parts.processes):
        return replace(whole, parts=number)
    least, most = (need_of(block, open_share=share) for share in (min(1.0, processes / number), 1.0))
    each = max((most.needed - least.needed) / max(number - processes, 1), 1.0)
    kept = min(int(1 + max(whole.allowed - least.needed, 0) / each / processes), number)
    return Need(
        "schur",
        int(least.needed + each * processes * (kept - 1)),
        whole.allowed,
        parts=number,
        kept=kept,
        whole=whole.needed,
    )


def _may_be_parted(block: Block) -> bool:
    """Return whether ground points can be adjusted in parts (``adjustment.parts.solve``)."""
    own = all(model.parameters.own.all() for model in image_models(block.images, block.options))
    return own and block.options.backend in ("auto", "schur") and no_point_is_named(block)


def reduced(block: Block, parts: Parts | None = None) -> tuple[Need, Block]:
    """Estimate the memory of a block. If it is too large, try parts, then no statistics, then both.

    Statistics of every observation are left out only if the options allow it.
    """
    parts = parts or Parts()
    choices = [block]
    if block.options.statistics == "auto" and not block.options.snoop:  # a search needs the statistics
        choices.append(replace(block, options=replace(block.options, statistics="basic")))
    least: Need | None = None
    for one in choices:
        need = _in_parts(one, parts) if parts.processes else need_of(one)
        if not (need.fits or parts.processes) and _may_be_parted(one):
            need = min(_in_parts(one, parts), need, key=lambda each: each.needed)
        if need.fits:
            return replace(need, statistics_left_out=one is not block), one
        least = need if least is None or need.needed < least.needed else least
    assert least is not None
    return least, block


def within_memory(block: Block, parts: Parts | None = None) -> tuple[Need, Block]:
    """Estimate the memory as :func:`reduced`.

    Raise InputError if the adjustment is not possible within the limit.
    """
    need, block = reduced(block, parts)
    if not need.fits:
        raise InputError(need.problem(block.name))
    return need, block
