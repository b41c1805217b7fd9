"""Scripts of an emulated lab: how the lab differs from the spec, and which faults occur.

A script is YAML. The settings and faults that it can contain depend on the types of the lab's
camera and actuator. `DeviceClasses` contains the two classes that emulate them.
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
from tetractl.spec.yaml.problems import InvalidSpecError, SpecProblem, suggest_similar
from tetractl.spec.yaml.spec_files import read_text
from tetractl_emulator.faults import MARK, Fault
from tetractl_emulator.process import PROCESS_FAULTS
from tetractl_emulator.registries import EMULATED_ACTUATORS, EMULATED_CAMERAS


def _parse_fault(value: Any, info: ValidationInfo) -> Fault:
    """Parse a fault of a script. The mapping's key `fault` names the kind of fault.

    A `Fault` is returned unchanged.

    Raises:
        PydanticCustomError: If no device of the lab has this kind of fault.
    """
    if isinstance(value, Fault):
        return value
    kinds = _device_classes(info).faults
    name = str(value.get("fault")) if isinstance(value, dict) else ""
    if name not in kinds:
        message = (
            f"the field fault must be one of {', '.join(kinds)}{suggest_similar(name, list(kinds))}"
        )
        raise PydanticCustomError("fault", "{text}", {"text": message})
    return kinds[name].model_validate(value, strict=True)


def _parse_settings(value: Any, info: ValidationInfo) -> Model:
    """Parse the settings of an emulated device. The field is named "camera" or "actuator".

    Raises:
        ValidationError: If the settings are invalid.
    """
    classes = _device_classes(info)
    side = classes.camera if info.field_name == "camera" else classes.actuator
    return side.Settings.model_validate(value, strict=True)


class TrueStart(Model):
    """The true start of a robot, if it differs from the spec's."""

    name: Name
    """Name of a robot of the spec."""
    start: Point | None = None
    """True start position of the robot [length unit]."""
    heading: Finite | None = None
    """True start heading of the robot [rad]."""


class Emulation(Model):
    """Properties of the emulated lab that differ from the spec."""

    camera: Annotated[Model, PlainValidator(_parse_settings)] | None = None
    """Settings of the emulated camera; the fields depend on the camera's type."""
    actuator: Annotated[Model, PlainValidator(_parse_settings)] | None = None
    """Settings of the emulated actuator; the fields depend on the actuator's type."""
    robots: tuple[TrueStart, ...] = ()
    """The robots whose true start differs from the spec's."""


class Script(Model):
    """A fault script, as read from its YAML file: an emulated lab and the faults that happen."""

    about: str = Field(min_length=1, max_length=500)
    """Purpose of the script, in one or two sentences."""
    emulation: Emulation = Emulation()
    """Properties of the emulated lab that differ from the spec."""
    faults: tuple[Annotated[Fault, PlainValidator(_parse_fault)], ...] = Field(
        default=(), max_length=100
    )
    """The faults and their times."""
    runner: dict[str, Any] = Field(default={})
    """How a test starts and disturbs the run; not used by the emulation."""
    expect: dict[str, Any] = Field(default={})
    """The result that a test expects of the run; not used by the emulation."""


NO_FAULTS = Script(about="nothing goes wrong")
"""A script without faults, for a lab that agrees with the spec."""


@dataclass(frozen=True, slots=True)
class DeviceClasses:
    """The two classes that emulate a lab's devices.

    Attributes:
        camera: The class of the emulated camera.
        actuator: The class of the emulated actuator.
    """

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
    classes = DeviceClasses.of_types(camera, actuator)
    try:
        script = Script.model_validate(
            with_tuples(document.data), strict=True, context={"device_classes": classes}
        )
    except ValidationError as error:
        errors = error.errors(include_url=False)
        problems = [_to_problem(details, document, classes) for details in errors]
        raise InvalidSpecError([*document.all_problems, *problems]) from None
    document.require_no_problems()
    return script


def _device_classes(info: ValidationInfo) -> DeviceClasses:
    """Return the classes of the emulated devices, which `parse_script` has passed as context."""
    assert info.context is not None, "parse_script passes the classes"
    return info.context["device_classes"]


def _to_problem(details: ErrorDetails, document: Document, classes: DeviceClasses) -> SpecProblem:
    """Convert a validation error to a problem with a line number and a message."""
    location = tuple(details["loc"])
    for name, side in (("camera", classes.camera), ("actuator", classes.actuator)):
        if details["type"] == "extra_forbidden" and location[:-1] == ("emulation", name):
            field_names = list(side.Settings.model_fields)
            suggestion = (
                suggest_similar(str(location[-1]), field_names)
                or f"; known here: {', '.join(field_names)}"
            )
            return document.key(location).problem(location, f"unknown key{suggestion}")
    place = (
        document.key(location) if details["type"] == "extra_forbidden" else document.place(location)
    )
    message = explain_in_words(details, details["input"])
    if details["type"] == "tuple_type" and location[0] == "faults" and len(location) > 2:
        fault_kind = classes.faults[document.data["faults"][location[1]]["fault"]]
        message = (
            f"must be {describe_list(fault_kind.model_json_schema()['properties'][location[2]])}"
        )
    return place.problem(location, message)
