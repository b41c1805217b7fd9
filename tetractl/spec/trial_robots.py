"""The mapping in place of a list of `robots`, by which each trial finds its own.

A package brings it: an entry point of the group `tetractl.trial_robots` maps a key of the mapping,
such as `choose` of `robots: {choose: 3, ...}`, to its class.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Self

from pydantic_core import PydanticCustomError

from tetractl.core.registries import TRIAL_ROBOTS
from tetractl.spec.base import Model
from tetractl.spec.packages import missing, not_installed
from tetractl.spec.registry_fields import OrMapping


@dataclass(frozen=True, slots=True)
class StandIn:
    """A robot of which only what is asked for is known: its place is still to be found. `target`
    [length unit], turning rate `a` [rad/s], `speed` [length unit/s]."""

    name: str
    target: tuple[float, float]
    a: float
    speed: float


class TrialRobots(Model):
    """A rule by which each trial finds its robots."""

    key: ClassVar[str]
    """The name of the class in the registry, which the mapping must have as a key."""
    prepare: ClassVar[str]
    """The function that finds the robots of a trial, a `tetractl.spec.plants.Prepare`, as
    "module:function"."""

    @property
    @abstractmethod
    def are_found(self) -> bool:
        """Whether the robots of the spec with this rule are those that a trial has found."""

    @abstractmethod
    def sought(self) -> Self:
        """Return the rule as the spec gave it, before a trial has found the robots."""

    @property
    @abstractmethod
    def stand_ins(self) -> Sequence[StandIn]:
        """The robots until a trial has found them."""


def rule_of(mapping: dict[Any, Any]) -> type[TrialRobots]:
    """Return the class that is named after a key of the mapping; PydanticCustomError if there is
    none."""
    installed = TRIAL_ROBOTS.names()
    for name in installed:
        if name in mapping:
            return TRIAL_ROBOTS.load(name)
    not_here = [name for name, _ in missing(TRIAL_ROBOTS.group, installed)]
    for name in not_here:
        why = not_installed(TRIAL_ROBOTS.group, name)
        if name in mapping and why:
            context = {"why": ": ".join(why), "key": name}
            raise PydanticCustomError("not_installed", "{why}", context)
    rules = ", ".join([*installed, *not_here])
    raise PydanticCustomError(
        "no_rule",
        "must be a list, each robot after a '-', or have the key {rules}",
        {"rules": rules},
    )


OrTrialRobots = partial(
    OrMapping,
    base=TrialRobots,
    section_of=rule_of,
    sections=lambda: TRIAL_ROBOTS.usable().values(),
)
"""Makes the annotation of a field that holds a value, or a rule by which trials find their robots,
as a mapping."""
