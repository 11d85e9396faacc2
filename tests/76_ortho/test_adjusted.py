"""Corrections are read from result folders and agree with the arrays of the folder."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import N_EOP, parameter_name
from fg_orient.rectification.ortho_models import read_orientation
from fg_orient.rpc.fitting import fit_image
from fg_orient.rpc.options import FitOptions
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.command import in_process as run
from tests.support.results import sealed

from .conftest import Twin

Array = np.ndarray


@pytest.mark.consistency
@pytest.mark.parametrize(("image", "number"), [("left", 0), ("right", 1)])
def test_eop_are_those_of_the_state(twin: Twin, image: str, number: int) -> None:
    found = read_orientation(twin.result, twin.sensors[image]).correction
    assert isinstance(found, Correction)
    arrays = np.load(twin.result / "arrays.npz")
    physical = arrays["state_image"][number] * arrays["prior_sigma"]
    codes = {parameter_name(code): code for code in range(N_EOP)}
    expected = np.zeros(N_EOP)
    expected[[codes[name] for name in arrays["parameter_names"]]] = physical
    assert np.abs(expected).max() > 0.1
    assert np.allclose(found.eop.ravel(), expected, rtol=1e-14, atol=0.0)
    assert found.look.shape == (2, 0) and not found.small_angle


def folder(path: Path, values: dict[str, float], *, small_angle: bool = False) -> Path:
    images, options = [{"id": "one", "file": "left.DIM"}], {"small_angle": small_angle}
    record = {"status": "converged", "images": images, "provenance": {"options": options}}
    (path / "result.json").write_text(json.dumps(record), encoding="utf-8")
    rows = ["image,parameter,value_per_tau", *(f"one,{name},{value!r}" for name, value in values.items())]
    (path / "eop.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.behaviour
def test_look_angles_and_small_angles(twin: Twin, tmp_path: Path) -> None:
    given = {"roll_1": 2e-6, "psi_x_s0": 1e-6, "psi_y_s0": 2e-6, "psi_x_s2": 3e-6, "psi_y_s2": 4e-6}
    found = read_orientation(folder(tmp_path, given, small_angle=True), twin.sensors["left"]).correction
    assert isinstance(found, Correction) and found.small_angle
    assert found.eop[6].tolist() == [0.0, 2e-6, 0.0] and np.count_nonzero(found.eop) == 1
    assert found.look.tolist() == [[1e-6, 0.0, 3e-6], [2e-6, 0.0, 4e-6]]


@pytest.mark.truth
def test_compensation_of_an_rpc_image(twin: Twin, tmp_path: Path) -> None:
    """A correction of an RPC image moves projected points by its terms, and other terms are refused."""
    model, _ = fit_image(twin.sensors["left"], (-50.0, 1850.0), FitOptions())
    sensor = RpcSensor(model)
    found = read_orientation(folder(tmp_path, {"line_0": 2.0, "sample_0": -3.0}), sensor, "one").correction
    ground = sensor.centre_m[None]
    moved = np.subtract(sensor.project(ground, found), sensor.project(ground)).ravel()
    assert np.allclose(moved, [2.0, -3.0], atol=1e-9)
    with pytest.raises(InputError) as error:
        read_orientation(folder(tmp_path, {"roll_0": 1e-6}), sensor, "one")
    assert error.value.problems[0].code == "ortho.other_sensor"


def refused(path: Path, sensor: object, image: str = "") -> tuple[str, str]:
    with pytest.raises(InputError) as caught:
        read_orientation(path, sensor, image)  # type: ignore[arg-type]
    return caught.value.problems[0].code, str(caught.value)


@pytest.mark.behaviour
def test_the_image_asked_for_is_that_of_the_metadata(twin: Twin, tmp_path: Path) -> None:
    """The content of the metadata file decides: another image's file is refused, a renamed copy is used."""
    left = twin.sensors["left"]
    code, text = refused(twin.result, left, "right")
    assert code == "ortho.other_image" and "image right" in text and "right.DIM" in text
    copy = tmp_path / "renamed.DIM"
    shutil.copy(twin.folder / "left.DIM", copy)
    expected = read_orientation(twin.result, left).correction
    for image in ("", "left"):
        found = read_orientation(twin.result, read_sensor(copy), image).correction
        assert np.array_equal(found.eop, expected.eop)  # type: ignore[union-attr]
    other = tmp_path / "left.DIM"
    shutil.copy(twin.folder / "right.DIM", other)
    assert refused(twin.result, read_sensor(other), "left")[0] == "ortho.other_image"
    assert np.array_equal(
        read_orientation(twin.result, read_sensor(other)).correction.eop,
        read_orientation(twin.result, twin.sensors["right"]).correction.eop,  # type: ignore[union-attr]
    )
    other.write_bytes((twin.folder / "left.DIM").read_bytes().rstrip() + b"\n<!-- edited -->\n")
    assert refused(twin.result, read_sensor(other))[0] == "ortho.other_image"
    assert refused(twin.result, read_sensor(other), "third")[0] == "ortho.result"


