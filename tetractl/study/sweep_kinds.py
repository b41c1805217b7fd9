"""The sweeps by name. A new one is one file and one line here, or an entry point."""

from tetractl.core.registry import Registry

SWEEPS = Registry(
    "tetractl.sweeps",
    "sweep",
    {
        "grid": "tetractl.study.sweep:Grid",
        "list": "tetractl.study.sweep:Points",
        "random": "tetractl.study.sweep:Random",
        "sobol": "tetractl.study.sweep:Sobol",
    },
    "tetractl.study.sweep:Sweep",
)
