"""Types of the spec's fields that select a kind by its name, such as `type: mpc`.

Each kind is a class in a registry, and plug-ins can add more.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, LiteralString

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from tetractl.core.registry import Registry
from tetractl.spec.packages import explain_missing


def validate_section(section: type[BaseModel], value: Any, info: core_schema.ValidationInfo) -> Any:
    """Validate the mapping of one section, as strictly as pydantic validates the enclosing section.

    Args:
        section: The section's class.
        value: The mapping.
        info: Pydantic's information about the parent.
    """
    strict = bool(info.context and info.context.get("strict"))
    return section.model_validate(value, strict=strict, context=info.context)


@dataclass(eq=False)
class KindSection:
    """Annotation of a field that holds a mapping with a `type`, the name of a class in a registry.

    `Annotated[Base, KindSection(REGISTRY, Base)]` accepts an instance of Base, or a mapping with a
    `type` that the registry knows. Each class of the registry is a `Model`, with its name as the
    `Literal` of its `type`. A class is imported when it is first chosen. If another package's class
    cannot be used, PluginError is raised.

    Attributes:
        registry: The registry.
        base: The class from which the chosen class must be derived.
        default: The type of a mapping without `type`. None if `type` is required.
    """

    registry: Registry
    base: type[BaseModel]
    default: str | None = None

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def validate(value: Any, info: core_schema.ValidationInfo) -> Any:
            if isinstance(value, self.base):
                return value
            return validate_section(self._section(value), value, info)

        return core_schema.with_info_plain_validator_function(validate)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        options: list[JsonSchemaValue] = []
        references: dict[str, str] = {}
        # what is usable: so that a broken package does not hide other mistakes
        for name, section_class in self.registry.load_usable().items():
            if not issubclass(section_class, self.base):
                continue
            option = handler(section_class.__pydantic_core_schema__)
            if "$ref" in option:
                references[name] = option["$ref"]
            required: list[str] = handler.resolve_ref_schema(option).get("required", [])
            if name != self.default and "type" not in required:
                # a mapping without `type` has the default kind
                options.append({**option, "required": ["type", *required]})
            else:
                options.append(option)
        choice: JsonSchemaValue = {
            "discriminator": {"mapping": references, "propertyName": "type"},
            "oneOf": options,
        }
        if self.default:
            choice["default"] = {"type": self.default}
        return choice

    def make(self) -> Any:
        """Create a section of the default kind with default values, as the default of a field."""
        return self._section({}).model_validate({})

    def _section(self, value: Any) -> Any:
        if not isinstance(value, dict):
            raise PydanticCustomError("model_type", "must be a mapping of keys to values")
        name = value.get("type", self.default)
        if name is None:
            raise self._wrong_type("union_tag_not_found", "has no type")
        if not isinstance(name, str) or name not in self.registry:
            missing = explain_missing(self.registry.group, str(name))
            if missing:
                raise PydanticCustomError("not_installed", "{why}", {"why": ": ".join(missing)})
            raise self._wrong_type("union_tag_invalid", "has an unknown type")
        section = self.registry.load(name)
        if not issubclass(section, self.base):
            raise self._wrong_type("union_tag_invalid", "cannot be used here", excluded_name=name)
        return section

    def _wrong_type(
        self, error_type: LiteralString, message: LiteralString, excluded_name: str = ""
    ) -> PydanticCustomError:
        """Create the error for a type that cannot be used, with a list of the types that can.

        Args:
            error_type: Pydantic's name of the error.
            message: The message.
            excluded_name: The type that the list leaves out. Empty to list all types.
        """
        known_types = {
            kind.name: str(kind) for kind in self.registry.kinds() if kind.name != excluded_name
        }
        return PydanticCustomError(error_type, message, {"known": known_types})


@dataclass(eq=False)
class OrMapping:
    """Annotation of a field of the spec that holds either a value, or a mapping of fields.

    A pydantic union would report a wrong value once for each alternative.

    Attributes:
        value: The type of the value.
        base: The base class of the sections.
        section_of: Returns the section's class for a mapping.
        sections: Returns all sections that can be chosen.
    """

    value: Any
    base: type[BaseModel]
    section_of: Callable[[dict[Any, Any]], type[BaseModel]]
    sections: Callable[[], Iterable[type[BaseModel]]]

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def validate(value: Any, otherwise: Any, info: core_schema.ValidationInfo) -> Any:
            if isinstance(value, self.base):
                return value
            if isinstance(value, dict):
                return validate_section(self.section_of(value), value, info)
            return otherwise(value)

        return core_schema.with_info_wrap_validator_function(
            validate,
            handler.generate_schema(self.value),
            serialization=core_schema.simple_ser_schema("any"),
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        sections = [handler(section.__pydantic_core_schema__) for section in self.sections()]
        return {"anyOf": [handler(schema), *sections]}


@dataclass(eq=False)
class KindName:
    """Annotation of a field of the spec that holds the name of a kind, which is not imported."""

    registry: Registry

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def check(value: str) -> str:
            if value not in self.registry:
                raise PydanticCustomError("literal_error", "is an unknown name")
            return value

        return core_schema.no_info_after_validator_function(check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"type": "string", "enum": list(self.registry.names())}
