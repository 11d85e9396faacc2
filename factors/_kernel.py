"""Kernels: functions that numba compiles as a whole at their first call, and stores with a digest of their sources.

Plain numba makes unused machine code for each function that a kernel calls, again for each caller. This
takes half the time of a first run. Here a function that kernels call is a *part*: it is translated once
and linked into the kernels. A kernel and its parts become machine code once.

This module extends internal classes of numba, which may change; therefore pyproject.toml limits the version of numba.
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

#: Write permission for the group and for others.
_OF_OTHERS: Final = stat.S_IWGRP | stat.S_IWOTH


class _Part(NamedTuple):
    """Function in the form that other kernels call."""

    key: object
    result: Any


@cache
def _flags(fastmath: str, forceinline: bool) -> Flags:
    """Return the options of a part.

    Equal options are the same object, so that numba's compiled functions are shared.
    """
    flags = Flags()
    options = {"nopython": True, "error_model": "numpy", "forceinline": forceinline,
               "fastmath": {fastmath} if fastmath else False}  # fmt: skip
    cpu_target.options.parse_as_flags(flags, options)
    flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
    return flags


class _KernelCompiler(_FunctionCompiler):  # type: ignore[misc]
    """The compiler makes parts, and kernels from parts."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.parts: dict[tuple[Any, ...], _Part] = {}
        self.vectorised = False

    def part(self, args: tuple[Any, ...]) -> _Part:
        """Return the part for one tuple of argument types, ready to be linked into kernels."""
        if args not in self.parts:
            context, options = self.targetdescr.target_context, self.targetoptions
            library = PartLibrary(context.codegen(), self.py_func.__qualname__)
            result = compiler.compile_extra(
                self.targetdescr.typing_context, context, self.py_func, args, None,
                _flags(*(options["fastmath"] or ("",)), options["forceinline"]), {}, library,
                pipeline_class=self.pipeline_class,
            )  # fmt: skip
            # numba would otherwise use the constants of the part, which has none, in the function loaded from disk
            Environment._memo.pop(result.fndesc.env_name, None)
            part = _Part(object(), result)
            context.insert_user_function(part.key, result.fndesc, [library])
            self.parts[args] = part
        return self.parts[args]

    def _compile_core(self, args: tuple[Any, ...], return_type: Any) -> Any:
        report_compilation(self.py_func.__name__)
        result = self.part(tuple(args)).result
        context = result.target_context  # this context includes the compiler options of the part
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
    """Files of a kernel.

    They contain code that is executed, so they are read only if no other user can have written them.

    Folders and files that belong to other users, or that others can write, are not read. After writing our own files,
    write permission is removed from others, so that the next run reads them even under a umask of 002.
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
    """Return whether only this user, root or the owner of the program can write a file or folder."""
    if not hasattr(os, "getuid"):  # on Windows the folders of a user are private
        return True
    status = os.stat(path)
    return status.st_uid in (os.getuid(), 0, os.stat(__file__).st_uid) and not status.st_mode & _OF_OTHERS


def _make_private(path: str) -> None:
    """Remove write permission for others, if the file or folder is ours."""
    status = os.stat(path)
    if status.st_mode & _OF_OTHERS and hasattr(os, "getuid") and status.st_uid == os.getuid():
        os.chmod(path, stat.S_IMODE(status.st_mode) & ~_OF_OTHERS)


class _Cache(FunctionCache):  # type: ignore[misc]
    """Cache of kernels on disk. If a file cannot be read or written, the kernel is compiled and the run continues."""

    def load_overload(self, signature: Any, context: Any) -> Any:
        try:  # only numba's memory management: its registries of functions would double the time
            rtsys.initialize(context)
            return self._load_overload(signature, context)
        except Exception:  # a damaged file may fail in any way; it is rewritten
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        try:
            super().save_overload(signature, result)
        except OSError:  # the disk is full, or the permissions have changed
            self.disable()


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """Compiled function that Python can call, and that other kernels can link as a part."""

    def __init__(self, py_func: Any, vectorised: bool = False, **options: Any) -> None:
        super().__init__(py_func, **options)
        self._compiler = _KernelCompiler(py_func, self.targetdescr, self.targetoptions, {}, Steps)
        self._compiler.vectorised = vectorised
        self._opened = False

    def compile(self, signature: Any) -> Any:
        """Return the machine code for one signature, from disk or newly compiled."""
        with global_compiler_lock, preparing(), signatures_kept(self.targetdescr.typing_context):
            self.open_cache()
            return super().compile(signature)

    def open_cache(self) -> _Cache | None:
        """Open the files of this kernel; return None if no folder is writable.

        The files are opened at the first call, not at import, because numba tests each folder.
        """
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
        """Return the type of the part for a call by another kernel."""
        signature, types = self._compiler.fold_argument_types(args, kws)
        result = self._compiler.part(tuple(types)).result
        name = self.py_func.__name__
        template = typing.make_concrete_template(f"CallTemplate({name})", key=name, signatures=[result.signature])
        return template, signature, types, {}

    def get_overload(self, signature: Any) -> object:
        """Return the key of the part for the signature of a call."""
        return self._compiler.part(tuple(sigutils.normalize_signature(signature)[0])).key
