"""Check coordinates have no influence and are opened only after convergence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.model.block import Block, Coordinates, WithheldCoordinates
from fg_orient.orientation import orient


def moved(block: Block, shift_m: float) -> Block:
    reader = block.withheld.reader

    def shifted() -> Coordinates:
        c = reader()
        return replace(c, ecef_m=c.ecef_m + shift_m)

    return replace(block, withheld=WithheldCoordinates(block.withheld.ids, shifted))


@pytest.mark.behaviour
def test_moving_every_check_coordinate_changes_no_estimate(twin: Block) -> None:
    a, b = fg.adjust(twin, eop_set=15), fg.adjust(moved(twin, 1000.0), eop_set=15)
    assert np.array_equal(a.state.image, b.state.image)
    assert np.array_equal(a.ground_m, b.ground_m)
    assert np.array_equal(a.residuals_px, b.residuals_px)
    assert a.chi2 == b.chi2
    assert np.array_equal(a.accuracy.control.enu_m, b.accuracy.control.enu_m)
    assert np.array_equal(a.accuracy.check.predicted_sigma_enu_m, b.accuracy.check.predicted_sigma_enu_m)
    assert np.abs(b.accuracy.check.ecef_m - a.accuracy.check.ecef_m + 1000.0).max() < 1e-6


@pytest.mark.oracle
def test_extreme_ratios_of_sigmas_are_exact(twin: Block) -> None:
    """Sigmas of 0.06 m and 1e5 m at one point give the exact weights. A covariance in between would lose them."""
    sigma = twin.points.known.sigma_enu_m.copy()
    first = int(twin.points.where(fg.Role.CONTROL)[0])
    sigma[first] = 0.06, 0.06, 1e5
    loose = replace(twin, points=replace(twin.points, known=replace(twin.points.known, sigma_enu_m=sigma)))
    solution = fg.adjust(loose, eop_set=10)
    assert solution.status is fg.Status.CONVERGED
    w = solution.problem.control_records[first, POINT.whitening].reshape(3, 3)
    assert np.allclose(np.linalg.svd(w, compute_uv=False), [1 / 0.06, 1 / 0.06, 1e-5], rtol=1e-9)


@pytest.mark.behaviour
def test_withheld_coordinates_are_opened_once_and_last(twin: Block, monkeypatch) -> None:
    events = []
    solve = orient.solve

    def recording_solve(*args: Any, **options: Any) -> object:
        out = solve(*args, **options)
        events.append("solved")
        return out

    def recording_reader() -> Coordinates:
        events.append("opened")
        return twin.withheld.reader()

    monkeypatch.setattr(orient, "solve", recording_solve)
    fg.adjust(replace(twin, withheld=WithheldCoordinates(twin.withheld.ids, recording_reader)), eop_set=10)
    assert events == ["solved", "opened"]


@pytest.mark.behaviour
def test_no_check_coordinates_in_the_arrays(twin: Block) -> None:
    check = twin.points.where(fg.Role.CHECK)
    assert len(check) == 10
    assert np.isnan(twin.points.known.ecef_m[check]).all()
    assert np.isnan(twin.points.known.sigma_enu_m[check]).all()
