"""Every seam of a spec by name. A new kind is one file and one line here, or an entry point."""

from collections.abc import Iterator
from typing import Any

from tetractl.core.registry import Registry
from tetractl.experiment.base import Model

SECTION = "tetractl.experiment.base:Model"

OPTIMIZERS = Registry(
    "tetractl.optimizers",
    "optimizer",
    {
        "pso": "tetractl.control.optimizers.pso_section:Pso",
        "multistart": "tetractl.control.optimizers.multistart:Multistart",
        "cem": "tetractl.control.optimizers.cem:CrossEntropy",
        "mppi": "tetractl.control.optimizers.mppi:Mppi",
    },
    SECTION,
)
CONTROLLERS = Registry(
    "tetractl.controllers",
    "controller",
    {
        "mpc": "tetractl.control.mpc:MpcSection",
        "sequence": "tetractl.control.sequence:SequenceSection",
        "ensemble": "tetractl.control.ensemble:EnsembleSection",
        "rrt": "tetractl.control.rrt:RrtSection",
    },
    SECTION,
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
    SECTION,
)
PLANTS = Registry(
    "tetractl.plants",
    "plant",
    {
        "sim": "tetractl.plant.simulation:SimSection",
        "lab": "tetractl.plant.lab_plant:LabPlantSection",
    },
    "tetractl.experiment.plant:PlantSection",
)
CAMERAS = Registry(
    "tetractl.cameras",
    "camera",
    {
        "optitrack": "tetractl.lab.cameras.optitrack.section:OptitrackSection",
        "apriltag": "tetractl.lab.cameras.apriltag.section:AprilTagSection",
        "cells": "tetractl.lab.cameras.cells.section:CellsSection",
    },
    "tetractl.experiment.lab_section:CameraSection",
)
ACTUATORS = Registry(
    "tetractl.actuators",
    "actuator",
    {
        "m3pi-xbee": "tetractl.lab.actuators.m3pi.section:M3piSection",
        "field": "tetractl.lab.actuators.field.section:FieldSection",
    },
    "tetractl.experiment.lab_section:ActuatorSection",
)
DISTURBANCES = Registry(
    "tetractl.disturbances",
    "disturbance",
    {
        "battery": "tetractl.plant.disturbances.battery:BatterySection",
        "camera-latency": "tetractl.plant.disturbances.camera_latency:CameraLatencySection",
        "flow": "tetractl.plant.disturbances.flow:FlowSection",
        "frame-loss": "tetractl.plant.disturbances.frame_loss:FrameLossSection",
        "frozen-camera": "tetractl.plant.disturbances.frozen_camera:FrozenCameraSection",
        "heading-drift": "tetractl.plant.disturbances.heading_drift:HeadingDriftSection",
        "marker-off": "tetractl.plant.disturbances.marker_off:MarkerOffSection",
        "planning-time": "tetractl.plant.disturbances.planning_time:PlanningTimeSection",
        "radio": "tetractl.plant.disturbances.radio:RadioSection",
        "silent-radio": "tetractl.plant.disturbances.silent_radio:SilentRadioSection",
        "stale-camera": "tetractl.plant.disturbances.stale_camera:StaleCameraSection",
        "start-error": "tetractl.plant.disturbances.start_error:StartErrorSection",
        "sticking": "tetractl.plant.disturbances.sticking:StickingSection",
        "tracking-loss": "tetractl.plant.disturbances.tracking_loss:TrackingLossSection",
        "wander": "tetractl.plant.disturbances.wander:WanderSection",
        "wobble": "tetractl.plant.disturbances.wobble:WobbleSection",
    },
    "tetractl.experiment.disturbance:DisturbanceSection",
)
SEAMS = (
    OPTIMIZERS,
    CONTROLLERS,
    MOTIONS,
    SHAPES,
    PLANTS,
    DISTURBANCES,
    CAMERAS,
    ACTUATORS,
)


def packages(spec: Model) -> dict[str, str]:
    """Return name and version of every other package that provides a kind used in a spec."""
    used = (seam.kind(name) for seam, name in _kinds(spec))
    return {kind.package: kind.version for kind in used if kind.package}


def _kinds(value: Any) -> Iterator[tuple[Registry, str]]:
    """Yield seam and name of every kind that is used in a section or a tuple of sections."""
    if isinstance(value, tuple):
        for item in value:
            yield from _kinds(item)
    if isinstance(value, Model):
        name = getattr(value, "type", None)
        for seam in SEAMS:  # two of them may have a kind of the same name
            if isinstance(name, str) and name in seam and type(value) is seam.load(name):
                yield seam, name
        for field, about in type(value).model_fields.items():
            inner = getattr(value, field)
            yield from _kinds(inner)
            for mark in about.metadata:  # a kind without a section is a name alone
                seam = getattr(mark, "registry", None)
                if isinstance(inner, str) and isinstance(seam, Registry):
                    yield seam, inner
