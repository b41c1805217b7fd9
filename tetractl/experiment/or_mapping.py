"""Fields whose value may be a mapping in place of what they hold otherwise."""

from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from tetractl.experiment.base import Model


class OrMapping:
    """Annotation of a field of another type whose value may be a mapping, which is read as a
    `model`: a of a robot may be a `PerStrength`, and `plain` is what the value is otherwise."""

    def __init__(self, model: type[Model], plain: Any) -> None:
        self.model = model
        self.plain = plain

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def validate(value: Any, listed: Any, info: core_schema.ValidationInfo) -> Any:
            if not isinstance(value, dict | self.model):
                return listed(value)
            strict = bool(info.context and info.context.get("strict"))
            return self.model.model_validate(value, strict=strict, context=info.context)

        either = core_schema.wrap_serializer_function_ser_schema(
            lambda value, inner: inner(value), schema=handler(source)
        )
        return core_schema.with_info_wrap_validator_function(
            validate, handler.generate_schema(self.plain), serialization=either
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [handler(schema), handler(self.model.__pydantic_core_schema__)]}
