"""The registries of emulated devices, and the folder of examples."""

from pathlib import Path

from tetractl.core.registry import Registry

EXAMPLES = Path(__file__).parent / "examples"
"""The folder of the examples that `tetractl init --example` writes."""

EMULATED_CAMERAS = Registry(
    "tetractl.emulated_cameras",
    {
        "optitrack": "tetractl_emulator.optitrack.side:EmulatedOptitrack",
        "apriltag": "tetractl_emulator.pictures.apriltag.side:EmulatedAprilTag",
        "cells": "tetractl_emulator.pictures.dish.side:EmulatedMicroscope",
    },
)
EMULATED_ACTUATORS = Registry(
    "tetractl.emulated_actuators",
    {
        "m3pi-xbee": "tetractl_emulator.m3pi.side:EmulatedM3pi",
        "twist": "tetractl_emulator.twist.side:EmulatedTwist",
        "field": "tetractl_emulator.pictures.field:EmulatedField",
    },
)
