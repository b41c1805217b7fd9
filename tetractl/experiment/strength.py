"""Turning rates in proportion to the strength B of the field: a = alpha B."""

from typing import Annotated

from pydantic import ConfigDict, Field, model_validator

from tetractl.experiment.base import Model, Positive, PositiveIfStated, inconsistent
from tetractl.experiment.registry_fields import OrMapping

UNITS = {"per_mT": "mT", "per_V_cm": "V/cm"}
"""The unit of the field's strength by the key of alpha."""


class PerStrength(Model):
    """A turning rate in proportion to the field: a = alpha B, at the spec's `strength` B."""

    model_config = ConfigDict(serialize_by_alias=True)

    per_mt: PositiveIfStated = Field(default=None, alias="per_mT")
    """alpha of magnetic cells [rad/s per mT]."""
    per_v_cm: PositiveIfStated = Field(default=None, alias="per_V_cm")
    """alpha of cells in an electric field [rad/s per V/cm]."""

    @model_validator(mode="after")
    def _is_one(self) -> "PerStrength":
        if (self.per_mt is None) == (self.per_v_cm is None):
            raise inconsistent("per_mT", "give either per_mT or per_V_cm")
        return self

    @property
    def key(self) -> str:
        """The key that is given, one of UNITS."""
        return "per_mT" if self.per_mt is not None else "per_V_cm"

    @property
    def alpha(self) -> float:
        """The turning rate [rad/s] per unit of strength."""
        return self.per_mt or self.per_v_cm or 0.0


TurningRate = Annotated[
    float | PerStrength,
    OrMapping(Positive, PerStrength, lambda _: PerStrength, lambda: [PerStrength]),
]
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
