"""Kernels as plain Python, for few rows: compiling takes a second, a loop in Python a millisecond.

The same functions run with the same operations in the same order and give the same bits (tests). Results do not depend
on the number of rows or on the kernels that are compiled already.

Maps on scalars without branches also take arrays with one number per row (:func:`plain`).
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

#: Largest number of elements for which a loop runs in Python; of rows for which arrays are passed to a map on scalars.
FEW: Final = 256
FEW_ARRAYS: Final = 1024
#: Number of calls after which the compiled loop is also used for few numbers: frequent calls repay the compilation.
OFTEN: Final = 24
_ON_ARRAYS: dict[str, Any] = {}


def on_arrays(other: Any) -> Callable[[F], F]:
    """Declare the function that replaces a function with a branch if its arguments are arrays."""

    def note(function: F) -> F:
        _ON_ARRAYS[f"{function.__module__}.{function.__qualname__}"] = other
        return function

    return note


@cache
def plain(function: Any) -> Any:
    """Plain Python form of a kernel; the kernels that it calls are plain Python, too."""
    inner = getattr(function, "py_func", function)
    if (replaced := _ON_ARRAYS.get(f"{inner.__module__}.{inner.__qualname__}")) is not None:
        return replaced
    space, bound = inner.__globals__, dict[str, Any]({"__builtins__": builtins})
    out = FunctionType(inner.__code__, bound, inner.__name__, inner.__defaults__, inner.__closure__)
    for name in names_of(inner.__code__):  # with those of attributes, of which one may be that of the kernel
        if name in space:
            bound[name] = out if space[name] is function else _plain_member(space[name])
    return out


def few_in_python(kernel: F) -> F:
    """Run the first calls of a kernel as plain Python if none of its arrays has more than :data:`FEW` numbers."""
    calls = count()

    @wraps(getattr(kernel, "py_func", kernel))
    def choose(*arguments: Any) -> Any:
        if max(a.size for a in arguments if isinstance(a, np.ndarray)) > FEW or next(calls) > OFTEN:
            return kernel(*arguments)
        with np.errstate(all="ignore"):  # as compiled code does
            return plain(kernel)(*arguments)

    return cast(F, choose)


class _Members:
    """Module with its kernels as plain Python."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return _plain_member(getattr(self._module, name))


def _plain_member(value: Any) -> Any:
    """Value of a name for the plain Python form."""
    if isinstance(value, ModuleType):
        return _Members(value) if _is_ours(value.__name__) else value
    function = getattr(value, "py_func", value)
    return plain(value) if isinstance(function, FunctionType) and _is_ours(function.__module__) else value


def _is_ours(module: str | None) -> bool:
    """Whether a module is not a library: kernels may be defined in any package."""
    return (module or "").partition(".")[0] not in LIBRARIES
