"""The sweeps by name. A new one is one file and one line here, or an entry point."""

from tetractl.core.registry import Registry

SWEEPS = Registry(
    "tetractl.sweeps",
    "sweep",
    {
        "grid": "tetractl.study.sweeps.grid:Grid",
        "list": "tetractl.study.sweeps.points:Points",
        "random": "tetractl.study.sweeps.sample:Random",
        "sobol": "tetractl.study.sweeps.sample:Sobol",
    },
    "tetractl.study.sweep:Sweep",
)
