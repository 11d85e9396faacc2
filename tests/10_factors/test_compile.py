"""Compiled code is valid for its sources; a kernel is compiled once, when it is called, in any place."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest

from factors import _compile
from factors._kernel import Kernel
from factors._preparation import on_compilation
from factors._sources import stamp
from factors.cameras import pushbroom
from factors.geometry import light
from fg_orient.kernels import batch, batch_pairs, vectors
from tests.support.equation_examples import look_angle_collinearity

pytestmark = pytest.mark.behaviour

#: A package whose kernel calls functions of two modules, each imported in another way; a test changes ``{0}``.
PACKAGE = {
    "__init__.py": "",
    "top.py": """
from factors._compile import compiled
import chain.sub
from chain.sub import second as renamed

@compiled
def kernel(x):
    return renamed(x) + chain.sub.other.third(x)
""",
    "sub/__init__.py": """
from . import other
from .deep import second
""",
    "sub/deep.py": """
from factors._compile import inlined
if True:
    from .leaf import first, FACTOR

@inlined
def second(x):
    return FACTOR * first(x)
""",
    "sub/leaf.py": """
from factors._compile import inlined
FACTOR = {factor}

@inlined
def first(x):
    return x + {leaf}
""",
    "sub/other.py": """
from factors._compile import compiled

@compiled
def third(x):
    return x * {other}
""",
}
RUN = """
import json, sys
from factors._preparation import on_compilation
told = []
with on_compilation(told.append):
    from chain.top import kernel
    value = kernel(1.0)
json.dump([value, told], sys.stdout)
"""


VALUES = {"factor": 2.0, "leaf": 3.0, "other": 5.0}
#: The same with values that change between two imports of the package.
CHANGES = """
import importlib, json, pathlib, sys
from factors._preparation import on_compilation
folder, texts, values = sys.argv[1], *map(json.loads, sys.argv[2:4])
found = []
for changed in values:
    for name, text in texts.items():
        (pathlib.Path(folder) / name).write_text(text.format(**changed), encoding="utf-8")
    for name in [name for name in sys.modules if name.partition(".")[0] == "chain"]:
        del sys.modules[name]
    importlib.invalidate_caches()
    told = []
    with on_compilation(told.append):
        found.append([importlib.import_module("chain.top").kernel(1.0), told])
json.dump(found, sys.stdout)
"""


class Chain:
    """The package in a folder, with a cache of its own; each run is a process."""

    def __init__(self, folder: Path, repository: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"
        self._environment = {**os.environ, "NUMBA_CACHE_DIR": str(self.cache),
                             "PYTHONPATH": os.pathsep.join([str(folder), str(repository)])}  # fmt: skip

    def run(self, code: str = RUN, **values: float) -> tuple[float, list[str]]:
        """Return the value of the kernel, and the kernels that were compiled for it."""
        for name, text in PACKAGE.items():
            path = self.folder / "chain" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text.format(**(VALUES | values)), encoding="utf-8")
        value, told = json.loads(self._output(code))
        return value, told

    def run_each(self, *values: dict[str, float]) -> list[tuple[float, list[str]]]:
        """Do :meth:`run` for each of the values in a single process."""
        given = json.dumps([VALUES | changed for changed in values])
        found = json.loads(self._output(CHANGES, str(self.folder / "chain"), json.dumps(PACKAGE), given))
        return [(value, told) for value, told in found]

    def _output(self, code: str, *arguments: str) -> str:
        ended = subprocess.run([sys.executable, "-B", "-c", code, *arguments], env=self._environment,
                               capture_output=True, text=True, check=False)  # fmt: skip
        assert ended.returncode == 0, ended.stderr
        return ended.stdout


@pytest.fixture
def chain(tmp_path: Path, repository: Path) -> Chain:
    return Chain(tmp_path, repository)


def test_a_change_two_imports_away_gives_the_new_result(chain: Chain) -> None:
    assert chain.run() == (2.0 * (1.0 + 3.0) + 5.0, ["kernel"])
    assert chain.run() == (13.0, [])  # from disk
    found = chain.run_each(
        {"leaf": 4.0},
        {"leaf": 4.0, "factor": 3.0},  # a constant of the same module
        {"leaf": 4.0, "factor": 3.0, "other": 6.0},  # by its module's name
        {"leaf": 4.0, "factor": 3.0, "other": 6.0},
    )
    assert found == [(15.0, ["kernel"]), (20.0, ["kernel"]), (21.0, ["kernel"]), (21.0, [])]


def test_stamps_do_not_depend_on_the_order_of_sets(repository: Path) -> None:
    """The stamps of all kernels are equal in two processes with different hash seeds.

    Python hashes strings differently in each process, and literals such as ``{"a", "b"}`` are sets.
    """
    code = """
