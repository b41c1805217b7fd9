"""Scripts of an emulated lab: how the lab differs from the spec, and which faults occur.

A script is YAML. The settings and faults that it can contain depend on the types of the lab's
camera and actuator. `Sides` holds the two classes that emulate them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self, get_args

from pydantic import Field, PlainValidator, ValidationError, ValidationInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from tetractl.core.errors import AbortError, SpecError
from tetractl.spec.base import Finite, Model, Name, Point, with_tuples
from tetractl.spec.explain_errors import describe_list, explain_in_words
from tetractl.spec.yaml.document import Document, parse_document
from tetractl.spec.yaml.problems import InvalidSpecError, SpecProblem, did_you_mean
from tetractl.spec.yaml.spec_files import read_text
from tetractl_emulator.faults import MARK, Fault
from tetractl_emulator.process import PROCESS_FAULTS
from tetractl_emulator.registries import EMULATED_ACTUATORS, EMULATED_CAMERAS


def _chosen_fault(value: Any, info: ValidationInfo) -> Fault:
    """Parse a fault. The mapping's key `fault` names its kind. A `Fault` is returned as it is.

    PydanticCustomError is raised if no device of the lab has this kind of fault.
    """
    if isinstance(value, Fault):
        return value
    kinds = _sides(info).faults
    name = str(value.get("fault")) if isinstance(value, dict) else ""
    if name not in kinds:
        text = f"the field fault must be one of {', '.join(kinds)}{did_you_mean(name, list(kinds))}"
        raise PydanticCustomError("fault", "{text}", {"text": text})
    return kinds[name].model_validate(value, strict=True)


def _settings(value: Any, info: ValidationInfo) -> Model:
    """Parse the settings of an emulated device. The field is named "camera" or "actuator".

    Invalid settings raise ValidationError.
    """
    sides = _sides(info)
    side = sides.camera if info.field_name == "camera" else sides.actuator
    return side.Settings.model_validate(value, strict=True)


class Placed(Model):
    """The true start of a robot, if it differs from the spec's."""

    name: Name
    """Name of a robot of the spec."""
    start: Point | None = None
    """True start position of the robot [length unit]."""
    heading: Finite | None = None
    """True start heading of the robot [rad]."""


class Emulation(Model):
    """Properties of the emulated lab that differ from the spec."""

    camera: Annotated[Model, PlainValidator(_settings)] | None = None
    """Settings of the emulated camera; the fields depend on the camera's type."""
    actuator: Annotated[Model, PlainValidator(_settings)] | None = None
    """Settings of the emulated actuator; the fields depend on the actuator's type."""
    robots: tuple[Placed, ...] = ()
    """The robots whose true start differs from the spec's."""


class Script(Model):
    """A fault script, as read from its YAML file: an emulated lab and the faults that happen."""

    about: str = Field(min_length=1, max_length=500)
    """Purpose of the script, in one or two sentences."""
    emulation: Emulation = Emulation()
    """Properties of the emulated lab that differ from the spec."""
    faults: tuple[Annotated[Fault, PlainValidator(_chosen_fault)], ...] = Field(
        default=(), max_length=100
    )
    """The faults and their times."""
    runner: dict[str, Any] = Field(default={})
    """How a test starts and disturbs the run; not used by the emulation."""
    expect: dict[str, Any] = Field(default={})
    """The result that a test expects of the run; not used by the emulation."""


NOTHING = Script(about="nothing goes wrong")


@dataclass(frozen=True, slots=True)
class Sides:
    """The two classes that emulate a lab's devices: the camera and the actuator."""

    camera: Any
    actuator: Any

    @classmethod
    def of_types(cls, camera: str, actuator: str) -> Self:
        """Load the classes that emulate a lab's devices.

        Args:
            camera: Type of the lab's camera.
            actuator: Type of the lab's actuator.

        Raises:
            SpecError: If a device of this type cannot be emulated.
            AbortError: If software that the emulation needs is not installed.
        """
        for registry, name in ((EMULATED_CAMERAS, camera), (EMULATED_ACTUATORS, actuator)):
            if name not in registry:
                names = ", ".join(registry.names())
                raise SpecError(
                    f"{name} cannot be emulated", f"these types can be emulated: {names}"
                )
        try:
            return cls(EMULATED_CAMERAS.load(camera), EMULATED_ACTUATORS.load(actuator))
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in ("cv2", "tetractl_microscope"):
                raise
            raise AbortError(
                f"emulating {camera} needs tetractl-microscope, which is not installed",
                "pip install ./packages/tetractl-microscope",
            ) from error

    @property
    def faults(self) -> dict[str, type[Fault]]:
        """Every kind of fault that the lab can have, by its name."""
        kinds = (*self.camera.faults, *self.actuator.faults, *PROCESS_FAULTS, MARK)
        return {get_args(kind.model_fields["fault"].annotation)[0]: kind for kind in kinds}


def load_script(path: Path, camera: str = "optitrack", actuator: str = "m3pi-xbee") -> Script:
    """Read a script for a lab from a file.

    Args:
        path: The file.
        camera: Type of the lab's camera.
        actuator: Type of the lab's actuator.

    Raises:
        InvalidSpecError: If the script is invalid. The error contains a line for each problem.
    """
    return parse_script(read_text(path), str(path), camera, actuator)


def parse_script(
    text: str, origin: str, camera: str = "optitrack", actuator: str = "m3pi-xbee"
) -> Script:
    """Parse the text of a script for a lab.

    Args:
        text: The text of the script.
        origin: Name of the script in error messages.
        camera: Type of the lab's camera.
        actuator: Type of the lab's actuator.

    Raises:
        InvalidSpecError: If the script is invalid. The error contains a line for each problem.
    """
    document = parse_document(text, origin)
    sides = Sides.of_types(camera, actuator)
    try:
        script = Script.model_validate(
            with_tuples(document.data), strict=True, context={"sides": sides}
        )
    except ValidationError as error:
        problem = error.errors(include_url=False)
        problems = [_problem(details, document, sides) for details in problem]
        raise InvalidSpecError([*document.all_problems, *problems]) from None
    document.require_no_problems()
    return script


def _sides(info: ValidationInfo) -> Sides:
    """Return the emulated devices that `parse_script` has passed as context."""
    assert info.context is not None, "parse_script passes the sides"
    return info.context["sides"]


def _problem(details: ErrorDetails, document: Document, sides: Sides) -> SpecProblem:
    """Convert a validation error to a problem with a line and a message.

    The problem is not raised.
    """
    loc = tuple(details["loc"])
    for name, side in (("camera", sides.camera), ("actuator", sides.actuator)):
        if details["type"] == "extra_forbidden" and loc[:-1] == ("emulation", name):
            fields = list(side.Settings.model_fields)
            guess = did_you_mean(str(loc[-1]), fields) or f"; known here: {', '.join(fields)}"
            return document.key(loc).problem(loc, f"unknown key{guess}")
    place = document.key(loc) if details["type"] == "extra_forbidden" else document.place(loc)
    message = explain_in_words(details, details["input"])
    if details["type"] == "tuple_type" and loc[0] == "faults" and len(loc) > 2:
        kind = sides.faults[document.data["faults"][loc[1]]["fault"]]
        message = f"must be {describe_list(kind.model_json_schema()['properties'][loc[2]])}"
    return place.problem(loc, message)
