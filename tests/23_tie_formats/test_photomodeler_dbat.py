"""Exports of PhotoModeler and point files of DBAT, published or written here, are read; faults name their line."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange import photomodeler
from fg_orient.formats.exchange.photomodeler import read_photomodeler, read_points_2d
from fg_orient.formats.registry import Settings
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from tests.support.format_files import PHOTOMODELER as EXPORT


def ideal_from_printed_formulas(x_px: float, y_px: float) -> tuple[float, float]:
    """Return the image coordinates of a mark by Brown's correction as DBAT documents it.

    They are in mm with y up from the principal point.
    """
    u, v = x_px / 100.0 - 5.0, -(y_px / 100.0 - 4.0)  # 100 pixels per mm
    r2 = u * u + v * v
    radial = 1e-3 * r2 - 1e-5 * r2 * r2
    p1, p2 = 2e-4, -3e-4
    return u + u * radial + p1 * (r2 + 2 * u * u) + 2 * p2 * u * v, v + v * radial + 2 * p1 * u * v + p2 * (
        r2 + 2 * v * v
    )


@pytest.mark.oracle
def test_an_export_is_a_frame_model_with_the_distortion_of_the_printed_formulas(tmp_path: Path) -> None:
    (tmp_path / "export.txt").write_text(EXPORT, newline="\r\n")
    model = read_photomodeler(tmp_path / "export.txt")
    assert [pose.name for pose in model.poses] == ["left one.JPG", "right.JPG"]
    assert model.point_ids == ("7", "9")
    assert model.points_m.tolist() == [[1.5, 2.5, 0.5], [2.5, 1.5, 0.0]]
    rows = zip(model.image.tolist(), model.point.tolist(), model.line.tolist(), model.sample.tolist(), strict=True)
    assert list(rows) == [(0, 1, 300.5, 400.25), (1, 1, 310.5, 410.25), (1, 0, 500.0, 600.0)]
    # the second photo looks straight down: X right, Y up
    assert np.abs(model.poses[1].rotation - np.diag([1.0, -1.0, -1.0])).max() < 1e-15
    camera = model.cameras["1"]
    ideal = camera.ideal(model.line, model.sample)
    expected = [
        ideal_from_printed_formulas(x, y) for x, y in zip(model.sample.tolist(), model.line.tolist(), strict=True)
    ]
    assert np.abs(ideal * [10.0, -10.0] - expected).max() < 1e-12


@pytest.mark.oracle
def test_angles_are_kappa_phi_omega_of_successive_turns(tmp_path: Path) -> None:
    (tmp_path / "export.txt").write_text(EXPORT)
    rotation = read_photomodeler(tmp_path / "export.txt").poses[0].rotation
    c, s = np.cos(np.radians([10.0, -5.0, 90.0])), np.sin(np.radians([10.0, -5.0, 90.0]))
    omega = np.array([[1, 0, 0], [0, c[0], s[0]], [0, -s[0], c[0]]])
    phi = np.array([[c[1], 0, -s[1]], [0, 1, 0], [s[1], 0, c[1]]])
    kappa = np.array([[c[2], s[2], 0], [-s[2], c[2], 0], [0, 0, 1]])
    assert np.abs(rotation - np.diag([1.0, -1.0, -1.0]) @ kappa @ phi @ omega).max() < 1e-15


@pytest.mark.consistency
@pytest.mark.real_data
def test_published_exports_without_their_image_size_have_the_same_cameras(real_data: Path, tmp_path: Path) -> None:
    exports = sorted((real_data / "dbat").rglob("*pmexport.txt"))
    assert len(exports) == 7
    for export in exports:
        lines = export.read_text().split("\n")
        lines[1] = " ".join(lines[1].split()[:2])
        (tmp_path / "export.txt").write_text("\n".join(lines))
        whole, without = read_photomodeler(export), read_photomodeler(tmp_path / "export.txt")
        (note,) = map(str, without.notes)
        ours, theirs = without.cameras["1"], whole.cameras["1"]
        assert (ours.n_lines, ours.n_samples) == (theirs.n_lines, theirs.n_samples), export.name
        assert (ours.focal_px, ours.principal_px.tolist()) == (theirs.focal_px, theirs.principal_px.tolist())
        assert f"{theirs.n_lines} lines and {theirs.n_samples} samples are used" in note


FAULTS = [
    ("1000 800", "", "photomodeler.size", "line 2"),  # three marks determine no size
    ("10.0 8.0", "10.0 0.0", "interchange.cells", "line 4"),
    ("Bundle Soln", "Bundle", "interchange.cells", "line 1"),
    ("1000 800", "1000", "interchange.cells", "line 2"),
    ("-3e-4\n", "\n", "interchange.cells", "line 4"),
    ("90.0 -5.0", "90.0", "interchange.cells", "line 7"),
    ("   1 photos", "   5 photos", "interchange.cells", "line 13"),
    ("2.5 1.5", "2.5 x", "interchange.cells", "line 19"),
    ("   1    7", "   1    8", "photomodeler.mark", ""),
    ("   1    7", "   2    7", "photomodeler.mark", ""),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("old", "new", "code", "place"), FAULTS)
def test_faults_of_an_export_name_their_line(old: str, new: str, code: str, place: str, tmp_path: Path) -> None:
    assert old in EXPORT
    (tmp_path / "export.txt").write_text(EXPORT.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_photomodeler(tmp_path / "export.txt")
    (found,) = error.value.problems
    assert (found.code, found.place) == (code, place)


TABLE = """Project Units: meters

