"""In cross-validation the fit does not use the excluded points, and each fold makes its own choices."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.rpc.estimate import fit_linear
from fg_orient.rpc.fit import RfmFit, cross_validate
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.points import ControlPoints
from fg_orient.rpc.select import fit_selected

Make = Callable[..., ControlPoints]


def plain(points: ControlPoints) -> RfmFit:
    return fit_linear(points, RfmForm(1))


@pytest.mark.oracle
def test_leave_one_out_is_a_fit_without_each_point(make: Make) -> None:
    points = make(20, noise_px=0.5)
    found = cross_validate(points, plain)
    for i in (0, 11, 19):
        keep = np.arange(20) != i
        expected = plain(points.take(keep)).residuals_px(points.take(~keep))[0]
        np.testing.assert_allclose(found.residuals_px[i], expected, atol=1e-9)
    assert (found.rms_px > plain(points).rms_px).all()


@pytest.mark.behaviour
def test_folds_divide_the_points(make: Make) -> None:
    seen: list[set[float]] = []

    def spy(points: ControlPoints) -> RfmFit:
        seen.append(set(points.line.tolist()))
        return plain(points)

    points = make(23, noise_px=0.5)
    found = cross_validate(points, spy, folds=5)
    everything = set(points.line.tolist())
    left_out = [everything - part for part in seen]
    assert sorted(map(len, left_out)) == [4, 4, 5, 5, 5]
    assert set().union(*left_out) == everything
    assert sum(map(len, left_out)) == 23
    again = cross_validate(points, plain, folds=5)
    np.testing.assert_array_equal(found.residuals_px, again.residuals_px)
    other = cross_validate(points, plain, folds=5, seed=2)
    assert not np.array_equal(found.residuals_px, other.residuals_px)


@pytest.mark.behaviour
def test_kappa_is_chosen_in_each_fold(make: Make) -> None:
    points, form = make(30, noise_px=0.5), RfmForm(2)
    found = cross_validate(points, lambda p: fit_selected(p, form, "ridge_l_curve"), folds=4)
    kappas = {fit.kappa for fit in found.fits if fit is not None}
    assert len(kappas) == 4
    assert sum(found.choices.values()) == 4
    assert all(words.startswith("kappa ") for words in found.choices)


@pytest.mark.behaviour
def test_a_fold_without_solution_counts_as_infinite(make: Make) -> None:
    def fails(points: ControlPoints) -> RfmFit:
        if len(seen := points.line) and 0 not in np.flatnonzero(np.isin(first, seen)):
            raise NoSolutionError.of("rfm.no_end", place="here")
        return plain(points)

    points = make(12)
    first = points.line[:1]
    found = cross_validate(points, fails)
    assert list(found.failures) == [0]
    assert np.isinf(found.rms_px).all()
    assert np.isfinite(found.residuals_px[1:]).all()


@pytest.mark.behaviour
@pytest.mark.parametrize("folds", [1, 13])
def test_number_of_folds(make: Make, folds: int) -> None:
    with pytest.raises(InputError, match="folds"):
        cross_validate(make(12), plain, folds=folds)
