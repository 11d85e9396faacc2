"""What the figures need of a result folder, by image: residuals, names of the unknowns, correlations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.report.orientation import image_correlations, short_names
from fg_orient.report.residual_plots import normalised
from fg_orient.result.plain import Table
from fg_orient.result.record import Result, read_result

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

LINE_SAMPLE = ("line", "sample")


@dataclass(frozen=True)
class Normalised:
    """Residuals of the image points in units of their own standard deviation.

    Parameters
    ----------
    values : (n, 2) array
        Line, sample; nan where there is none.
    words : str
        What they are.
    """

    values: Array
    words: str


@dataclass(frozen=True)
class Folder:
    """A result folder as the figures see it.

    Parameters
    ----------
    result : Result
        Record, points, residuals, orientation, iterations.
    """

    result: Result

    @property
    def record(self) -> dict[str, Any]:
        """``result.json``."""
        return self.result.record

    @property
    def residuals(self) -> Table:
        """``residuals.csv``."""
        return self.result.residuals

    @property
    def images(self) -> list[str]:
        """Ids of the images, in the order of the record."""
        return self.result.images

    @cached_property
    def rows(self) -> dict[str, Index]:
        """Rows of ``residuals`` by image, in the order of the record."""
        image = self.residuals.codes("image", self.images)
        return {name: np.flatnonzero(image == k) for k, name in enumerate(self.images)}

    @cached_property
    def parameters(self) -> dict[str, list[str]]:
        """Names of the unknowns by image, in the order of its correlations."""
        return short_names(self.result)

    @cached_property
    def correlations(self) -> dict[str, Array]:
        """Correlations (k, k) of the unknowns by image; none where covariances are withheld."""
        return image_correlations(self.result)

    def normalised(self) -> Normalised:
        """Normalised residuals w, or v/sigma where no tests are given."""
        values, tested = normalised(self.result, np.arange(len(self.residuals)))
        return Normalised(values, "normalised residual w = v/(σ√r)" if tested else "residual v/σ")


def read_folder(folder: Path) -> Folder:
    """Read a result folder.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    return Folder(read_result(folder))
