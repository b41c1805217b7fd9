"""Compile kernels so that each of their parts is optimised only once, with its kernel.

A *kernel* is a compiled function that Python calls. Its *parts* are the functions that only kernels
call. By default, numba optimises each part alone and makes machine code of it. Then it links the
part into every function that calls it, and optimises it again there. For kernels of a hundred small
functions, this takes a third of the compiler's time.

Here a part is only translated and simplified. A kernel is optimised with all its parts, as one
program: since nothing else calls these parts, the compiler may inline them, share them, or drop
arguments that they do not use. The kernel never calls machine code from outside. Therefore it
computes the same bits whether it was compiled now or loaded from the cache.

The passes that translate Python are numba's own, without those that kernels do not need. Only
its private class of a code library is replaced. If numba has no such class, each part is compiled
as by default, with equal results.
"""

from types import CodeType
from typing import Any

from llvmlite.binding import Linkage
from numba.core import typed_passes, untyped_passes
from numba.core.compiler import Compiler, Flags

JITCodeLibrary: Any
try:
    from numba.core.codegen import JITCodeLibrary
except ImportError:
    JITCodeLibrary = object

_IS_REPLACED = JITCodeLibrary is not object


class _NoMachineCode:
    """A stand-in for the code generator of a part, which generates no machine code."""

    def set_env(self, env_name: str, env: Any) -> None:
        """Do nothing. Only machine code needs its environment, and a kernel has its own."""


class PartLibrary(JITCodeLibrary):
    """Numba's code library for a part of a kernel, without machine code."""

    @property
    def codegen(self) -> Any:
        """The code generator that Numba asks for the environment of machine code."""
        return _NoMachineCode()

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0, which means that there is no machine code."""
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        """Do nothing, because the kernel is optimised together with its parts."""

    def _finalize_final_module(self) -> None:
        """Prepare compiled code so that it can be linked into kernels."""
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class KernelLibrary(JITCodeLibrary):
    """Numba's code library for a kernel together with its parts."""

    def _optimize_final_module(self) -> None:
        """Optimise the kernel after its parts have become its own.

        Numba would optimise it twice: the first time quickly, to find needless counts of
        references. The kernels whose compilation takes long have none.
        """
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = "internal"
        pass_manager, pass_builder = self._codegen._module_pass_manager()
        pass_manager.run(self._final_module, pass_builder)


class SharedFlags(Flags):
    """The compiler options of many functions, in one object that never changes.

    Numba looks up the implementation of every operation by its types and by the options. It would
    compare all options one by one. These options are equal only if they are the same object.
    """

    __slots__ = ()

    @classmethod
    def equal_to(cls, flags: Flags) -> "SharedFlags":
        """Return the shared object for the given options."""
        values = flags.values()
        for shared in _shared_flags:
            if shared.values() == values:
                return shared
        shared = cls()
        shared._values = flags._values.copy()
        _shared_flags.append(shared)
        return shared

    def copy(self) -> Flags:
        """Return options that may be changed."""
        changeable = Flags()
        changeable._values = self._values.copy()
        return changeable

    def __eq__(self, other: object) -> bool:
        if isinstance(other, SharedFlags):
            return self is other
        return super().__eq__(other)

    def __hash__(self) -> int:
        return _HASH


_shared_flags: list[SharedFlags] = []
_HASH = hash(Flags())  # the same for all options


class _FunctionFlags(Flags):
    """The compiler options of one function, for which numba looks up implementations."""

    __slots__ = ()

    def copy(self) -> Flags:
        """Return the shared object with these options. Numba compiles with a copy."""
        return SharedFlags.equal_to(self)


_NEEDLESS_PASSES = {
    untyped_passes.WithLifting,
    untyped_passes.InlineClosureLikes,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    typed_passes.InlineOverloads,
    typed_passes.DumpParforDiagnostics,
}
"""Numba's passes for parts of Python that kernels do not use: `with`, closures, and `literally`.

Most of them search each function for what they translate, and then analyse it again. Kernels that
create no arrays also need no `NopythonRewrites`, which merges operations of whole arrays.
"""


class _QuickCompiler(Compiler):
    """Numba's compiler with fewer passes, and with a chosen class of code library."""

    library: type[Any] = JITCodeLibrary

    def __init__(
        self,
        typingctx: Any,
        targetctx: Any,
        library: Any,
        args: Any,
        return_type: Any,
        flags: Flags,
        locals: Any,
    ) -> None:
        function_flags = _FunctionFlags()
        function_flags._values = flags._values.copy()
        super().__init__(typingctx, targetctx, library, args, return_type, function_flags, locals)

    def define_pipelines(self) -> Any:
        """Select the code library, and return those of Numba's compiler passes that are needed."""
        _use_library(self.state, self.library)
        managers = super().define_pipelines()
        constants = self.state.func_id.code.co_consts
        creates_arrays = self.state.flags.nrt
        needless = (
            _NEEDLESS_PASSES
            if creates_arrays
            else _NEEDLESS_PASSES | {typed_passes.NopythonRewrites}
        )
        if not any(isinstance(constant, CodeType) for constant in constants):  # no closures
            for manager in managers:
                manager.passes = [
                    compiler_pass
                    for compiler_pass in manager.passes
                    if compiler_pass[0] not in needless
                ]
                manager.finalize()
        return managers


class PartCompiler(_QuickCompiler):
    """Numba's compiler with settings for functions that are parts of kernels."""

    library = PartLibrary


class KernelCompiler(_QuickCompiler):
    """Numba's compiler with settings for kernels, the functions that Python calls."""

    library = KernelLibrary


def _use_library(state: Any, library: type[Any]) -> None:
    """Store a function's code in a new library of the given class.

    This does nothing if the function has a library, or if Numba lacks the classes that it replaces.
    """
    if _IS_REPLACED and state.library is None:
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()  # so that a kernel can be stored