import sys
from fg_orient.kernels import batch, batch_cofactors, batch_pairs
from factors._kernel import Kernel
from factors._sources import stamp
kernels = {f for name, module in list(sys.modules.items()) if name.startswith(("factors", "fg_orient.kernels"))
           for f in vars(module).values() if isinstance(f, Kernel)}
print(sorted((f.py_func.__module__, f.py_func.__name__, stamp(f.py_func).hex()) for f in kernels))
"""
    runs = [
        subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed}, cwd=repository,
                       capture_output=True, text=True, check=True).stdout
        for seed in ("1", "2")
    ]  # fmt: skip
    assert runs[0].count("fg_orient.kernels.batch") > 20 and runs[0] == runs[1]


def test_damaged_files_are_compiled_anew(chain: Chain) -> None:
    chain.run()
    files = [path for path in chain.cache.rglob("*") if path.suffix in (".nbi", ".nbc")]
    assert len(files) == 2
    for path in files:
        path.write_bytes(path.read_bytes()[:50])
    assert chain.run() == (13.0, ["kernel"])


def test_without_a_writable_place_kernels_run_all_the_same(chain: Chain) -> None:
    nowhere = "from numba.core import caching\ncaching.FunctionCache._impl_class._locator_classes = []\n"
    last = "from factors._compile import cache_folder\nassert cache_folder() is None\n"
    assert chain.run(nowhere + RUN + last) == (13.0, ["kernel"])
    assert chain.run(nowhere + RUN) == (13.0, ["kernel"])
    assert not chain.cache.exists()


def test_a_full_disk_stops_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    @_compile.compiled
    def twice(x: float) -> float:
        return 2.0 * x

    tried = []

    def full(*_: object) -> None:
        tried.append(True)
        raise OSError(28, "No space left on device")

    kernel: Any = twice
    monkeypatch.setattr(kernel.open_cache()._cache_file, "save", full)
    assert twice(2.0) == 4.0 and twice(3) == 6
    assert tried


def test_stamp_sees_what_a_function_is_bound_to() -> None:
    def make(constant: object, callee: FunctionType, text: str = "") -> FunctionType:
        space = {"constant": constant, "callee": callee, "np": np, "module": SimpleNamespace}
        exec(f"def f(x):\n    {text!r}\n    return callee(x) + constant", space)
        made = space["f"]
        assert isinstance(made, FunctionType)
        return made

    def one(x: float) -> float:
        return x

    def two(x: float) -> float:
        return x + x

    before = stamp(make(1.0, one))
    assert stamp(make(1.0, one)) == before
    assert stamp(make(1.0, one, "another docstring")) == before
    assert stamp(make(2.0, one)) != before
    assert stamp(make(1, one)) != before  # an integer is another type
    assert stamp(make(1.0, two)) != before
    assert stamp(make(np.array([1.0]), one)) != stamp(make(np.array([2.0]), one))
    assert stamp(make(1.0, one), {"fastmath": True}) != before


def test_stamp_of_a_kernel_follows_functions_and_intrinsics() -> None:
    """A changed function changes the stamps of the kernels that call it, and of no other kernel."""
    kernels: list[Any] = [batch_pairs.pair_blocks, batch.rows_of_form, pushbroom.fill]
    before = [stamp(kernel.py_func) for kernel in kernels]

    def changed(owner: Any, name: str) -> list[bool]:
        with pytest.MonkeyPatch.context() as patch:
            code = (lambda *_: None).__code__
            patch.setattr(getattr(owner, name).py_func if hasattr(getattr(owner, name), "py_func") else
                          getattr(owner, name), "__code__", code)  # fmt: skip
            from factors import _sources

            _sources._read.cache_clear()
            after = [stamp(kernel.py_func) for kernel in kernels]
        _sources._read.cache_clear()
        return [a != b for a, b in zip(after, before, strict=True)]

    assert changed(pushbroom, "_tangent") == [False, True, True]
    assert changed(vectors, "splat") == [True, True, False]  # a function that writes instructions
    assert changed(light, "unit") == [False, False, False]


def test_a_function_that_numba_compiles_may_call_kernels() -> None:
    """A user's ``numba.njit`` loop may call a kernel, and its sum equals that of the kernel called from Python."""
    e = look_angle_collinearity(np.random.default_rng(5))
    fill: Any = pushbroom.fill

    @numba.njit
    def summed(records, setup, x, ground):  # type: ignore[no-untyped-def]
        total, out = 0.0, np.empty((2, setup.shape[1] + 4))
        for _ in range(2):
            fill(records, 0, setup, x, ground, out, True)
            total += out.sum()
        return total

    blocks = pushbroom.LOOK_ANGLE_COLLINEARITY.kernel(e.record, e.setup, *e.unknowns, True)
    expected = 2.0 * sum(float(block.sum()) for block in blocks)
    assert summed(e.record[None], e.setup, *e.unknowns) == pytest.approx(expected, rel=1e-13)


