"""The strict base class of all sections of a spec, and types of constrained numbers and names."""

from collections.abc import Callable
from copy import copy
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from tetractl.spec.yaml.document import Document
from tetractl.spec.yaml.problems import InvalidSpecError

STRICT_CONTEXT = {"strict": True}
"""Pydantic's validation context in which values of a wrong type are refused, as in a spec."""


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


def validate_document(model: type[Section], document: Document) -> Section:
    """Check the data of a YAML document, and convert it to a section or another model of the spec.

    Args:
        model: The class to which the data is converted.
        document: The document.

    Raises:
        InvalidSpecError: If the document has problems or wrong values. The error lists all of them.
    """
    try:
        return model.model_validate(with_tuples(document.data), strict=True, context=STRICT_CONTEXT)
    except ValidationError as error:
        from tetractl.spec.explain_errors import explain  # no valid spec needs it

        problems = explain(error, document, model)
        raise InvalidSpecError([*document.all_problems, *problems]) from None


def with_tuples(value: Any) -> Any:
    """Convert the lists in a file's data to tuples, as strict validation of a `Model` requires.

    Lists inside mappings and other lists are converted too. All other values stay the same.
    """
    if isinstance(value, dict):
        return {key: with_tuples(inner_value) for key, inner_value in value.items()}
    return tuple(map(with_tuples, value)) if isinstance(value, list) else value


def defaults(**values: Any) -> Callable[[type[Section]], type[Section]]:
    """Decorate a class of the spec that inherits fields, to give them other defaults by name.

    Only the decorated class changes: its parent class keeps its own defaults. A name that is not a
    field raises KeyError.
    """

    def decorate(section: type[Section]) -> type[Section]:
        for name, value in values.items():
            field_info = section.model_fields[name] = copy(section.model_fields[name])
            field_info.default = value
        section.model_rebuild(force=True)
        return section

    return decorate


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
PositiveIfStated = Annotated[Positive | None, Field(exclude_if=lambda value: value is None)]
"""A positive number, or None. If it is None, even a complete spec leaves the field out."""
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
"""A length in a published result, bounded so that squares do not overflow."""
ANGLE_MARK = "angle [rad]"
"""The mark of types that are angles, by which a warning about angles in degrees finds them."""
Angle = Annotated[Finite, ANGLE_MARK]
PositiveAngle = Annotated[Positive, ANGLE_MARK]
NonNegativeAngle = Annotated[NonNegative, ANGLE_MARK]
Fraction = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
Point = tuple[Finite, Finite]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$")]


def inconsistent(field: str, message: str) -> PydanticCustomError:
    """Create the error with which a model's validator refuses a field. The caller raises it.

    Args:
        field: Name of the field.
        message: What is wrong, as the end of a sentence that begins with the field.
    """
    return PydanticCustomError("inconsistent", "{message}", {"field": field, "message": message})
