"""Kernels: functions that numba compiles as a whole at their first call, cached with a digest of their sources.

Plain numba optimises each function that a kernel calls, turns it into machine code that is never called, and repeats
this inside each caller: half the time of a first run. Here a function that kernels call is a *part*: it is translated
once and linked into kernels. A kernel is optimised once, together with its parts, and becomes machine code.

This module extends internal classes of numba, which may change: pyproject.toml bounds the version of numba.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any, Final, NamedTuple

from numba.core import compiler, sigutils, typing
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.environment import Environment
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime.nrt import rtsys

from factors._libraries import Flags, KernelLibrary, PartLibrary, Result, Steps, signatures_kept
from factors._preparation import preparing, report_compilation
from factors._sources import stamp

#: Right to write of the group and of others.
_OF_OTHERS: Final = stat.S_IWGRP | stat.S_IWOTH


class _Part(NamedTuple):
    """Function in the form in which other kernels call it."""

    key: object
    result: Any


@cache
def _flags(fastmath: str, forceinline: bool) -> Flags:
    """Options of a part; one object for equal options, so that numba's own compiled functions are shared."""
    flags = Flags()
    options = {"nopython": True, "error_model": "numpy", "forceinline": forceinline,
               "fastmath": {fastmath} if fastmath else False}  # fmt: skip
    cpu_target.options.parse_as_flags(flags, options)
    flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
    return flags


class _KernelCompiler(_FunctionCompiler):  # type: ignore[misc]
    """Compiles parts, and kernels from them."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.parts: dict[tuple[Any, ...], _Part] = {}
        self.vectorised = False

    def part(self, args: tuple[Any, ...]) -> _Part:
        """Part for one tuple of argument types, to be linked into kernels."""
        if args not in self.parts:
            context, options = self.targetdescr.target_context, self.targetoptions
            library = PartLibrary(context.codegen(), self.py_func.__qualname__)
            result = compiler.compile_extra(
                self.targetdescr.typing_context, context, self.py_func, args, None,
                _flags(*(options["fastmath"] or ("",)), options["forceinline"]), {}, library,
                pipeline_class=self.pipeline_class,
            )  # fmt: skip
            # by this name numba would give the same function, loaded from disk, the constants of the part: none
            Environment._memo.pop(result.fndesc.env_name, None)
            part = _Part(object(), result)
            context.insert_user_function(part.key, result.fndesc, [library])
            self.parts[args] = part
        return self.parts[args]

    def _compile_core(self, args: tuple[Any, ...], return_type: Any) -> Any:
        report_compilation(self.py_func.__name__)
        result = self.part(tuple(args)).result
        context = result.target_context  # with the options of the part
        library = KernelLibrary(context.codegen(), result.fndesc.qualname)
        library.vectorised = self.vectorised
        library.enable_object_caching()
        library.add_linking_library(result.library)
        with context.push_code_library(library):
            context.create_cpython_wrapper(
                library, result.fndesc, result.environment, result.call_helper, release_gil=self.targetoptions["nogil"]
            )
        entry = context.get_executable(library, result.fndesc, result.environment)
        return Result(*result._replace(library=library, entry_point=entry))


class _PrivateFiles(IndexDataCacheFile):  # type: ignore[misc]
    """Files of a kernel that no other user can have written: they hold pickled code, which is run.

    Folders and files of other users, or that others can write, are not read. In our own ones, writing takes this right
    from others, so that also under a umask of 002 the next run reads them.
    """

    def _load_index(self) -> Any:
        if os.path.exists(self._index_path) and not (_is_private(self._cache_path) and _is_private(self._index_path)):
            return {}
        return super()._load_index()

    def _load_data(self, name: str) -> Any:
        if not _is_private(self._data_path(name)):
            raise PermissionError(self._data_path(name))
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        _make_private(self._cache_path)
        if not _is_private(self._cache_path):
            raise PermissionError(self._cache_path)
        with super()._open_for_write(filepath) as stream:
            yield stream
        _make_private(filepath)


def _is_private(path: str) -> bool:
    """Whether only this user, root or the owner of the program can write a file or folder."""
    if not hasattr(os, "getuid"):  # Windows: a user's folders are private
        return True
    status = os.stat(path)
    return status.st_uid in (os.getuid(), 0, os.stat(__file__).st_uid) and not status.st_mode & _OF_OTHERS


def _make_private(path: str) -> None:
    """Take the right to write from others, if the file or folder is ours."""
    status = os.stat(path)
    if status.st_mode & _OF_OTHERS and hasattr(os, "getuid") and status.st_uid == os.getuid():
        os.chmod(path, stat.S_IMODE(status.st_mode) & ~_OF_OTHERS)


class _Cache(FunctionCache):  # type: ignore[misc]
    """Kernels on disk; if a file cannot be read or written, the kernel is compiled and the run continues."""

    def load_overload(self, signature: Any, context: Any) -> Any:
        try:  # with numba's memory management, without its registries of compilable functions: half the time
            rtsys.initialize(context)
            return self._load_overload(signature, context)
        except Exception:  # a damaged file may fail in any way; it is written again
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        try:
            super().save_overload(signature, result)
        except OSError:  # the disk is full, or the permissions have changed
            self.disable()


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A compiled function: as a whole for Python, as a part for other kernels."""

    def __init__(self, py_func: Any, vectorised: bool = False, **options: Any) -> None:
        super().__init__(py_func, **options)
        self._compiler = _KernelCompiler(py_func, self.targetdescr, self.targetoptions, {}, Steps)
        self._compiler.vectorised = vectorised
        self._opened = False

    def compile(self, signature: Any) -> Any:
        """Machine code for one signature, from disk or compiled."""
        with global_compiler_lock, preparing(), signatures_kept(self.targetdescr.typing_context):
            self.open_cache()
            return super().compile(signature)

    def open_cache(self) -> _Cache | None:
        """Files of this kernel, or None if no folder is writable; opened late, because numba tries each folder."""
        if not self._opened:
            self._opened = True
            with suppress(RuntimeError):  # no folder is writable
                self._cache = _Cache(self.py_func)
                file = self._cache._cache_file
                self._cache._cache_file = _PrivateFiles(
                    file._cache_path, file._index_name.removesuffix(".nbi"), stamp(self.py_func, self.targetoptions)
                )
        return self._cache if isinstance(self._cache, _Cache) else None

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type of the part for a call by another kernel."""
        signature, types = self._compiler.fold_argument_types(args, kws)
        result = self._compiler.part(tuple(types)).result
        name = self.py_func.__name__
        template = typing.make_concrete_template(f"CallTemplate({name})", key=name, signatures=[result.signature])
        return template, signature, types, {}

    def get_overload(self, signature: Any) -> object:
        """Key of the part for the signature of a call."""
        return self._compiler.part(tuple(sigutils.normalize_signature(signature)[0])).key
