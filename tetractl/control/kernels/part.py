"""Compiles functions that only kernels call ("parts"), without machine code of their own.

Numba makes machine code and wrappers for each function that it compiles, although a part is inlined
into every kernel that calls it. Here a part ends as optimised intermediate code, which is linked
into the kernels.
"""

import ctypes
from typing import Any, Literal

from numba import _dynfunc  # pyright: ignore[reportAttributeAccessIssue]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

_REFUSE = ctypes.cast(ctypes.pythonapi.PyErr_BadArgument, ctypes.c_void_p).value


class _PartLibrary(JITCodeLibrary):
    """The intermediate code of a part. It is optimised as that of a kernel, since otherwise the
    kernels would round differently."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Turns typed code into a `_PartLibrary`. If Python calls a part, that raises TypeError."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        name, target = state.func_id.func_qualname, state.targetctx
        state.library = _PartLibrary(target.codegen(), name)
        super().run_pass(state)
        description, env = state.cr.fndesc, state.cr.env
        # numba finds the code of a part by this object
        key = _dynfunc.make_function(
            description.lookup_module(), name, "", _REFUSE, env, (state.library,)
        )
        target.insert_user_function(key, description, [state.library])
        state["cr"] = state.cr._replace(cfunc=key)
        return True


class PartCompiler(Compiler):
    """Numba's compiler for a part, the `pipeline_class` of the decorators."""

    def define_pipelines(self) -> list[Any]:
        """Return numba's passes, with the last one replaced."""
        self.state.flags.no_compile = True
        (passes,) = super().define_pipelines()
        passes.passes = [
            (_PartLowering if one is NativeLowering else one, text) for one, text in passes.passes
        ]
        passes.finalize()
        return [passes]
