"""Fixtures are three rendered images of known geometry, matched once."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fg_orient.orientation.match.job import match_project
from tests.support.rendered_pair import Scene, View, write_pair

#: The models of b and c are wrong by some pixels; b has another radiometry and is turned against a.
VIEWS = (
    View("a", (0.25, -0.05), 180),
    View("b", (-0.25, 0.1), 180, rotation_deg=4.0, shift_px=(2.5, -1.5), gain=1.3, offset=40.0),
    View("c", (0.05, 0.3), 180, shift_px=(-1.0, 2.0)),
)


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Return a surface with hills and a few walls."""
    return Scene(85.0, 3, relief_m=5.0, walls=3)


@pytest.fixture(scope="session")
def rendered(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the images and of a project without tables."""
    folder = tmp_path_factory.mktemp("rendered")
    write_pair(folder, scene, VIEWS, snr=50.0)
    return folder


@pytest.fixture(scope="session")
def matched(rendered: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return the folder and the record of a run."""
    folder = tmp_path_factory.mktemp("matched")
    shutil.copytree(rendered, folder, dirs_exist_ok=True)
    return folder, match_project(folder / "project.toml")


@pytest.fixture
def project(rendered: Path, tmp_path: Path) -> Path:
    """Return a copy of the project, to be matched by a test."""
    shutil.copytree(rendered, tmp_path, dirs_exist_ok=True)
    return tmp_path / "project.toml"


@pytest.fixture
def interrupted() -> Callable[[int], Callable[[int, int, str], None]]:
    """Return a callback that stops a run after some cells."""

    def after(count: int) -> Callable[[int, int, str], None]:
        def callback(done: int, total: int, text: str) -> None:
            if "cells" in text and done >= count:
                raise KeyboardInterrupt

        return callback

    return after
