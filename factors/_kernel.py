"""Kernels: functions that numba compiles once, whole, when they are called, and that are kept with their sources.

numba by itself optimises each function that a kernel calls alone, turns it into machine code that nobody calls, and
does all that again inside each caller: half of the first run's time. Here a function that kernels call is a *part*:
translated once and linked into kernels. A kernel is optimised once, together with its parts, and becomes machine code.

Classes of numba are extended at places that it does not promise to keep: pyproject.toml bounds its version.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from typing import Any, Final, NamedTuple

from llvmlite import binding
from numba.core import codegen, compiler, sigutils, typing
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime.nrt import rtsys

from factors._preparation import preparing, tell
from factors._sources import stamp


class _Flags(compiler.Flags):  # type: ignore[misc]
    """Options of the compiler that are equal only if they are the same; numba compares them thousands of times."""

    __slots__ = ()
    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other

    def copy(self) -> _Flags:
        return self


#: Begin of the names under which a function keeps its Python constants.
_CONSTANTS: Final = "_ZN08NumbaEnv"


class _Result(compiler.CompileResult):  # type: ignore[misc]
    """A compiled kernel; on disk goes what it needs itself, and nothing of its parts."""

    __slots__ = ()

    def _find_referenced_environments(self) -> list[Any]:
        return []  # its own is kept apart


class _Part(NamedTuple):
    """A function as other kernels call it."""

    key: object
    result: Any


class _PartLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Code that is only linked into kernels: neither optimised nor turned into machine code by itself."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Code to be linked; each kernel has a place for constants of its own, or a later one would find it empty."""
        if self._shared_module is None:
            module = super()._get_module_for_linking()
            for variable in module.global_variables:
                if variable.name.startswith(_CONSTANTS):
                    variable.linkage = "internal"
        return self._shared_module


class _KernelLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """A kernel with all its parts, optimised once."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    vectorised: bool = False

    def _optimize_final_module(self) -> None:
        # a loop over observations that calls a whole equation becomes vector instructions only if all is put into one
        # and simplified first; for other kernels that brings nothing and costs a tenth of the first run (measured)
        first: dict[str, Any] = {"opt": 1, "loop_vectorize": False, "slp_vectorize": False}
        for options in (first, {}) if self.vectorised else ({},):
            passes, builder = self._codegen._module_pass_manager(**options)
            passes.run(self._final_module, builder)

    def finalize(self) -> None:
        libraries, waiting = dict[Any, None](), list(self._linking_libraries)
        while waiting:
            library = waiting.pop()
            if library not in libraries:
                libraries[library] = None
                waiting += library._linking_libraries if isinstance(library, _PartLibrary) else ()
        self._linking_libraries: list[Any] = list(libraries)
        super().finalize()

    def serialize_using_object_code(self) -> Any:
        """Machine code, and of the intermediate one only that the functions are there: parts are never loaded."""
        names = [function.name for function in self.get_defined_functions()]
        text = "".join(f'define void @"{name}"() {{ ret void }}\n' for name in names)
        return self.name, "object", (self._get_compiled_object(), binding.parse_assembly(text).as_bitcode())


@cache
def _flags(fastmath: str, forceinline: bool) -> _Flags:
    """Options of a part; functions with the same ones share what numba compiles for its own."""
    flags = _Flags()
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
        """Function for one tuple of argument types, to be linked into others."""
        if args not in self.parts:
            context, options = self.targetdescr.target_context, self.targetoptions
            library = _PartLibrary(context.codegen(), self.py_func.__qualname__)
            result = compiler.compile_extra(
                self.targetdescr.typing_context, context, self.py_func, args, None,
                _flags(*(options["fastmath"] or ("",)), options["forceinline"]), {}, library,
                pipeline_class=self.pipeline_class,
            )  # fmt: skip
            part = _Part(object(), result)
            context.insert_user_function(part.key, result.fndesc, [library])
            self.parts[args] = part
        return self.parts[args]

    def _compile_core(self, args: tuple[Any, ...], return_type: Any) -> Any:
        tell(self.py_func.__name__)
        result = self.part(tuple(args)).result
        context = result.target_context  # with the options of the part
        library = _KernelLibrary(context.codegen(), result.fndesc.qualname)
        library.vectorised = self.vectorised
        library.enable_object_caching()
        library.add_linking_library(result.library)
        with context.push_code_library(library):
            context.create_cpython_wrapper(
                library, result.fndesc, result.environment, result.call_helper, release_gil=self.targetoptions["nogil"]
            )
        entry = context.get_executable(library, result.fndesc, result.environment)
        return _Result(*result._replace(library=library, entry_point=entry))


class _Cache(FunctionCache):  # type: ignore[misc]
    """Kernels on disk; what cannot be read or written is compiled, and the run goes on."""

    def load_overload(self, signature: Any, context: Any) -> Any:
        try:  # with numba's memory management, but without the registries of what it can compile: half the time
            rtsys.initialize(context)
            return self._load_overload(signature, context)
        except Exception:  # a damaged file may fail in any way, and is written anew
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        try:
            super().save_overload(signature, result)
        except OSError:  # the disk is full, or its rights have changed
            self.disable()


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A compiled function: as a whole for Python, as a part for other kernels."""

    def __init__(self, py_func: Any, vectorised: bool = False, **options: Any) -> None:
        super().__init__(py_func, **options)
        self._compiler = _KernelCompiler(py_func, self.targetdescr, self.targetoptions, {}, compiler.Compiler)
        self._compiler.vectorised = vectorised
        self._opened = False

    def compile(self, signature: Any) -> Any:
        """Machine code for one signature, from disk or compiled."""
        with global_compiler_lock, preparing():
            self.open_cache()
            return super().compile(signature)

    def open_cache(self) -> _Cache | None:
        """Files of this kernel, or None where no place is writable; opened late, since numba tries each place."""
        if not self._opened:
            self._opened = True
            with suppress(RuntimeError):  # no place is writable
                self._cache = _Cache(self.py_func)
                self._cache._cache_file._source_stamp = stamp(self.py_func, self.targetoptions)
        return self._cache if isinstance(self._cache, _Cache) else None

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type of the part that a call by another kernel takes."""
        signature, types = self._compiler.fold_argument_types(args, kws)
        result = self._compiler.part(tuple(types)).result
        name = self.py_func.__name__
        template = typing.make_concrete_template(f"CallTemplate({name})", key=name, signatures=[result.signature])
        return template, signature, types, {}

    def get_overload(self, signature: Any) -> object:
        """Key of the part for the signature of a call."""
        return self._compiler.part(tuple(sigutils.normalize_signature(signature)[0])).key
