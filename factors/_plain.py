"""Kernels run as plain Python for few rows, where a loop takes a millisecond but compiling takes a second.

The same functions execute the same operations in the same order and give the same bits (tested). So results depend
neither on the number of rows nor on which kernels are already compiled.

Scalar maps without branches also accept arrays with one number per row (:func:`plain`).
"""

from __future__ import annotations

import builtins
from collections.abc import Callable
from functools import cache, wraps
from itertools import count
from types import FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast

import numpy as np

from factors._sources import LIBRARIES, names_of

F = TypeVar("F", bound=Callable[..., Any])

#: A loop runs in Python if an array has at most this number of elements. Arrays are passed to
#: a scalar map if they have at most this number of rows.
FEW: Final = 256
FEW_ARRAYS: Final = 1024
#: Number of calls after which the compiled loop is used even for few numbers, because frequent calls repay compilation.
OFTEN: Final = 24
_ON_ARRAYS: dict[str, Any] = {}


def on_arrays(other: Any) -> Callable[[F], F]:
    """Declare the function that is used for arrays instead of a scalar function with a branch."""

    def note(function: F) -> F:
        _ON_ARRAYS[f"{function.__module__}.{function.__qualname__}"] = other
        return function

    return note


@cache
def plain(function: Any) -> Any:
    """Return the plain Python form of a kernel and of the kernels that it calls."""
    inner = getattr(function, "py_func", function)
    if (replaced := _ON_ARRAYS.get(f"{inner.__module__}.{inner.__qualname__}")) is not None:
        return replaced
    space, bound = inner.__globals__, dict[str, Any]({"__builtins__": builtins})
    out = FunctionType(inner.__code__, bound, inner.__name__, inner.__defaults__, inner.__closure__)
    for name in names_of(inner.__code__):  # the names include attributes of modules, which may be kernels
        if name in space:
            bound[name] = out if space[name] is function else _plain_member(space[name])
    return out


def few_in_python(kernel: F) -> F:
    """Run the first calls of a kernel as plain Python, if none of its arrays has more than :data:`FEW` numbers."""
    calls = count()

    @wraps(getattr(kernel, "py_func", kernel))
    def choose(*arguments: Any) -> Any:
        if max(a.size for a in arguments if isinstance(a, np.ndarray)) > FEW or next(calls) > OFTEN:
            return kernel(*arguments)
        with np.errstate(all="ignore"):  # without warnings of numpy, as in compiled code
            return plain(kernel)(*arguments)

    return cast(F, choose)


class _Members:
    """Proxy of a module that returns the module's kernels as plain Python."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return _plain_member(getattr(self._module, name))


def _plain_member(value: Any) -> Any:
    """Return the value of a name in plain Python form."""
    if isinstance(value, ModuleType):
        return _Members(value) if _is_ours(value.__name__) else value
    function = getattr(value, "py_func", value)
    return plain(value) if isinstance(function, FunctionType) and _is_ours(function.__module__) else value


def _is_ours(module: str | None) -> bool:
    """Return whether a module may contain kernels: any module except numpy, numba and the standard library."""
    return (module or "").partition(".")[0] not in LIBRARIES
