"""What the figures need of a result folder: tables, record, cofactors of the orientation."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.errors import InputError
from fg_orient.report.data import Columns, Result, read_columns, read_result

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
        Record, points, orientation, iterations.
    residuals : Columns
        All columns of ``residuals.csv``.
    rows : dict
        Rows of ``residuals`` by image, in the order of the record.
    parameters : dict
        Names of the unknowns by image.
    correlations : dict
        Correlations (k, k) of the unknowns by image; none where covariances are withheld.
    """

    result: Result
    residuals: Columns
    rows: dict[str, Index]
    parameters: dict[str, list[str]]
    correlations: dict[str, Array]

    @property
    def record(self) -> dict[str, Any]:
        """``result.json``."""
        return self.result.record

    @property
    def images(self) -> list[str]:
        """Ids of the images, in the order of the record."""
        return [str(image["id"]) for image in self.record["images"]]

    def normalised(self) -> Normalised:
        """Normalised residuals w, or v/sigma where no redundancy numbers are given."""
        table = self.residuals
        v = table.numbers("v_line_px", "v_sample_px") / table.numbers("sigma_line_px", "sigma_sample_px")
        if "w_line" in table.figures:
            return Normalised(table.numbers("w_line", "w_sample"), "normalised residual w = v/(σ√r)")
        if "redundancy_line" not in table.figures:
            return Normalised(v, "residual v/σ")
        from fg_orient.quality.reliability import ROUNDING  # loads the solvers: under a loss only

        r = table.numbers("redundancy_line", "redundancy_sample")
        with np.errstate(divide="ignore", invalid="ignore"):
            return Normalised(np.where(r > ROUNDING, v / np.sqrt(r), np.nan), "normalised residual w = v/(σ√r)")


def read_folder(folder: Path) -> Folder:
    """Read a result folder.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    result = read_result(folder)
    name = "residuals.csv"
    try:
        residuals = read_columns(folder / name)
        name = "arrays.npz"
        parameters, correlations = _orientation(folder / name)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError.of("report.damaged", file=folder / name, value=error) from None
    rows = _rows(residuals, [str(image["id"]) for image in result.record["images"]])
    return Folder(result, residuals, rows, parameters, correlations)


def _rows(residuals: Columns, images: list[str]) -> dict[str, Index]:
    place = {image: k for k, image in enumerate(images)}
    image = np.array([place.get(name, -1) for name in residuals.words["image"]], np.intp)
    return {name: np.flatnonzero(image == k) for name, k in place.items()}


def _orientation(path: Path) -> tuple[dict[str, list[str]], dict[str, Array]]:
    """Names of the unknowns and their correlations by image."""
    with np.load(path, allow_pickle=False) as arrays:
        ids, counts = [str(name) for name in arrays["image_ids"]], arrays["n_parameters"].tolist()
        names, cofactors = np.atleast_2d(arrays["parameter_names"]), arrays["image_cofactors"]
    parameters, correlations = {}, {}
    for k, (image, n) in enumerate(zip(ids, counts, strict=True)):
        parameters[image] = [str(name) for name in names[min(k, len(names) - 1)][:n]]
        q = cofactors[k, :n, :n]
        sigma = np.sqrt(np.diag(q))
        if n and np.isfinite(q).all() and (sigma > 0.0).all():
            correlations[image] = np.asarray(q / np.outer(sigma, sigma))
    return parameters, correlations
