"""Every seam of a spec by name. A new kind is one file and one line here, or an entry point."""

from tetractl.core.registry import Registry

OPTIMIZERS = Registry(
    "tetractl.optimizers",
    "optimizer",
    {
        "pso": "tetractl.experiment.controller:SwarmSpec",
        "multistart": "tetractl.experiment.controller:MultistartSpec",
    },
)
CONTROLLERS = Registry(
    "tetractl.controllers",
    "controller",
    {"pso-mpc": "tetractl.experiment.controller:PsoMpcSpec"},
)
MOTIONS = Registry(
    "tetractl.motions",
    "motion",
    {
        "euler": "tetractl.model.motion.euler:EULER",
        "arc": "tetractl.model.motion.arc:ARC",
        "exact": "tetractl.model.motion.exact:EXACT",
    },
)
SHAPES = Registry(
    "tetractl.shapes",
    "shape",
    {
        "rectangle": "tetractl.model.shapes.rectangle:Rectangle",
        "circle": "tetractl.model.shapes.circle:Circle",
        "polygon": "tetractl.model.shapes.polygon:Polygon",
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
