"""The fixture is one small comparison on the twin, in memory and through a project folder, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from fg_orient.model.block import Block
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak, zonguldak_block
from fg_orient.studies.comparison.compare import compare
from fg_orient.studies.comparison.model import Comparison
from tests.support.command import Ended, Run, in_process

#: Well conditioned; velocity (a mere yaw); velocity and attitude.
SETS = (2, 5, 17)
#: An inverse that truncates, one that breaks down, a method on A, two that the iteration leaves out.
SOLVERS = ("moore_penrose_inverse", "cholesky_inverse", "qr", "cramer_inverse", "tikhonov_od")


@pytest.fixture(scope="session")
def run() -> Run:
    """Run a command in this process."""
    return in_process


@pytest.fixture(scope="session")
def twin() -> Block:
    """Return the twin in memory."""
    return zonguldak_block(ZonguldakOptions())[0]


@pytest.fixture(scope="session")
def comparison(twin: Block) -> Comparison:
    """Return the comparison of all solvers for the sets of the tests."""
    return compare(twin, eop_sets=SETS, solvers=SOLVERS)


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the project file of the same twin; not to be changed."""
    return simulate_zonguldak(tmp_path_factory.mktemp("compare") / "zonguldak", ZonguldakOptions())


@pytest.fixture(scope="session")
def written(project: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> tuple[Path, Ended]:
    """Return the comparison folder of the project and how ``compare --json`` ended; not to be changed."""
    out = tmp_path_factory.mktemp("compared") / "comparison"
    sets, solvers = ",".join(map(str, SETS)), ",".join(SOLVERS)
    return out, run("compare", project, "--eop-sets", sets, "--solvers", solvers, "--out", out, "--json")
