"""In the page of a large block points are thinned and long lists are cut; the page states what is left out."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from fg_orient.report import write_report
from fg_orient.report.html import MANY
from fg_orient.simulate.block import BlockOptions, simulate_block
from tests.support.command import in_process
from tests.support.results import sealed

pytestmark = pytest.mark.behaviour


def test_long_lists_are_cut_and_the_rest_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = simulate_block(tmp_path / "block", BlockOptions(points=60))
    folder = tmp_path / "result"
    assert in_process("adjust", project, "--out", folder, "--quiet").code == 0
    record = json.loads((folder / "result.json").read_text("utf-8"))
    row = {"id": "c7", "axis": "east", "difference_m": 1.0, "ratio": 3.5}
    record["accuracy"]["check"]["suspicious"] = [row] * (MANY["rows"] + 23)
    (folder / "result.json").write_text(json.dumps(record), "utf-8")
    monkeypatch.setitem(MANY, "images", 3)
    monkeypatch.setitem(MANY, "terms", 10)
    monkeypatch.setattr("fg_orient.report.maps.MAX_POINTS", 20)
    path, comparison = write_report(sealed(folder), project.parent / "truth")
    text = path.read_text("utf-8")
    assert text.count('<td class="id">c7</td>') == MANY["rows"] and "23 more are in result.json" in text
    assert comparison is not None and f"{len(comparison['eop']) - 10} more with --json" in text
    assert "1 more images are in eop.csv" in text
    maps = [part.partition("<figcaption")[0] for part in text.split('<svg class="map"')[1:]]
    assert len(maps) == 2
    for drawn in maps:
        signs = dict.fromkeys(("tie", "control", "check"), -1)  # one of each is in the legend
        for role, path in re.findall(r'<path class="(tie|control|check)" d="([^"]*)"', drawn):
            signs[role] += path.count("M")
        n = sum(signs.values())
        assert n <= 20 and f"{60 - n} points are not drawn" in drawn and "<title>" not in drawn
        assert signs["control"] == 6  # none of the control points is left out
