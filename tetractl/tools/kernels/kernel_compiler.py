"""Compile kernels so that each of their parts is optimised only once, with its kernel.

A *kernel* is a compiled function that Python calls. Its *parts* are the functions that only kernels
call. By default, numba optimises each part alone and makes machine code of it. Then it links the
part into every function that calls it, and optimises it again there. For kernels of a hundred small
functions, this takes a third of the compiler's time.

Here a part is only translated and simplified. A kernel is optimised with all its parts, as one
program: since nothing else calls these parts, the compiler may inline them, share them, or drop
arguments that they do not use. The kernel never calls machine code from outside. Therefore it
computes the same bits whether it was compiled now or loaded from the cache.

The passes that translate Python are numba's own. Only its private class of a code library is
replaced. If numba has no such class, it compiles as it does by default, with equal results.
"""

from typing import Any

from llvmlite.binding import Linkage
from numba.core.compiler import Compiler

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
        """Optimise the kernel after its parts have become its own."""
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = "internal"
        super()._optimize_final_module()


class PartCompiler(Compiler):
    """Numba's compiler with settings for functions that are parts of kernels."""

    def define_pipelines(self) -> Any:
        """Select the code library, and return Numba's own compiler passes."""
        _use_library(self.state, PartLibrary)
        return super().define_pipelines()


class KernelCompiler(Compiler):
    """Numba's compiler with settings for kernels, the functions that Python calls."""

    def define_pipelines(self) -> Any:
        """Select the code library, and return Numba's own compiler passes."""
        _use_library(self.state, KernelLibrary)
        return super().define_pipelines()


def _use_library(state: Any, library: type[Any]) -> None:
    """Store a function's code in a new library of the given class.

    This does nothing if the function has a library, or if Numba lacks the classes that it replaces.
    """
    if _IS_REPLACED and state.library is None:
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()  # so that a kernel can be stored
