"""Regularisations are an axis of a comparison: the tests check rows, recommendation, page and command."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.model.parameters import with_options
from fg_orient.studies.comparison.advice import advise, best_set
from fg_orient.studies.comparison.compare import compare
from fg_orient.studies.comparison.model import Comparison
from fg_orient.studies.comparison.report import verdict
from fg_orient.studies.comparison.selections import options_of, regularisation_of, regularised
from fg_orient.studies.comparison.set_results import SetResult
from fg_orient.studies.two_stage import TwoStage
from tests.support.command import Run
from tests.support.dense_reduced import dense_of
from tests.support.dense_reduced import regularised as regularised_problem

WORDS = ("none", "tikhonov:gcv", "tikhonov:1", "minimum_norm:1e-05")


@pytest.fixture(scope="module")
def free(twin: Block) -> Block:
    """Return the block without priors, where set 19 has directions that no observation determines."""
    return with_options(twin, "test", priors=False)


@pytest.fixture(scope="module")
def found(free: Block) -> Comparison:
    return compare(free, eop_sets=[19], solvers="qr", regularisations=WORDS)


@pytest.mark.behaviour
def test_deficient_set_has_regularised_rows_only(found: Comparison) -> None:
    assert found.regularisations == WORDS
    adjusted = [r for r in found.rows if r.backend != "faithful"]
    assert {r.regularisation for r in adjusted} == set(WORDS)
    assert all("not observable" in r.failure for r in adjusted if r.regularisation == "none")
    for word in WORDS[1:]:
        solved = [r for r in adjusted if r.regularisation == word and not r.failure]
        assert {r.backend for r in solved} == {"dense", "schur", "explicit", "graph"}
        assert max(r.difference_sigmas for r in solved) < 1e-6 and max(r.difference_m for r in solved) < 1e-6
    assert {r.regularisation for r in found.rows if r.backend == "faithful"} == {""}


@pytest.mark.oracle
def test_regularised_rows_against_numpy(free: Block, found: Comparison) -> None:
    """Regularised rows have the errors, kappa, sigma0 and condition of numpy's ridge solution.

    numpy iterates Gauss-Newton with all rows.
    """
    kappa = next(r.kappa for r in found.rows if r.regularisation == "tikhonov:gcv" and not r.failure)
    for word, of_kappa in (("tikhonov:gcv", kappa), ("tikhonov:1", 1.0)):
        plain, problem = regularised_problem(free, 19, **options_of(word))
        assert problem.regularisation is not None
        assert problem.regularisation.kappa == pytest.approx(of_kappa, rel=1e-12)
        z, state = plain.n_free_unknowns, plain.start
        held = np.zeros((z, plain.n_columns))
        held[:, :z] = np.sqrt(of_kappa) * np.eye(z)
        for _ in range(8):
            residual, design = assemble(plain, state)
            rows, right = np.vstack([design, held]), -np.append(residual, held[:, :z] @ plain.image_vector(state))
            scale = np.linalg.norm(rows, axis=0)
            state = plain.moved(state, np.linalg.lstsq(rows / scale, right, rcond=None)[0] / scale)
        known = dict(zip(free.withheld.ids, free.withheld.open().ecef_m, strict=True))
        away = [state.ground[j] + plain.origin_m - known[free.points.ids[j]] for j in free.points.where(Role.CHECK)]
        rmse = np.sqrt(np.mean(np.square(away), axis=0))
        residual, design = assemble(plain, state)
        hat = (
            design
            @ np.linalg.lstsq(np.vstack([design, held]), np.eye(len(design) + z)[:, : len(design)], rcond=None)[0]
        )
        own = [r for r in found.rows if r.regularisation == word and not r.failure]
        assert len(own) > 10
        for row in own:
            assert [getattr(row, f"check_rmse_{a}_m") for a in "xyz"] == pytest.approx(rmse, rel=1e-6)
            assert row.kappa == pytest.approx(of_kappa, rel=1e-12)
            freedom = len(design) - float(np.trace(hat))  # at the solution; the row has it at the start
            assert row.sigma0 == pytest.approx(np.sqrt(residual @ residual / freedom), rel=1e-4)
            both = np.vstack([assemble(plain, plain.start)[1], held])
            physical = both / np.append(np.concatenate([p.sigma for p in plain.parameters]), np.ones(both.shape[1] - z))
            unit = physical / np.linalg.norm(physical, axis=0)
            assert row.cond_scaled == pytest.approx(np.linalg.cond(unit) ** 2, rel=1e-5)


@pytest.mark.behaviour
def test_recommended_estimate_states_its_bias(found: Comparison) -> None:
    advice, said = found.advice, verdict(found)
    assert advice is not None and advice.eop_set == 19 and advice.regularisation in WORDS[1:]
    assert advice.options is not None and advice.options["priors"] is False
    assert (
        with_options(found.block, "test", **advice.options).options.regularisation == advice.options["regularisation"]
    )
    text = " ".join(said["text"])
    assert (
        "The estimate is regularised and therefore biased: its standard deviations do not describe its accuracy" in text
    )
    assert "with the bias of true deviations of one prior sigma" in text
    best = next(s for s in found.sets if s.key == advice.set_key)
    assert 0.0 < best.bias_m < best.predicted_m < best.limit_m
    assert np.isnan(best.aicc) and np.isnan(best.prediction_factor)
    assert said["title"].endswith(("tikhonov (gcv)", "tikhonov (1)", "minimum norm (1e-05)"))


@pytest.mark.consistency
def test_regularisation_of_the_block_is_the_default(free: Block) -> None:
    block = with_options(free, "test", regularisation="tikhonov", kappa_rule="gcv")
    rows = compare(block, eop_sets=[5], backends="graph").rows
    assert {r.regularisation for r in rows} == {"tikhonov:gcv"} and not any(r.failure for r in rows)
    solution = fg.adjust(block, eop_set=5)
    assert rows[0].sigma0 == pytest.approx(solution.sigma0, rel=1e-9)
    assert solution.problem.regularisation is not None and rows[0].kappa == solution.problem.regularisation.kappa


@pytest.mark.behaviour
def test_an_interrupted_comparison_goes_on(free: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interrupted comparison reads finished sets with their error vectors and does not compute them again.

    Another selection is computed.
    """
    given = {"eop_sets": [2], "solvers": "qr", "types": [1], "backends": "faithful,graph", "folder": tmp_path}
    first = compare(free, regularisations="tikhonov:gcv", **given)  # type: ignore[arg-type]
    assert compare(free, regularisations="none", **given).regularisations == ("none",)  # type: ignore[arg-type]
    monkeypatch.setattr("fg_orient.studies.comparison.compare.Adjustments", None)
    again = compare(free, regularisations="tikhonov:gcv", **given)  # type: ignore[arg-type]
    assert again.sets[0].regularisation == "tikhonov:gcv" and str(again.rows) == str(first.rows)
    (mine,), (theirs,) = again.vectors, first.vectors
    assert mine.ids == theirs.ids and np.array_equal(mine.enu_m["check"], theirs.enu_m["check"])


