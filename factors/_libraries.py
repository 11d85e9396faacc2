"""Extended classes of numba's compiler: options compared by identity, cached types, and code to link or execute.

``factors._kernel`` uses them to make kernels.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from llvmlite import binding
from numba.core import codegen, compiler, typed_passes, types, untyped_passes


class Flags(compiler.Flags):  # type: ignore[misc]
    """Compiler options that are equal only if they are the same object.

    This comparison is fast, and numba compares options thousands of times.
    """

    __slots__ = ()
    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other

    def copy(self) -> Flags:
        return self


#: Signatures of operations on numbers; the key contains the identities (``id``) of
#: operation and types. The objects are stored too, so that Python cannot use their
#: identities for other objects.
_SIGNATURES: Final[dict[tuple[int, ...], tuple[Any, ...]]] = {}


@contextmanager
def signatures_kept(context: Any) -> Iterator[None]:
    """Cache the types of operations on numbers.

    Otherwise numba tries all its templates for each product of two floats.
    """
    if "resolve_function_type" in vars(context):
        yield
        return
    resolve = context.resolve_function_type

    def resolved(function: Any, arguments: Any, keywords: Any) -> Any:
        numbers = not keywords and all(isinstance(a, types.Number) for a in arguments)
        if not numbers or isinstance(function, types.Dispatcher):
            return resolve(function, arguments, keywords)
        key = (id(function), *map(id, arguments))
        if key not in _SIGNATURES:
            _SIGNATURES[key] = resolve(function, arguments, keywords), function, arguments
        return _SIGNATURES[key][0]

    context.resolve_function_type = resolved
    try:
        yield
    finally:
        del context.resolve_function_type


#: Compiler steps for constructs that this package does not use: closures, ``with``,
#: expressions of whole arrays, loops over tuples of several types. Each step visits the
#: whole function, and most steps count the uses of all variables.
_NOT_NEEDED: Final = frozenset({
    typed_passes.InlineOverloads, typed_passes.NopythonRewrites, untyped_passes.FindLiterallyCalls,
    untyped_passes.InlineClosureLikes, untyped_passes.InlineInlinables, untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass, untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.RewriteDynamicRaises, untyped_passes.WithLifting,
})  # fmt: skip


class Steps(compiler.Compiler):  # type: ignore[misc]
    """numba's compiler without unnecessary steps."""

    def define_pipelines(self) -> list[Any]:
        managers: list[Any] = super().define_pipelines()
        for manager in managers:
            manager.passes = [step for step in manager.passes if step[0] not in _NOT_NEEDED]
        return managers


#: Beginning of the names under which a function's Python constants are stored.
_CONSTANTS: Final = "_ZN08NumbaEnv"


class Result(compiler.CompileResult):  # type: ignore[misc]
    """Compiled kernel.

    Its file contains only its own code and constants, not code or constants of its parts.
    """

    __slots__ = ()

    def _find_referenced_environments(self) -> list[Any]:
        return []  # there are none: the kernel's own environment is stored separately


class PartLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Code that is only linked into kernels.

    This code is not optimised or converted to machine code by itself.
    """

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        self._finalized = True

    def own_module(self) -> Any:
        """Return code to link.

        The code of constants is copied, because each kernel needs its own; a shared one
        would be empty in a later kernel.
        """
        if self._shared_module is None:
            module = super()._get_module_for_linking()
            for variable in module.global_variables:
                if variable.name.startswith(_CONSTANTS):
                    variable.linkage = "internal"
        return self._shared_module

    def _get_module_for_linking(self) -> Any:
        """Return the same code with everything it calls, for a function compiled by plain numba."""
        module = self.own_module().clone()
        for part in _reached(self._linking_libraries):
            module.link_in(part._get_module_for_linking(), preserve=True)
        return module


class _Alone:
    """A part without the parts that it calls. The kernel links each of those once."""

    def __init__(self, part: PartLibrary) -> None:
        self._reload_init, self._get_module_for_linking = part._reload_init, part.own_module


def _reached(libraries: list[Any]) -> list[Any]:
    """Return the libraries and all code that their parts call, each once."""
    reached, waiting = dict[Any, None](), list(libraries)
    while waiting:
        library = waiting.pop()
        if library not in reached:
            reached[library] = None
            waiting += library._linking_libraries if isinstance(library, PartLibrary) else ()
    return [_Alone(library) if isinstance(library, PartLibrary) else library for library in reached]


class KernelLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Kernel with all its parts, optimised once."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    vectorised: bool = False

    def _optimize_final_module(self) -> None:
        # A loop over observations that calls a whole equation becomes vector instructions
        # only if everything is inlined and simplified first. Other kernels gain nothing
        # by this, and a first run would take a tenth longer (measured).
        first: dict[str, Any] = {"opt": 1, "loop_vectorize": False, "slp_vectorize": False}
        for options in (first, {}) if self.vectorised else ({},):
            passes, builder = self._codegen._module_pass_manager(**options)
            passes.run(self._final_module, builder)

    def finalize(self) -> None:
        self._linking_libraries: list[Any] = _reached(self._linking_libraries)
        super().finalize()

    def serialize_using_object_code(self) -> Any:
        """Return the machine code.

        Its intermediate code has only empty functions, because parts are never loaded.
        """
        names = [function.name for function in self.get_defined_functions()]
        text = "".join(f'define void @"{name}"() {{ ret void }}\n' for name in names)
        return self.name, "object", (self._get_compiled_object(), binding.parse_assembly(text).as_bitcode())
