"""Mistakes in tables of image points that a model tells at once: exchanged, or counted from the other side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError, Finding, finding

Array = npt.NDArray[np.float64]

#: Points that an image needs for a judgement, and how many times better another reading must fit.
LEAST_POINTS: Final = 3
BETTER: Final = 10.0

Reading = Callable[[Array, Array, Any], tuple[Array, Array]]

#: Other readings of line and sample, by what they mean.
READINGS: Final[dict[str, Reading]] = {
    "line and sample exchanged": lambda line, sample, sensor: (sample, line),
    "lines counted from the last one": lambda line, sample, sensor: (
        sensor.first_line + sensor.last_line - line, sample
    ),
    "samples counted from the last one": lambda line, sample, sensor: (
        line, sensor.first_sample + sensor.last_sample - sample
    ),
}  # fmt: skip


def mix_ups(block: Block) -> tuple[Finding, ...]:
    """Name images whose control points fit far better when their image coordinates are read in another way.

    Parameters
    ----------
    block : Block

    Returns
    -------
    tuple of Finding
        One per image; median distances are those between the points measured and the points projected with
        the orientation of the metadata, in pixels.
    """
    out = []
    for k, image in enumerate(block.images):
        distances = _distances(block, k)
        if distances is None:
            continue
        given = distances.pop("")
        name, best = min(distances.items(), key=lambda item: item[1])
        if BETTER * best < given:
            out.append(finding("solution.mix_up", image=image.id, best_px=best, given_px=given, reading=name))
    return tuple(out)


def _distances(block: Block, k: int) -> dict[str, float] | None:
    """Median distance in pixels by reading, "" as given; None where an image cannot be judged."""
    o, known, sensor = block.observations, block.points.known, block.images[k].sensor
    row = np.flatnonzero((o.image == k) & np.isfinite(known.ecef_m[o.point]).all(axis=1))
    if len(row) < LEAST_POINTS:
        return None
    try:
        line, sample = (np.asarray(x, np.float64) for x in sensor.project(known.ecef_m[o.point[row]]))
        read = {"": (o.line[row], o.sample[row])}
        read |= {name: reading(o.line[row], o.sample[row], sensor) for name, reading in READINGS.items()}
    except (FgOrientError, AttributeError):  # nothing to hold them against
        return None
    away = {name: np.hypot(x - line, y - sample) for name, (x, y) in read.items()}
    seen = np.isfinite(away[""])
    return {name: float(np.median(d[seen])) for name, d in away.items()} if seen.sum() >= LEAST_POINTS else None
