"""The commands of the page on PhotoModeler exports give the printed reports of DBAT."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.photomodeler import read_photomodeler
from fg_orient.model.digits import last_digit
from tests.support import dbat, pages, photomodeler

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs" / "how-to" / "photomodeler.md"
FENCES = pages.fences(PAGE, PAGE.name)
COMMANDS = [command for fence in FENCES if fence.language == "sh" for command in pages.commands(fence)]
#: Result, report, unknowns, redundancy, sigma0 as the page says.
ROWS = re.findall(
    r"^\| `([\w-]+)-result` \| `(.*?)` \| (\d+) \| (\d+) \| (\S+) \|$", PAGE.read_text("utf-8"), re.MULTILINE
)
#: Runs that take seconds.
LONG = ("cam-fixed", "wsmart", "prior-eo")


@pytest.fixture
def data(real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder in which DBAT's files have the names of the page; the current one."""
    for name in ("prague2016", "dbat"):
        (tmp_path / name).symlink_to(real_data / "dbat" / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(name: str) -> list[str]:
    """Run the page's commands of a result; give the import's words."""
    mine = [c for c in COMMANDS if c.words[-1] in (name, f"{name}-result")]
    assert len(mine) == 2
    for command in mine:
        pages.check_command(command, pages.run_command(command, REPOSITORY))
    return mine[0].words


def orientation(record: dict, shift: np.ndarray) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the angles and centres of the photos by number, with their deviations over m0."""
    out = {}
    for k, photo in enumerate(record["photos"], start=1):
        outer = photo["exterior"]
        values = [*(outer[f"{a}_deg"] for a in ("omega", "phi", "kappa")), *(np.array(outer["centre_m"]) - shift)]
        sigma = np.array([*outer["sigma_angles_deg"], *outer["sigma_centre_m"]]) / record["m0"]
        names = ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")
        out[str(k)] = {n: (float(v), float(s)) for n, v, s in zip(names, values, sigma, strict=True)}
    return out


@pytest.mark.behaviour
def test_the_page_has_all_seven() -> None:
    assert [name for name, *_ in ROWS] == ["cam-fixed", "cam-weighted", "f-op0", "w-op0", "w-op1", "wsmart", "prior-eo"]


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize(
    "row", [pytest.param(row, id=row[0], marks=[pytest.mark.slow] * (row[0] in LONG)) for row in ROWS]
)
def test_a_published_run(row: tuple[str, ...], data: Path) -> None:
    name, report, unknowns, redundancy, sigma0 = row
    words = run(name)
    record = json.loads((data / f"{name}-result" / "closerange.json").read_text("utf-8"))
    figures, printed = dbat.report(data / report)
    assert (figures["Number of params"], figures["Redundancy"], figures["Sigma0"]) == (unknowns, redundancy, sigma0)
    assert (record["unknowns"], record["redundancy"]) == (int(unknowns), int(redundancy))
    assert abs(record["m0"] - float(sigma0)) <= 0.5 * last_digit(sigma0)
    control = photomodeler.read_control(data / words[words.index("--control") + 1])
    shift = photomodeler.shift_of(read_photomodeler(data / words[3]), control) * ("--stations" not in words)
    # they stop once |J step| <= 1e-6 |r|: no unknown moves by more than 1e-6 sqrt(redundancy) of its deviation
    units = dbat.units_apart(orientation(record, shift), printed, record["m0"], 1e-6 * float(np.sqrt(int(redundancy))))
    assert len(units) == 12 * len(record["photos"]) and max(units) < 1.0


@pytest.mark.truth
@pytest.mark.real_data
def test_the_calibration_and_its_three_failures(data: Path) -> None:
    """The three failing runs of the page end with its sentences; DBAT's reports print NaN, 499.142 and 258.848."""
    part = [fence for fence in FENCES if "camcal" in fence.text]
    (sentences,) = re.findall(r"^```text\n(error: .*?)^```$", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    said = ""
    for fence in part:
        if fence.language == "python":
            pages.run_python(fence, {})
            continue
        for command in pages.commands(fence):
            if command.code == 2 or "import" in command.words:
                ended = pages.run_command(command, REPOSITORY)
                pages.check_command(command, ended)
                said += ended.stderr
    assert said == sentences
    for name, sigma0 in (("1ray", "NaN"), ("missing-obs", "499.142"), ("no-datum", "258.848")):
        figures, _ = dbat.report(data / "dbat" / "dbatexports" / f"camcal-dbatreport-{name}.txt")
        assert figures["Sigma0"] == sigma0 and sigma0 in PAGE.read_text("utf-8")
