"""Fixtures are the twin and one result of it, made once; commands run in the process or in a new interpreter."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import Ended, Run, in_process


@pytest.fixture(scope="session")
def run() -> Run:
    """Run a command in this process."""
    return in_process


@pytest.fixture(scope="session")
def fresh(repository: Path) -> Run:
    """Run a command in a fresh interpreter."""

    def call(*words: object, cwd: Path | None = None, before: str = "") -> Ended:
        code = f"import sys; sys.path.insert(0, {str(repository)!r})\n{before}\nfrom fg_orient.cli import main\nmain()"
        command = [sys.executable, "-c", code, *map(str, words)]
        done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600)
        return Ended(done.returncode, done.stdout, done.stderr)

    return call


@pytest.fixture(scope="session")
def twin_source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the twin; not to be changed."""
    folder = tmp_path_factory.mktemp("twin") / "zonguldak"
    simulate_zonguldak(folder, ZonguldakOptions())
    return folder


@pytest.fixture(scope="session")
def adjusted(twin_source: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> tuple[Path, Ended]:
    """Return the result folder of the twin and how ``adjust --json`` ended; not to be changed."""
    out = tmp_path_factory.mktemp("adjusted") / "result"
    return out, run("adjust", twin_source / "project.toml", "--out", out, "--json")


@pytest.fixture
def twin(twin_source: Path, tmp_path: Path) -> Path:
    """Return the project file of a copy of the twin that a test may spoil."""
    shutil.copytree(twin_source, tmp_path / "twin")
    return tmp_path / "twin" / "project.toml"


@pytest.fixture
def result(adjusted: tuple[Path, Ended], tmp_path: Path) -> Path:
    """Return the copy of the result folder that a test may spoil."""
    shutil.copytree(adjusted[0], tmp_path / "result")
    return tmp_path / "result"
