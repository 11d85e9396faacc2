"""Fresh interpreters show which modules are loaded at the start."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.command import in_process

HEAVY = ("gtsam", "numba", "scipy", "pandas", "pyarrow", "matplotlib", "rasterio", "pyproj", "erfa", "lxml", "pydantic")
#: Modules that no command below needs, because none makes a plot or reads a raster.
OPTIONAL = (
    "pandas", "pyarrow", "matplotlib", "rasterio", "shapely", "pyogrio", "dask", "scipy.stats", "scipy.interpolate",
)  # fmt: skip
#: Parts of scipy that take as long to load as an adjustment to compute, for tasks that most blocks do not have.
SCIPY = ("scipy.optimize", "scipy.spatial")
#: For each name: words of the command, and modules that it must not load.
FORBIDDEN = {
    "--help": (
        ["--help"],
        (*HEAVY, "numpy", "jinja2", "threadpoolctl"),
    ),
    "adjust --help": (
        ["adjust", "--help"],  # pydantic is loaded, because typer reads the words of a command with it
        ("gtsam", "numba", "scipy", "numpy", "pyproj", "lxml", "fg_orient.cli.closerange", "fg_orient.cli.rpc"),
    ),
    "--version": (
        ["--version"],
        ("numpy", "gtsam", "numba", "scipy", "pyproj", "lxml", "rich", "fg_orient.cli.adjust"),
    ),
    "locate": (
        ["locate", "{left}", "--line", "6000", "--sample", "6000", "--height", "350"],
        (*OPTIONAL, *SCIPY, "scipy.sparse", "gtsam", "pyproj", "erfa", "jinja2", "fg_orient.adjustment",
         "fg_orient.cli.adjust"),
    ),
    "adjust --backend schur": (
        ["adjust", "{project}", "--out", "{out}", "--backend", "schur"],
        (*OPTIONAL, *SCIPY, "gtsam", "erfa", "fg_orient.adjustment.explicit", "fg_orient.adjustment.parts",
         "fg_orient.orientation.outlier_search", "fg_orient.orientation.dem_control",
         "fg_orient.adjustment.linear.kappa_graph"),
    ),
    "adjust": (
        ["adjust", "{project}", "--out", "{out}"],
        (*OPTIONAL, *SCIPY, "erfa", "fg_orient.adjustment.parts", "fg_orient.adjustment.linear.kappa_graph"),
    ),
}  # fmt: skip


def run(code: str, folder: Path) -> str:
    """Run code in a fresh interpreter of this environment and give what it prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.repository
def test_import_loads_nothing_but_itself(repository: Path) -> None:
    """``import fg_orient`` loads only four modules of its own and modules of the standard library."""
    code = (
        "import sys; before = set(sys.modules); import fg_orient\n"
        "found = set(sys.modules) - before\n"
        "print(sorted(m for m in found if m.partition('.')[0] not in sys.stdlib_module_names))"
    )
    assert run(code, repository).strip() == "['factors', 'fg_orient', 'fg_orient.model', 'fg_orient.model.public']"


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("startup") / "zonguldak"
    assert in_process("simulate", "zonguldak", "--out", folder).code == 0
    return folder


@pytest.mark.repository
@pytest.mark.parametrize("name", FORBIDDEN)
def test_a_command_loads_only_what_it_uses(name: str, repository: Path, twin: Path, tmp_path: Path) -> None:
    """Each command runs without loading the modules that are forbidden for it.

    Kernels are not counted: they may be compiled in advance or not, and they need numba and scipy.linalg.
    """
    words, forbidden = FORBIDDEN[name]
    places = {"left": twin / "left.DIM", "project": twin / "project.toml", "out": tmp_path / "out"}
    words = [word.format(**places) for word in words]
    code = (
        f"import json, sys; sys.argv = ['fg-orient', *{words!r}]\n"
        "from fg_orient.cli import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
        "print('LOADED', json.dumps(sorted(sys.modules)))"
    )
    loaded = json.loads(run(code, repository).rsplit("LOADED", 1)[1])
    assert "fg_orient.cli.app" in loaded
    assert [module for module in forbidden if module in loaded] == []
    if words[0] == "adjust" and "--help" not in words:
        assert (tmp_path / "out" / "report.html").is_file()
        assert ("gtsam" in loaded) == ("schur" not in words)


@pytest.mark.repository
@pytest.mark.parametrize("name", ["right.DIM", "points.csv"])
def test_a_missing_file_is_refused_without_numba(name: str, repository: Path, twin: Path, tmp_path: Path) -> None:
    """``adjust`` refuses a missing file with exit code 2 before it loads numba, scipy, GTSAM or jinja2."""
    project = shutil.copytree(twin, tmp_path / "project")
    (project / name).unlink()
    code = (
        f"import sys; sys.argv = ['fg-orient', 'adjust', {str(project / 'project.toml')!r}]\n"
        "from fg_orient.cli import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    print(end.code)\n"
        "print([name for name in ('numba', 'scipy', 'gtsam', 'jinja2') if name in sys.modules])"
    )
    assert run(code, repository).splitlines() == ["2", "[]"]


@pytest.mark.repository
def test_every_public_name_loads(repository: Path) -> None:
    code = "import fg_orient as fg; print([n for n in fg.__all__ if getattr(fg, n) is None or n not in dir(fg)])"
    assert run(code, repository).strip() == "[]"


@pytest.mark.behaviour
def test_unknown_name_is_an_attribute_error(repository: Path) -> None:
    code = "import fg_orient\ntry:\n    fg_orient.nonsense\nexcept AttributeError as e:\n    print(e)"
    assert run(code, repository).strip() == "module 'fg_orient' has no attribute 'nonsense'"
