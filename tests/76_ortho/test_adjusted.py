"""Corrections out of result folders, against the arrays of the same folder and against made-up ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fg_orient.errors import InputError
from fg_orient.parameters import N_EOP, parameter_name
from fg_orient.raster.adjusted import read_correction
from fg_orient.rpc.fitting import fit_image
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.rpc_sensor import RpcSensor

from .conftest import Twin

Array = np.ndarray


@pytest.mark.parametrize(("image", "number"), [("left", 0), ("right", 1)])
def test_eop_are_those_of_the_state(twin: Twin, image: str, number: int) -> None:
    found = read_correction(twin.result, twin.sensors[image])
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
    record = {"images": [{"id": "one", "file": "left.DIM"}], "provenance": {"options": {"small_angle": small_angle}}}
    (path / "result.json").write_text(json.dumps(record), encoding="utf-8")
    rows = ["image,parameter,value_per_tau", *(f"one,{name},{value!r}" for name, value in values.items())]
    (path / "eop.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_look_angles_and_small_angles(twin: Twin, tmp_path: Path) -> None:
    given = {"roll_1": 2e-6, "psi_x_s0": 1e-6, "psi_y_s0": 2e-6, "psi_x_s2": 3e-6, "psi_y_s2": 4e-6}
    found = read_correction(folder(tmp_path, given, small_angle=True), twin.sensors["left"])
    assert isinstance(found, Correction) and found.small_angle
    assert found.eop[6].tolist() == [0.0, 2e-6, 0.0] and np.count_nonzero(found.eop) == 1
    assert found.look.tolist() == [[1e-6, 0.0, 3e-6], [2e-6, 0.0, 4e-6]]


def test_compensation_of_an_rpc_image(twin: Twin, tmp_path: Path) -> None:
    """The compensated model moves a projected point by what the names say."""
    model, _ = fit_image(twin.sensors["left"], (-50.0, 1850.0), file="left.DIM")
    sensor = RpcSensor(model)
    found = read_correction(folder(tmp_path, {"line_0": 2.0, "sample_0": -3.0}), sensor, "one")
    ground = sensor.centre_m[None]
    moved = np.subtract(sensor.project(ground, found), sensor.project(ground)).ravel()
    assert np.allclose(moved, [2.0, -3.0], atol=1e-9)
    with pytest.raises(InputError) as error:
        read_correction(folder(tmp_path, {"roll_0": 1e-6}), sensor, "one")
    assert error.value.problems[0].code == "ortho.other_sensor"
