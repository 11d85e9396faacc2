"""The result folder is complete and can be recomputed; it is written whole or not at all."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest

import fg_orient.orientation.run as runs
from fg_orient.formats.atomic import staged_folder
from fg_orient.model.errors import InputError
from fg_orient.result.record import Result

FILES = {"result.json", "eop.csv", "points.csv", "residuals.csv", "accuracy.csv", "iterations.jsonl", "arrays.npz",
         "covariance.npz", "manifest.json", "report.html"}  # fmt: skip


def rows(path: Path) -> list[dict[str, str]]:
    """Return the records of a CSV file; comment lines left out."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def record(folder: Path) -> dict[str, Any]:
    """Read ``result.json``."""
    return dict(json.loads((folder / "result.json").read_text("utf-8")))


@pytest.mark.behaviour
def test_complete(adjusted: tuple[Path, Any]) -> None:
    assert {p.name for p in adjusted[0].iterdir()} == FILES
    assert [p.name for p in adjusted[0].parent.iterdir()] == ["result"]


@pytest.mark.behaviour
def test_record_equals_what_was_printed(adjusted: tuple[Path, Any]) -> None:
    out, ended = adjusted
    assert {**record(out), "out": str(out)} == ended.json


@pytest.mark.oracle
def test_statistics_follow_from_tables_and_input(adjusted: tuple[Path, Any], twin_source: Path) -> None:
    """RMSE, sigma0 and redundancy of the record follow from the tables and the input within 1e-9."""
    out, ended = adjusted
    points, residuals, eop = (rows(out / f"{name}.csv") for name in ("points", "residuals", "eop"))
    given = {row["id"]: row for row in rows(twin_source / "points.csv")}
    chi2 = sum((float(r[f"v_{a}_px"]) / float(r[f"sigma_{a}_px"])) ** 2 for r in residuals for a in ("line", "sample"))
    chi2 += sum((float(r["value_per_tau"]) / float(r["prior_sigma"])) ** 2 for r in eop)
    axes = ("east", "north", "up")
    control = [p for p in points if p["role"] == "control"]
    chi2 += sum(
        (float(p[f"difference_{a}_m"]) / float(given[p["id"]][f"sigma_{a}_m"])) ** 2 for p in control for a in axes
    )
    n = 2 * len(residuals) + 3 * len(control) + len(eop)
    redundancy = n - len(eop) - 3 * len(points)
    assert redundancy == ended.json["redundancy"]
    # differences of ECEF coordinates carry 1e-9 m of rounding, 2e-8 of a sigma of 0.06 m, against chi2 = 139
    assert math.sqrt(chi2 / redundancy) == pytest.approx(ended.json["sigma0"], rel=1e-9)
    for role in ("control", "check"):
        some = [p for p in points if p["role"] == role]
        for key, column in [*((a, a) for a in axes), *((f"ecef_{a}", a) for a in "xyz")]:
            values = np.array([float(p[f"difference_{column}_m"]) for p in some])
            rmse = ended.json["accuracy"][role][f"rmse_{key}_m"]
            assert math.sqrt(float(np.mean(values**2))) == pytest.approx(rmse, rel=1e-9)


@pytest.mark.oracle
def test_differences_are_adjusted_minus_measured(adjusted: tuple[Path, Any], twin_source: Path) -> None:
    """The differences of points are adjusted minus measured coordinates, converted by PROJ, within 5e-9 m."""
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    given = {row["id"]: row for row in rows(twin_source / "points.csv")}
    for p in rows(adjusted[0] / "points.csv"):
        measured = to_ecef.transform(*(float(given[p["id"]][k]) for k in ("lon_deg", "lat_deg", "height_m")))
        difference = np.array([float(p[f"{a}_m"]) for a in "xyz"]) - measured
        stated = np.array([float(p[f"difference_{a}_m"]) for a in "xyz"])
        assert np.abs(difference - stated).max() < 5e-9  # rounding of coordinates of 6e6 m


