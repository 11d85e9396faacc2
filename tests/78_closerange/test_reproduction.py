"""Ayhan 1996 is compared with results from its measurements, section by section."""

from __future__ import annotations

import csv
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fg_orient.closerange.fitting import compare_points
from fg_orient.closerange.surface_fit import fit_surface
from fg_orient.model.names import CellKey
from fg_orient.studies.published import tables as published
from fg_orient.studies.published.tables import load
from fg_orient.studies.reproduce import ayhan1996_photos as thesis
from fg_orient.studies.reproduce.reproduction import Reproduction, reproduce
from tests.support.command import in_process as run

from .conftest import Array

Values = dict[CellKey, float]
TABLES = (
    "1", "2", "3", "4", "ek1.comparator", "ek1.cameras", "ek1.bundle", "ek1.refined", "ek1.points", "ek2.dlt",
    "ek2.control", "ek2.points", *map(str, range(5, 21)), "ek3.surfaces", "ek3.points", "text",
)  # fmt: skip


def differing(reproduction: Reproduction) -> dict[str, list[str]]:
    """Return the cells that differ, by table."""
    out: dict[str, list[str]] = {}
    for row in reproduction.rows:
        if row.verdict == "differs":
            out.setdefault(row.table, []).append(row.cell)
    return out


@pytest.mark.behaviour
def test_every_table_is_there_with_a_reason(reproduction: Reproduction) -> None:
    assert tuple(reproduction.titles) == TABLES
    assert len(reproduction.rows) == 3138
    assert all(row.reason for row in reproduction.rows)


@pytest.mark.truth
def test_verdicts(reproduction: Reproduction) -> None:
    """The verdicts on Ayhan 1996 have the stated counts. If a count changes, docs/closerange.md must change too."""
    counts = reproduction.counts()
    assert {kind: counts[kind] for kind in counts if counts[kind]} == {
        "equal": 323, "rounding": 303, "unit": 20, "spread": 416, "sigma": 148, "fitted": 148, "differs": 55,
        "not_reproducible": 1725,
    }  # fmt: skip


@pytest.mark.truth
def test_what_differs_is_known(reproduction: Reproduction) -> None:
    found = differing(reproduction)
    assert found["ek1.bundle"] == ["m0, adjustment"]
    assert set(found) == {"1", "ek1.comparator", "ek1.bundle", "ek1.refined", "ek1.points", "ek2.dlt", "ek2.points",
                          "5", "13", "ek3.points", "text"}  # fmt: skip
    assert found["1"] == [f"diameter_in_text_m, ring {k}" for k in (1, 4, 6)]
    assert found["ek1.comparator"] == ["z2_mm, point 39"]
    assert found["ek1.refined"] == ["zs2_mm, point 39"]
    assert set(found["ek2.dlt"]) == {"L4, photo 1", "L8, photo 1", "L4, photo 2", "L8, photo 2", "kappa_gon, photo 2"}
    assert Counter(cell.partition(", ")[2] for cell in found["5"]) == {"collinearity 15": 1, "dlt 15": 3, "parallax": 3}
    assert found["13"] == ["da_cm, case 1"]
    assert found["text"] == ["sphere, deviation of field points"]


@pytest.mark.truth
def test_geodesy_recomputes_to_print(values: Values, reproduction: Reproduction) -> None:
    """The 196 geodetic values of tables 3 and 4 are recomputed within 0.056 mm of print."""
    rows = [row for row in reproduction.rows if row.table in "34" and row.verdict in ("equal", "unit")]
    assert len(rows) == 196
    assert max(abs(row.published - row.reproduced) for row in rows) <= 0.056e-3


@pytest.mark.truth
def test_rings(reproduction: Reproduction) -> None:
    off = {
        table: max(abs(row.published - row.reproduced) for row in reproduction.rows
                   if row.table == table and row.cell.startswith("distance"))
        for table in ("1", "2")
    }  # fmt: skip
    assert (1e3 * off["1"], 1e3 * off["2"]) == pytest.approx((0.86, 0.36), abs=0.006)


@pytest.mark.truth
def test_land_spheroid_to_four_decimals(land: Array) -> None:
    fit = fit_surface(land, "spheroid", method="algebraic").parameters
    printed = {"a": 0.9418, "b": 0.8437, "x0": 999.9917, "y0": 1005.5012, "z0": 2.3622}
    assert max(abs(fit[name] - value) for name, value in printed.items()) <= 0.5e-4


