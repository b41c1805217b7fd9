"""Which class emulates which type of camera or actuator. A new one is one line here."""

from tetractl.core.registry import Registry

CAMERAS = Registry(
    "tetractl.emulated_cameras",
    "emulated camera",
    {
        "optitrack": "tetractl.emulate.optitrack.side:EmulatedOptitrack",
        "apriltag": "tetractl.emulate.apriltag.side:EmulatedAprilTag",
    },
)
ACTUATORS = Registry(
    "tetractl.emulated_actuators",
    "emulated actuator",
    {
        "m3pi-xbee": "tetractl.emulate.m3pi.side:EmulatedM3pi",
        "field": "tetractl.emulate.field_side:EmulatedField",
    },
)