@pytest.mark.consistency
def test_arrays_need_no_pickle_and_agree_with_the_tables(adjusted: tuple[Path, Any]) -> None:
    out, ended = adjusted
    with np.load(out / "arrays.npz", allow_pickle=False) as arrays:
        cofactors, covariance = arrays["image_cofactors"], arrays["image_covariance"]
        values = (arrays["state_image"] * arrays["prior_sigma"]).ravel()
        names = list(arrays["parameter_names"])
    eop = rows(out / "eop.csv")
    assert [row["parameter"] for row in eop] == names * 2
    assert np.array([float(row["value_per_tau"]) for row in eop]) == pytest.approx(values, rel=1e-15, abs=0.0)
    assert covariance == pytest.approx(cofactors * ended.json["sigma0"] ** 2, rel=1e-12, abs=0.0)
    sigma = np.sqrt(np.einsum("mkk->mk", covariance)).ravel()
    assert np.array([float(row["sigma"]) for row in eop]) == pytest.approx(sigma, rel=1e-12, abs=0.0)
    assert {row["sigma_scale"] for row in eop} == {"posterior"}


@pytest.mark.oracle
def test_per_line_coefficients(adjusted: tuple[Path, Any]) -> None:
    """Per-line values and sigmas of EOP coefficients are c_k / c^k with c = (12000 - 1)/2."""
    for row in rows(adjusted[0] / "eop.csv"):
        power = 5999.5 ** int(row["degree"])
        assert float(row["per_line_value"]) == pytest.approx(float(row["value_per_tau"]) / power, rel=1e-14, abs=0.0)
        assert float(row["per_line_sigma"]) == pytest.approx(float(row["sigma"]) / power, rel=1e-14, abs=0.0)
        assert row["per_line_unit"] == row["unit"] + ("", "/line", "/line^2")[int(row["degree"])]


@pytest.mark.behaviour
def test_iterations_are_logged_as_they_come(adjusted: tuple[Path, Any]) -> None:
    out, ended = adjusted
    lines = [json.loads(line) for line in (out / "iterations.jsonl").read_text("utf-8").splitlines()]
    assert [line["iteration"] for line in lines] == list(range(1, ended.json["iterations"] + 1))
    assert lines[-1]["chi2_after"] == pytest.approx(ended.json["chi2"], rel=1e-9)
    assert lines[-1]["ratio"] is None  # there the predicted decrease is a rounding error


@pytest.mark.behaviour
def test_accuracy_table(adjusted: tuple[Path, Any]) -> None:
    out, ended = adjusted
    for row in rows(out / "accuracy.csv"):
        assert float(row["value"]) == ended.json["accuracy"][row["role"]][row["quantity"]]


@pytest.mark.behaviour
def test_provenance_names_inputs_without_folders(adjusted: tuple[Path, Any], twin_source: Path) -> None:
    import hashlib

    out, _ = adjusted
    found = record(out)["provenance"]
    names = ["project.toml", "left.DIM", "right.DIM", "points.csv", "observations.csv"]
    assert [entry["file"] for entry in found["inputs"]] == names
    for entry in found["inputs"]:
        assert entry["sha256"] == hashlib.sha256((twin_source / entry["file"]).read_bytes()).hexdigest()
    assert {"python", "fg_orient", "gtsam", "numpy", "scipy", "numba"} <= set(found["versions"])
    for name in FILES - {"arrays.npz", "covariance.npz"}:
        assert str(twin_source.parent) not in (out / name).read_text("utf-8"), name


@pytest.mark.behaviour
def test_moving_check_coordinates_changes_no_estimate(run: Any, twin: Path, adjusted: tuple[Path, Any]) -> None:
    """Check points moved by 1 km change their differences and the exit code, but no estimate.

    They are moved to the north, by 0.009 degrees of latitude.
    """
    path = twin.parent / "points.csv"
    lines = path.read_text("utf-8").splitlines()
    for k, line in enumerate(lines):
        cells = line.split(",")
        if len(cells) > 3 and cells[1] == "check":
            cells[3] = repr(float(cells[3]) + 0.009)
            lines[k] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    ended = run("adjust", twin, "--json")
    assert ended.code == 4 and "check points contradict" in ended.json["reason"]
    moved, before = twin.parent / "result", adjusted[0]
    assert ended.json["accuracy"]["check"]["mean_north_m"] == pytest.approx(-1000.0, abs=5.0)
    assert ended.json["sigma0"] == record(before)["sigma0"]
    for name in ("eop.csv", "residuals.csv"):
        assert (moved / name).read_text("utf-8") == (before / name).read_text("utf-8")
    columns = [f"{a}_m" for a in "xyz"] + [f"sigma_{a}_m" for a in ("east", "north", "up")]
    for old, new in zip(rows(before / "points.csv"), rows(moved / "points.csv"), strict=True):
        # predicted sigmas of check points are turned by the axes of the measured place: 1 km turns them by 1.6e-4
        exact = columns[:3] if old["role"] == "check" else columns
        assert [old[c] for c in exact] == [new[c] for c in exact]


