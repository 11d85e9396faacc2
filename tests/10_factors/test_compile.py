"""Cached code is valid for the sources it was made of."""

from __future__ import annotations

from pathlib import Path

import pytest

from factors import _compile, batch_pairs, batch_pushbroom, light, pushbroom
from factors._compile import stamp

FOLDER = Path(_compile.__file__).parent


def test_stamp_knows_the_files_that_are_compiled_into_a_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = {
        "kernel": "from factors.middle import f\n",
        "middle": "from factors import (\n    other,\n    leaf,\n)\n",
        "leaf": "x = 1\n", "other": "", "stranger": "x = 1\n",
    }  # fmt: skip
    monkeypatch.setattr(_compile, "_HERE", tmp_path)

    def stamped(**changed: str) -> bytes:
        for name, text in (sources | changed).items():
            (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        _compile._digest.cache_clear()
        _compile._imported.cache_clear()
        return stamp(tmp_path / "kernel.py")

    before = stamped()
    assert stamped(leaf="x = 2\n") != before
    assert stamped(other="y = 2\n") != before
    assert stamped(stranger="x = 2\n") == before
    _compile._digest.cache_clear()
    _compile._imported.cache_clear()


@pytest.mark.parametrize(
    ("kernel", "callee"),
    [(batch_pairs.pair_blocks, "vectors"), (batch_pushbroom.pushbroom_rows, "rotations"), (pushbroom.kernel, "sight")],
)
def test_numba_uses_the_stamp(kernel: object, callee: str) -> None:
    """Fails when a release of numba keeps it elsewhere."""
    file = Path(kernel.py_func.__code__.co_filename)  # type: ignore[attr-defined]
    assert kernel._cache._cache_file._source_stamp == stamp(file)  # type: ignore[attr-defined]
    waiting, seen = [file], {file}
    while waiting:
        new = _compile._imported(waiting.pop()) - seen
        seen |= new
        waiting += new
    assert FOLDER / f"{callee}.py" in seen
    assert Path(light.__file__) not in seen


def test_a_function_does_not_take_the_rounding_of_its_first_caller() -> None:
    """Numba hands fastmath and forceinline on to functions that say nothing and are compiled for a caller."""
    for compile_ in (_compile.compiled, _compile.inlined, _compile.exact, _compile.threaded):
        options = compile_(lambda x: x * x).targetoptions  # type: ignore[attr-defined]
        assert {"fastmath", "forceinline"} <= options.keys()
