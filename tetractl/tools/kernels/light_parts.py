"""Compiles the parts of a kernel, the functions that it calls, only within the kernel.

By itself Numba optimises each function that a kernel calls and turns it into machine code, which is
never run, since parts are inlined. Here a part is linked as it was lowered, once, and optimised
with the kernel; a function that Python calls is finished as always. Kernels compute the same bits.
This takes classes of Numba that are private: a version that was not tried compiles as it does for
others, which takes longer.
"""

from functools import cache
from typing import Any

TRIED = ((0, 61), (0, 68))
"""First and last version of Numba with which this was tried."""


def light(version: str) -> dict[str, Any]:
    """Return the option of `numba.njit` for kernels, none with a version that was not tried."""
    parts = version.split(".")[:2]
    release = tuple(int(part) for part in parts if part.isdigit())
    return {"pipeline_class": _light()} if TRIED[0] <= release <= TRIED[1] else {}


def _callers_first(library: Any) -> list[Any]:
    """Return all that is linked into a library, each before what it calls.

    LLVM's linker leaves out a function that nothing calls yet.
    """
    visited = set[Any]()
    order = list[Any]()

    def visit(part: Any) -> None:
        if part not in visited:
            visited.add(part)
            for called in () if part._finalized else reversed(part._linking_libraries):
                visit(called)
            order.append(part)

    visit(library)
    return order[-2::-1]


@cache
def _light() -> type[Any]:
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler
    from numba.core.environment import lookup_environment

    class Library(JITCodeLibrary):
        """The code of one function; it is optimised only if Python or another library asks."""

        @property
        def codegen(self) -> Any:
            """What numba sets an environment by: there is no place for it in a part."""
            return self._codegen if self._finalized else self

        def set_env(self, name: str, environment: Any) -> None:
            """Do nothing: `finalize` of the kernel sets the environments of its parts."""

        def add_linking_library(self, library: Any) -> None:
            if isinstance(library, Library) and not library._finalized:
                self._linking_libraries.append(library)
            else:
                super().add_linking_library(library)

        def get_pointer_to_function(self, name: str) -> int:
            functions = self._final_module.functions
            if self._finalized or any(function.name == name for function in functions):
                return super().get_pointer_to_function(name)
            return 0  # what Python cannot call

        def _get_module_for_linking(self) -> Any:
            if self._finalized:
                return super()._get_module_for_linking()
            if self._shared_module is None:
                self._shared_module = self._final_module.clone()
                for function in self._shared_module.functions:
                    if not function.is_declaration and function.linkage.name == "external":
                        function.linkage = "linkonce_odr"
            return self._shared_module

        def finalize(self) -> None:
            self._shared_module = None
            self._linking_libraries = _callers_first(self)
            super().finalize()
            for variable in self._final_module.global_variables:
                environment = lookup_environment(variable.name)
                if environment is not None:
                    self.codegen.set_env(variable.name, environment)

    class LightParts(Compiler):
        """Numba's compiler, in which all that it compiles for a kernel is a `Library`."""

        def compile_extra(self, func: Any) -> Any:
            codegen = self.state.targetctx.codegen()
            usual = codegen._library_class
            codegen._library_class = Library
            try:
                return super().compile_extra(func)
            finally:
                codegen._library_class = usual

    return LightParts
