"""Digest of everything compiled into a kernel: its code, the code of all called functions, and their constants.

A name is resolved to its value at run time. Therefore the form of an import does not
matter: ``import factors.x``, ``from factors.sub import x as y``, an import inside ``if``
or ``try``. The digest contains the byte code of functions, the used members of modules,
and the values of other names. The code of libraries is not included.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import numpy as np

#: Top-level packages that are not followed: numba's own cache checks its version, and
#: numpy is not compiled into kernels.
LIBRARIES: Final = frozenset({"numba", "llvmlite", "numpy", "scipy", *sys.stdlib_module_names})


def stamp(function: FunctionType, options: object = None) -> bytes:
    """Return the digest of a function, all functions that it calls, the constants that they use, and ``options``."""
    digest, seen, waiting = hashlib.sha256(_own() + repr(options).encode()), set[int](), [function]
    while waiting:
        current = waiting.pop()
        if id(current) in seen:
            continue
        seen.add(id(current))
        parts, callees = _read(current)
        digest.update(parts)
        waiting += callees
    return digest.digest()


@cache
def _own() -> bytes:
    """Return the digest of the source files that determine how kernels are compiled."""
    here = Path(__file__)
    return hashlib.sha256(
        b"".join(here.with_name(f"_{n}.py").read_bytes() for n in ("compile", "kernel", "libraries"))
    ).digest()


@cache
def _read(function: FunctionType) -> tuple[bytes, list[FunctionType]]:
    """Return the digest of one function and its named constants, and the functions that it names."""
    digest, callees = hashlib.sha256(_code(function.__code__)), []
    for name, value in _bound(function):
        callee = _function_of(value)
        if callee is None:
            digest.update(f"{name}={_constant(value)};".encode())
        elif _is_followed(callee):
            options = getattr(value, "targetoptions", None)
            digest.update(f"{name}:{callee.__module__}.{callee.__qualname__}{options};".encode())
            callees.append(callee)
    return digest.digest(), callees


def _bound(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield names in a function's code with their values: globals, members of modules, variables of a closure."""
    names = names_of(function.__code__)
    for cell, name in zip(function.__closure__ or (), function.__code__.co_freevars, strict=True):
        yield name, cell.cell_contents
    yield "defaults", function.__defaults__
    spaces, seen = [("", function.__globals__)], set[int]()
    while spaces:
        prefix, space = spaces.pop()
        for name in names:
            if name not in space:
                continue
            value = space[name]
            if not isinstance(value, ModuleType):
                yield prefix + name, value
            elif id(value) not in seen and value.__name__.partition(".")[0] not in LIBRARIES:
                seen.add(id(value))
                spaces.append((f"{value.__name__}.", vars(value)))


def names_of(code: CodeType) -> list[str]:
    """Return the global names and attributes of a code and its inner functions, in their order."""
    names = dict.fromkeys(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= dict.fromkeys(names_of(constant))
    return list(names)


def _code(code: CodeType) -> bytes:
    """Return byte code and constants, without file name, line numbers and docstring."""
    constants = [_literal(c) for c in code.co_consts]
    if code.co_consts and isinstance(code.co_consts[0], str):
        constants[0] = ""  # a docstring has no effect
    return repr((code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars)).encode()


def _literal(constant: Any) -> str:
    """Return a text of a constant that is the same in every run, although sets have no order."""
    if isinstance(constant, CodeType):
        return _code(constant).hex()
    if isinstance(constant, tuple | frozenset):
        parts = [_literal(item) for item in constant]
        return f"{type(constant).__name__}{parts if isinstance(constant, tuple) else sorted(parts)}"
    return repr(constant)


def _function_of(value: Any) -> FunctionType | None:
    """Return the Python function of a function, kernel or numba intrinsic; None for anything else."""
    for inner in (value, getattr(value, "py_func", None), getattr(value, "_defn", None)):
        if isinstance(inner, FunctionType):
            return inner
    return None


def _is_followed(function: FunctionType) -> bool:
    return (function.__module__ or "").partition(".")[0] not in LIBRARIES


def _constant(value: Any) -> str:
    """Return a text of a value that is the same in every run."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | slice | np.generic):
        return repr(value)
    if isinstance(value, tuple | list):
        return f"({','.join(_constant(item) for item in value)})"
    if isinstance(value, dict):
        return f"{{{','.join(f'{key!r}:{_constant(item)}' for key, item in value.items())}}}"
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"
