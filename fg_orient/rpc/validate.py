"""Cross-validation of rational function models: errors at points that the fit, and every choice in it, did not see."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.names import Progress
from fg_orient.rpc.fit import RfmFit, rms
from fg_orient.rpc.rfm_points import ControlPoints

Array = npt.NDArray[np.float64]
Estimator = Callable[[ControlPoints], RfmFit]


@dataclass(frozen=True)
class CrossValidation:
    """Errors at points left out.

    Parameters
    ----------
    residuals_px : (n, 2) array
        True image residuals, projected minus observed, line and sample; inf where a fold has no solution.
    fits : tuple of RfmFit or None
        One per fold.
    failures : dict
        Fold to the reason why it has no solution.
    """

    residuals_px: Array
    fits: tuple[RfmFit | None, ...]
    failures: dict[int, str]

    @property
    def rms_px(self) -> Array:
        """RMS per axis: (2,) line and sample."""
        return rms(self.residuals_px)

    @property
    def choices(self) -> dict[str, int]:
        """What the folds chose and how many did, most frequent first."""
        words = (", ".join(f"{k} {v}" for k, v in f.choice.items()) for f in self.fits if f is not None)
        return dict(Counter(words).most_common())


def cross_validate(
    points: ControlPoints, estimator: Estimator, *, folds: int | None = None, seed: int = 1,
    progress: Progress | None = None,
) -> CrossValidation:  # fmt: skip
    """Leave out each point, or each of k folds, fit the others, project what was left out.

    The estimator sees the points of the other folds only: a kappa or a selection that it chooses is chosen anew in each
    fold (nested cross-validation, Varma & Simon 2006).

    Parameters
    ----------
    points : ControlPoints
    estimator : callable
        ControlPoints to RfmFit, for instance ``lambda p: fit_selected(p, form, "ridge_gcv")``.
    folds : int, optional
        k; default leave-one-out.
    seed : int
        Of the assignment of points to folds.
    progress : callable, optional
        Called with (done, of, text) before each fold.

    Returns
    -------
    CrossValidation

    Raises
    ------
    InputError
        Number of folds out of range, or points that the estimator refuses.
    """
    n = len(points)
    k = n if folds is None else folds
    if not 2 <= k <= n:
        raise InputError.of("rfm.folds", place="folds", value=k, points=n)
    place = np.arange(n) if folds is None else np.random.default_rng(seed).permutation(n) % k
    residuals = np.full((n, 2), np.inf)
    fits: list[RfmFit | None] = []
    failures: dict[int, str] = {}
    for fold in range(k):
        if progress is not None:
            progress(fold, k, "cross-validation")
        out = place == fold
        try:
            fit = estimator(points.take(~out))
        except NoSolutionError as error:
            failures[fold] = str(error)
            fits.append(None)
            continue
        residuals[out] = fit.residuals_px(points.take(out))
        fits.append(fit)
    return CrossValidation(residuals, tuple(fits), failures)
