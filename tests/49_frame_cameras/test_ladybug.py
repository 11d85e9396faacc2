"""BAL Ladybug 49/7776 reaches the cost of GTSAM's own optimiser; the free datum is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import fg_orient as fg
from fg_orient.formats.exchange.bal import read_bal

pytestmark = pytest.mark.truth

#: Half the sum of squares, px^2: GTSAM's LevenbergMarquardtOptimizer on GeneralSFMFactorCal3Bundler ends at 13308.45.
BOUND = 13308.5


@pytest.mark.real_data
@pytest.mark.slow
def test_ladybug_reaches_the_cost_of_gtsam_and_claims_no_deviations(real_data: Path) -> None:
    """Ladybug 49 reaches GTSAM's cost, and the free datum gives seven motions and no covariance.

    Points that begin behind their cameras are excluded; GTSAM's factor counts them as zero.
    """
    block = read_bal(real_data / "bal" / "problem-49-7776-pre.txt.gz", keep_behind=False)
    solution = fg.adjust(replace(block, options=replace(block.options, max_iterations=40)))
    assert 0.5 * solution.log[0].chi2 == pytest.approx(850802.09, abs=0.01)
    assert 0.5 * solution.chi2 <= BOUND
    assert solution.cofactors is None
    assert [reason.code for reason in solution.unavailable] == ["unavailable.free_datum"]
    assert solution.block_view is not None
    words = [w for m in solution.block_view.motions for w in m.words]
    assert len(words) == 7
    assert {w.split()[0] for w in words} == {"shifted", "turned", "scaled"}
