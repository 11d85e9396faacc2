"""The tests check the linear model that predicts detection and false alarms, reduced studies, and their page."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks import detection, false_alarms
from benchmarks.detection_page import CERTAIN, PAGE, page
from benchmarks.linear_doubts import SHARE, LinearBlock
from benchmarks.mistakes import BLOCKS, MISTAKES
from fg_orient.quality.doubts import BUDGET

#: Draws of the linear model.
DRAWS = 10_000


@pytest.mark.oracle
@pytest.mark.parametrize("name", list(BLOCKS))
def test_the_doubts_of_perfect_data_keep_their_shares_in_a_linear_model(name: str) -> None:
    """In a linear model of perfect data each doubt is raised at most as often as its share allows.

    The limit is the 99.9 % quantile.
    """
    drawn = detection.source(name).draw(np.random.default_rng(1), noise=0.0)
    linear = LinearBlock.of(drawn.block, drawn)
    e, check = linear.errors(drawn.block, drawn)
    assert np.abs(e[: linear.n_image]).max() < 1e-6
    assert linear.problem.redundancy == pytest.approx(np.trace(linear.r), abs=1e-6)
    alarms = linear.doubts(e, check, np.ones(len(e)), DRAWS, np.random.default_rng(2))
    for code, found in alarms.items():
        assert found.sum() <= binom.ppf(0.999, DRAWS, SHARE[code]), code
    assert np.any(np.stack(list(alarms.values())), axis=0).sum() <= binom.ppf(0.999, DRAWS, sum(BUDGET.values()))


@pytest.mark.behaviour
def test_at_least_forty_kinds_of_mistakes_have_three_sizes() -> None:
    assert len(MISTAKES) >= 40
    assert len({mistake.what for mistake in MISTAKES}) == len(MISTAKES)
    assert all(len(set(mistake.sizes)) == 3 for mistake in MISTAKES)
    assert len(BLOCKS) == 3
    assert len(false_alarms.KINDS) == 10


def certain(names: list[str], block: str) -> list[tuple[str, int, int]]:
    """Return the largest size of each of these mistakes."""
    return [(block, m, 2) for m, mistake in enumerate(MISTAKES) if mistake.what in names]


@pytest.mark.oracle
def test_mistakes_that_theory_sees_are_doubted_and_named() -> None:
    """Mistakes with a predicted power of 0.99 give a doubt or worse, and the right name, for the RPC pair."""
    names = [
        "heights of the control points lowered (orthometric)", "longitude and latitude in radians",
        "image turned by half a turn", "one control point measured under two ids", "constant shift of check points",
        "coordinates of one control point under two ids", "stated sigmas of image points too small",
    ]  # fmt: skip
    keys = certain(names, "rpc")
    assert len(keys) == len(names)
    for key in keys:
        record = detection.cell(key, None, 1)
        assert record["predicted"] >= CERTAIN, MISTAKES[key[1]].what
        assert record["codes"][0] != 0, MISTAKES[key[1]].what
        assert record["named"] == [1], (MISTAKES[key[1]].what, record["texts"])


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize("block", list(BLOCKS))
def test_mistakes_are_doubted_as_often_as_the_linear_model_predicts(block: str) -> None:
    """Mistakes of each kind and size are doubted as often as the predicted powers say, within 99.9 %.

    Each has two runs. A power from a number of draws is uncertain itself: by 0.01 of each cell.
    """
    predicted, found, low = list[float](), 0, 0
    for m in range(len(MISTAKES)):
        for size in range(3):
            record = detection.cell((block, m, size), None, 2)
            power, seen = record["predicted"], sum(code != 0 for code in record["codes"])
            predicted += [power] * 2
            found += seen
            low += 2 - seen if power >= CERTAIN else 0
    p = np.array(predicted)
    spread = 3.3 * np.sqrt(np.sum(p * (1.0 - p)) + 1.0)
    assert abs(found - p.sum()) <= spread + 0.01 * len(p)
    assert low <= binom.ppf(0.999, int(np.sum(p >= CERTAIN)), 1.0 - CERTAIN)


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize("kind", list(false_alarms.KINDS))
def test_perfect_blocks_of_each_kind_end_with_exit_code_0(kind: str) -> None:
    """Of 200 perfect blocks no more end with exit code 4 than the budget allows (99.9 % quantile)."""
    runs = false_alarms.some_runs(kind, 10_000, 200)
    assert sum(map(bool, runs)) <= binom.ppf(0.999, len(runs), sum(BUDGET.values()))
    count = Counter(code.partition(".")[2] for codes in runs for code in set(codes))
    for code, share in BUDGET.items():
        assert count[code] <= binom.ppf(0.9999, len(runs), share), code


@pytest.mark.repository
def test_the_page_is_made_of_the_results() -> None:
    texts = (json.loads(path.read_text("utf-8")) for path in (detection.RESULTS, false_alarms.RESULTS))
    assert PAGE.read_text("utf-8") == page(*texts), "run: python -m benchmarks.detection_page"
