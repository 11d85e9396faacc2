"""Estimate a constant undulation from points with two heights: ellipsoidal, and above a zero level."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fg_orient.formats.faults import Faults
from fg_orient.formats.tables import read_table
from fg_orient.model.errors import Finding, finding

#: Columns of the table of points that have both heights.
BOTH_COLUMNS: Final = ("id", "height_m", "ellipsoidal_height_m")
#: Probability that any point is reported as an outlier although all heights are correct.
ODD: Final = 0.01


@dataclass(frozen=True)
class Estimate:
    """Estimated constant undulation: mean, standard deviation of the mean, and standard deviation of one point, m."""

    undulation_m: float
    sigma_m: float
    single_m: float
    notes: tuple[Finding, ...]


def estimated(path: Path) -> Estimate:
    """Estimate a constant undulation from a table of points with both heights.

    The undulation is the mean of the differences of both heights. Its standard deviation
    follows from the scatter of the differences. A point whose difference does not fit the
    other points is reported but kept. The test uses externally studentised differences;
    its level over all points is ``ODD``.

    Raises
    ------
    InputError
        The table has a fault.
    """
    faults = Faults(str(path))
    table = read_table(path, [BOTH_COLUMNS], faults)
    faults.raise_if_any()
    assert table is not None
    table.refuse_repeated(list(table.cells["id"]), "points.id_twice", "id")
    values = table.numbers(*BOTH_COLUMNS[1:])
    table.report(faults)
    faults.raise_if_any()
    difference, n = values[:, 1] - values[:, 0], len(values)
    mean = float(difference.mean())
    if n == 1:
        return Estimate(mean, np.nan, np.nan, (finding("heights.one_point", file=path, undulation_m=mean),))
    single = float(difference.std(ddof=1))
    sigma = single / np.sqrt(n)
    said: dict[str, Any] = {"undulation_m": mean, "sigma_m": sigma, "single_m": single, "n": n}
    notes = [finding("heights.estimated", file=path, **said)]
    if n >= 4:
        from fg_orient.model.distributions import sidak, t_two_sided  # imported here, because it loads scipy

        others = (difference.sum() - difference) / (n - 1)
        # sum of squares of the other points about their own mean
        square = ((difference - mean) ** 2).sum() - (difference - mean) ** 2 * n / (n - 1)
        spread = np.sqrt(np.maximum(square, 0.0) / (n - 2) * n / (n - 1))
        apart = difference - others
        times = np.abs(apart) / np.maximum(spread, np.finfo(float).tiny)
        k = int(np.argmax(times))
        if t_two_sided(n - 2, times[k]) < sidak(ODD, n):
            notes.append(finding("heights.odd_point", file=path, place=f"point {table.cells['id'][k]}",
                                 apart_m=float(apart[k]), times=float(times[k])))  # fmt: skip
    return Estimate(mean, float(sigma), single, tuple(notes))