def result(eop_set: int, rmse: float, **more: object) -> SetResult:
    given = {"status": "converged", "backend": "graph", "optimizer": "gauss-newton", "n_check": 50,
             "check_freedom": 200.0, "check_rmse_3d_m": rmse, "effective_unknowns": 10.0 - eop_set} | more  # fmt: skip
    return SetResult(eop_set, f"S{eop_set}", 10 + eop_set, **given)  # type: ignore[arg-type]


@pytest.mark.behaviour
def test_an_unbiased_estimate_is_taken_unless_it_is_worse() -> None:
    """The advice prefers an estimate without bias unless its check RMSE is worse by a standard error.

    Variances are never compared.
    """
    plain = result(1, 1.04, regularisation="none", aicc=5.0, bic=5.0)
    ridge = result(1, 1.0, regularisation="tikhonov:gcv", bias_m=0.3, predicted_m=0.1)
    other = result(2, 1.0, regularisation="tikhonov:gcv")
    assert best_set([plain, ridge])[0] is plain
    assert "it alone is not regularised, and so without bias" in " ".join(best_set([plain, ridge])[1])
    worse = replace(plain, check_rmse_3d_m=1.2)
    best, why = best_set([worse, ridge])
    assert best is ridge and "of the predicted RMSE 0.3 m are bias" in why[-1]
    assert best_set([ridge, other])[0] is other  # fewer effective unknowns
    nothing = {"n_check": 0, "check_rmse_3d_m": float("nan")}
    alone = [replace(one, **nothing) for one in (ridge, other, worse)]
    assert best_set(alone)[0] is alone[2] and best_set(alone[:2])[0] is alone[1]
    assert advise([ridge], [], {}).options == {"eop_set": 1, "regularisation": "tikhonov", "kappa_rule": "gcv"}


@pytest.mark.behaviour
@pytest.mark.parametrize(("word", "complete"), [
    ("none", "none"), ("tikhonov", "tikhonov:bayes"), ("tikhonov:0.1", "tikhonov:0.1"),
    ("truncated:gcv", "truncated:gcv"), ("minimum_norm", "minimum_norm:1e-09"), ("stein:1e-5", "stein:1e-05"),
])  # fmt: skip
def test_words_of_regularisations(word: str, complete: str) -> None:
    options = regularised(fg.Options(penalty="laplace"), word)
    assert regularisation_of(options) == complete
    again = regularised(fg.Options(penalty="laplace"), complete)
    assert again == options
    assert with_options_of(complete) == complete
    assert (options.penalty == "laplace") == word.startswith("tikhonov")


