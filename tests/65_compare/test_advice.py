"""Recommendations follow rules on invented results, and the predicted limit agrees with a simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.simulate.mixed import MixedOptions, mixed_block
from fg_orient.studies.comparison.advice import advise, best_engine, best_set
from fg_orient.studies.comparison.compare import compare
from fg_orient.studies.comparison.model import OWN_CHOICE, Row
from fg_orient.studies.comparison.report import verdict
from fg_orient.studies.comparison.set_results import SetResult, predicted_rmse

LABELS = {"gtsam": "GTSAM", "qr": "QR"}


def result(eop_set: int, rmse: float, aicc: float, **more: object) -> SetResult:
    given = {"status": "converged", "backend": "graph", "optimizer": "gauss-newton", "n_check": 50, "bic": aicc,
             "check_freedom": 200.0, "check_rmse_3d_m": rmse, "aicc": aicc} | more  # fmt: skip
    return SetResult(eop_set, f"S{eop_set}", 10 + eop_set, **given)  # type: ignore[arg-type]


def row(backend: str, seconds: float, **more: object) -> Row:
    solver = {"dense": "qr", "schur": "dense"}.get(backend, "gtsam")
    given = {
        "optimizer": "gauss-newton",
        "regularisation": "none",
        "difference_sigmas": 1e-12,
        "difference_m": 1e-9,
    } | more
    return Row(1, "S1", solver, backend, processor_s=seconds, **given)  # type: ignore[arg-type]


@pytest.mark.behaviour
def test_check_points_exclude_and_aicc_chooses() -> None:
    """The advice excludes sets by the RMSE of check points, and chooses the least AICc among the rest.

    The standard error of the mean square is a tenth of it: RMSE up to 1.049 times the least one remain.
    """
    best, why = best_set([result(1, 1.0, 30.0), result(2, 1.04, 10.0), result(3, 1.06, 0.0)])
    assert best is not None and best.eop_set == 2
    assert why[0] == "3-D RMSE 1.04 m at 50 check points; the least of 3 sets is 1 m (set 1)"
    assert why[1] == "2 sets are within its standard error; of these it has the least AICc and BIC"
    few = [
        result(k, rmse, aicc, check_freedom=4.0) for k, rmse, aicc in ((1, 1.0, 30.0), (2, 1.04, 10.0), (3, 1.06, 0.0))
    ]
    assert best_set(few)[0] == few[2]


@pytest.mark.behaviour
def test_without_check_points_aicc_chooses_and_bic_is_named() -> None:
    nothing = {"n_check": 0, "check_rmse_3d_m": float("nan")}
    best, (why,) = best_set([result(1, 0.0, 30.0, bic=5.0, **nothing), result(2, 0.0, 10.0, bic=7.0, **nothing)])
    assert best is not None and best.eop_set == 2
    assert why == "no check points decide: of 2 sets it has the least AICc (the least BIC: set 1)"


@pytest.mark.behaviour
def test_undetermined_and_failed_sets_come_last() -> None:
    free = result(1, 1.0, 0.0, undetermined=2)
    failed = result(3, 0.1, 0.0, status="not_converged")
    best, why = best_set([free, result(2, 2.0, 50.0), failed])
    assert best is not None and best.eop_set == 2
    assert why[-1] == "1 set left aside: only priors determine some of their directions"
    assert best_set([free, failed])[0] == free
    assert best_set([failed])[0] is None and best_set([])[0] is None


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("graph_s", "schur_s", "expected"), [(0.4, 0.01, "graph"), (14.0, 10.0, "graph"), (16.0, 10.0, "schur")]
)
def test_default_engine_unless_another_is_much_faster(graph_s: float, schur_s: float, expected: str) -> None:
    rows = [row("graph", graph_s), row("schur", schur_s, notes=(OWN_CHOICE,)), row("explicit", 1e-3),
            row("dense", 99.0), row("dense", 1e-4, difference_m=1.0)]  # fmt: skip
    chosen, why = best_engine(result(1, 1.0, 0.0), rows, LABELS)
    assert chosen is not None and chosen.backend == expected
    assert why[0] == "4 of 5 engines give the same solution (within 1e-12 prior sigmas and 1e-09 m), 1 another one"
    advice = advise([result(1, 1.0, 0.0)], rows, LABELS)
    assert advice.options == {"eop_set": 1, "backend": expected, "optimizer": "gauss-newton"}


@pytest.mark.oracle
def test_limit_of_the_predicted_rmse_against_a_simulation(twin: Block) -> None:
    """5 % of draws from the covariance of check points exceed the limit of the predicted RMSE, within 1 %."""
    check = fg.adjust(twin, eop_set=2).accuracy.check
    predicted, limit, freedom = predicted_rmse(check, check.covariance_m2)
    c, n = check.covariance_m2, len(check)
    assert c is not None and check.joint is not None
    turn = np.zeros((3 * n, 3 * n))
    for k in range(n):
        turn[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = check.joint.axes[k].T
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(3 * n), turn @ c @ turn.T, 20_000).reshape(-1, n, 3)
    squares = (draws**2).mean(axis=1)
    worst = int(squares.mean(axis=0).argmax())
    assert predicted == pytest.approx(np.sqrt(squares[:, worst].mean()), rel=0.02)
    assert np.mean(np.sqrt(squares[:, worst]) > limit) == pytest.approx(0.05, abs=0.01)
    total = squares.sum(axis=1)
    assert 2.0 * total.mean() ** 2 / total.var() == pytest.approx(freedom, rel=0.1)


@pytest.mark.slow
@pytest.mark.behaviour
def test_mixed_block_has_its_answer() -> None:
    """The comparison of a mixed block recommends a set and a graph, with equal solutions of all engines.

    Engines that cannot adjust shared unknowns are rows with the reason.
    """
    block = mixed_block(MixedOptions())[0]
    found = compare(block, eop_sets=[2, 9], solvers="qr")
    said = verdict(found)
    assert said["title"] in ("Take EOP set 2 (PU0) with graph · GTSAM, Gauss-Newton",
                             "Take EOP set 9 (A) with graph · GTSAM, Gauss-Newton")  # fmt: skip
    assert found.target_from == "predicted" and "95 % of cases" in " ".join(said["text"])
    solved = [r for r in found.rows if not r.failure]
    assert {r.backend for r in solved} == {"dense", "schur", "explicit", "graph"}
    assert max(r.difference_m for r in solved) < 1e-6
    left = [r for r in found.rows if r.left_out]
    assert all("images share unknowns" in r.failure for r in left if r.backend == "schur")
    assert all("different columns" in r.failure for r in left if r.backend == "faithful")


@pytest.mark.behaviour
def test_sets_with_the_same_unknowns_are_compared_once(twin: Block) -> None:
    block = replace(twin, options=replace(twin.options, image_unknowns=("x_0", "y_0", "z_0", "roll_0", "pitch_0")))
    found = compare(block, eop_sets="1-20", backends="graph")
    assert found.eop_sets == (1,) and len(found.sets) == 1
    assert found.repeated == dict.fromkeys(range(2, 21), 1)
    assert "Not compared: sets 2-20, in these images the same as 1." in verdict(found)["text"]
