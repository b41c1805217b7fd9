"""Every seam of a spec by name. A new kind is one file and one line here, or an entry point."""

from tetractl.core.registry import Registry

OPTIMIZERS = Registry(
    "tetractl.optimizers",
    "optimizer",
    {
        "pso": "tetractl.control.optimizers.pso:Pso",
        "multistart": "tetractl.control.optimizers.multistart:Multistart",
        "cem": "tetractl.control.optimizers.cem:CrossEntropy",
        "mppi": "tetractl.control.optimizers.mppi:Mppi",
    },
)
CONTROLLERS = Registry(
    "tetractl.controllers",
    "controller",
    {"mpc": "tetractl.control.mpc:MpcSection"},
)
MOTIONS = Registry(
    "tetractl.motions",
    "motion",
    {
        "euler": "tetractl.model.cell:euler",
        "arc": "tetractl.model.cell:arc",
        "exact": "tetractl.model.cell:exact",
    },
)
SHAPES = Registry(
    "tetractl.shapes",
    "shape",
    {
        "rectangle": "tetractl.experiment.experiment:Rectangle",
        "circle": "tetractl.experiment.experiment:Circle",
    },
)
CAMERAS = Registry(
    "tetractl.cameras",
    "camera",
    {},
)
ACTUATORS = Registry(
    "tetractl.actuators",
    "actuator",
    {},
)
