"""A map raster is refused for bad options, damaged images and models without an outline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from fg_orient.model.errors import InputError
from fg_orient.rectification.fit import Observations, fit
from fg_orient.rectification.grid import LevelSurface
from fg_orient.rectification.options import OrthoOptions
from fg_orient.rectification.ortho import orthorectify, rectify_image
from fg_orient.rectification.ortho_models import PointModel, solved
from fg_orient.rectification.transformation import find_model

from .conftest import CRS

Array = np.ndarray


def model() -> PointModel:
    """Return a model from map to image: north up, 30 m, the centre of the first pixel at (1005, 5025)."""
    sample, line = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 299.0, 4), np.linspace(0.0, 199.0, 4)))
    ground = np.stack([1005.0 + 30.0 * sample, 5025.0 - 30.0 * line], axis=1)
    found = fit(Observations.of(ground, np.stack([sample, line], axis=1)), find_model("affine"),
                source_names=("easting", "northing"), target_names=("sample", "line"), crs=CRS)  # fmt: skip
    return PointModel(found.transformation)


def picture(path: Path, dtype: str = "uint8", **settings: object) -> Path:
    """Return an image of 200 x 300 pixels of noise."""
    grey = np.random.default_rng(5).integers(1, 200, (200, 300)).astype(dtype)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        with rasterio.open(path, "w", driver="GTiff", width=300, height=200, count=1, dtype=dtype, **settings) as sink:
            sink.write(grey, 1)
    return path


def mapped(image: Path, nodata: float | None = None) -> dict[str, object]:
    return orthorectify(image, model(), LevelSurface(0.0), image.with_name("map.tif"), crs=CRS, resolution=30.0,
                        nodata=nodata, overwrite=True)  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize("compress", ["none", "deflate"])
def test_a_truncated_image_is_named_not_the_output(compress: str, tmp_path: Path) -> None:
    image = picture(tmp_path / "cut.tif", compress=compress)
    whole = image.read_bytes()
    assert mapped(image)["filled"] == 1.0
    (tmp_path / "map.tif").unlink()
    image.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError) as caught:
        mapped(image)
    assert caught.value.problems[0].code == "ortho.image"
    assert "cut.tif" in str(caught.value) and "free space" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["cut.tif"]


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "options", [{"window": 0}, {"window": -1}, {"window": 2.5}, {"compress": "foo"}, {"compress": ""}]
)
def test_options_that_cannot_be(options: dict[str, object]) -> None:
    with pytest.raises(InputError) as caught:
        OrthoOptions(**options)  # type: ignore[arg-type]
    assert caught.value.problems[0].code == "options.value"
    assert caught.value.problems[0].option in options


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("dtype", "nodata"),
    [("uint8", 300.0), ("uint8", -1.0), ("uint8", np.nan), ("uint8", 0.5), ("uint8", np.inf), ("float32", 1e39)],
)
def test_a_value_that_the_type_cannot_hold_is_refused(dtype: str, nodata: float, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        mapped(picture(tmp_path / "image.tif", dtype), nodata=nodata)
    assert (caught.value.problems[0].code, caught.value.problems[0].place) == ("options.value", "nodata")


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("dtype", "nodata"), [("uint8", 255.0), ("int16", -32768.0), ("float32", np.nan), ("float32", -9999.0)]
)
def test_a_value_that_the_type_holds_is_taken(dtype: str, nodata: float, tmp_path: Path) -> None:
    image = picture(tmp_path / "image.tif", dtype)
    assert mapped(image, nodata=nodata)["filled"] == 1.0
    with rasterio.open(tmp_path / "map.tif") as found:
        assert np.array_equal(found.nodata, nodata, equal_nan=True)


@pytest.mark.truth
def test_newton_ends_or_says_nan() -> None:
    """Newton's method finds a solution, or gives nan if there is none or the slope vanishes.

    x^2 = 4 from 5 ends at 2; x^2 = -1 has no solution; at 0 the slope of x^2 vanishes.
    """

    def squares(at: Array) -> Array:
        return np.stack([at[:, 0] ** 2, at[:, 1]], axis=1)

    wanted, scale = np.array([[4.0, 1.0], [-1.0, 1.0]]), np.ones(2)
    found = solved(squares, wanted, np.array([5.0, 0.0]), scale)
    assert found[0] == pytest.approx([2.0, 1.0], abs=1e-12)
    assert np.isnan(found[1]).all()
    assert np.isnan(solved(squares, wanted, np.zeros(2), scale)).all()


def folded(east: Array) -> Array:
    """Return the samples of a map that turns round at its middle; no sample is above 150."""
    return 150.0 - ((east - 5000.0) / 500.0) ** 2


@pytest.mark.behaviour
def test_an_image_beyond_the_fold_of_a_polynomial_has_no_outline(tmp_path: Path) -> None:
    east, north = (a.ravel() for a in np.meshgrid(np.linspace(100.0, 4100.0, 5), np.linspace(0.0, 6000.0, 5)))
    pixel = np.stack([folded(east), north / 30.0], axis=1)
    found = fit(Observations.of(np.stack([east, north], axis=1), pixel), find_model("polynomial", 2),
                source_names=("easting", "northing"), target_names=("sample", "line"), crs=CRS)  # fmt: skip
    bound, image, out = PointModel(found.transformation), picture(tmp_path / "image.tif"), tmp_path / "map.tif"
    with pytest.raises(InputError) as caught:
        orthorectify(image, bound, LevelSurface(0.0), out, crs=CRS)
    assert caught.value.problems[0].code == "ortho.outline" and "sample 187:" in str(caught.value)
    record = orthorectify(image, bound, LevelSurface(0.0), out, crs=CRS, resolution=30.0,
                          bounds=(900.0, 600.0, 3000.0, 3000.0))  # fmt: skip
    assert record["filled"] == 1.0


@pytest.mark.behaviour
@pytest.mark.parametrize("which", ["image", "dem", "model", "foreign"])
def test_nothing_that_is_read_and_no_foreign_file_is_replaced(tmp_path: Path, which: str) -> None:
    """An output that is an input or a foreign file is refused, also with --overwrite, and stays as it was."""
    files = {name: tmp_path / f"{name}.tif" for name in ("image", "dem", "model", "foreign")}
    for path in files.values():
        path.write_bytes(b"not to be lost")
    with pytest.raises(InputError) as caught:
        rectify_image(files["image"], files["model"], files[which], dem=files["dem"], overwrite=True)
    assert caught.value.problems[0].code == ("ortho.foreign" if which == "foreign" else "ortho.over_input")
    assert files[which].read_bytes() == b"not to be lost"
