"""The strict base class of all sections of a spec, and types of constrained numbers and names."""

from collections.abc import Callable
from copy import copy
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from tetractl.spec.yaml.document import Document
from tetractl.spec.yaml.problems import InvalidSpecError

STRICT = {"strict": True}
"""Validation context in which values of another type are refused, as they are in a spec."""


class Model(BaseModel):
    """An immutable section of the spec that refuses unknown keys and non-finite numbers."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        str_max_length=10_000,
    )


Section = TypeVar("Section", bound=BaseModel)


def validated(model: type[Section], document: Document) -> Section:
    """Convert the data of a YAML document to a given type, and check it.

    Raises:
        InvalidSpecError: If the document has problems or wrong values. The error lists all of them.
    """
    try:
        return model.model_validate(with_tuples(document.data), strict=True, context=STRICT)
    except ValidationError as error:
        from tetractl.spec.explain_errors import explain  # no valid spec needs it

        problems = explain(error, document, model)
        raise InvalidSpecError([*document.all_problems, *problems]) from None


def with_tuples(value: Any) -> Any:
    """Convert the lists in a file's data to tuples, as strict validation of a `Model` requires.

    Lists inside mappings and other lists are converted too. All other values stay the same.
    """
    if isinstance(value, dict):
        return {key: with_tuples(item) for key, item in value.items()}
    return tuple(map(with_tuples, value)) if isinstance(value, list) else value


def defaults(**values: Any) -> Callable[[type[Section]], type[Section]]:
    """Decorate a class of the spec that inherits fields, to give them other defaults by name.

    Only the decorated class changes: its parent class keeps its own defaults. A name that is not a
    field raises KeyError.
    """

    def decorate(section: type[Section]) -> type[Section]:
        for name, value in values.items():
            field = section.model_fields[name] = copy(section.model_fields[name])
            field.default = value
        section.model_rebuild(force=True)
        return section

    return decorate


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
PositiveIfStated = Annotated[Positive | None, Field(exclude_if=lambda value: value is None)]
"""A positive number that is left out of a spec if it is not stated, even of a complete spec."""
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
"""A length in a published result, bounded so that squares do not overflow."""
ANGLE = "angle [rad]"
"""Marks the type of a field that is an angle, for the warning of angles in degrees."""
Angle = Annotated[Finite, ANGLE]
PositiveAngle = Annotated[Positive, ANGLE]
NonNegativeAngle = Annotated[NonNegative, ANGLE]
Fraction = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
Point = tuple[Finite, Finite]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$")]


def inconsistent(field: str, message: str) -> PydanticCustomError:
    """Create the error by which a model's validator reports a problem of the field `field`.

    The caller raises it.
    """
    return PydanticCustomError("inconsistent", "{message}", {"field": field, "message": message})
