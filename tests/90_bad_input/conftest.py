"""The fixture is a small project folder with substitute sensors."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.project_folder import ProjectFolder, install_stand_in


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectFolder:
    install_stand_in(monkeypatch)
    return ProjectFolder(tmp_path)
