"""What belongs to a publication: who computes its cells, which claims are about it, what is known about its misfits."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.l_curve import LCurve
from fg_orient.model.cells import CellKey
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce.verdict import Verdict

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]


#: What most numbers of the studies on SPOT-5 stand on.
ON_TWIN: Final = (
    "The points and images of the publication are not available. Each seed is a twin with points, errors and noise of "
    "its own, so digits cannot agree; patterns, orders of magnitude and which side of the target a result falls on "
    "can. "
    '"Reproduced" is the median of the runs, the range their smallest and largest value.'
)


class Compute(Protocol):
    """Computes the cells of some tables for some seeds."""

    def __call__(
        self, tables: Collection[str], seeds: Sequence[int], *, as_run: bool, progress: Progress | None
    ) -> dict[CellKey, Array]:
        """Values (n,) of each cell."""


class Curves(Protocol):
    """Computes the L-curves that the kappas of some tables lie on, on the twin of a seed."""

    def __call__(self, tables: Collection[str], seed: int, *, as_run: bool) -> dict[int, LCurve]:
        """Curve of each EOP set."""


class RealVerdicts(Protocol):
    """Judges the cells of tables whose real data are public."""

    def __call__(
        self, printed: PublishedTables, tables: Collection[str], data: Path | None, *, permutations: int,
        progress: Progress | None,
    ) -> dict[CellKey, Verdict]:  # fmt: skip
        """Verdict of each cell."""


@dataclass(frozen=True)
class Source:
    """A publication.

    Parameters
    ----------
    name, title : str
        Folder of the published tables; author, year and subject.
    compute : callable or None
        See :class:`Compute`; None if nothing is computed on the twin.
    claims : tuple of str
        Ids of the claims about it.
    explain : callable
        Gives a sentence on a known misfit of a cell, as published or as run, or "".
    real : callable, optional
        See :class:`RealVerdicts`.
    real_tables : tuple of str
        Its tables; the twin has no part in them.
    about : str
        What the numbers stand on, for the report.
    meanings : mapping, optional
        Meaning of a verdict where it is not that of runs on the twin.
    counted : str
        How the numbers of the verdict ``rounding`` are summed up.
    patterned : str
        The same of ``pattern``.
    curves : callable, optional
        See :class:`Curves`.
    """

    name: str
    title: str
    compute: Compute | None
    claims: tuple[str, ...]
    explain: Callable[[PublishedCell, bool], str]
    real: RealVerdicts | None = None
    real_tables: tuple[str, ...] = ()
    about: str = ON_TWIN
    meanings: Mapping[str, str] = field(default_factory=dict)
    counted: str = "are rounding noise inside the spread of the runs"
    patterned: str = "lie on the same side of the limit"
    curves: Curves | None = None
