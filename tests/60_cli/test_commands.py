"""The tests run ``simulate``, ``validate`` and ``doctor``, and check usage errors of all commands."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import fg_orient
from fg_orient.cli.checks import self_test
from fg_orient.model.installation import stamp
from fg_orient.result.plain import dumps
from fg_orient.result.provenance import provenance, relative
from tests.support.command import entry_point

pytestmark = pytest.mark.behaviour


def test_simulate_zonguldak_passes_every_option_on(run: Any, tmp_path: Path) -> None:
    out = tmp_path / "twin"
    words = ("--seed", 7, "--point-set", "G-C", "--image-noise", 1.0, "--errors", "prior", "--distortion", "3e-6",
             "--radial-velocity", -8.5, "--attitude", "-1.6e-4,-7.2e-4,9e-4")  # fmt: skip
    ended = run("simulate", "zonguldak", *words, "--out", out, "--json")
    assert ended.code == 0, ended.stderr
    assert ended.json == {"out": str(out), "project": str(out / "project.toml"), "truth": str(out / "truth")}
    options = json.loads((out / "truth" / "options.json").read_text("utf-8"))
    expected = {"seed": 7, "point_set": "G-C", "image_noise_px": 1.0, "errors": "prior", "distortion_rad": 3e-6,
                "radial_velocity_m_s": -8.5, "attitude_rad": [-1.6e-4, -7.2e-4, 9e-4]}  # fmt: skip
    assert {key: options[key] for key in expected} == expected
    again = run("simulate", "zonguldak", "--out", out, "--json")
    assert (again.code, again.json["errors"][0]["code"]) == (2, "output.exists")


def test_simulate_block_can_be_adjusted(run: Any, tmp_path: Path) -> None:
    out = tmp_path / "block"
    words = ("--rows", 1, "--columns", 2, "--points", 60, "--control-share", 0.2, "--check-share", 0.3, "--seed", 3)
    assert run("simulate", "block", *words, "--out", out).code == 0
    record = run("adjust", out / "project.toml", "--json").json
    assert (record["status"], record["accuracy"]["control"]["n"], record["accuracy"]["check"]["n"]) == (
        "converged", 12, 18,
    )  # fmt: skip
    ended = run("report", out / "result", "--truth", out / "truth", "--json")
    assert set(ended.json["truth"]["points"]) == {"control", "check", "tie"}


@pytest.mark.parametrize("words", [("--attitude=1,2",), ("--point-set", "H-7"), ("--errors", "many")])
def test_simulate_refuses(run: Any, tmp_path: Path, words: tuple[str, ...]) -> None:
    ended = run("simulate", "zonguldak", *words, "--out", tmp_path / "out", "--json")
    assert (ended.code, len(ended.json["errors"])) == (2, 1)
    assert list(tmp_path.iterdir()) == []


def test_validate(run: Any, twin: Path) -> None:
    ended = run("validate", twin, "--json")
    assert (ended.code, ended.json["errors"]) == (0, [])
    assert "no errors" in run("validate", twin).stdout
    path = twin.parent / "points.csv"
    path.write_text(path.read_text("utf-8").replace("\n02,control", "\n01,control"), encoding="utf-8")
    ended = run("validate", twin, "--json")
    assert ended.code == 2
    assert "points.id_twice" in {e["code"] for e in ended.json["errors"]}
    assert len(ended.stderr.splitlines()) == len(ended.json["errors"])


def test_validate_doubts_exchanged_columns_of_square_images(run: Any, twin: Path) -> None:
    """All pixels are inside after the exchange, so no table has an error, but the images show it."""
    path = twin.parent / "observations.csv"
    path.write_text(path.read_text("utf-8").replace("line,sample,", "sample,line,", 1), encoding="utf-8")
    ended = run("validate", twin)
    assert ended.code == 4
    doubts = [line for line in ended.stdout.splitlines() if line.startswith("doubt: ")]
    assert ["line and sample exchanged" in line for line in doubts] == [True, True]
    assert ended.stdout.startswith(doubts[0])
    assert "no errors" not in ended.stdout
    seen = run("validate", twin, "--json")
    assert (seen.code, seen.json["errors"]) == (4, [])
    assert [p["code"] for p in seen.json["remarks"] if p["severity"] == "doubt"] == ["solution.mix_up"] * 2


@pytest.mark.parametrize(
    ("entry", "place"), [('loss = "nonsense"', "loss"), ("gnc = true", "gnc"), ('optimizer = "newton"', "optimizer")]
)
def test_validate_refuses_what_adjust_refuses(run: Any, twin: Path, entry: str, place: str) -> None:
    """``validate`` and ``adjust`` refuse a wrong entry with the same file and place."""
    text, count = re.subn(rf"^{place} = .*$", entry, twin.read_text("utf-8"), flags=re.MULTILINE)
    assert count == 1
    twin.write_text(text, "utf-8")
    for command in ("validate", "adjust"):
        ended = run(command, twin, "--json")
        found = ended.json["errors"][0]
        assert (ended.code, found["file"], found["place"]) == (2, str(twin), f"adjustment.{place}")


def test_self_test_notices_a_wrong_projection(monkeypatch: pytest.MonkeyPatch) -> None:
    """The self-test fails if a sensor's projection differs from the equation by 0.01 px per 1000 lines.

    The adjustment converges, but the check points are centimetres off. The data have no noise, so the self-test does
    not notice a Jacobian that slows the convergence down only.
    """
    from fg_orient.sensors.pushbroom import PushbroomSensor

    good, detail = self_test()
    assert good and detail.startswith("converged after ")
    project = PushbroomSensor.project

    def shifted(self: PushbroomSensor, ground_m: Any, correction: Any = None) -> Any:
        line, sample = project(self, ground_m, correction)
        return line, sample + 0.01 * line / 1000.0

    monkeypatch.setattr(PushbroomSensor, "project", shifted)
    good, detail = self_test()
    (error_m,) = re.findall(r"^converged after .* check points within (\S+) m", detail)
    assert not good and 0.001 < float(error_m) < 1.0


@pytest.mark.parametrize(
    "words", [("adjust",), ("adjust", "a", "--nonsense"), ("nonsense",), ("locate", "a", "--line", "x"), ("simulate",)]
)
def test_usage_error_is_one_line_and_exit_2(words: tuple[str, ...]) -> None:
    ended = entry_point(*words, "--json")
    assert ended.code == 2
    assert len(ended.stderr.splitlines()) == 1
    assert ended.stderr.startswith("error: fg-orient")
    assert [e["code"] for e in ended.json["errors"]] == ["cli.usage"]


def test_help_and_version(run: Any) -> None:
    ended = run("--help")
    assert ended.code == 0
    for command in ("adjust", "locate", "project", "intersect", "simulate", "validate", "doctor", "report"):
        assert command in ended.stdout
        assert run(command, "--help").code == 0
    assert run().stdout == ended.stdout
    assert run("--version").stdout == f"fg-orient {fg_orient.__version__}\n"


def test_json_has_no_nan() -> None:
    nan = float("nan")
    assert json.loads(dumps({"a": nan, "b": [1.0, float("inf")], 3: (True, None, "x")})) == {
        "a": None, "b": [1.0, None], "3": [True, None, "x"],
    }  # fmt: skip


def test_no_folder_of_this_machine_in_the_provenance(tmp_path: Path) -> None:
    from fg_orient.simulate.zonguldak import zonguldak_block

    command = ("fg-orient", "adjust", str(tmp_path / "a.toml"), f"--out={tmp_path}/x", "--eop-set=3", "-q")
    found = provenance(zonguldak_block()[0], tmp_path, command)
    assert found["command"] == ["fg-orient", "adjust", "a.toml", "--out=x", "--eop-set=3", "-q"]
    assert stamp(command)["command"] == found["command"]  # codes of close range, rectification and reproductions
    assert relative(str(tmp_path / "sub" / "f"), tmp_path) == "sub/f"
    assert relative("/elsewhere/f", tmp_path) == "f"