def with_options_of(word: str) -> str:
    return regularisation_of(fg.Options(**options_of(word)))


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "wrong", ["ridge", "tikhonov:", "tikhonov:-1", "tikhonov:best", "minimum_norm:gcv", "none:1", "stein:2"]
)
def test_unknown_regularisations_are_one_line(run: Run, project: Path, tmp_path: Path, wrong: str) -> None:
    ended = run("compare", project, "--regularisations", f"none,{wrong}", "--out", tmp_path / "out")
    assert ended.code == 2 and f"unknown regularisation (found {wrong})" in " ".join(ended.stderr.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.behaviour
def test_command_page_and_tables(run: Run, project: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ended = run("compare", project, "--eop-sets", "5,19", "--backends", "graph", "--no-priors", "--regularisations",
                "none,tikhonov:gcv", "--out", out, "--json")  # fmt: skip
    assert ended.code == 0, ended.stderr
    record = json.loads((out / "result.json").read_text("utf-8"))
    assert record["regularisations"] == ["none", "tikhonov:gcv"] and len(record["sets"]) == 4
    page = (out / "report.html").read_text("utf-8")
    part = page.partition('id="regularisations"')[2].partition("</section>")[0]
    assert len(re.findall(r"<tr><td", part)) == 2 and "bias included" in part
    spectra = (out / "spectra.csv").read_text("utf-8")
    assert '"adjustment, tikhonov:gcv",priors' in spectra
    shown = run("compare", project, "--eop-sets", "19", "--backends", "graph", "--no-priors", "--regularisations",
                "tikhonov:gcv", "--out", out, "--overwrite").stdout  # fmt: skip
    assert "regularised estimates are biased: they have no ratio and no AICc" in " ".join(shown.split())


@pytest.mark.oracle
def test_error_vectors_are_those_of_the_published_rows(twin: Block, written: tuple[Path, object]) -> None:
    """The error vectors of each published row have its RMSE, after conversion to ECEF."""
    with (written[0] / "error_vectors.csv").open(encoding="utf-8", newline="") as stream:
        vectors = list(csv.DictReader(stream))
    with (written[0] / "compare.csv").open(encoding="utf-8", newline="") as stream:
        rows = [r for r in csv.DictReader(stream) if r["backend"] == "faithful" and not r["failure"]]
    lon, lat = geodetic(twin)
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    axes = np.stack([east, np.cross(up, east), up])
    assert rows
    key = ("eop_set", "type", "solver")
    for row in rows:
        mine = [v for v in vectors if all(v[name] == row[name] for name in key)]
        for role in ("control", "check"):
            own = [[float(v[f"{a}_m"]) for a in ("east", "north", "up")] for v in mine if v["role"] == role]
            rmse = np.sqrt(np.mean(np.square(np.array(own) @ axes), axis=0))
            assert [float(row[f"{role}_rmse_{a}_m"]) for a in "xyz"] == pytest.approx(rmse, rel=1e-6)
    assert len({tuple(v[name] for name in key) for v in vectors}) == len(rows)


def geodetic(block: Block) -> tuple[float, float]:
    """Return the longitude and latitude, rad, of the middle of the control points by pyproj."""
    from pyproj import Transformer

    middle = block.points.known.ecef_m[block.points.where(Role.CONTROL)].mean(axis=0)
    lon, lat, _ = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*middle)
    return float(np.radians(lon)), float(np.radians(lat))


@pytest.mark.truth
def test_error_vectors_point_from_measured_to_computed(twin: Block, comparison: Comparison) -> None:
    """Error vectors point from measured to computed, opposite to the published sign."""
    one = next(v for v in comparison.vectors if v.solver == "qr")
    errors = TwoStage(twin).bundle(one.eop_set, one.type, "qr").accuracy  # type: ignore[arg-type]
    assert one.ids["check"] == errors.icp_ids
    lon, lat = geodetic(twin)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    np.testing.assert_allclose(one.enu_m["check"][:, 2], -errors.icp_m @ up, rtol=1e-6, atol=1e-6)


@pytest.mark.oracle
def test_points_project_out_of_regularised_rows(free: Block) -> None:
    """The condition of a Tikhonov row is that of numpy's singular values of the reduced system."""
    plain, problem = regularised_problem(free, 19, regularisation="tikhonov", kappa=0.01)
    s = np.linalg.svd(dense_of(plain).a, compute_uv=False)
    assert problem.regularisation is not None
    want = np.sqrt((s[0] ** 2 + 0.01) / (s[-1] ** 2 + 0.01))
    assert problem.regularisation.condition == pytest.approx(want, rel=1e-6)