Object Point ID,Photo #,X (pixels),Y (pixels),Residual X,Tagged
2,1,1429.187065,1456.427823,-0.16,
2,3,666.583514,1126.807078,-0.16,
5,1,1.5,2.5,0.0,
"""


@pytest.mark.behaviour
def test_a_table_of_points_names_photos_by_number(tmp_path: Path) -> None:
    (tmp_path / "2d.txt").write_bytes(TABLE.replace("\n", "\r\r\n").encode())
    survey = photomodeler.FORMAT.read((tmp_path / "2d.txt",), Settings())  # type: ignore[misc]
    assert (survey.images, survey.ids) == (("1", "3"), ("2", "5"))
    assert survey.observed.line.tolist() == [1456.427823, 1126.807078, 2.5]
    for old, new, code in (
        ("5,1,", "2,1,", "interchange.twice"), ("1.5,2.5", "1.5,", "interchange.cells"),
        ("Object", "Subject", "interchange.cells"),
    ):  # fmt: skip
        (tmp_path / "2d.txt").write_text(TABLE.replace(old, new, 1))
        with pytest.raises(InputError) as error:
            read_points_2d(tmp_path / "2d.txt")
        assert error.value.problems[0].code == code


MARKS = "# Marks\n# Format: Image id, OP id, x, y, sxy\n 1, 2, 10.5, 20.25, 0.1\n 1, 03, 11, 21, 0.2\n2,2,5,6,0.1\n"
CONTROL = "# id\n2, CP1, 0.00, 1.00, 0.00, 0.001, 0.002, 0.003\n8, , 1.0, 2.0, 3.0\n9,A,1,2,3,0.5\n\n"


def both(folder: Path, marks: str = MARKS, control: str = CONTROL) -> tuple[Path, Path]:
    (folder / "marks.txt").write_text(marks)
    (folder / "control.txt").write_text(control)
    return folder / "marks.txt", folder / "control.txt"


@pytest.mark.behaviour
def test_marks_and_control_points_of_dbat(tmp_path: Path) -> None:
    survey = photomodeler.DBAT.read(both(tmp_path), Settings("EPSG:32633"))  # type: ignore[misc]
    assert (survey.crs, survey.ids, survey.images) == ("EPSG:32633", ("2", "8", "9", "03"), ("1", "2"))
    assert survey.roles == (Role.CONTROL,) * 3 + (Role.TIE,)
    assert survey.fixed.tolist() == [False, True, False, False]
    assert survey.sigma_enu_m[2].tolist() == [0.5, 0.5, 0.5]
    assert survey.sigma_enu_m[0].tolist() == [0.001, 0.002, 0.003]
    assert np.isnan(survey.coordinates[3]).all()
    o = survey.observed
    rows = zip(o.image, o.point, o.line, o.sample, o.sigma_line_px, strict=True)
    assert list(rows) == [(0, 0, 20.25, 10.5, 0.1), (0, 3, 21.0, 11.0, 0.2), (1, 0, 6.0, 5.0, 0.1)]
    other = MARKS.replace("Image id, OP id, x, y, sxy", "id, image, y, x, sxy")
    exchanged = photomodeler.DBAT.read(both(tmp_path, other)[:1], Settings())  # type: ignore[misc]
    assert (exchanged.images, exchanged.ids) == (("2", "03"), ("1", "2"))
    assert exchanged.observed.line.tolist() == [10.5, 11.0, 5.0]


DBAT_FAULTS: list[tuple[str, str, str, str]] = [
    ("# Format: Image id, OP id, x, y, sxy\n", "", "dbat.order", ""),
    ("OP id", "thing", "dbat.order", ""),
    ("OP id", "image", "dbat.order", ""),
    (" 1, 03, 11, 21, 0.2", " 1, 03, 11, 21", "interchange.cells", "line 4"),
    ("11, 21", "11, x", "interchange.cells", "line 4"),
    ("21, 0.2", "21, 0.0", "interchange.cells", "line 4"),
    ("1, 03", "1, 2", "interchange.twice", ""),
    ("0.002", "-0.002", "interchange.cells", "line 2"),
    ("8, ,", "2, ,", "interchange.twice", "line 3"),
    ("2.0, 3.0", "2.0", "interchange.cells", "line 3"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("old", "new", "code", "place"), DBAT_FAULTS)
def test_faults_of_dbat_files_name_their_line(old: str, new: str, code: str, place: str, tmp_path: Path) -> None:
    assert old in MARKS + CONTROL
    files = both(tmp_path, MARKS.replace(old, new, 1), CONTROL.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        photomodeler.DBAT.read(files, Settings())  # type: ignore[misc]
    (found,) = error.value.problems
    assert (found.code, found.place) == (code, place)


@pytest.mark.truth
@pytest.mark.real_data
def test_published_exports_agree_with_their_tables(real_data: Path) -> None:
    folder = real_data / "dbat" / "prague2016" / "sxb" / "pmexports"
    model = read_photomodeler(folder / "wsmart-with-orient-pmexport.txt")
    plain, smart = (read_points_2d(folder / f"wsmart-with-orient-{name}.txt") for name in ("2dpts", "2dsmartpts"))
    assert [pose.name for pose in model.poses] == ["8811.jpg", "8936.jpg", "8937.jpg", "8938.jpg", "9111.jpg"]

    keys = [(str(i + 1), model.point_ids[p]) for i, p in zip(model.image.tolist(), model.point.tolist(), strict=True)]
    export = dict(zip(keys, np.column_stack([model.line, model.sample]), strict=True))
    tables = {}
    for survey in (plain, smart):
        o = survey.observed
        for k in range(len(o)):
            tables[survey.images[o.image[k]], survey.ids[o.point[k]]] = o.line[k], o.sample[k]
    assert set(export) <= set(tables)
    assert len(export) == (1267 + 1173 - 3 * 16) // 2  # redundancy, unknowns and control points of DBAT's report
    assert max(np.abs(np.subtract(export[key], tables[key])).max() for key in export) < 5.1e-5  # four decimals
    # residuals printed in the tables: orientations of the export have three decimals (deg, m), 0.2 px in the image
    printed = {}
    for name in ("2dpts", "2dsmartpts"):
        for line in (folder / f"wsmart-with-orient-{name}.txt").read_text().splitlines():
            cells = line.split(",")
            if len(cells) > 7 and cells[0].isdigit():
                printed[cells[1], cells[0]] = float(cells[6])
    ours = np.linalg.norm(model.residuals_px(), axis=1)
    theirs = [
        printed[str(i + 1), model.point_ids[p]] for i, p in zip(model.image.tolist(), model.point.tolist(), strict=True)
    ]
    assert np.median(np.abs(ours - theirs)) < 0.2


@pytest.mark.truth
@pytest.mark.real_data
def test_published_examples_of_dbat_are_read(real_data: Path, tmp_path: Path) -> None:
    script = real_data / "dbat" / "script"
    roma = tmp_path / "markpts.txt"
    roma.write_bytes(gzip.decompress((script / "romabundledemo" / "measurements" / "markpts.txt.gz").read_bytes()))
    counts = {
        script / "camcaldemo": (script / "camcaldemo/measurements/markpts.txt", "camcal-weighted.txt", 21, 4),
        script / "sxb": (script / "sxb/measurements/markpts.txt", "sxb-control.txt", 5, 16),
    }
    for folder, (marks, control, n_images, n_control) in counts.items():
        survey = photomodeler.DBAT.read((marks, folder / "reference" / control), Settings())  # type: ignore[misc]
        assert len(survey.images) == n_images
        assert survey.roles.count(Role.CONTROL) == n_control
        assert np.isfinite(survey.sigma_enu_m[:n_control]).all()
    found = photomodeler.DBAT.read((roma,), Settings())  # type: ignore[misc]
    assert (len(found.images), len(found.ids)) == (60, 26321)