@pytest.mark.truth
def test_table_3_has_another_depth_than_appendix_1(values: Values) -> None:
    """Table 3 gives b = 0.84426 and Y0 = 1005.50077, unlike appendix 1 (0.8437, 1005.5012); other values agree."""
    fit = fit_surface(thesis.points_of(values, "3", ("x_m", "y_m", "z_m")), "spheroid", method="algebraic").parameters
    expected = {"a": 0.9418, "b": 0.84426, "x0": 999.9917, "y0": 1005.50077, "z0": 2.3622}
    assert fit == pytest.approx(expected, abs=0.5e-4)
    assert (fit["b"], fit["y0"]) == pytest.approx((0.84426, 1005.50077), abs=0.6e-5)


@pytest.mark.truth
def test_sums_follow_from_the_printed_differences(values: Values) -> None:
    """The printed sums 0.3924/2.0093/0.4857 follow from the printed differences within 1.5e-4.

    The differences are rounded to 1 um.
    """
    found = np.sum(thesis.points_of(values, "ek1.points", ("dx_cm", "dy_cm", "dz_cm")) ** 2, axis=0)
    printed = [values[CellKey("text", quantity=q, parameter="sums")] for q in ("fxfx", "fyfy", "fzfz")]
    assert np.abs(found - printed).max() <= 1.5e-4


@pytest.mark.truth
def test_refined_coordinates_come_back(values: Values) -> None:
    """59 of 60 refined coordinates are recomputed within 0.01 um if the P2 term is doubled, as printed."""
    printed = thesis.points_of(values, "ek1.refined", thesis.REFINED, thesis.CONTROL)
    cells = thesis.refined_cells(values)
    found = np.array([
        [cells[CellKey("ek1.refined", quantity=q, parameter=f"point {k}")].value for q in thesis.REFINED]
        for k in thesis.CONTROL
    ])  # fmt: skip
    off = np.sort(1e3 * np.abs(found - printed).ravel())
    assert off[-2] <= 0.0105  # um
    assert off[-1] == pytest.approx(2.0, abs=0.02)
    raw = thesis.points_of(values, "ek1.comparator", thesis.COMPARATOR, thesis.CONTROL)
    camera = thesis.interior(values, "photo 1")
    single = camera.tangents(raw[:, :2]) * camera.focal * [1.0, -1.0]
    assert 1e3 * np.abs(single - printed[:, :2]).max() > 0.1


@pytest.mark.truth
def test_recovered_comparator_coordinates_lie_on_the_grid(values: Values) -> None:
    """Recovered comparator coordinates give the refined ones within 0.0085 um.

    By chance the mean distance from whole micrometres would be 0.25 um.
    """
    refined = thesis.points_of(values, "ek1.refined", thesis.REFINED)
    raw = thesis.comparator(values)
    for k, photo in enumerate(thesis.PHOTOS):
        back = thesis._as_program(thesis.interior(values, photo), raw[:, 2 * k : 2 * k + 2])
        assert 1e3 * np.abs(back - refined[:, 2 * k : 2 * k + 2]).max() <= 0.0085


@pytest.mark.truth
def test_sums_control_points_apart(values: Values, land: Array) -> None:
    """Our sums of differences are 0.394/2.038/0.493, those of control and other points add up, and others are worse.

    From print they are 0.3933/2.0138/0.4847.
    """
    control = np.isin(thesis.POINTS, thesis.CONTROL)
    printed = thesis.points_of(values, "ek1.points", thesis.PHOTO)
    ours = thesis._intersected(thesis.oriented(values), thesis.points_of(values, "ek1.refined", thesis.REFINED),
                               reweighted=True).points_m  # fmt: skip
    found = compare_points(land, np.where(control[:, None], printed, ours), control)
    assert found.every.sums_cm2[:3] == pytest.approx([0.394, 2.038, 0.493], abs=0.0005)
    assert (found.control.n, found.other.n) == (15, 34)
    assert found.every.sums_cm2 == pytest.approx(np.add(found.control.sums_cm2, found.other.sums_cm2))
    assert found.other.rms_mm[1] is not None and found.every.rms_mm[1] is not None
    assert found.other.rms_mm[1] > found.every.rms_mm[1]
    assert compare_points(land, land, ~control & control).control.rms_mm == [None] * 4


