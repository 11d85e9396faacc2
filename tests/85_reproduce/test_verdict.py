"""Each test of a verdict is met where its rule requires it, and only there."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fg_orient.model.digits import last_digit
from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import PublishedCell
from fg_orient.studies.reproduce.verdict import KINDS, RULES, assess_runs, kind_of

pytestmark = pytest.mark.behaviour

COUNT = CellKey("4.3", "1", "bundle", quantity="n_observations", method="least_squares")
GCP = CellKey("4.28", "5", "bundle", "1", "gcp", "rmse_x", "pivot_inverse")
ICP = GCP._replace(point_role="icp")
KAPPA = CellKey("4.25", "5", "bundle", "1", quantity="kappa", method="tikhonov_hkb")
DP = CellKey("4.17", "1", "pre-left", quantity="dP", method="gauss_inverse", parameter="X0")
RANK = CellKey("4.10", "1", "pre-left", quantity="rank")
DET = RANK._replace(quantity="det")
NORM = RANK._replace(quantity="cond_norm")
HADAMARD = RANK._replace(quantity="cond_hadamard")
CORRELATION = CellKey("s4.2.2", "1", "pre-left", quantity="correlation", parameter="X0 Y0")
MISCLOSURE = CellKey("4.3", "1", "pre-left", quantity="sum_residual", method="least_squares")
RESIDUAL = MISCLOSURE._replace(stage="bundle")
NAN = math.nan


def verdict(key: CellKey, text: str, runs: list[float] | None, order: float | None = None) -> str:
    """Return the kind of the verdict on a printed number."""
    cell = PublishedCell(key, float(text or "nan"), text, text or "words")
    return assess_runs(cell, None if runs is None else np.array(runs), order).kind


@pytest.mark.parametrize(
    ("key", "text", "runs", "expected"),
    [
        (COUNT, "188", [188.0, 188.0], "equal"),
        (COUNT, "188", [188.0, 189.0], "differs"),
        (COUNT, "188", [198.0, 198.0], "differs"),
        (COUNT, "188", [188.4, 188.4], "differs"),
        (GCP, "0.5", [0.06, 0.07], "order"),
        (GCP, "0.5", [0.04, 0.045], "side"),
        (GCP, "0.5", [5.1, 6.0, 0.001], "differs"),
        (GCP, "939491.512", [1e5, NAN], "side"),
        (GCP, "939491.512", [9e4, NAN, NAN], "side"),
        (GCP, "939491.512", [1.0, 1.0, NAN], "differs"),
        (GCP, "0.5", [0.04, 6.0], "differs"),
        (GCP, "939491.512", [9.4e6, 2e6], "order"),
        (GCP, "0.5", [NAN, NAN], "not_reproducible"),
        (GCP, "nan", [NAN, 1e3], "side"),
        (GCP, "nan", [1.0, 2.0], "not_reproducible"),
        (ICP, "756513.118", [6.0, 7.0], "differs"),
        (ICP, "14.9", [1.0, 1.2], "side"),
        (ICP, "15.1", [1.0, 1.2], "differs"),
        (KAPPA, "1", [1.0, 1.0], "equal"),
        (KAPPA, "1", [0.9999, 1.0], "rounding"),
        (KAPPA, "0.50", [0.496, 0.504], "equal"),
        (KAPPA, "0.50", [0.496, 0.51, 0.503], "rounding"),
        (KAPPA, "0.50", [0.51, 0.51, 0.503], "spread"),
        (KAPPA, "3e-17", [0.0, 4e-18], "spread"),
        (KAPPA, "3e-17", [0.0, 2e-18], "differs"),
        (DP, "-8.5e-11", [9e-12, -3e-13], "spread"),
        (DP, "-8.5e-11", [8.4e-12, -3e-13], "differs"),
        (DP, "-8.5e-11", [8.6e-10, 9e-9], "differs"),
        (MISCLOSURE, "1e-20", [2e-19, 1e-17], "differs"),
        (RESIDUAL, "1e-5", [2e-5, 1e-3], "order"),
        (CORRELATION, "0.9851", [0.99, 0.999], "side"),
        (CORRELATION, "0.9851", [0.98511, 0.98507], "equal"),
        (CORRELATION, "0.9851", [0.97, 0.97], "differs"),
        (DET, "0", [0.0, 0.0], "equal"),
        (DET, "0", [1e-300, 0.0], "rounding"),
        (DET, "0", [1e-300, 1e-300], "differs"),
        (DET, "-2.2e-172", [3e-172], "order"),
        (NORM, "8.6e17", [1e20, 1e22], "side"),
        (NORM, "8.6e17", [1e15, 1e15], "differs"),
        (HADAMARD, "nan", [1e-200], "not_reproducible"),
        (HADAMARD, "-7.6e-70", [1e-125], "side"),
    ],
)
def test_verdict(key: CellKey, text: str, runs: list[float], expected: str) -> None:
    assert verdict(key, text, runs) == expected


@pytest.mark.parametrize(
    ("text", "runs", "expected"),
    [("8", [8.0, 8.0], "equal"), ("8", [7.0, 8.0], "spread"), ("8", [7.0, 8.0, 8.0], "rounding"),
     ("8", [4.0, 5.0], "side"),
     ("8", [9.0, 9.0], "differs"), ("9", [9.0, 8.0, 9.0], "rounding"),
     ("9", [8.0, 8.0, 9.0], "spread"), ("9", [4.0, 4.0], "differs")],
)  # fmt: skip
def test_ranks_are_judged_by_the_order_of_their_matrix(text: str, runs: list[float], expected: str) -> None:
    assert verdict(RANK, text, runs, order=9.0) == expected


def test_what_cannot_be_compared_says_why() -> None:
    assert verdict(COUNT, "", None) == "not_reproducible"
    words = assess_runs(PublishedCell(COUNT, NAN, "", "2002-05-04"), None)
    gap = assess_runs(PublishedCell(COUNT, NAN, "", "-"), np.array([1.0]))
    fact = assess_runs(PublishedCell(COUNT, 832.0, "832", "832"), None)
    assert (words.reason, gap.reason) == ("a statement in words", "nothing is printed")
    assert "nothing to compute" in fact.reason
    assert math.isnan(fact.reproduced)


def test_the_reproduced_value_is_a_run_of_the_middle_and_says_how_many_broke_down() -> None:
    found = assess_runs(PublishedCell(DP, 2.0, "2.0", "2.0"), np.array([4.0, NAN, 1.0, -3.0, 2.0]))
    assert (found.reproduced, found.low, found.high) == (1.0, -3.0, 4.0)
    assert "5 runs, 1 of them without a result" in found.reason
    half = assess_runs(PublishedCell(DP, 2.0, "2.0", "2.0"), np.array([4.0, NAN]))
    assert math.isnan(half.reproduced), "half of the runs is not most of them"


@pytest.mark.parametrize(
    ("text", "unit"), [("74", 1.0), ("0.510", 1e-3), ("-8.5e-11", 1e-12), ("7.6E-10", 1e-11), ("1e16", 1e16)]
)
def test_last_printed_digit(text: str, unit: float) -> None:
    assert last_digit(text) == pytest.approx(unit, rel=1e-12)


def test_every_reason_is_one_line_and_every_kind_of_verdict_occurs() -> None:
    seen = set()
    for key, text in ((COUNT, "1"), (GCP, "1.0"), (DP, "1.0"), (NORM, "1e17"), (GCP, "nan")):
        for runs in ([1.0], [0.01], [1e20], [1e3, 1e-3]):
            found = assess_runs(PublishedCell(key, float(text), text, text), np.array(runs))
            assert found.reason and "\n" not in found.reason
            seen.add(found.kind)
    assert seen == set(KINDS) - {"rounding", "unit", "sigma", "fitted"}  # test_verdict, test_null


def test_every_rule_is_used_and_documented(repository_rules: str) -> None:
    keys = (COUNT, GCP, ICP, KAPPA, DP, RANK, DET, NORM, HADAMARD, CORRELATION, MISCLOSURE, RESIDUAL)
    used = {kind_of(key) for key in keys} | {"cond_spectral", "normal"}
    assert used == set(RULES)
    for name, rule in RULES.items():
        assert f"| `{name}` | {', '.join(rule.tests)} |" in repository_rules


@pytest.fixture
def repository_rules(repository: object) -> str:
    """Return the page that documents the rules."""
    from pathlib import Path

    return (Path(str(repository)) / "docs" / "reproduce.md").read_text("utf-8")
