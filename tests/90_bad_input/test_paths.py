"""Names in input files never lead to a path outside the folder that a command reads or writes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fg_orient.formats.exchange.tie_folders import write_matches, write_ties
from fg_orient.formats.registry import Settings
from fg_orient.model.errors import InputError
from fg_orient.orientation.match import chips
from fg_orient.orientation.match.tables import require_tables
from fg_orient.result.summary import file_stems

pytestmark = pytest.mark.behaviour

NAMES = ["../x", "a/../../x", "/etc/x", "..\\x"]


@pytest.mark.parametrize("name", NAMES)
def test_an_image_gives_a_file_in_the_folder_or_none(name: str, tmp_path: Path) -> None:
    """An image name that leads outside the folder is refused for one-file-per-image formats, or made harmless.

    These are tie points of MicMac and ASP; result files have other characters.
    """
    o = SimpleNamespace(image=np.array([0, 1]), point=np.array([0, 0]), line=np.ones(2), sample=np.ones(2))
    survey: Any = SimpleNamespace(ids=("1",), images=(name, "b"), observed=o)
    for write in (write_ties, write_matches):
        folder = tmp_path / "out" / "deep"
        folder.mkdir(parents=True, exist_ok=True)
        with pytest.raises(InputError) as caught:
            write(survey, (folder,), Settings())
        assert caught.value.problems[0].code == "match.image"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    assert Path(file_stems([name])[name]).name == file_stems([name])[name]


def test_a_chip_beside_the_folder_of_the_control_points_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "x.tif").write_bytes(b"")
    (inner / "y.tif").write_bytes(b"")
    survey = SimpleNamespace(located=np.ones(1, bool), coordinates=np.array([[31.5, 41.5, 10.0]]),
                             sigma_enu_m=np.ones((1, 3)), crs="EPSG:4979")  # fmt: skip
    monkeypatch.setattr(chips, "format_of", lambda path, place: None)
    monkeypatch.setattr(chips, "read_survey", lambda *_: (survey, ()))
    survey.ids = ("../x",)
    with pytest.raises(InputError, match=r"chip \.\./x\.tif"):
        chips.read_control(inner / "control.csv")
    survey.ids = ("y",)
    assert chips.read_control(inner / "control.csv").chips == (inner / "y.tif",)


@pytest.mark.parametrize(("text", "usable"), [("export A=1\n", False), ("", False), ("image,id,line,sample\n", True)])
def test_match_adds_rows_to_tables_only(text: str, usable: bool, tmp_path: Path) -> None:
    """``match`` refuses before matching if the project's table of image points is another file."""
    (tmp_path / "notes").write_text(text, encoding="utf-8")
    entry = SimpleNamespace(file="../notes", format="csv")
    project: Any = SimpleNamespace(points=SimpleNamespace(file=None), observations=entry)
    path = tmp_path / "project" / "project.toml"
    path.parent.mkdir()
    if usable:
        require_tables(path, project, overwrite=False)
    else:
        with pytest.raises(InputError) as caught:
            require_tables(path, project, overwrite=False)
        assert caught.value.problems[0].code == "match.table_form"
