"""Load only the actuator of a spec, to stop its robots even if another part of the spec is wrong.

A stop needs only the actuator's ports and the names of its robots. The motion of the robots, the
camera, the controller and the calibration do not matter.
"""

from typing import Annotated, Any

from pydantic import TypeAdapter, ValidationError

from tetractl.core.registries import ACTUATORS
from tetractl.core.setup import Setup
from tetractl.spec.base import STRICT_CONTEXT, with_tuples
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import ActuatorSection, RobotPart
from tetractl.spec.registry_fields import KindSection
from tetractl.spec.yaml.document import Document

STAND_IN = {"start": (0.5, 0.5), "target": (0.5, 0.5), "a": 1.0, "speed": 1.0}
"""Placeholders for the start, target and motion of a robot that is only stopped.

A setup needs these values, but no stop uses them.
"""
STAND_IN_WHEEL_RADIUS = 1.0
"""Placeholder for the distance from a wheel to a robot's centre [length unit]."""


def load_actuator_alone(spec: Document) -> tuple[ActuatorSection, Setup] | None:
    """Load only the actuator of a spec's plant or lab, and make a setup with its robots' names.

    The result is None if the section `actuator` is missing or invalid.
    """
    section = _valid_actuator(spec.data.get("plant")) or _valid_actuator(spec.data.get("lab"))
    if section is None:
        return None
    robot_parts = dict(section).get("robots", ())
    names = [part.name for part in robot_parts if isinstance(part, RobotPart)]
    contents = {
        "name": "stop",
        "arena": {"left": 0.0, "bottom": 0.0, "width": 1.0, "height": 1.0},
        # without names, one robot stands for all cells in a field
        "robots": tuple({"name": name, **STAND_IN} for name in names or ("all",)),
        "wheels": {"radius": STAND_IN_WHEEL_RADIUS},
    }
    experiment = Experiment.model_validate(contents, strict=True, context=STRICT_CONTEXT)
    return section, experiment.setup


def _valid_actuator(lab: Any) -> ActuatorSection | None:
    """Return the actuator section of a lab's raw data. None if it is missing or invalid."""
    if not isinstance(lab, dict) or "actuator" not in lab:
        return None
    adapter = TypeAdapter[ActuatorSection](
        Annotated[ActuatorSection, KindSection(ACTUATORS, ActuatorSection)]
    )
    try:
        return adapter.validate_python(
            with_tuples(lab["actuator"]), strict=True, context=STRICT_CONTEXT
        )
    except ValidationError:
        return None
