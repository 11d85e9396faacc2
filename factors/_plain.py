"""Kernels as plain Python, for the few rows where compiling costs a second and a loop of Python a millisecond.

The same functions run, with the same operations in the same order, and give the same bits (tests): results depend
neither on the number of rows nor on what is compiled already.

Maps on scalars that have no branches take arrays as well, a number for each row (:func:`plain`).
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

#: Numbers up to which a loop runs in Python, and rows up to which arrays go through a map on scalars.
FEW: Final = 256
FEW_ARRAYS: Final = 1024
#: Calls after which the compiled loop serves few numbers, too: a program that calls so often is worth compiling for.
OFTEN: Final = 24
_ON_ARRAYS: dict[str, Any] = {}


def on_arrays(other: Any) -> Callable[[F], F]:
    """Say what takes the place of a function with a branch where its arguments are arrays."""

    def note(function: F) -> F:
        _ON_ARRAYS[f"{function.__module__}.{function.__qualname__}"] = other
        return function

    return note


@cache
def plain(function: Any) -> Any:
    """Form of a kernel in Python; so are the kernels that it calls."""
    inner = getattr(function, "py_func", function)
    if (replaced := _ON_ARRAYS.get(f"{inner.__module__}.{inner.__qualname__}")) is not None:
        return replaced
    space = inner.__globals__
    bound = {name: _plain_member(space[name]) for name in names_of(inner.__code__) if name in space}
    bound["__builtins__"] = builtins
    return FunctionType(inner.__code__, bound, inner.__name__, inner.__defaults__, inner.__closure__)


def few_in_python(kernel: F) -> F:
    """Run a kernel as plain Python the first times, where none of its arrays has more than :data:`FEW` numbers."""
    calls = count()

    @wraps(getattr(kernel, "py_func", kernel))
    def choose(*arguments: Any) -> Any:
        if max(a.size for a in arguments if isinstance(a, np.ndarray)) > FEW or next(calls) > OFTEN:
            return kernel(*arguments)
        with np.errstate(all="ignore"):  # as compiled code does
            return plain(kernel)(*arguments)

    return cast(F, choose)


class _Members:
    """A module whose kernels are plain Python."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return _plain_member(getattr(self._module, name))


def _plain_member(value: Any) -> Any:
    """What a name is bound to, as the form in Python needs it."""
    if isinstance(value, ModuleType):
        return _Members(value) if _is_ours(value.__name__) else value
    function = getattr(value, "py_func", value)
    return plain(value) if isinstance(function, FunctionType) and _is_ours(function.__module__) else value


def _is_ours(module: str | None) -> bool:
    """Whether a module is none of the libraries: kernels may lie in any package."""
    return (module or "").partition(".")[0] not in LIBRARIES
