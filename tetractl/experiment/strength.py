"""Turning rates in proportion to the strength B of the field: a = alpha B."""

from typing import Annotated, Any

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from tetractl.experiment.base import Model, Positive, inconsistent

UNITS = {"per_mT": "mT", "per_V_cm": "V/cm"}
"""The unit of the field's strength by the key of alpha."""


class PerStrength(Model):
    """A turning rate in proportion to the field: a = alpha B, at the spec's `strength` B."""

    per_mt: Positive | None = Field(default=None, alias="per_mT")
    """alpha of magnetic cells [rad/s per mT]."""
    per_v_cm: Positive | None = Field(default=None, alias="per_V_cm")
    """alpha of cells in an electric field [rad/s per V/cm]."""

    @model_validator(mode="after")
    def _is_one(self) -> "PerStrength":
        if (self.per_mt is None) == (self.per_v_cm is None):
            raise inconsistent("per_mT", "give either per_mT or per_V_cm")
        return self

    @model_serializer
    def _given(self) -> dict[str, float]:
        return {self.key: self.alpha}

    @property
    def key(self) -> str:
        """The key that is given, one of UNITS."""
        return "per_mT" if self.per_mt is not None else "per_V_cm"

    @property
    def alpha(self) -> float:
        """The turning rate [rad/s] per unit of strength."""
        return self.per_mt or self.per_v_cm or 0.0


class _OrPerStrength:
    """Annotation of a number in place of which a spec may have a mapping, a `PerStrength`.

    A union of pydantic's would report a wrong value once for each alternative.
    """

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def validate(value: Any, number: Any, info: core_schema.ValidationInfo) -> Any:
            if not isinstance(value, dict | PerStrength):
                return number(value)
            strict = bool(info.context and info.context.get("strict"))
            return PerStrength.model_validate(value, strict=strict, context=info.context)

        either = core_schema.wrap_serializer_function_ser_schema(
            lambda value, inner: inner(value), schema=handler(source)
        )
        return core_schema.with_info_wrap_validator_function(
            validate, handler.generate_schema(Positive), serialization=either
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [handler(schema), handler(PerStrength.__pydantic_core_schema__)]}


TurningRate = Annotated[float | PerStrength, _OrPerStrength()]
"""a of a robot: a number [rad/s], or a mapping with its alpha."""


def rate(a: float | PerStrength, strength: float | None) -> float:
    """Return a turning rate [rad/s] at a strength in the unit of its alpha."""
    return a.alpha * (strength or 0.0) if isinstance(a, PerStrength) else a


def unit_of(rates: tuple[float | PerStrength, ...]) -> str:
    """Return the unit of the strength for turning rates, mT if none depends on it.

    Raises the error of a spec that mixes units.
    """
    units = {UNITS[a.key] for a in rates if isinstance(a, PerStrength)} or {"mT"}
    if len(units) > 1:
        raise inconsistent("robots", "have a per mT and a per V/cm; there is one field")
    return units.pop()
