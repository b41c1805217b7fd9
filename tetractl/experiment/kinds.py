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
PLANTS = Registry(
    "tetractl.plants",
    "plant",
    {
        "sim": "tetractl.plant.simulation:SimSection",
        "lab": "tetractl.plant.lab:LabPlantSection",
    },
)
CAMERAS = Registry(
    "tetractl.cameras",
    "camera",
    {"optitrack": "tetractl.lab.cameras.optitrack.section:OptitrackSection"},
)
ACTUATORS = Registry(
    "tetractl.actuators",
    "actuator",
    {"m3pi-xbee": "tetractl.lab.actuators.m3pi.section:M3piSection"},
)
