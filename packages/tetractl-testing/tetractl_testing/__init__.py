"""Checks whether code that extends tetractl, such as your own camera, does what tetractl requires.

tetractl calls such an extension a kind. It is a motion, or the section of a shape, optimiser,
controller, disturbance, camera or actuator. In your own tests, a check raises AssertionError for
the first fault. `tetractl kinds --check` lists all faults instead. Random numbers come from a fixed
seed, so the findings repeat.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pkgutil import resolve_name
from typing import Any, Protocol, get_args, runtime_checkable

from pydantic import ValidationError

from tetractl.core.errors import UsageError, describe_error
from tetractl.core.setup import Setup
from tetractl.model.motion.motion import Motion
from tetractl.spec.base import Model
from tetractl.spec.controller import ControllerSection, OptimizerSection
from tetractl.spec.disturbance import DisturbanceSection
from tetractl.spec.experiment import ShapeSection
from tetractl.spec.explain_errors import explain_in_words
from tetractl.spec.lab_section import ActuatorSection, CameraSection
from tetractl_testing.control_checks import check_controller, check_optimizer
from tetractl_testing.device_checks import MovedRobots, SeenRobots, check_actuator, check_camera
from tetractl_testing.disturbance_checks import check_disturbance
from tetractl_testing.expect import Finding, findings_of
from tetractl_testing.model_checks import check_motion, check_shape

__all__ = [
    "Finding", "MovedRobots", "SeenRobots", "check_actuator", "check_camera", "check_controller",
    "check_disturbance", "check_kind", "check_motion", "check_optimizer", "check_shape",
    "findings_of",
]  # fmt: skip


@runtime_checkable
class Checked(Protocol):
    """A kind that another package has defined, together with its own check."""

    def checked(self) -> None:
        """Check this section."""
        ...


CHECKS: Mapping[type, Callable[[Any, Setup], None]] = {
    ShapeSection: check_shape,
    OptimizerSection: check_optimizer,
    ControllerSection: check_controller,
    DisturbanceSection: check_disturbance,
    CameraSection: check_camera,
    ActuatorSection: check_actuator,
}


def check_kind(code: str, fields: Mapping[str, Any], setup: Setup) -> list[Finding]:
    """Check a motion, or the section of another kind, and return all findings.

    Args:
        code: The object, as "module:attribute".
        fields: The section's fields.
        setup: The robots of the experiment.

    Raises:
        UsageError: If the object cannot be imported, or is no kind that can be checked.
    """
    module, _, name = code.partition(":")
    if not module or not name:
        raise UsageError(
            f"{code}: write it as MODULE:NAME",
            "for example pivot:PIVOT for PIVOT in the file pivot.py",
        )
    try:
        kind = resolve_name(code)
    except (Exception, SystemExit) as error:  # a module may raise anything, or leave
        raise UsageError(f"{code}: cannot be imported: {describe_error(error)}") from None
    if isinstance(kind, Motion):
        return findings_of(partial(check_motion, kind))
    if isinstance(kind, type) and issubclass(kind, Model) and issubclass(kind, Checked):
        return findings_of(_section(code, kind, fields).checked)
    for base, check in CHECKS.items():
        if isinstance(kind, type) and issubclass(kind, base):
            return findings_of(partial(check, _section(code, kind, fields), setup))
    with_a_check = ", ".join(base.__name__ for base in CHECKS)
    raise UsageError(
        f"{code}: there is no check for an object of this kind",
        f"these kinds can be checked: {with_a_check} and Motion",
    )


def _section(code: str, kind: type[Model], fields: Mapping[str, Any]) -> Any:
    """Create a section of a kind with the given fields.

    Raises:
        UsageError: If a field is wrong.
    """
    stated = kind.model_fields.get("type")
    names = get_args(stated.annotation) if stated else ()
    if len(names) != 1:
        raise UsageError(f"{code}: the field `type` must be a Literal with a single name")
    try:
        return kind.model_validate({"type": names[0], **fields})
    except ValidationError as error:
        details = error.errors()[0]
        field = ".".join(map(str, details["loc"]))
        description = explain_in_words(details, details["input"])
        if not field:  # of a check of the whole section
            raise UsageError(f"{code}: {description}") from None
        hint = f"give this field a value with --set {field}=VALUE"
        in_python = f'give this field a value with "{field}=VALUE"'
        raise UsageError(f"{code}: {field}: {description}", hint, in_python) from None
