"""Which class emulates which type of camera or actuator. A new one is one line here."""

from tetractl.core.registry import Registry

CAMERAS = Registry(
    "tetractl.emulated_cameras",
    "emulated camera",
    {
        "optitrack": "tetractl.lab.emulate.optitrack.side:EmulatedOptitrack",
        "apriltag": "tetractl.lab.emulate.apriltag.side:EmulatedAprilTag",
    },
)
ACTUATORS = Registry(
    "tetractl.emulated_actuators",
    "emulated actuator",
    {
        "m3pi-xbee": "tetractl.lab.emulate.m3pi.side:EmulatedM3pi",
        "field": "tetractl.lab.emulate.field_side:EmulatedField",
    },
)
