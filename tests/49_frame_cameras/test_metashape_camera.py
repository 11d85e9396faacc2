"""Cameras exported by Metashape have the right values and covariance; damaged files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.metadata.frame import read_camera, read_convention
from fg_orient.model.errors import InputError
from tests.support.changed_text import changed
from tests.support.command import in_process

VALUES = {"f": 3664.125, "cx": 3.5, "cy": -12.25, "b1": 0.8, "b2": -0.2, "k1": -0.02, "k2": 0.01, "p1": 1e-4}
NAMES = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")


def covariance() -> np.ndarray:
    """Return a covariance of f, cx, cy, k1 with correlations."""
    sigma = np.array([0.5, 0.2, 0.3, 1e-4])
    rho = np.array([[1.0, 0.1, -0.2, -0.7], [0.1, 1.0, 0.0, 0.05], [-0.2, 0.0, 1.0, 0.1], [-0.7, 0.05, 0.1, 1.0]])
    return rho * np.outer(sigma, sigma)


def text() -> str:
    values = "".join(f"<{name}>{value!r}</{name}>" for name, value in VALUES.items())
    coeffs = " ".join(map(repr, covariance().ravel().tolist()))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true"><sensors next_id="1">
<sensor id="0" label="FC6310, 8.8mm" type="frame"><resolution width="5472" height="3648"/>
<calibration type="frame" class="initial"><resolution width="5472" height="3648"/><f>3650</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="5472" height="3648"/>{values}</calibration>
<covariance><params>f cx cy k1</params><coeffs>{coeffs}</coeffs></covariance>
</sensor></sensors></chunk></document>
"""


def write(folder: Path, content: str) -> Path:
    path = folder / "cameras.xml"
    path.write_text(content, "utf-8")
    return path


@pytest.mark.oracle
def test_values_and_covariance_are_those_of_the_file(tmp_path: Path) -> None:
    """A Metashape file is read with its values and covariance, and converts as these values do by the function."""
    path = write(tmp_path, text())
    file = read_convention(path)
    assert file is not None and (file.name, file.lines, file.samples) == ("FC6310, 8.8mm", 3648, 5472)
    assert {name: value for name, value in file.values.items() if value} == VALUES
    place = [NAMES.index(name) for name in ("f", "cx", "cy", "k1")]
    whole = np.array(file.covariance)
    assert whole[np.ix_(place, place)] == pytest.approx(covariance(), rel=1e-15, abs=0.0)
    assert np.count_nonzero(whole) == np.count_nonzero(covariance())
    own = file.converted(path, "colmap-opencv")
    direct = fg.convert_camera(
        {name: VALUES.get(name, 0.0) for name in NAMES}, "metashape", "colmap-opencv", covariance=whole,
        image_size=(3648, 5472),
    )  # fmt: skip
    assert own.values == direct.values and own.sigma == direct.sigma
    assert read_camera(path).focal_px == VALUES["f"]
    out = tmp_path / "camera.toml"
    ended = in_process("camera", "convert", path, "--to", "metashape", "--out", out)
    assert ended.code == 0, ended.stderr
    again = read_convention(out)
    assert again is not None and again.values == pytest.approx(file.values, rel=1e-15, abs=0.0)
    assert np.array(again.covariance) == pytest.approx(whole, rel=1e-12)


DAMAGE = {
    "cut": ("</covariance>", ""), "no sensor": ("<sensor ", "<sensr "), "no adjusted": ('class="adjusted"', ""),
    "fisheye": ('type="frame" class="adjusted"', 'type="fisheye" class="adjusted"'),
    "no size": ('class="adjusted"><resolution width="5472" height="3648"/>', 'class="adjusted">'),
    "width": ('class="adjusted"><resolution width="5472"', 'class="adjusted"><resolution width="5472.5"'),
    "height": ('height="3648"/><f>3664.125', 'height="-1"/><f>3664.125'),
    "huge": ('height="3648"/><f>3664.125', 'height="99999999999"/><f>3664.125'),
    "focal": ("<f>3664.125</f>", "<f>0</f>"), "negative": ("<f>3664.125</f>", "<f>-1</f>"),
    "no focal": ("<f>3664.125</f>", ""), "word": ("<cx>3.5</cx>", "<cx>three</cx>"),
    "nan": ("<cx>3.5</cx>", "<cx>nan</cx>"), "inf": ("<cx>3.5</cx>", "<cx>1e999</cx>"),
    "twice": ("<cx>3.5</cx>", "<cx>3.5</cx><cx>3.5</cx>"), "empty": ("<cx>3.5</cx>", "<cx/>"),
    "params": ("f cx cy k1", "f cx cy k9"), "doubled params": ("f cx cy k1", "f cx cy cx"),
    "fewer params": ("f cx cy k1", "f cx cy"), "coeffs": ("<coeffs>", "<coeffs>1 "),
    "negative variance": ("<coeffs>0.25", "<coeffs>-0.25"), "doctype": ("<document ", "<!DOCTYPE x><document "),
}  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path = write(tmp_path, changed(text(), DAMAGE[name]))
    ended = in_process("camera", "convert", path, "--to", "opencv", "--out", tmp_path / "out.toml")
    assert ended.code == 2, ended.stdout
    assert "cameras.xml" in ended.stderr and len(ended.stderr.strip().splitlines()) == 1, ended.stderr
    with pytest.raises(InputError):
        read_camera(path)