@pytest.mark.behaviour
def test_two_images_with_files_of_one_name_are_told_apart(twin: Twin, tmp_path: Path) -> None:
    """Images whose files have one name get their own corrections by the content of the files.

    All products of a mission have the name METADATA.DIM. Without content in the record the image must be stated.
    """
    files = {}
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        files[name] = tmp_path / name / "METADATA.DIM"
        shutil.copy(twin.folder / f"{name}.DIM", files[name])
    record = json.loads((twin.result / "result.json").read_text("utf-8"))
    for entry in record["images"]:
        entry["file"] = "METADATA.DIM"
    shutil.copy(twin.result / "eop.csv", tmp_path)
    (tmp_path / "result.json").write_text(json.dumps(record), encoding="utf-8")
    for name, path in files.items():
        expected = read_orientation(twin.result, twin.sensors[name]).correction
        assert np.array_equal(read_orientation(sealed(tmp_path), read_sensor(path)).correction.eop, expected.eop)  # type: ignore[union-attr]
    record["provenance"]["inputs"] = []
    (tmp_path / "result.json").write_text(json.dumps(record), encoding="utf-8")
    code, text = refused(sealed(tmp_path), read_sensor(files["right"]))
    assert code == "ortho.which_image" and "left or right" in text
    assert read_orientation(tmp_path, read_sensor(files["right"]), "right").correction is not None


@pytest.mark.behaviour
def test_the_command_compares_the_image(twin: Twin, tmp_path: Path) -> None:
    done = run(
        "rectify", "ortho", twin.folder / "left.tif", twin.folder / "left.DIM", "--dem", twin.folder / "dem.tif",
        "--result", twin.result, "--image-id", "right", "--out", tmp_path / "map.tif",
    )  # fmt: skip
    assert done.code == 2 and "was computed from another metadata file" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.behaviour
def test_commands_warn_of_heights_that_no_land_has(twin: Twin, tmp_path: Path) -> None:
    """``rectify ortho``, ``adjust`` and ``replay`` warn of cells in the DEM whose nodata value is not declared."""
    rasterio = pytest.importorskip("rasterio")
    project, dem = tmp_path / "twin", tmp_path / "twin/spoiled.tif"
    shutil.copytree(twin.folder, project)
    shutil.copyfile(project / "dem.tif", dem)
    with rasterio.open(dem, "r+") as raster:
        heights = raster.read(1)
        heights[32::64, 32::64] = -32767.0  # some in each square of cells that a command reads
        raster.write(heights, 1)
    points = (project / "points.csv").read_text("utf-8").splitlines()
    kept = [f"{line.split(',')[0]},tie,,,,,," if line.split(",")[1:2] == ["check"] else line for line in points]
    (project / "points.csv").write_text("\n".join(kept) + "\n", "utf-8")
    result, told = tmp_path / "result", "cells have heights below"
    done = [
        run(
            "rectify",
            "ortho",
            project / "left.tif",
            project / "left.DIM",
            "--dem",
            dem,
            "--out",
            tmp_path / "map.tif",
            "--allow-holes",
        ),
        run("adjust", project / "project.toml", "--dem-control", dem, "--dem-sigma", 300, "--out", result),
        run("replay", result, "--project", project / "project.toml", "--out", tmp_path / "again"),
    ]
    for one in done:
        assert one.code == 0 and told in one.stderr + one.stdout, one.stderr