@pytest.mark.truth
def test_deviations_of_the_field_points(land: Array, values: Values) -> None:
    """The largest deviations are 2.09/1.87/2.16 mm of the spheroid and 2.11/3.41/2.14 of the sphere, at point 26.

    So "at most 2 mm" fails there.
    """
    sphere = thesis.points_of(values, "4", ("x_m", "y_m", "z_m"))
    for points, kind, worst in ((land, "spheroid", (2.09, 1.87, 2.16)), (sphere, "sphere", (2.11, 3.41, 2.14))):
        fit = fit_surface(points, kind, method="algebraic")  # type: ignore[arg-type]
        assert 1e3 * np.abs(fit.deviations_m).max(axis=0) == pytest.approx(worst, abs=0.006)
    assert int(np.argmax(np.abs(fit.deviations_m).max(axis=1))) + 1 == 26
    assert 1e3 * fit.rms_m == pytest.approx(1.54, abs=0.005)


@pytest.mark.truth
def test_mapping(reproduction: Reproduction) -> None:
    """The mapped coordinates differ from print by 0.05/0.03/0.06 mm rms and 0.26 mm at most."""
    off = np.array([
        [1e3 * (row.published - row.reproduced) for row in reproduction.rows
         if row.table == "ek3.points" and row.cell.startswith(f"{axis}_mapped")]
        for axis in "xyz"
    ])  # fmt: skip
    assert np.sqrt(np.mean(off**2, axis=1)) == pytest.approx([0.05, 0.03, 0.06], abs=0.006)
    assert np.abs(off).max() == pytest.approx(0.26, abs=0.006)


@pytest.mark.behaviour
def test_large_six_point_differences_name_the_open_direction(reproduction: Reproduction) -> None:
    rows = [row for row in reproduction.rows if "two levels leave open" in row.reason]
    spheroids = [row for row in rows if row.table in ("13", "14", "15", "16")]
    assert len(spheroids) == 24  # six cases, each in all four applications
    ratios = [float(row.reason.split("-dY0/db = ")[1].split()[0]) for row in spheroids]
    assert 0.5 <= min(ratios) and max(ratios) <= 1.01


@pytest.mark.truth
def test_the_parallax_row_ignores_the_convergence(reproduction: Reproduction) -> None:
    found = {row.cell: row.reproduced for row in reproduction.rows if row.table == "5"}
    assert found["fyy_cm2, parallax"] > 200.0 > 9.17
    assert found["fxx_cm2, parallax"] == pytest.approx(3.2, abs=0.1)


def altered(tmp_path: Path, file: str, old: str, new: str) -> Path:
    """Return the copy of the tables with one value changed."""
    folder = tmp_path / "ayhan1996"
    shutil.copytree(Path(published.__file__).parent / "ayhan1996", folder)
    text = (folder / file).read_text("utf-8")
    assert text.count(old) == 1
    (folder / file).write_text(text.replace(old, new), "utf-8")
    return folder


@pytest.mark.behaviour
def test_an_altered_value_changes_what_follows(tmp_path: Path) -> None:
    folder = altered(tmp_path, "table-3-points-spheroid.csv", "3,point 5,x_m,999.0523", "3,point 5,x_m,999.0533")
    found = {row.cell: row.verdict for row in reproduce("ayhan1996", tables="3", published=folder).rows}
    assert found["x_m, point 5"] == "differs"
    assert found["x_m, point 6"] == "equal"


@pytest.mark.behaviour
def test_numbers_without_a_solution_are_a_reason(tmp_path: Path) -> None:
    folder = altered(tmp_path, "ek-1-cameras.csv", "ek1.cameras,photo 2,c,60.65001678", "ek1.cameras,photo 2,c,-60.0")
    rows = reproduce("ayhan1996", tables="ek1.points", published=folder).rows
    assert all("no solution" in row.reason for row in rows)


@pytest.mark.behaviour
def test_command(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("reproduce", "ayhan1996", "--tables", "1-4,13", "--out", out)
    assert done.code == 0
    with (out / "cells.csv").open(encoding="utf-8", newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 28 + 7 + 245 + 245 + 105
    assert len(load("ayhan1996").cells) == 3138
