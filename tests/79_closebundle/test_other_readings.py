"""Image coordinates in another reading are named, whether a bundle or a resection converges or not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fg_orient.closerange.bundle import adjust_bundle
from fg_orient.closerange.resection import other_readings, resect
from fg_orient.model.errors import NoSolutionError
from tests.support import page_files
from tests.support.command import in_process as run

from .conftest import SIGMA, Array, Scene, make

pytestmark = pytest.mark.oracle

CONTROL = 10


def bundle(scene: Scene, image: Array) -> NoSolutionError:
    control = {scene.ids[k]: (scene.points[k], 1e-3) for k in range(CONTROL)}
    with pytest.raises(NoSolutionError) as caught:
        adjust_bundle(scene.photos(), scene.ids, scene.points, scene.which, scene.of, image, sigma=SIGMA,
                      control=control, max_iterations=20)  # fmt: skip
    return caught.value


@pytest.mark.parametrize("kind", ["y", "exchanged"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_other_direction_of_y_is_named(seed: int, kind: str) -> None:
    scene = make(seed)
    image = scene.image * [1.0, -1.0] if kind == "y" else scene.image[:, ::-1]
    first, *rest = bundle(scene, np.ascontiguousarray(image)).problems
    assert first.code == "closerange.other_reading"
    assert "photos ph0, ph1, ph2" in first.message
    assert "y_axis" in first.remedy
    assert rest


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_point_with_exchanged_coordinates_is_named(seed: int) -> None:
    scene = make(seed)
    image = scene.image.copy()
    far = int(np.argmax(np.abs(image[:CONTROL] @ [1.0, -1.0])))
    image[far] = image[far, ::-1]
    photos = [("ph0", scene.interior, scene.points, image[: scene.n], scene.ids)]
    (found,) = other_readings(photos)
    assert (found.code, found.place, found.data["points"]) == ("closerange.exchanged_point", "photo ph0", [f"p{far}"])


@pytest.mark.parametrize("seed", range(10))
def test_right_coordinates_are_not_doubted(seed: int) -> None:
    """Gross errors, and a wrong focal length, are not named as another reading."""
    scene = make(seed)
    own = scene.image[: scene.n].copy()
    assert other_readings([("ph0", scene.interior, scene.points, own, scene.ids)]) == []
    own[3] += [4.0, -7.0]
    assert other_readings([("ph0", scene.interior, scene.points, own, scene.ids)]) == []
    wrong = replace(scene.interior, focal=90.0)
    assert other_readings([("ph0", wrong, scene.points, own, scene.ids)]) == []
    few = [("ph0", scene.interior, scene.points[:5], own[:5] * [1.0, -1.0], scene.ids[:5])]
    assert other_readings(few) == []


def test_a_resection_without_solution_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A resection of wrong coordinates may converge, so the iteration is replaced by one that does not."""

    def fails(*given: object) -> None:
        raise NoSolutionError.of("closerange.not_converged", place="resection", reason="it oscillates")

    monkeypatch.setattr("fg_orient.closerange.resection._best", fails)
    scene = make(1)
    for image, codes in (
        (scene.image * [1.0, -1.0], ["closerange.other_reading", "closerange.not_converged"]),
        (scene.image, ["closerange.not_converged"]),
    ):
        with pytest.raises(NoSolutionError) as caught:
            resect(scene.interior, scene.points, image[: scene.n], sigma=SIGMA)
        assert [p.code for p in caught.value.problems] == codes


@pytest.mark.parametrize("sigma", [(), ("--sigma", "0.001")])
@pytest.mark.parametrize("command", ["resect", "bundle"])
def test_a_result_with_y_in_the_other_direction_is_not_trustworthy(
    command: str, sigma: tuple[str, ...], tmp_path: Path
) -> None:
    """The iteration converges with y in the wrong direction; without sigmas m0 tells nothing."""
    page_files.photos_and_control(tmp_path)
    path = tmp_path / "cameras.toml"
    words = {
        "resect": ("control.csv", "cameras.toml"),
        "bundle": ("image.csv", "cameras.toml", "--control", "ground.csv"),
    }
    given = [tmp_path / w if w.endswith((".csv", ".toml")) else w for w in words[command]]
    assert run("closerange", command, *given, *sigma).code == 0
    path.write_text(path.read_text("utf-8").replace("focal = 60.0", 'focal = 60.0\ny_axis = "down"'), "utf-8")
    done = run("closerange", command, *given, *sigma)
    first, last = done.stderr.splitlines()[0], done.stdout.splitlines()[-1]
    assert done.code == 4
    assert "y of the image coordinates has the other direction" in first and "check y_axis in the photo file" in first
    assert last.startswith("not trustworthy: ") and "has the other direction" in last
