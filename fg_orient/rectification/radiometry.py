"""Radiometric corrections and classification errors (İpbüker 1994, section 4.2 and summary).

The thesis describes them only in words. Destriping uses the moments of each detector
(Horn & Woodham 1979). The dark object has the darkest grey value of a band (Chavez 1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import numbers, whole

#: Number of detectors of a band of Landsat MSS, which scans six lines at a time.
DETECTORS: Final = 6


def _band(image: npt.ArrayLike, valid: npt.ArrayLike | None) -> tuple[Array, Mask]:
    """Return grey values (rows, columns), and pixels with a finite value that the mask does not exclude."""
    band = numbers("image", image)
    if band.ndim != 2:
        raise InputError.of("rectify.numbers", place="image", value=f"shape {band.shape}")
    good = np.isfinite(band)
    if valid is not None:
        mask = np.asarray(valid, bool)
        if mask.shape != band.shape:
            raise InputError.of("rectify.numbers", place="valid", value=f"shape {mask.shape}")
        good &= mask
    return band, good


def destripe(
    image: npt.ArrayLike, detectors: int = DETECTORS, *, valid: npt.ArrayLike | None = None, first_detector: int = 0
) -> Array:
    """Equalise the detectors of a scanner by the mean and the standard deviation of their lines.

    Line k belongs to detector ``(first_detector + k) mod detectors``. Its grey values are
    transformed linearly to the mean and standard deviation of the whole band. This
    assumes that all detectors see the same distribution of radiances, so the image must
    be large compared with its objects.

    Parameters
    ----------
    image : (rows, columns) array
        Grey values of a band in sensor geometry, before resampling.
    detectors : int
    valid : (rows, columns) bool array, optional
        Pixels that count; others and those that are not finite do not change.
    first_detector : int
        Detector of the first line.

    Returns
    -------
    (rows, columns) array
        Grey values, not rounded.

    Raises
    ------
    InputError
        The array is not a band, or a detector does not have two different valid grey values.
    """
    band, good = _band(image, valid)
    whole("detectors", detectors, 1)
    which = (first_detector + np.arange(len(band))) % detectors
    out = band.copy()
    every = band[good]
    for detector in range(detectors):
        mine = good & (which == detector)[:, None]
        own = band[mine]
        spread = float(own.std()) if own.size else 0.0
        if spread == 0.0:
            raise InputError.of("rectify.detector", place=f"detector {detector}", value=f"{own.size} valid pixels")
        out[mine] = every.mean() + (own - own.mean()) * (every.std() / spread)
    return out


def subtract_dark_object(
    image: npt.ArrayLike, *, least_pixels: int = 1, valid: npt.ArrayLike | None = None
) -> tuple[Array, float]:
    """Subtract the grey value of the darkest object of a band, which is the scattered light.

    Parameters
    ----------
    image : (rows, columns) array
        Grey values of a band.
    least_pixels : int
        Minimum number of pixels of the dark object. Darker pixels are noise and become 0.
    valid : (rows, columns) bool array, optional
        Pixels that count; others and those that are not finite do not change.

    Returns
    -------
    (rows, columns) array
    float
        The grey value that was subtracted.

    Raises
    ------
    InputError
        The array is not a band, or it has fewer valid pixels than ``least_pixels``.
    """
    band, good = _band(image, valid)
    whole("least pixels", least_pixels, 1)
    values = band[good]
    if len(values) < least_pixels:
        raise InputError.of("rectify.dark", place="image", value=len(values), least=least_pixels)
    dark = float(np.partition(values, least_pixels - 1)[least_pixels - 1])
    out = band.copy()
    out[good] = np.maximum(values - dark, 0.0)
    return out, dark


@dataclass(frozen=True)
class ClassificationErrors:
    """Table of the errors of a classification.

    Parameters
    ----------
    classes : tuple of str
    counts : (k, k) array of int
        Pixels, by class (rows) and truth (columns).
    omission : (k,) array
        Share of the pixels of a true class that were not assigned to it; nan for a class that does not occur.
    commission : (k,) array
        Share of the pixels assigned to a class that do not belong to it; nan for a class that is not assigned.
    correct : float
        Share of the pixels that are assigned to their true class.
    sigma_correct : float
        Standard deviation of ``correct`` for independent pixels, sqrt(p (1 - p)/n).
    kappa : float
        Agreement beyond chance (Cohen 1960); nan if only one class occurs.
    """

    classes: tuple[str, ...]
    counts: npt.NDArray[np.int64]
    omission: Array
    commission: Array
    correct: float
    sigma_correct: float
    kappa: float


def classification_errors(assigned: npt.ArrayLike, truth: npt.ArrayLike) -> ClassificationErrors:
    """Compute the omission and commission errors of a classification at pixels of known class.

    Parameters
    ----------
    assigned, truth : arrays of the same shape
        Class of each tested pixel: numbers or names.

    Raises
    ------
    InputError
        The shapes differ, or there are no pixels.
    """
    both = [np.asarray(values).ravel() for values in (assigned, truth)]
    if np.shape(assigned) != np.shape(truth) or not len(both[0]):
        value = f"shapes {np.shape(assigned)} and {np.shape(truth)}"
        raise InputError.of("rectify.numbers", place="assigned, truth", value=value)
    classes, codes = np.unique(np.concatenate(both), return_inverse=True)
    n, k = len(both[0]), len(classes)
    counts = np.bincount(codes[:n] * k + codes[n:], minlength=k * k).reshape(k, k)
    hits, rows, columns = counts.diagonal(), counts.sum(axis=1), counts.sum(axis=0)
    with np.errstate(invalid="ignore"):
        omission, commission = 1.0 - hits / columns, 1.0 - hits / rows
    p, chance = float(hits.sum()) / n, float(rows @ columns) / n**2
    kappa = (p - chance) / (1.0 - chance) if chance < 1.0 else np.nan
    names = tuple(map(str, classes.tolist()))
    return ClassificationErrors(names, counts, omission, commission, p, float(np.sqrt(p * (1.0 - p) / n)), kappa)
