"""Gross errors in a bundle: the tests check search, robust losses, variance components and common options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.closerange.bundle import adjust_bundle
from fg_orient.closerange.bundle_result import BundleResult
from tests.support.command import in_process as run

from .conftest import SIGMA, Array, Scene, make

#: Rows of the image points with an error, and the errors, image units; point and error of a control height, m.
WRONG = {5: [0.05, 0.04], 27: [0.0, -0.05], 58: [-0.03, 0.06]}
HEIGHT, HEIGHT_ERROR_M = 2, 0.05
N_CONTROL, SIGMA_CONTROL = 8, 0.001
BACKENDS = ("dense", "graph", "schur")


def planted(*, height: bool = True, noise: float = SIGMA) -> tuple[Scene, dict[str, tuple[Array, float]]]:
    """Return the scene of four photos and its control points with gross errors."""
    scene = make(3, 20, 4, noise=noise)
    for row, error in WRONG.items():
        scene.image[row] += error
    off = np.random.default_rng(9).normal(scale=SIGMA_CONTROL, size=(N_CONTROL, 3))
    off[HEIGHT, 2] += HEIGHT_ERROR_M * height
    return scene, {f"p{k}": (scene.points[k] + off[k], SIGMA_CONTROL) for k in range(N_CONTROL)}


def adjusted(scene: Scene, control: Any, keep: Any = slice(None), **more: Any) -> BundleResult:
    photos = scene.photos(shared=("k1", "p1"), camera="a")
    return adjust_bundle(photos, scene.ids, scene.points + 0.01, scene.which[keep], scene.of[keep], scene.image[keep],
                         sigma=SIGMA, control=control, **more)  # fmt: skip


@pytest.mark.truth
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_search_finds_the_planted_errors(backend: str) -> None:
    scene, control = planted()
    result = adjusted(scene, control, backend=backend, snoop=True)
    assert np.flatnonzero(result.rejected).tolist() == list(WRONG)
    search = result.solution.snooping
    assert search is not None
    assert search.complete
    assert "height of point p2" in [test.name for test in search.tests]
    for row, error in WRONG.items():  # computed minus measured; the prediction has the noise of two image points
        assert np.abs(result.residuals[row] + error).max() < 10.0 * SIGMA
    assert np.isnan(result.redundancy_numbers[result.rejected]).all()
    assert result.sigma_m is not None
    assert np.abs((result.points_m - scene.points) / result.sigma_m).max() < 5.0


@pytest.mark.consistency
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_end_is_the_bundle_without_the_errors(backend: str) -> None:
    scene, control = planted(height=False)
    keep = np.setdiff1d(np.arange(len(scene.image)), list(WRONG))
    found, without = (adjusted(scene, control, rows, backend=backend, snoop=snoop)
                      for rows, snoop in ((slice(None), True), (keep, False)))  # fmt: skip
    assert np.flatnonzero(found.rejected).tolist() == list(WRONG)
    assert (found.redundancy, found.labels) == (without.redundancy, without.labels)
    assert found.m0 == pytest.approx(without.m0, rel=1e-8)
    assert found.points_m == pytest.approx(without.points_m, abs=1e-8)
    assert found.residuals[keep] == pytest.approx(without.residuals, abs=1e-7)
    assert found.redundancy_numbers[keep] == pytest.approx(without.redundancy_numbers, abs=1e-6)
    assert found.cofactors == pytest.approx(without.cofactors, rel=1e-5)


@pytest.mark.consistency
def test_a_search_that_finds_nothing_changes_nothing() -> None:
    scene = make(11, 20, 4)
    control = {f"p{k}": (scene.points[k], SIGMA_CONTROL) for k in range(N_CONTROL)}
    plain, searched = adjusted(scene, control), adjusted(scene, control, snoop=True)
    assert not searched.rejected.any()
    for name in ("residuals", "redundancy_numbers", "points_m", "cofactors", "others_whitened", "image_sigma"):
        assert np.array_equal(getattr(plain, name), getattr(searched, name)), name


@pytest.mark.truth
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("how", [{"loss": "tukey"}, {"loss": "tls", "gnc": True}, {"loss": "huber"}])
def test_losses_give_the_planted_errors_no_weight(how: dict[str, Any], backend: str) -> None:
    scene, control = planted()
    result = adjusted(scene, control, backend=backend, **how)
    assert np.flatnonzero(result.weights < 0.3).tolist() == list(WRONG)
    assert result.solution.weights is not None
    assert np.flatnonzero(result.solution.weights.control < 0.3).tolist() == [HEIGHT]
    assert np.abs(result.points_m - scene.points).max() < 3e-3
    assert result.m0 == 1.0
    for row, error in WRONG.items():
        assert np.abs(result.residuals[row] + error).max() < 10.0 * SIGMA


@pytest.mark.truth
def test_a_point_with_all_its_observations_is_without_place() -> None:
    scene, control = planted()
    result = adjusted(scene, control, snoop=True, snoop_kind="points")
    gone = {scene.of[row] for row in WRONG} | {HEIGHT}
    assert np.flatnonzero(np.isnan(result.points_m[:, 0])).tolist() == sorted(gone)
    assert np.flatnonzero(result.rejected).tolist() == np.flatnonzero(np.isin(scene.of, list(gone))).tolist()
    assert np.isnan(result.residuals[result.rejected]).all()
    assert result.ids == tuple(scene.ids)


@pytest.mark.truth
def test_variance_components() -> None:
    """If image points are three times worse than stated, variance components find this factor."""
    scene = make(5, 30, 4, noise=3.0 * SIGMA)
    rng = np.random.default_rng(2)
    control = {f"p{k}": (scene.points[k] + rng.normal(scale=SIGMA_CONTROL, size=3), SIGMA_CONTROL) for k in range(12)}
    result = adjusted(scene, control, variance_components=("image",))
    components = result.solution.components
    assert components is not None
    (image,) = components.components
    assert abs(image.factor - 3.0) < 4.0 * image.sd
    assert result.image_sigma == pytest.approx(np.full_like(scene.image, SIGMA * image.factor), rel=1e-4)


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["eop_set", "backend_", "check_points"])
def test_other_options_are_refused(name: str) -> None:
    scene, control = planted()
    with pytest.raises(TypeError, match=f"adjust_bundle.*{name}"):
        adjusted(scene, control, **{name: 1})


# --- command ---------------------------------------------------------------------------------------


@pytest.fixture
def words(tmp_path: Path) -> tuple[object, ...]:
    """Write the planted scene without the wrong height; return the words of the command."""
    scene, control = planted(height=False)
    rows = [f"p{k},ph{p},{float(x)!r},{float(y)!r}"
            for (x, y), p, k in zip(scene.image, scene.which, scene.of, strict=True)]  # fmt: skip
    (tmp_path / "image.csv").write_text("\n".join(["id,photo,x,y", *rows]) + "\n", "utf-8")
    rows = [f"{name},{','.join(repr(float(v)) for v in at)}" for name, (at, _) in control.items()]
    (tmp_path / "control.csv").write_text("\n".join(["id,x_m,y_m,z_m", *rows]) + "\n", "utf-8")
    entry = '[[photos]]\nname = "ph{}"\nfocal = 60.0\nprincipal = [0.3, -0.2]\nk1 = 1e-5\np1 = 1e-5\n'
    photos = "".join(entry.format(k) for k in range(4))
    (tmp_path / "cameras.toml").write_text("schema = 1\n" + photos, "utf-8")
    return ("closerange", "bundle", tmp_path / "image.csv", tmp_path / "cameras.toml", "--control",
            tmp_path / "control.csv", "--shared", "k1,p1")  # fmt: skip


SIGMAS = ("--sigma", str(SIGMA), "--sigma-control", str(SIGMA_CONTROL))


@pytest.mark.truth
def test_command_with_a_search(words: tuple[object, ...], tmp_path: Path) -> None:
    done = run(*words, *SIGMAS, "--snoop", "--out", tmp_path / "out", "--json")
    assert done.code == 0, done.stderr
    record, page = done.json, (tmp_path / "out" / "report.html").read_text("utf-8")
    assert [k for k, row in enumerate(record["residuals"]) if row["weight"] == 0.0] == list(WRONG)
    assert record["snooping"]["n_left_out"] == len(WRONG)
    assert record["m0"] < 1.5
    assert [row["w_x"] for row in record["residuals"] if row["weight"] == 0.0] == [None] * len(WRONG)
    assert "Search for gross errors" in page
    assert f"{len(record['residuals']) - len(WRONG)} image points" in page
    plain = run(*words, *SIGMAS, "--json").json
    assert "weight" not in plain["residuals"][0]
    assert (plain["loss"], plain["robust"], plain["snooping"], plain["variance_components"]) == ("none", *[None] * 3)
    assert "snooping left out 3 observations" in run(*words, *SIGMAS, "--snoop").stderr


@pytest.mark.truth
def test_command_with_a_loss_and_with_components(words: tuple[object, ...], tmp_path: Path) -> None:
    record = run(*words, *SIGMAS, "--loss", "tukey", "--out", tmp_path / "out", "--json").json
    assert [k for k, row in enumerate(record["residuals"]) if row["weight"] < 0.3] == list(WRONG)
    assert record["robust"]["n_image_points_below_half"] == len(WRONG)
    assert record["significance"] is None
    assert "Weights of the loss" in (tmp_path / "out" / "report.html").read_text("utf-8")
    more = ("--variance-components-of", "image", "--snoop")
    assert "sigmas estimated" in run(*words, *SIGMAS, *more).stdout
    estimated = run(*words, *SIGMAS, *more, "--json").json
    freedom = [one["freedom"] for one in estimated["significance"]["coefficients"]]
    assert len(freedom) == 2
    assert not any(f == estimated["redundancy"] for f in freedom)


@pytest.mark.behaviour
@pytest.mark.parametrize("more", [("--loss", "tukey"), ("--outlier-test", "baarda"), ("--variance-components",)])
def test_options_that_need_sigmas(words: tuple[object, ...], more: tuple[str, ...]) -> None:
    done = run(*words, *more)
    assert done.code == 2
    assert len(done.stderr.splitlines()) == 1
    assert more[0] in done.stderr
    assert "--sigma" in done.stderr