@pytest.mark.behaviour
def test_deleting_the_truth_changes_nothing(run: Any, twin: Path, adjusted: tuple[Path, Any]) -> None:
    import shutil

    shutil.rmtree(twin.parent / "truth")
    assert run("adjust", twin, "--quiet").code == 0
    for name in ("eop.csv", "points.csv", "residuals.csv"):
        assert (twin.parent / "result" / name).read_bytes() == (adjusted[0] / name).read_bytes()


# --- whole or not at all -------------------------------------------------------------------------


def content(folder: Path) -> dict[str, bytes]:
    """Return the bytes of every file in a folder and below."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.behaviour
def test_existing_folder_is_refused_before_anything_is_read(run: Any, result: Path, tmp_path: Path) -> None:
    before = content(tmp_path)
    (tmp_path / "broken.toml").write_text("not a project", encoding="utf-8")
    ended = run("adjust", tmp_path / "broken.toml", "--out", result, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "output.exists")
    (tmp_path / "broken.toml").unlink()
    assert content(tmp_path) == before


@pytest.mark.behaviour
def test_overwrite_replaces_a_result(run: Any, twin: Path) -> None:
    folder = twin.parent / "result"
    assert run("adjust", twin, "--quiet").code == 0
    (folder / "report.html").write_text("of an earlier run", encoding="utf-8")
    assert run("adjust", twin, "--quiet", "--overwrite", "--eop-set", 10).code == 0
    assert "of an earlier run" not in (folder / "report.html").read_text("utf-8")
    assert {p.name for p in folder.iterdir()} == FILES
    assert record(folder)["eop_set"] == 10
    assert [p.name for p in twin.parent.iterdir() if p.name.startswith(".")] == []


@pytest.mark.behaviour
def test_overwrite_spares_a_folder_that_is_no_result(run: Any, twin: Path) -> None:
    """``--out --overwrite`` with the folder of the project is refused, and the folder does not change."""
    before = content(twin.parent)
    ended = run("adjust", twin, "--out", twin.parent, "--overwrite", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "output.foreign")
    assert content(twin.parent) == before


@pytest.mark.behaviour
@pytest.mark.parametrize("foreign", ["notes.txt", "points.csv/mine.txt", "copy/result.json"])
def test_overwrite_spares_foreign_files_in_a_result(run: Any, twin: Path, result: Path, foreign: str) -> None:
    if foreign.startswith("points.csv"):
        (result / "points.csv").unlink()
    (result / foreign).parent.mkdir(exist_ok=True)
    (result / foreign).write_text("mine", encoding="utf-8")
    before = content(result)
    ended = run("adjust", twin, "--out", result, "--overwrite", "--json")
    (error,) = ended.json["errors"]
    assert (ended.code, error["code"]) == (2, "output.foreign")
    assert error["value"] in (foreign, foreign.split("/")[0]), "the first foreign entry is named"
    assert content(result) == before


@pytest.mark.behaviour
def test_file_or_link_is_no_output_folder(run: Any, twin: Path, result: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(result, target_is_directory=True)
    file = tmp_path / "file"
    file.touch()
    for out, code in ((twin, "output.is_input"), (file, "output.not_a_folder"), (link, "output.not_a_folder")):
        ended = run("adjust", twin, "--out", out, "--overwrite", "--json")
        assert (ended.code, ended.json["errors"][0]["code"]) == (2, code)


@pytest.mark.behaviour
@pytest.mark.parametrize("existing", [False, True])
def test_interrupted_run_leaves_nothing(run: Any, twin: Path, monkeypatch: pytest.MonkeyPatch, existing: bool) -> None:
    """Ctrl-C in the first iteration gives exit code 130 and leaves earlier results as they were, without new files."""
    if existing:
        assert run("adjust", twin, "--quiet").code == 0
    before = content(twin.parent)
    adjust = runs.adjust

    def interrupted(block: Any, callback: Any, **how: Any) -> Any:
        def stop(iteration: Any) -> None:
            callback(iteration)
            raise KeyboardInterrupt

        return adjust(block, callback=stop, **how)

    monkeypatch.setattr(runs, "adjust", interrupted)
    ended = run("adjust", twin, "--overwrite", "--out", twin.parent / "result", "--json")
    assert (ended.code, ended.stdout) == (130, "")
    assert "interrupted" in ended.stderr
    assert content(twin.parent) == before
    assert [p.name for p in twin.parent.iterdir() if p.name.startswith(".")] == []


@pytest.mark.behaviour
def test_failure_of_the_program_is_short_and_leaves_nothing(
    run: Any, twin: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(Result, "write", fail)
    ended = run("adjust", twin, "--out", twin.parent / "a" / "b")
    assert (ended.code, ended.stdout) == (1, "")
    assert len(ended.stderr.splitlines()) == 1
    assert "ZeroDivisionError: planted" in ended.stderr
    assert not (twin.parent / "a").exists()
    assert "Traceback" in run("adjust", twin, "--debug").stderr
    told = run("adjust", twin, "--json")
    (error,) = told.json["errors"]
    assert (told.code, error["code"], set(error)) == (
        1,
        "internal",
        {*"code severity message file place value remedy data".split()},
    )
    assert "ZeroDivisionError: planted" in error["message"] and "report" in error["remedy"]
    assert len(told.stderr.splitlines()) == 1


@pytest.mark.behaviour
def test_staged_folder_appears_whole_with_its_parents(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "a" / "b") as folder:
        (folder / "result.json").write_text("{}", encoding="utf-8")
        assert not (tmp_path / "a" / "b").exists()
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b"]


@pytest.mark.behaviour
def test_staged_folder_yields_to_somebody_faster_and_needs_a_place(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught, staged_folder(tmp_path / "out"):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "theirs").write_text("", encoding="utf-8")
    assert caught.value.problems[0].code == "output.exists"
    assert content(tmp_path) == {"out/theirs": b""}
    with pytest.raises(InputError) as caught, staged_folder(tmp_path / "out" / "theirs" / "out"):
        pass
    assert caught.value.problems[0].code == "output.unwritable"


@pytest.mark.behaviour
def test_error_of_the_computation_is_not_blamed_on_the_folder(tmp_path: Path) -> None:
    """An OSError of the computation passes unchanged, and the folder in work is removed.

    An example is a missing raster.
    """
    with pytest.raises(FileNotFoundError), staged_folder(tmp_path / "out"):
        raise FileNotFoundError("planted")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.behaviour
@pytest.mark.parametrize("step", ["write", "adjust"])
def test_only_writing_makes_an_unwritable_output(
    run: Any, twin: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Result if step == "write" else runs, step, fail)
    ended = run("adjust", twin, "--json")
    (error,) = ended.json["errors"]
    expected = (2, "output.unwritable") if step == "write" else (1, "internal")
    assert (ended.code, error["code"]) == expected
    assert "No space left" in error["value"] + error["message"]
    assert not (twin.parent / "result").exists()


@pytest.mark.behaviour
def test_documented_columns_are_those_written(adjusted: tuple[Path, Any], repository: Path) -> None:
    text = (repository / "docs" / "results.md").read_text("utf-8")
    for name in ("eop.csv", "points.csv", "residuals.csv", "accuracy.csv"):
        for column in rows(adjusted[0] / name)[0]:
            assert f"`{column}`" in text, (name, column)
    for key in adjusted[1].json:
        if key not in ("schema", "name", "chi2", "look_polynomial", "priors", "check_points", "notes", "provenance"):
            assert f"`{key}`" in text or key in ("images", "observability"), key
