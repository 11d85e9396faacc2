"""A project with RPC images is read, adjusted, written, reported and compared with its truth."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.rpc import read_rpc
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.model.block import Image
from fg_orient.model.names import Role
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.rpc_block import TERMS, RpcTwin, rpc_twin, twin_with_models, write_folder
from tests.support.rpc_model import reference_project

Run = Callable[..., Any]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def drifting(tmp_path_factory: pytest.TempPathFactory, run: Run) -> tuple[RpcTwin, Path, Any]:
    """Return the twin with shift and drift along the lines only (no mixed term), project and how adjust ended."""
    twin = rpc_twin("shift_drift", seed=4)
    project = write_folder(tmp_path_factory.mktemp("rpc") / "twin", twin)
    return twin, project, run("adjust", project, "--json")


@pytest.mark.consistency
def test_files_give_the_solution_of_the_block_in_memory(drifting: tuple[RpcTwin, Path, Any]) -> None:
    """A project with RPC files and options has the solution of the block in memory within 1e-7."""
    twin, project, ended = drifting
    assert ended.code == 0, ended.stderr
    record = ended.json
    assert (record["rpc_compensation"], record["datum"], record["status"]) == ("shift_drift", "control", "converged")
    solution = fg.adjust(fg.read_project(project))
    base = fg.adjust(twin.block)
    # the table of points has degrees: 1e-8 m
    assert np.abs(solution.state.image - base.state.image).max() < 1e-7
    assert [(i["model"], i["format"]) for i in _result(project)["images"]] == [("RPC", "_RPC.TXT")] * 2


def _result(project: Path) -> Any:
    return json.loads((project.parent / "result" / "result.json").read_text("utf-8"))


@pytest.mark.oracle
def test_table_of_compensation(drifting: tuple[RpcTwin, Path, Any]) -> None:
    """The table of EOPs has the compensation in pixels and per line, near the truth, and chi2 follows from it."""
    twin, project, ended = drifting
    out = project.parent / "result"
    rows = table(out / "eop.csv")
    assert [row["parameter"] for row in rows] == [*TERMS[:4]] * 2
    assert {row["unit"] for row in rows} == {"px"}
    assert [row["degree"] for row in rows[:4]] == ["0", "0", "1", "1"]
    scale = twin.block.images[0].sensor.model.scales[0]
    assert float(rows[2]["per_line_value"]) == pytest.approx(
        float(rows[2]["value_per_tau"]) / scale, rel=1e-12, abs=0.0
    )
    assert (rows[2]["per_line_unit"], rows[0]["per_line_unit"]) == ("px/line", "px")
    for k, row in enumerate(rows):
        true = twin.compensation[k // 4, k % 4]
        assert abs(float(row["value_per_tau"]) - true) < 4.0 * float(row["sigma"])
    chi2 = sum((float(row["value_per_tau"]) / float(row["prior_sigma"])) ** 2 for row in rows)
    for row in table(out / "residuals.csv"):
        chi2 += sum((float(row[f"v_{a}_px"]) / float(row[f"sigma_{a}_px"])) ** 2 for a in ("line", "sample"))
    for row in table(out / "points.csv"):
        if row["role"] == "control":
            chi2 += sum((float(row[f"difference_{a}_m"]) / float(row[f"own_sigma_{a}_m"])) ** 2
                        for a in ("east", "north", "up"))  # fmt: skip
    assert chi2 == pytest.approx(ended.json["chi2"], rel=1e-6)


@pytest.mark.oracle
def test_corrected_rpc_are_written(tmp_path: Path, run: Run) -> None:
    """``adjust`` writes corrected RPC that project with the shift; for affine terms a note states the fit."""
    project = write_folder(tmp_path / "twin", rpc_twin("shift"))
    out = tmp_path / "result"
    assert run("adjust", project, "--out", out, "--quiet").code == 0
    solution = fg.adjust(fg.read_project(project))
    assert sorted(p.name for p in (out / "rpc").iterdir()) == ["left_RPC.TXT", "right_RPC.TXT"]
    for image in solution.block.images:
        model = image.sensor.model
        u = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 200))
        ground = model.offsets[2:, None] + model.scales[2:, None] * u
        found = reference_project(read_rpc(out / "rpc" / f"{image.id}_RPC.TXT"), *ground)
        shift = np.asarray(solution.correction(image.id))[:2, None]
        assert np.abs(np.array(found, float) - np.array(reference_project(model, *ground), float) - shift).max() < 1e-9
    again = run("adjust", project, "--out", out, "--overwrite", "--rpc-compensation", "affine", "--json")
    assert again.code == 0, again.stderr  # the files are ours: the folder may be replaced
    assert len(list((out / "rpc").iterdir())) == 2
    assert sum("the corrected RPC is fitted" in note for note in again.json["notes"]) == 2


@pytest.mark.consistency
def test_run_of_rpc_images_comes_out_again(drifting: tuple[RpcTwin, Path, Any], run: Run, tmp_path: Path) -> None:
    """``replay`` repeats a run of RPC images with its options, and compares the corrected RPC."""
    ended = run("replay", drifting[1].parent / "result", "--out", tmp_path / "again", "--json")
    assert (ended.code, ended.json["equal"], ended.json["differences"]) == (0, True, [])
    assert [name for name in ended.json["tables"] if name.startswith("rpc/")] == [
        "rpc/left_RPC.TXT",
        "rpc/right_RPC.TXT",
    ]


@pytest.mark.behaviour
def test_report_speaks_of_rpc(drifting: tuple[RpcTwin, Path, Any], run: Run) -> None:
    """The report of RPC images has the compensation, the truth, and no EOP set or metadata orientation."""
    _, project, _ = drifting
    out = project.parent / "result"
    ended = run("report", out, "--truth", project.parent / "truth", "--json")
    assert ended.code == 0, ended.stdout
    html = (out / "report.html").read_text("utf-8")
    assert "RPC compensation: shift and drift" in html
    assert "EOP set" not in html
    assert "Orientation of the metadata" not in html
    assert "Comparison with the simulated truth" in html
    assert "line_l1" in html


@pytest.mark.behaviour
def test_people_are_told_what_was_adjusted(tmp_path: Path, run: Run) -> None:
    project = write_folder(tmp_path / "twin", rpc_twin("shift"))
    text = run("adjust", project).stdout
    assert "RPC compensation: shift" in text
    assert "EOP set" not in text


@pytest.mark.oracle
def test_gross_errors_are_listed(tmp_path: Path, run: Run) -> None:
    """A point with an error of 10 px in one image is first in the list of the record, and in the report."""
    twin = rpc_twin("shift")
    block, o = twin.block, twin.block.observations
    j = int(block.points.where(Role.CONTROL)[8])
    wrong = replace(o, line=o.line + 10.0 * ((o.point == j) & (o.image == 1)))
    project = write_folder(tmp_path / "twin", replace(twin, block=replace(block, observations=wrong)))
    record = run("adjust", project, "--json").json
    worst = record["suspicious_observations"][0]
    assert (worst["image"], worst["id"], worst["part"]) == ("right", block.points.ids[j], "image")
    assert worst["error"] == pytest.approx([10.0, 0.0], abs=1.5)
    assert worst["statistic"] > worst["limit"]
    html = (project.parent / "result" / "report.html").read_text("utf-8")
    assert "Observations to look at" in html
    assert f"point {block.points.ids[j]} in image right" in html


@pytest.mark.behaviour
def test_relative_adjustment_from_the_command_line(tmp_path: Path, run: Run) -> None:
    """Without control points ``adjust`` needs ``--datum priors``, and then states y-parallaxes and no accuracy."""
    project = write_folder(tmp_path / "twin", rpc_twin("shift", seed=5), control=False)
    refused = run("adjust", project, "--json")
    assert (refused.code, refused.json["errors"][0]["code"]) == (2, "block.no_control")
    ended = run("adjust", project, "--datum", "priors", "--json")
    assert ended.code == 0, ended.stdout
    record = ended.json
    assert record["accuracy"]["check"]["n"] == record["accuracy"]["control"]["n"] == 0
    assert sum("shifted together" in text for text in record["unobservable"]) == 3
    parallax = record["y_parallax"]
    assert parallax["n"] == 47
    assert parallax["rms_after_px"] < 0.6 < 3.0 < parallax["rms_before_px"]
    html = (project.parent / "result" / "report.html").read_text("utf-8")
    assert "y-parallax" in html
    assert "but not whether their positions are right" in html
    told = run("adjust", project, "--datum", "priors", "--overwrite").stdout
    assert "y-parallax of 47 tie points" in told
    wrong = run("adjust", project, "--datum", "nowhere", "--json", "--overwrite")
    assert (wrong.code, wrong.json["errors"][0]["place"]) == (2, "--datum")
    wrong = run("adjust", project, "--rpc-compensation", "bias", "--json", "--overwrite")
    assert (wrong.code, wrong.json["errors"][0]["place"]) == (2, "--rpc-compensation")


@pytest.mark.behaviour
def test_points_outside_the_validity_are_named(tmp_path: Path) -> None:
    """Points above the valid heights of an RPC give a warning with their number, and the adjustment still runs."""
    _, _, models = twin_with_models()
    twin = rpc_twin("shift")
    low = replace(models[0], stated_validity=models[0].validity._replace(height_m=(-200.0, 300.0)))
    images = (Image("left", RpcSensor(low)), twin.block.images[1])
    solution = fg.adjust(replace(twin.block, images=images))
    height = ecef_to_geodetic(solution.ground_m)[2]
    told = [text for text in solution.warnings if "the validity range of the model of image left" in text]
    assert f"{(height > 300.0).sum()} points lie outside" in told[0]
    assert not [text for text in fg.adjust(twin.block).warnings if "validity" in text]
