"""Every file of the two packages keeps to the order of layers, the sizes of modules and the rules of code."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.repository

LIMIT = {"factors": 200, "fg_orient": 450}  # lines per module
MEDIAN = {"factors": 125, "fg_orient": 200}


def modules(repository: Path, *packages: str) -> list[Path]:
    """Return the Python files of the packages."""
    return [path for package in packages for path in sorted((repository / package).rglob("*.py"))]


@pytest.mark.parametrize("package", ["factors", "fg_orient"])
def test_module_sizes(repository: Path, package: str) -> None:
    sizes = {
        str(p.relative_to(repository)): len(p.read_text("utf-8").splitlines()) for p in modules(repository, package)
    }
    assert len(sizes) > 5
    assert {name: n for name, n in sizes.items() if n > LIMIT[package]} == {}
    assert sorted(sizes.values())[len(sizes) // 2] <= MEDIAN[package]


def test_the_library_never_prints(repository: Path) -> None:
    """No module outside ``fg_orient/cli`` calls ``print``."""
    found = []
    for path in modules(repository, "factors", "fg_orient"):
        name, text = str(path.relative_to(repository)), path.read_text("utf-8")
        if name.startswith("fg_orient/cli") or not re.search(r"\bprint\b", text):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                found.append(f"{name}:{node.lineno}")
    assert found == []


def tracked_files(repository: Path) -> list[Path]:
    """Return the text files under version control (or of the tree where there is no git)."""
    done = subprocess.run(["git", "ls-files"], cwd=repository, capture_output=True, text=True)
    if done.returncode != 0 or not done.stdout.strip():
        pytest.skip("not a git checkout")
    return [repository / name for name in done.stdout.splitlines() if (repository / name).is_file()]


# The names are joined from pieces, so that this file itself does not contain them.
FORBIDDEN = {
    "a folder of a developer's machine": re.compile("/" + r"(work|root|home|Users|tmp/try)/\w"),
    "the shared folder": re.compile(r"\.\./" + "shared"),
    "a package registry": re.compile(
        "(files[.]python" + "hosted|pypi[.]" + r"org/simple|--index-" + r"url|find-" + "links)"
    ),
}


@pytest.mark.parametrize("what", FORBIDDEN)
def test_no_committed_file_names(repository: Path, what: str) -> None:
    found = []
    for path in tracked_files(repository):
        name = path.relative_to(repository).as_posix()
        if path.suffix in {".png", ".npz", ".gz"} or (what == "the shared folder" and name == ".ci/run"):
            continue
        text = path.read_text("utf-8", errors="replace")  # the corpus of tests/fuzz has other encodings, too
        found += [f"{name}: {match.group()}" for match in FORBIDDEN[what].finditer(text)]
    assert found == []


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the packages in a folder, not on the installed ones."""
    code = (
        "import sys; sys.path.insert(0, '.'); from importlinter.cli import lint_imports; "
        "sys.exit(lint_imports(cache_dir=None))"
    )
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=600)


@pytest.fixture(scope="module")
def copied_tree(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the packages and the contracts."""
    folder = tmp_path_factory.mktemp("tree")
    for package in ("factors", "fg_orient"):
        shutil.copytree(repository / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(repository / "pyproject.toml", folder)
    return folder


def test_contracts_hold(copied_tree: Path) -> None:
    done = lint_imports(copied_tree)
    assert done.returncode == 0, done.stdout + done.stderr


#: Module, the line added to it, the contract that it breaks, and the import that the report of the contract contains.
PLANTED = [
    (
        "factors/geometry/polynomials.py",
        "import fg_orient.model.block",
        "factors is the ground floor",
        "fg_orient.model.block",
    ),
    ("factors/geometry/rotations.py", "import gtsam", "inside factors only factors.graph imports gtsam", "gtsam"),
    (
        "fg_orient/model/block.py",
        "def f():\n    import gtsam",
        "only adjustment and quality.covariance import gtsam",
        "gtsam",
    ),
    (
        "fg_orient/sensors/metadata.py",
        "import fg_orient.adjustment.problem",
        "floors of fg_orient",
        "fg_orient.adjustment.problem",
    ),
    (
        "fg_orient/model/parameters.py",
        "def f():\n    import fg_orient.quality.observability",
        "floors of fg_orient",
        "fg_orient.quality.observability",
    ),
    (
        "fg_orient/studies/tables_spot5.py",
        "import fg_orient.studies.published.tables",
        "what computes may not import what was published",
        "fg_orient.studies.published.tables",
    ),
    (
        "fg_orient/studies/two_stage.py",
        "def f():\n    import fg_orient.studies.published",
        "what computes may not import what was published",
        "fg_orient.studies.published",
    ),
    (
        "fg_orient/cli/studies.py",
        "def f():\n    from fg_orient.studies.published.tables import load",
        "what computes may not import what was published",
        "fg_orient.studies.published.tables",
    ),
]


@pytest.fixture(scope="module")
def planted(copied_tree: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return import-linter's output for a copy with all violations; they do not hide one another."""
    folder = tmp_path_factory.mktemp("planted") / "tree"
    shutil.copytree(copied_tree, folder)
    for module, line, _, _ in PLANTED:
        path = folder / module
        path.write_text(f"{path.read_text('utf-8')}\n\n{line}\n", "utf-8")
    done = lint_imports(folder)
    assert done.returncode != 0
    return done.stdout


@pytest.mark.parametrize(("module", "line", "contract", "imported"), PLANTED)
def test_planted_violation_is_caught(planted: str, module: str, line: str, contract: str, imported: str) -> None:
    broken = [row for row in planted.splitlines() if " BROKEN" in row]
    assert any(contract in row for row in broken), planted
    said = planted[planted.index("Broken contracts") :]
    importer = module.removesuffix(".py").replace("/", ".")
    assert re.search(rf"{re.escape(importer)} -> {re.escape(imported)}\b", said), planted


def test_one_module_knows_the_distributions(repository: Path) -> None:
    """Only ``fg_orient/model/distributions.py`` imports scipy's special functions and statistics."""
    found = [
        str(path.relative_to(repository))
        for path in modules(repository, "factors", "fg_orient")
        if re.search(r"^\s*(from scipy\.(special|stats)|from scipy import .*\b(special|stats)\b|import scipy\.s)",
                     path.read_text("utf-8"), re.MULTILINE)
    ]  # fmt: skip
    assert found == ["fg_orient/model/distributions.py"]
