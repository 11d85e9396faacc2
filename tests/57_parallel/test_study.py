"""Results of studies are in the order of the cases, stored one by one, and equal for any workers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.parts.study import dumps, loads, study
from fg_orient.model.block import Block
from fg_orient.studies.claims import Claim, Outcome, outcome, run_claims
from fg_orient.studies.comparison.model import Comparison


def spectrum(seed: int) -> dict[str, Any]:
    """Return nested numbers, words and arrays."""
    values = np.linalg.svd(np.random.default_rng(seed).normal(size=(4, 3)), compute_uv=False)
    return {"seed": seed, "values": values, "nested": [{"nan": math.nan, "text": "é"}, np.float64(values[0])]}


def assert_same(a: list[Any], b: list[Any]) -> None:
    assert len(a) == len(b)
    for x, y in zip(a, b, strict=True):
        assert x["seed"] == y["seed"] and x["nested"][1] == y["nested"][1]
        np.testing.assert_array_equal(x["values"], y["values"])


@pytest.mark.consistency
def test_results_keep_their_bits() -> None:
    found, again = spectrum(3), loads(dumps(spectrum(3)))
    assert_same([found], [again])
    assert math.isnan(again["nested"][0]["nan"]) and again["nested"][0]["text"] == "é"
    for bad in (object(), {"a": np.array([object()])}):
        with pytest.raises(TypeError, match="cannot hold"):
            dumps(bad)


@pytest.mark.behaviour
def test_an_interrupted_study_goes_on(tmp_path: Path) -> None:
    cases, seen, told = list(range(6)), [], []

    def task(case: int) -> dict[str, Any]:
        seen.append(case)
        if case == 4 and len(seen) == 5:
            raise KeyboardInterrupt
        return spectrum(case)

    with pytest.raises(KeyboardInterrupt):
        study(task, cases, folder=tmp_path / "kept")
    assert len(list((tmp_path / "kept").iterdir())) == 4
    found = study(task, cases, folder=tmp_path / "kept", callback=lambda *step: told.append(step))
    assert_same(found, [spectrum(case) for case in cases])
    assert seen == [0, 1, 2, 3, 4, 4, 5]
    assert told == [(k + 1, 6, k) for k in range(6)]
    study(task, cases, folder=tmp_path / "kept", key="another input")
    assert len(seen) == 7 + 6


@pytest.mark.behaviour
def test_a_kept_file_that_is_not_whole_and_a_folder_that_cannot_be_made_are_named(tmp_path: Path) -> None:
    study(spectrum, [1], folder=tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:200])
    for folder, code, file in (
        (tmp_path, "parallel.result", str(path)), (path / "below", "output.unwritable", ""),
    ):  # fmt: skip
        with pytest.raises(fg.InputError) as caught:
            study(spectrum, [1], folder=folder)
        assert caught.value.problems[0].code == code
        assert caught.value.problems[0].file == file or not file


def even(at: Any) -> Outcome:
    return outcome({"even": at.seed % 2 == 0}, half=at.seed / 2)


@pytest.mark.behaviour
def test_claims_are_shared_by_seed() -> None:
    told: list[tuple[int, int]] = []
    (found,) = run_claims([1, 2, 3, 4], lambda *step: told.append(step), [Claim("C0", "even seeds", even)])
    assert (found.passed, found.of, found.met) == (2, 4, False)
    assert found.figures["half"] == (0.5, 1.25, 2.0)
    assert found.reason == "even: not in 2 of 4" and told == [(k, 4) for k in range(1, 5)]


def assert_same_comparison(a: Comparison, b: Comparison) -> None:
    """Assert that two comparisons are equal but for the times."""
    np.testing.assert_equal(without_times(a.rows), without_times(b.rows))
    for x, y in zip(a.spectra, b.spectra, strict=True):
        np.testing.assert_array_equal(x.values, y.values)


def without_times(rows: Any) -> list[dict[str, Any]]:
    return [{k: v for k, v in row.as_dict().items() if k not in ("processor_s", "peak_bytes")} for row in rows]


@pytest.mark.consistency
def test_a_comparison_keeps_its_sets(small: Block, tmp_path: Path) -> None:
    """A comparison with a folder has the same rows, a second run reuses them, and other options do not."""
    given: dict[str, Any] = {"eop_sets": [1, 15], "solvers": "qr", "backends": "dense"}
    alone, shared = fg.compare(small, **given), fg.compare(small, **given, folder=tmp_path)
    assert_same_comparison(shared, alone)
    told: list[tuple[int, int, str]] = []
    kept = fg.compare(small, **given, folder=tmp_path, callback=lambda *step: told.append(step))
    assert [row.processor_s for row in kept.rows] == [row.processor_s for row in shared.rows]
    assert [step[:2] for step in told] == [(1, 2), (2, 2)]
    fg.compare(small, **{**given, "eop_sets": [1]}, look_polynomial=0, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.consistency
@pytest.mark.slow
def test_workers_share_a_comparison(client: Any, small: Block) -> None:
    given: dict[str, Any] = {"eop_sets": [1, 15], "solvers": "qr", "backends": "dense,graph"}
    assert_same_comparison(fg.compare(small, **given, cluster=client), fg.compare(small, **given))
