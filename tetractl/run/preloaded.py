"""Load the modules that every trial needs, once, in the process from which workers are forked.

Each worker loads the compiled kernels itself from the cache, because this process knows no spec.
"""

import gc
from contextlib import suppress
from importlib import import_module
from typing import Any

PRELOADED_MODULES = (
    "tetractl.run.task",
    "tetractl.control.methods.mpc",
    "tetractl.control.estimation.kernels.bank",
    "tetractl.control.search.kernels.multistart",
    "tetractl.control.search.kernels.prediction",
    "tetractl.plant.simulation",
)

gc.disable()  # searching what is imported takes a tenth of a second
for name in PRELOADED_MODULES:
    import_module(name)
with suppress(ImportError, AttributeError):  # private; else each worker does it, with a kernel
    import numba.core.registry as registry

    target: Any = registry.cpu_target
    target.target_context.refresh()
    target.typing_context.refresh()
gc.freeze()  # no worker searches these objects, or copies them by doing so
gc.enable()
