"""Loading of a user's own file by the command line: it registers sensors, equations, solvers, kappa rules and losses.

The command line imports the file of its option ``plugin`` before the command begins; Python code imports it as any
other module. Nothing else loads code, so a project file from another source cannot do so.
"""

from __future__ import annotations

import sys
import traceback
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from fg_orient.model.errors import FgOrientError, Finding, InputError, finding
from fg_orient.model.paths import require_path

#: Loaded files, with the names that tracebacks contain.
_LOADED: set[str] = set()


def load_plugin(path: str | Path) -> ModuleType:
    """Import a Python file under its own name, only once.

    The path must be ``NAME.py``, and no other module may be called NAME. Its folder is added to the end of
    ``sys.path``, so that worker processes find the module. If the file cannot be imported, the InputError names the
    line.
    """
    require_path(path)
    path = Path(path).resolve()
    if not path.is_file() or path.suffix != ".py" or not path.stem.isidentifier():
        raise InputError.of("plugin.file", file=path, option="plugin")
    present = sys.modules.get(path.stem)
    if present is not None and getattr(present, "__file__", None) == str(path):
        return present
    other = present or find_spec(path.stem)
    if other is not None:
        known = getattr(other, "origin", None) or getattr(other, "__file__", "")
        if known != str(path):
            raise InputError.of("plugin.name", file=path, option="plugin", value=path.stem)
    return _imported(path)


def _imported(path: Path) -> ModuleType:
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None  # this is always true for a file that ends in .py
    module = sys.modules[path.stem] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    # SystemExit too, because a script that calls exit would otherwise end the command
    except (Exception, SystemExit) as error:
        del sys.modules[path.stem]
        value = error if isinstance(error, FgOrientError) else told(error)
        raise InputError.of("plugin.failed", file=path, place=_line(error, path), value=value) from error
    _LOADED.add(str(path))
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    return module


def fault_of(error: BaseException) -> Finding | None:
    """Return the finding of an exception other than ``FgOrientError``; None if it did not come from a plugin."""
    file = next((name for name, _ in reversed(_frames(error)) if name in _LOADED), None)
    if file is None:
        return None
    return finding("plugin.raised", file=file, place=_line(error, Path(file)), value=told(error))


def raised_in(error: BaseException, file: str) -> str:
    """Return file and line of the user's code that raised an exception.

    If a built-in function raised the exception, return only the file.
    """
    return f"{file}, {_line(error, Path(file))}" if file in dict(_frames(error)) else file


def told(error: BaseException) -> str:
    """Return class and text of an exception as one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _frames(error: BaseException) -> list[tuple[str, int]]:
    """Return the files and lines through which an exception passed, innermost last."""
    return [(frame.f_code.co_filename, line) for frame, line in traceback.walk_tb(error.__traceback__)]


def _line(error: BaseException, path: Path) -> str:
    """Return the last line of the file through which the error passed.

    For a syntax error, return the line of the error itself.
    """
    if isinstance(error, SyntaxError) and error.filename == str(path):
        return f"line {error.lineno}"
    lines = [line for file, line in _frames(error) if file == str(path)]
    return f"line {lines[-1]}" if lines else "<plugin>"
