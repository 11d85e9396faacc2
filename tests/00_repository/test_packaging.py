"""The packages import what pyproject.toml declares, and a user gets it."""

from __future__ import annotations

import ast
import functools
import re
import sys
import tomllib
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

import fg_orient
from fg_orient.model.installation import OPTIONAL, REQUIRED
from tests.support.syntax import nodes

pytestmark = pytest.mark.repository

PACKAGES = ("factors", "fg_orient")
#: Modules that exist for type checkers only.
TYPES_ONLY = {"_typeshed"}
REQUIREMENT = re.compile(r"^([A-Za-z0-9._-]+)(\[[a-z,]+\])?([^;]*)$")


@pytest.fixture(scope="module")
def declared(repository: Path) -> dict[str, Any]:
    return tomllib.loads((repository / "pyproject.toml").read_text("utf-8"))


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def names(requirements: list[Any]) -> set[str]:
    """Return the distributions of a list of requirements."""
    found = [REQUIREMENT.match(text) for text in requirements if isinstance(text, str)]
    assert all(found)
    return {normal(match[1]) for match in found if match}


def group(declared: dict[str, Any], name: str) -> set[str]:
    """Return the distributions of a dependency group, with those that it includes."""
    entries = declared["dependency-groups"][name]
    included = [group(declared, entry["include-group"]) for entry in entries if isinstance(entry, dict)]
    return names(entries).union(*included)


@functools.cache
def owners() -> Mapping[str, list[str]]:
    """Return the distributions of each installed top-level module; reads the records of all of them."""
    return metadata.packages_distributions()


@functools.cache
def imports(repository: Path, *folders: str) -> dict[str, str]:
    """Return each imported top-level module with a file that imports it.

    Imports by a string, as in ``import_module``, are included.
    """
    found = {}
    for folder in folders:
        for file in sorted((repository / folder).rglob("*.py")):
            if {"_build", "api"} & set(file.relative_to(repository).parts):
                continue
            for node in nodes(file):
                if isinstance(node, ast.Import):
                    modules = [alias.name for alias in node.names]
                elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    modules = [node.module]
                elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
                    called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                    known = called in ("import_module", "find_spec", "importorskip")
                    modules = [str(node.args[0].value)] if known else []
                else:
                    continue
                found.update({module.split(".")[0]: file.relative_to(repository).as_posix() for module in modules})
    own = {*PACKAGES, *TYPES_ONLY, "tests", "benchmarks", "mathml"}  # the last one lies in docs
    return {name: file for name, file in found.items() if name not in sys.stdlib_module_names and name not in own}


def undeclared(found: dict[str, str], known: set[str]) -> dict[str, str]:
    """Return the imported modules, with a file, of which no distribution is declared.

    A module of no installed distribution counts under its own name.
    """
    return {name: file for name, file in found.items() if not {normal(d) for d in owners().get(name, [name])} & known}


def test_every_import_of_the_packages_is_declared(repository: Path, declared: dict[str, Any]) -> None:
    """``pyproject.toml`` declares every distribution that the packages import.

    An undeclared package may be missing later if another distribution no longer installs it.
    """
    project = declared["project"]
    known = names(project["dependencies"]).union(*map(names, project["optional-dependencies"].values()))
    found = imports(repository, *PACKAGES)
    assert {"numba", "llvmlite", "markupsafe", "rasterio", "distributed"} <= set(found)
    assert undeclared(found, known | {"distributed"}) == {}  # dask[distributed]


def test_every_import_of_tests_and_documents_is_declared(repository: Path, declared: dict[str, Any]) -> None:
    project = declared["project"]
    users = names(project["dependencies"]).union(*map(names, project["optional-dependencies"].values()))
    known = users | group(declared, "dev") | group(declared, "bench") | {"distributed"}
    assert undeclared(imports(repository, "tests", "examples", "benchmarks", "docs"), known) == {}


def test_what_is_declared_is_imported(repository: Path, declared: dict[str, Any]) -> None:
    """The packages import every declared dependency, so that no user installs one that nothing uses."""
    project = declared["project"]
    wanted = names(project["dependencies"]).union(
        *(names(r) for name, r in project["optional-dependencies"].items() if name != "all")
    )
    used = {normal(d) for module in imports(repository, *PACKAGES) for d in owners().get(module, ())}
    assert wanted - used == set()


def test_extras_hold_nothing_of_the_developers(declared: dict[str, Any]) -> None:
    extras = declared["project"]["optional-dependencies"]
    assert set(extras) == {
        "geo", "match", "tables", "office", "arrow", "cloud", "report", "cluster", "reference", "all"
    }  # fmt: skip
    assert extras["all"] == ["fg-orient[geo,match,tables,office,arrow,cloud,report,cluster,reference]"]
    tools = group(declared, "dev") | group(declared, "bench")
    assert {"pytest", "sphinx", "mypy", "pycolmap"} <= tools
    assert tools & set().union(*map(names, extras.values())) == set()


def test_make_installs_all_extras_and_groups(repository: Path, declared: dict[str, Any]) -> None:
    text = (repository / "Makefile").read_text("utf-8")
    assert '-e ".[all]" --group dev' in text
    used = set(re.findall(r"--group (\w+)", text))
    included = {e["include-group"] for r in declared["dependency-groups"].values() for e in r if isinstance(e, dict)}
    assert used | included == set(declared["dependency-groups"])


def test_every_dependency_is_constrained(repository: Path, declared: dict[str, Any]) -> None:
    """``constraints.txt`` states an exact version of each dependency and of pip, which must be 25.1 or newer.

    Older versions of pip do not support dependency groups.
    """
    lines = (repository / "constraints.txt").read_text("utf-8").splitlines()
    exact = {normal(name): version for name, _, version in (line.partition("==") for line in lines if "==" in line)}
    project = declared["project"]
    known = names(project["dependencies"]).union(*map(names, project["optional-dependencies"].values()))
    asked = known | group(declared, "dev") | group(declared, "bench") | {"pip"}
    assert asked - {"fg-orient"} - set(exact) == set()
    assert tuple(map(int, exact["pip"].split(".")[:2])) >= (25, 1)


def test_numba_is_bounded_above(declared: dict[str, Any]) -> None:
    """The dependencies numba and llvmlite have upper bounds, because fg_orient uses their internals.

    The internals are the cache of kernels, and intrinsics that write LLVM instructions.
    """
    bounds = {name: text for text in declared["project"]["dependencies"] for name in ("numba", "llvmlite")
              if text.startswith(name)}  # fmt: skip
    assert set(bounds) == {"numba", "llvmlite"} and all("<" in text for text in bounds.values())


def test_doctor_names_every_dependency(declared: dict[str, Any]) -> None:
    project = declared["project"]
    assert set(REQUIRED) == names(project["dependencies"])
    extras = set().union(*map(names, project["optional-dependencies"].values()))
    assert set(OPTIONAL) == extras - {"fg-orient"}


def test_versions_agree(repository: Path, declared: dict[str, Any]) -> None:
    import factors

    stated = {
        "pyproject.toml": declared["project"]["version"],
        "factors": factors.FG_ORIENT_FACTORS,
        "CITATION.cff": re.findall(r"^version: (.*)$", (repository / "CITATION.cff").read_text("utf-8"), re.M)[0],
    }
    assert stated == dict.fromkeys(stated, fg_orient.__version__)