def test_a_kernel_is_compiled_whole_and_its_parts_are_not(tmp_path: Path) -> None:
    told: list[str] = []

    @_compile.inlined
    def part(x: float) -> float:
        return x + 1.0

    @_compile.compiled
    def whole(x: float) -> float:
        return 2.0 * part(x)

    for kernel in (part, whole):
        kernel._opened = True  # type: ignore[attr-defined]  # no file: this test may have run before
    with on_compilation(told.append):
        assert whole(1.0) == 4.0
        assert told == ["whole"]
        assert part(1.0) == 2.0  # called from Python it becomes a kernel of its own
    assert told == ["whole", "part"]


def test_a_part_that_becomes_a_kernel_gives_arrays(chain: Chain) -> None:
    """A kernel returns arrays to Python after another process compiled it as a part of a second kernel.

    The code that converts an array to Python belongs to the kernel itself.
    """
    code = """
import json, sys
import numpy as np
from factors._compile import compiled

@compiled
def part(x):
    out = np.empty(2)
    out[0], out[1] = x, 2.0 * x
    return out

@compiled
def whole(x):
    return part(x)[1]

value = whole(1.0) + part(3.0)[1]
json.dump([value, []], sys.stdout)
"""
    script = chain.folder / "script.py"
    script.write_text(code, encoding="utf-8")
    for run in range(3):  # compiled, from disk, and compiled where another process has written the part as a kernel
        assert chain.run("import runpy, sys; runpy.run_path(r'" + str(script) + "')") == (8.0, [])
        files = list(chain.cache.rglob("script.whole*"))
        assert files
        for path in files if run == 1 else ():
            path.unlink()


def test_a_function_does_not_take_the_rounding_of_its_first_caller() -> None:
    """Each compiled function states its own fastmath and forceinline.

    numba passes these options of the first caller on to functions that do not state them.
    """
    for compile_ in (_compile.compiled, _compile.inlined, _compile.exact, _compile.threaded):
        options = compile_(lambda x: x * x).targetoptions  # type: ignore[attr-defined]
        assert {"fastmath", "forceinline"} <= options.keys()


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="rights of POSIX")
@pytest.mark.parametrize("opened", ["folder", "index", "data"])
def test_files_that_others_can_write_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opened: str) -> None:
    """A cached kernel that others can write is compiled again, and the new files are not writable by others.

    The run after it reads the new files.
    """
    monkeypatch.setattr(numba.core.config, "CACHE_DIR", str(tmp_path))

    def runs() -> int:
        """Return the kernels read from disk by a new kernel."""
        kernel = _compile.compiled(_doubled)
        assert isinstance(kernel, Kernel)
        assert kernel(2.0) == 4.0
        return sum(kernel.stats.cache_hits.values())

    assert (runs(), runs()) == (0, 1)
    (index,), (data,) = tmp_path.rglob("*.nbi"), tmp_path.rglob("*.nbc")
    {"folder": index.parent, "index": index, "data": data}[opened].chmod(0o777)
    assert runs() == 0
    assert all(not path.stat().st_mode & 0o022 for path in (index.parent, index, data))
    assert runs() == 1


def _doubled(x: float) -> float:
    return 2.0 * x
