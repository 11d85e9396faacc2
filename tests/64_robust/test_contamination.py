"""The tests check the parts of the study of gross errors, a small study on the twin, and its claim."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks import contamination as study
from benchmarks.contamination import PLAIN, RESULTS, SEEDS, TRACE
from benchmarks.contamination_page import LIMIT, PAGE, ratios, with_study
from fg_orient.model.names import Role

#: Methods that must keep the check points within 1.2 of the clean run.
WINNERS = ("tukey", "hampel", "GNC, tls")


def means(records: list[dict[str, object]]) -> dict[tuple[float, str], float]:
    found: dict[tuple[float, str], list[float]] = defaultdict(list)
    for r in records:
        found[r["share"], r["method"]].append(r["rmse_m"])  # type: ignore[index, arg-type]
    return {key: float(np.mean(values)) for key, values in found.items()}


@pytest.mark.behaviour
def test_errors_are_where_and_as_large_as_the_case_says() -> None:
    clean = study.clean("twin", 1)
    spoiled = study.spoil("twin", 1, 0.2)
    o, moved = clean.block.observations, spoiled.block.observations
    delta = np.hypot((moved.line - o.line) / o.sigma_line_px, (moved.sample - o.sample) / o.sigma_sample_px)
    assert np.array_equal(delta > 0.0, spoiled.image)
    assert spoiled.image.sum() == round(0.2 * 74)
    assert not spoiled.control.any()
    assert 5.0 - 1e-9 <= delta[spoiled.image].min() <= delta.max() <= 100.0
    control = np.isin(o.point, clean.block.points.where(Role.CONTROL))
    assert control[spoiled.image].all()
    assert spoiled.truth is clean.truth


@pytest.mark.truth
def test_what_is_checkable_follows_from_the_redundancy_of_its_direction() -> None:
    """An error counts as checkable if enough of it remains in the residual of its direction.

    20 sigmas in a direction that keeps 1 % leave 2 sigmas; in one that keeps half, 14.
    """
    q = np.array([[[0.01, 0.0], [0.0, 0.5]]] * 3)
    error = np.array([[20.0, 0.0], [0.0, 20.0], [42.0, 0.0]])
    assert study._trace(error, q).tolist() == [False, True, True]
    assert 0.1 * 41.0 < TRACE < 0.1 * 42.0


@pytest.mark.oracle
def test_a_small_twin_of_the_study() -> None:
    """With 20 % of the rays wrong, Tukey's and Hampel's losses keep the check points right; least squares does not."""
    records = study.study(1, ["twin"], 1, shares=(0.0, 0.2), methods=(PLAIN, "tukey", "hampel"))
    mean = means(records)
    for method in ("tukey", "hampel"):
        assert mean[0.2, method] <= LIMIT * mean[0.0, PLAIN]
    assert mean[0.2, PLAIN] > 2.0 * mean[0.0, PLAIN]
    for record in records:
        assert record["good"] == 131 - (15 if record["share"] else 0)
        assert record["checkable"] + record["not_checkable"] == (15 if record["share"] else 0)
        if record["method"] != PLAIN:
            assert record["missed"] == record["false"] == 0


@pytest.mark.behaviour
def test_only_what_is_missing_runs_and_is_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With ``--missing`` only the second seed runs, and its results are added to the file.

    Gathered results can be separated.
    """
    asked: list[tuple[str, int, float]] = []

    def measure(spoiled: tuple[str, int, float], method: str) -> dict[str, object]:
        asked.append(spoiled)
        return {"rmse_m": float(spoiled[1]), "seconds": 0.0}

    monkeypatch.setattr(study, "spoil", lambda case, seed, share: (case, seed, share))
    monkeypatch.setattr(study, "measure", measure)
    common = ["--cases", "twin", "--shares", "0.1", "--methods", "lad", "--workers", "1", "--out", f"{tmp_path}/r.json"]
    study.main(["--seeds", "1", *common])
    study.main(["--seeds", "2", "--missing", *common])
    assert asked == [("twin", 1, 0.1), ("twin", 2, 0.1)]
    found = json.loads((tmp_path / "r.json").read_text("utf-8"))
    assert [(e["seed"], e["rmse_m"]) for e in found["entries"]] == [([1, 2], [1.0, 2.0])]
    assert study.gathered(study.spread(found["entries"])) == found["entries"]
    assert found["head"]["seeds"] == 2


@pytest.mark.repository
def test_the_page_is_made_of_the_results() -> None:
    results = json.loads(RESULTS.read_text("utf-8"))
    assert PAGE.read_text("utf-8") == with_study(PAGE.read_text("utf-8"), results), (
        "run: python -m benchmarks.contamination_page"
    )
    found = ratios(results["entries"])
    seeds = {(e["case"], e["share"], e["method"]): e["seed"] for e in results["entries"]}
    for case in ("twin", "block"):
        for share in (0.0, 0.05, 0.1, 0.2, 0.3):  # 0, and the four shares of gross errors
            for method in (m for m in study.METHODS if m not in (study.SNOOPING, "lad")):
                assert sorted(seeds[case, share, method]) == list(range(1, 21)), (case, share, method)
    for case in ("twin", "block"):
        for method in WINNERS:
            assert found[case, 0.2, method] <= LIMIT, (case, method)
        assert found[case, 0.2, PLAIN] > 2.0


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize("case", ["twin", "block"])
def test_at_20_percent_the_winners_keep_the_check_points(case: str) -> None:
    """With 20 % wrong rays the winners have at most 1.2 of the clean RMSE over 20 seeds; least squares has twice it."""
    mean = means(study.study(SEEDS, [case], 1, shares=(0.0, 0.2), methods=(PLAIN, *WINNERS)))
    for method in WINNERS:
        assert mean[0.2, method] <= LIMIT * mean[0.0, PLAIN], method
    assert mean[0.2, PLAIN] > 2.0 * mean[0.0, PLAIN]


@pytest.mark.truth
@pytest.mark.parametrize(("seed", "share"), [(14, 0.05), (15, 0.3)])
def test_no_right_point_moves_for_a_little_better_fit(seed: int, share: float) -> None:
    """Points with few rays stay in their place: the RMSE of check points is below 6.5 m.

    They moved by 100 m for less than a unit of the cost, which made 18 and 15 m.
    """
    record = study.measure(study.spoil("block", seed, share), "GNC, tls")
    assert record["rmse_m"] < 6.5
