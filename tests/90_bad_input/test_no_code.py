"""No data of a file are executed: no code unpickles, evaluates, or calls a shell."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.repository

#: Calls, by their last name, that execute content of data.
RUNNING = {"eval", "exec", "compile", "system", "popen", "unsafe_load", "Unpickler"}
#: Modules whose loads run code.
MODULES = {"pickle", "marshal", "shelve", "yaml", "dill", "joblib", "cloudpickle"}
#: ``compile`` of patterns, ``pickle.dumps`` for a digest, the user's own plugins.
ALLOWED = {("re", "compile"), ("pickle", "dumps")}
_WORDS = (*(f"{name}(" for name in RUNNING), *MODULES, "shell", "np.load")


def calls(tree: ast.AST) -> list[tuple[str, str, ast.Call]]:
    """Return the object and the name of each call."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            f = node.func
            owner = ast.unparse(f.value) if isinstance(f, ast.Attribute) else ""
            found.append((owner, f.attr if isinstance(f, ast.Attribute) else getattr(f, "id", ""), node))
    return found


def faults(text: str) -> list[str]:
    """Return the calls of a module that may run what data contain."""
    if not any(word in text for word in _WORDS):
        return []  # most modules; parsing takes seconds
    bad = []
    for owner, name, node in calls(ast.parse(text)):
        words = {one.arg: ast.unparse(one.value) for one in node.keywords}
        plain = owner.rpartition(".")[2]
        if (plain in MODULES or (name in RUNNING and owner in ("", "os", "builtins"))) and (plain, name) not in ALLOWED:
            bad.append(f"{owner}.{name}")
        if words.get("shell") == "True" or (plain == "np" and name == "load" and words.get("allow_pickle") != "False"):
            bad.append(f"{owner}.{name}({words})")
    return bad


def test_nothing_runs_what_data_contain(repository: Path) -> None:
    files = [*sorted((repository / "fg_orient").rglob("*.py")), *sorted((repository / "factors").rglob("*.py"))]
    found = {path.relative_to(repository).as_posix(): faults(path.read_text("utf-8")) for path in files}
    assert len(found) > 300
    kernels = {name for name in found if name.startswith("factors/_")}  # numba compiles sources of our own
    assert {name: bad for name, bad in found.items() if bad and name not in kernels} == {}


@pytest.mark.parametrize("text", [
    "import pickle\npickle.load(f)", "eval(text)", "exec(code)", "np.load(path)", "np.load(path, allow_pickle=True)",
    "subprocess.run(x, shell=True)", "os.system(x)", "yaml.load(x)",
])  # fmt: skip
def test_planted_call_is_found(text: str) -> None:
    assert faults(text)
