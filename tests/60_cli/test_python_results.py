"""In Python the record of a solution, its folder and its tables are the same."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import fg_orient as fg
from fg_orient.report import write_report


def rows(path: Path) -> list[dict[str, str]]:
    """Return the records of a CSV file."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def solution(twin_source: Path) -> fg.Solution:
    """Return the adjusted twin."""
    return fg.adjust(fg.read_project(twin_source / "project.toml"))


@pytest.fixture(scope="module")
def saved(solution: fg.Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of it; not to be changed."""
    folder = tmp_path_factory.mktemp("saved") / "result"
    solution.save(folder)
    return folder


@pytest.mark.consistency
def test_page_of_the_folder_is_the_page_of_the_record(saved: Path) -> None:
    made = (saved / "report.html").read_bytes()
    write_report(saved)
    assert (saved / "report.html").read_bytes() == made


@pytest.mark.consistency
def test_saved_folder_reads_back_and_writes_the_same_bytes(solution: fg.Solution, saved: Path, tmp_path: Path) -> None:
    result = fg.read_result(saved)
    result.write(tmp_path)
    files = {p.name for p in saved.iterdir()} - {"report.html", "arrays.npz", "covariance.npz", "manifest.json"}
    assert files == {"result.json", "points.csv", "residuals.csv", "eop.csv", "accuracy.csv", "iterations.jsonl"}
    for name in files:
        assert (tmp_path / name).read_bytes() == (saved / name).read_bytes(), name
    np.testing.assert_array_equal(result.arrays["ground_m"], solution.ground_m)
    assert result.joint is not None
    assert solution.result.joint is not None
    np.testing.assert_array_equal(result.joint.cofactors, solution.result.joint.cofactors)
    np.testing.assert_array_equal(result.points.numbers("x_m", "y_m", "z_m"), solution.ground_m)


@pytest.mark.consistency
def test_saved_solution_has_the_tables_of_the_command(saved: Path, adjusted: tuple[Path, Any]) -> None:
    for name in ("points.csv", "residuals.csv", "eop.csv", "accuracy.csv"):
        assert (saved / name).read_bytes() == (adjusted[0] / name).read_bytes(), name
    logs = [(folder / "iterations.jsonl").read_text("utf-8").splitlines() for folder in (saved, adjusted[0])]
    mine, other = ([json.loads(line) | {"seconds": None} for line in log] for log in logs)
    assert mine == other != []
    mine, other = (json.loads((folder / "result.json").read_text("utf-8")) for folder in (saved, adjusted[0]))
    assert mine.keys() == other.keys()
    assert mine["provenance"]["inputs"] == other["provenance"]["inputs"]


@pytest.mark.behaviour
def test_an_existing_folder_is_replaced_on_demand_only(solution: fg.Solution, tmp_path: Path) -> None:
    solution.save(tmp_path / "out")
    with pytest.raises(fg.InputError, match="exists"):
        solution.save(tmp_path / "out")
    assert solution.save(tmp_path / "out", overwrite=True).record["out"] == "out"


@pytest.mark.consistency
def test_frames_are_the_tables(solution: fg.Solution, saved: Path) -> None:
    result = fg.read_result(saved)
    for mine, name in (("points", "points"), ("residuals", "residuals"), ("unknowns", "eop"), ("accuracy", "accuracy")):
        frame = solution.to_frame(mine)
        written = rows(saved / f"{name}.csv")
        assert list(frame.columns) == list(written[0]) and len(frame) == len(written)
        for column, values in frame.items():
            cells = [row[str(column)] for row in written]
            if values.dtype.kind in "fi":
                np.testing.assert_array_equal(values, [float(cell or "nan") for cell in cells])
            else:
                assert values.to_list() == cells
        pandas.testing.assert_frame_equal(frame, result.to_frame(mine), check_exact=True, check_dtype=False)
    assert len(solution.to_frame("iterations")) == solution.iterations


@pytest.mark.consistency
def test_frame_of_covariances_holds_those_asked_for_by_name(solution: fg.Solution) -> None:
    frame = solution.to_frame("covariances")
    named = solution.covariance("image:left")
    assert [name.rpartition(".")[2] for name in named.names] == list(frame.loc["left"].index)
    np.testing.assert_allclose(frame.loc["left"].to_numpy(), named.values, rtol=1e-12)
    joint = solution.covariance("image:left.roll_0", "point:01").to_frame()
    assert list(joint.index) == list(joint.columns) == list(solution.covariance("image:left.roll_0", "point:01").names)


@pytest.mark.behaviour
def test_unknown_table_is_refused(solution: fg.Solution) -> None:
    with pytest.raises(fg.InputError, match="points"):
        solution.to_frame("nothing")


@pytest.mark.behaviour
def test_points_as_geojson(solution: fg.Solution) -> None:
    collection = json.loads(json.dumps(solution.to_geo(), allow_nan=False))
    table = solution.result.points
    assert collection["type"] == "FeatureCollection" and len(collection["features"]) == len(table)
    first = collection["features"][0]
    assert first["geometry"]["coordinates"] == table.numbers("lon_deg", "lat_deg")[0].tolist()
    assert first["properties"]["id"] == table.words["id"][0]


@pytest.mark.behaviour
def test_objects_are_short_in_words(solution: fg.Solution, saved: Path) -> None:
    result = fg.read_result(saved)
    for one in (solution, result, result.points, solution.block, solution.covariance("image:left")):
        assert len(repr(one)) < 300 and repr(one).startswith("<"), repr(one)[:300]
    for one in (solution, result):
        assert "converged" in repr(one) and "<table>" in one._repr_html_()
