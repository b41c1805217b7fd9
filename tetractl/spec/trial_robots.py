"""Rules by which each trial finds its own robots, instead of a list `robots` in the spec.

Packages provide such rules. An entry point of the group `tetractl.trial_robots` maps a key of the
mapping, such as `choose` in `robots: {choose: 3, ...}`, to its class.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Self

from pydantic_core import PydanticCustomError

from tetractl.core.registries import TRIAL_ROBOTS
from tetractl.spec.base import Model
from tetractl.spec.packages import explain_missing, list_missing
from tetractl.spec.registry_fields import OrMapping


@dataclass(frozen=True, slots=True)
class StandIn:
    """A placeholder for a robot, such as a cell, that a trial has yet to find.

    Attributes:
        name: The robot's name.
        target: The robot's target [length unit].
        a: The turning rate that the robot should have [rad/s].
        speed: The speed that the robot should have [length unit/s].
    """

    name: str
    target: tuple[float, float]
    a: float
    speed: float


class TrialRobots(Model):
    """A rule by which each trial finds its robots itself, for example among cells in a dish."""

    key: ClassVar[str]
    """The name of the class in the registry. The mapping must have it as a key."""
    prepare: ClassVar[str]
    """The function that finds the robots of a trial, as "module:function".

    It is a `tetractl.spec.plants.Prepare`.
    """

    @property
    @abstractmethod
    def are_found(self) -> bool:
        """Whether a trial has already found the robots of this spec."""

    @abstractmethod
    def sought(self) -> Self:
        """Return the rule as the spec gave it, without the robots that a trial has found."""

    @property
    @abstractmethod
    def stand_ins(self) -> Sequence[StandIn]:
        """Placeholders, one for each robot of a trial, until the trial has found its robots."""


def find_rule(mapping: dict[Any, Any]) -> type[TrialRobots]:
    """Find the class of the rule that a spec's mapping `robots` selects by its key.

    Raises:
        PydanticCustomError: If no key of the mapping is the name of a rule.
    """
    installed = TRIAL_ROBOTS.names()
    for name in installed:
        if name in mapping:
            return TRIAL_ROBOTS.load(name)
    uninstalled = [name for name, _ in list_missing(TRIAL_ROBOTS.group, installed)]
    for name in uninstalled:
        explanation = explain_missing(TRIAL_ROBOTS.group, name)
        if name in mapping and explanation:
            context = {"why": ": ".join(explanation), "key": name}
            raise PydanticCustomError("not_installed", "{why}", context)
    rules = ", ".join([*installed, *uninstalled])
    raise PydanticCustomError(
        "no_rule",
        "must be a list, with each robot after a '-', or a mapping with the key {rules}",
        {"rules": rules},
    )


OrTrialRobots = partial(
    OrMapping,
    base=TrialRobots,
    section_of=find_rule,
    sections=lambda: TRIAL_ROBOTS.load_usable().values(),
)
"""Annotation of a field that holds a value, or a mapping by which trials find their robots."""
