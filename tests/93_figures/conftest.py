"""Fixtures are the twin and one result of it, made once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import Run, in_process


@pytest.fixture(scope="session")
def run() -> Run:
    """Run a command in this process."""
    return in_process


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the project file of the twin; not to be changed."""
    return simulate_zonguldak(tmp_path_factory.mktemp("figures") / "zonguldak", ZonguldakOptions())


@pytest.fixture(scope="session")
def adjusted(project: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> Path:
    """Return the result folder of the twin; not to be changed."""
    out = tmp_path_factory.mktemp("adjusted") / "result"
    assert run("adjust", project, "--out", out).code == 0
    return out


@pytest.fixture
def result(adjusted: Path, tmp_path: Path) -> Path:
    """Return the copy of the result folder that a test may spoil."""
    shutil.copytree(adjusted, tmp_path / "result")
    return tmp_path / "result"
