"""Wraps a disturbance that already exists in a section of a spec."""

from typing import Any, Literal

from tetractl.spec.disturbance import Disturbance, DisturbanceSection


class BuiltSection(DisturbanceSection):
    """Stands for the section of `disturbance`, which has its random numbers as `rng` then."""

    type: Literal["built"] = "built"
    disturbance: Any

    @classmethod
    def holding(cls, disturbance: Disturbance) -> "BuiltSection":
        return cls.model_construct(disturbance=disturbance)

    def build(self, setup, rng):
        self.disturbance.rng = rng
        return self.disturbance
