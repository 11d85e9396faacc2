"""``closerange compare-report`` compares published values with a result by their digits."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.photomodeler import read_photomodeler
from fg_orient.model.digits import agreement, last_digit
from tests.support import dbat, pages, photomodeler
from tests.support.command import in_process as run

REPOSITORY = Path(__file__).resolve().parents[2]
RECORD = {
    "kind": "bundle", "report": {}, "m0": 1.23456, "redundancy": 40, "unknowns": 31,
    "photos": [{
        "photo": "p1", "parameters": [], "exterior": {
            "centre_m": [1.0, 2.0, 3.0004], "sigma_centre_m": [0.01, 0.02, 0.03], "omega_deg": -179.9999,
            "phi_deg": 0.5, "kappa_deg": 0.0, "sigma_angles_deg": [0.001, 0.002, 0.003],
        }}],
    "cameras": [{"camera": "all", "parameters": [{"name": "k1", "value": 4.5e-3, "sigma": 2.31e-5}]}],
    "points": [{"id": "7", "x_m": 1.5, "y_m": 2.5, "z_m": 3.5, "sigma_x_m": 0.1, "sigma_y_m": 0.1, "sigma_z_m": None}],
    "correlations": {
        "parts": [{"of": "camera all", "names": ["k1", "k2"], "triangle": [[], [-0.9791]]}],
        "largest": [{"a": "photo p1 X0", "b": "camera all k1", "correlation": 0.9512}],
    },
}  # fmt: skip
#: Line of the table, verdict of the value and of its standard deviation.
LINES = {
    "m0,1.2346,,": ("equal", None),
    "redundancy,41,,": ("differs", None),  # a count
    "unknowns,31,,": ("equal", None),
    "photo p1 X0,1.02,0.03,": ("sigma", "differs"),
    "photo p1 Y0,2.05,,": ("differs", None),
    "photo p1 Z0,3.000,0.03,": ("equal", "equal"),
    "photo p1 omega_deg,180.000,0.002,": ("equal", "rounding"),
    "camera all k1,0.0045,2.310e-05,6": ("equal", "equal"),
    "point 7 z_m,3.4,,": ("rounding", None),
    "point 7 x_m,1.2,,": ("differs", None),
    "camera all k2/k1,-0.98,,": ("equal", None),
    "camera all k1/photo p1 X0,0.951,,": ("equal", None),
}


@pytest.fixture
def result(tmp_path: Path) -> Path:
    folder = tmp_path / "result"
    folder.mkdir()
    (folder / "closerange.json").write_text(json.dumps(RECORD), "utf-8")
    return folder


def table(folder: Path, *lines: str) -> Path:
    path = folder.parent / "values.csv"
    path.write_text("\n".join(["name,value,sigma,digits", *lines]) + "\n", "utf-8")
    return path


@pytest.mark.oracle
def test_agreement_is_that_of_rounding() -> None:
    """A value within half a unit of a printed digit is equal, within one unit a rounding, beyond it differs."""
    for value in np.random.default_rng(1).normal(0.0, 1e3, 200).tolist():
        text = f"{value:.4f}"
        unit = last_digit(text)
        assert agreement(value - float(text), float(text), unit) == "equal"
        assert agreement(0.75 * unit, float(text), unit) == "rounding"
        assert agreement(1.5 * unit, float(text), unit) == "differs"
        assert agreement(1.5 * unit, float(text), unit, 2.0 * unit) == "sigma"
    assert agreement(np.nan, 1.0, 0.1, 1.0) == "differs"


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("text", "digits", "unit"), [("7.4574", 6, 1e-5), ("1e-05", 3, 1e-7), ("120", 2, 10.0), ("0", 3, 1.0)]
)
def test_unit_of_significant_digits(text: str, digits: int, unit: float) -> None:
    assert last_digit(text, digits) == pytest.approx(unit, rel=1e-12)


@pytest.mark.behaviour
def test_each_verdict(result: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = run("closerange", "compare-report", result, table(result, *LINES), "--json", "--report", page)
    assert done.code == 0, done.stderr
    rows = done.json["values"]
    assert [(r["verdict"], r["sigma_verdict"]) for r in rows] == list(LINES.values())
    assert rows[6]["difference"] == pytest.approx(1e-4, abs=1e-12), "angles are compared modulo 360"
    assert done.json["counts"] == {"equal": 7, "rounding": 1, "sigma": 1, "differs": 3}
    text = page.read_text("utf-8")
    assert "3 of 12 values differ" in text and all(line.split(",")[0] in text for line in LINES)
    words = run("closerange", "compare-report", result, table(result, *LINES)).stdout
    assert "3 of 12 values differ" in words and "camera all k1" in words


@pytest.mark.behaviour
def test_all_unknown_names_are_one_error(result: Path) -> None:
    done = run("closerange", "compare-report", result, table(result, "sigma0,1,,", "m0,1.2,,", "camera all k9,0.1,,"))
    assert done.code == 2 and done.stderr.count("error:") == 1
    assert "sigma0, camera all k9" in done.stderr


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("m0,x,,", "line 2, column value"),
        ("m0,NaN,,", "line 2, column value"),
        ("m0,1.2,0,", "line 2, column sigma"),
        ("m0,1.2,-1,", "line 2, column sigma"),
        ("m0,1.2,,2.5", "line 2, column digits"),
        ("m0,1.2,,18", "line 2, column digits"),
        ("m0,1.2,,0", "line 2, column digits"),
        ("m0,1.2", "line 2"),
    ],
)
def test_faults_of_the_table(result: Path, line: str, words: str) -> None:
    done = run("closerange", "compare-report", result, table(result, line))
    assert done.code == 2 and done.stderr.count("error:") == 1 and words in done.stderr


@pytest.mark.behaviour
def test_a_name_twice_and_a_folder_without_result(result: Path, tmp_path: Path) -> None:
    done = run("closerange", "compare-report", result, table(result, "m0,1.2,,", "m0,1.3,,"))
    assert done.code == 2 and "line 3" in done.stderr and "line 2" in done.stderr
    done = run("closerange", "compare-report", tmp_path, table(result, "m0,1.2,,"))
    assert done.code == 2 and "closerange.json" in done.stderr


@pytest.mark.truth
@pytest.mark.real_data
def test_report_of_dbat_on_aerial_photos(tmp_path: Path, real_data: Path) -> None:
    """All printed values of five aerial photos agree with DBAT's report, and a changed last digit is found."""
    data = real_data / "dbat" / "prague2016" / "sxb"
    export, control = data / "pmexports" / "f-op0-with-orient-pmexport.txt", data / "ref" / "ctrlpts-fixed.txt"
    done = run("closerange", "import", export, "--control", control, "--sigma-image", 1, "--out", tmp_path / "f")
    assert done.code == 0, done.stderr
    files = [tmp_path / "f" / name for name in ("image.csv", "photos.toml")]
    result = tmp_path / "result"
    done = run("closerange", "bundle", *files, "--control", tmp_path / "f" / "control.csv", "--out", result, "--json")
    assert done.code == 0, done.stderr
    shift = photomodeler.shift_of(read_photomodeler(export), photomodeler.read_control(control))
    figures, printed = dbat.report(data / "dbatexports" / "f-op0-with-orient-dbatreport.txt")
    ours = {"Omega": "omega_deg", "Phi": "phi_deg", "Kappa": "kappa_deg", "Xc": "X0", "Yc": "Y0", "Zc": "Z0"}
    lines = [f"m0,{figures['Sigma0']},,", f"redundancy,{figures['Redundancy']},,", "unknowns,30,,"]
    for k, photo in enumerate(done.json["photos"], start=1):
        for theirs, name in ours.items():
            value, sigma = printed[str(k)][theirs]
            if theirs[1:] == "c":  # the report prints the shifted system
                value = f"{float(value) + shift['XYZ'.index(theirs[0])]:.6f}"
            lines.append(f"photo {photo['photo']} {name},{value},{sigma},")
    done = run("closerange", "compare-report", result, table(result, *lines), "--json")
    assert done.code == 0, done.stderr
    rows = done.json["values"]
    assert len(rows) == 33
    centres = [row for row in rows if row["name"][-2:] in ("X0", "Y0", "Z0")]
    assert all(row["verdict"] in ("equal", "rounding") for row in rows if row not in centres)
    # DBAT stops once |J step| <= 1e-6 |r|: no unknown moves by more than 1e-6 sqrt(64) of its deviation
    assert all(abs(row["difference"]) <= 1e-6 + 8e-6 * row["sigma"] for row in centres)
    assert all(row["sigma_verdict"] in ("equal", "rounding", None) for row in rows)
    wrong = run("closerange", "compare-report", result, table(result, "m0,1.0422,,"), "--json").json
    assert wrong["counts"]["differs"] == 1


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.slow
def test_the_page_on_the_calibration(tmp_path: Path, real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page on the calibration has the numbers of DBAT's report, and its commands find that all values agree."""
    page = REPOSITORY / "docs" / "how-to" / "published-report.md"
    (values,) = re.findall(r"^```text\n(.*?)^```$", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    report = (real_data / "dbat" / "dbat" / "dbatexports" / "camcal-dbatreport-model1.txt").read_text()
    numbers = [*re.findall(r"[-+\d.e]+", report), "2.96421e-05", "-0.979"]  # -P2; -97.9%
    assert "-2.96421e-05" in numbers and "K3:-97.9%" in report
    assert all(cell in numbers for line in values.splitlines()[1:] for cell in line.split(",")[1:3] if cell)
    (tmp_path / "values.csv").write_text(values, "utf-8")
    (tmp_path / "dbat").symlink_to(real_data / "dbat" / "dbat")
    monkeypatch.chdir(tmp_path)
    made = [page.with_name("photomodeler.md"), page]
    commands = [c for p in made for f in pages.fences(p, p.name) if f.language == "sh" for c in pages.commands(f)]
    commands = [c for c in commands if c.words[-1] in ("camcal", "camcal-result", "comparison.html")]
    for command in commands:
        ended = pages.run_command(command, REPOSITORY)
        pages.check_command(command, ended)
    assert len(commands) == 3 and "All values agree" in ended.stdout
