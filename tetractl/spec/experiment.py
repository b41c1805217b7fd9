"""The experiment that a spec describes, with everything that a batch of trials depends on."""

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from tetractl.core.colors import NAMED_COLORS, known_colors
from tetractl.core.losses import LossRule
from tetractl.core.poses import Floats, Poses
from tetractl.core.registries import CONTROLLERS, PLANTS, SHAPES, SPEC_REGISTRIES, TRIAL_ROBOTS
from tetractl.core.registry import Registry
from tetractl.core.route_measure import HoldTask
from tetractl.core.setup import METRES, Bounds, Setup
from tetractl.core.shape import Shape
from tetractl.spec.base import (
    Angle,
    Finite,
    Length,
    Model,
    Name,
    NonNegative,
    Point,
    Positive,
    PositiveIfStated,
    inconsistent,
)
from tetractl.spec.controller import ControllerSection
from tetractl.spec.lab_section import LabLimits, LabSection
from tetractl.spec.plant import PlantSection, Wheels
from tetractl.spec.registry_fields import KindName, KindSection, OrMapping
from tetractl.spec.section_abilities import GivenDirections
from tetractl.spec.trial_robots import OrTrialRobots, TrialRobots


class Units(Model):
    """Units of the numbers in the spec. Angles are radians and times seconds."""

    length: Literal["um", "mm", "cm", "m"] = "mm"
    """Length unit of every position, distance, speed and cost."""


class ShapeSection(Model):
    """Base class of the sections of obstacles, whose shapes are in `tetractl.model.shapes`."""

    type: Any  # the section's name, a Literal in each subclass

    @abstractmethod
    def shape(self) -> Shape:
        """Return the obstacle's shape in the arena's coordinates [length unit]."""


Obstacle = Annotated[ShapeSection, KindSection(SHAPES, ShapeSection)]


class Arena(Model):
    """The field of view: the rectangle that holds the robots and obstacles."""

    left: Finite
    """Minimum x [length unit]."""
    bottom: Finite
    """Minimum y [length unit]."""
    width: Positive
    """Extent in x [length unit]."""
    height: Positive
    """Extent in y [length unit]."""

    @property
    def bounds(self) -> Bounds:
        """The edges of the arena [length unit]: left, bottom, right and top."""
        return Bounds(self.left, self.bottom, self.left + self.width, self.bottom + self.height)


STRENGTH_UNITS = {"per_mT": "mT", "per_V_cm": "V/cm"}
"""The unit of the field's strength, by the key with which a spec gives alpha."""


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
            raise inconsistent("per_mT", "give either per_mT or per_V_cm, and only one of them")
        return self

    @property
    def key(self) -> str:
        """The key that the spec uses, one of STRENGTH_UNITS."""
        return "per_mT" if self.per_mt is not None else "per_V_cm"

    @property
    def alpha(self) -> float:
        """The turning rate per unit of the field's strength [rad/s per mT or per V/cm].

        The unit depends on the key that the spec uses.
        """
        return self.per_mt or self.per_v_cm or 0.0


TurningRate = Annotated[
    float | PerStrength,
    OrMapping(Positive, PerStrength, lambda _: PerStrength, lambda: [PerStrength]),
]
"""a of a robot: a number [rad/s], or a mapping with its alpha."""


def turning_rate(a: float | PerStrength, strength: float | None) -> float:
    """Compute a robot's turning rate [rad/s] at a strength of the field.

    Args:
        a: The rate as the spec gives it. A number does not depend on the strength.
        strength: Strength of the field, in the unit of the rate's alpha. None if it is not stated.
            Then a rate per strength is 0.
    """
    return a.alpha * (strength or 0.0) if isinstance(a, PerStrength) else a


def strength_unit(rates: tuple[float | PerStrength, ...]) -> str:
    """Return the unit of the field's strength in which some turning rates are given.

    The unit is mT if no rate depends on the strength. Mixed units raise PydanticCustomError.
    """
    units = {STRENGTH_UNITS[a.key] for a in rates if isinstance(a, PerStrength)} or {"mT"}
    if len(units) > 1:
        raise inconsistent(
            "robots",
            "have rates a per mT and rates a per V/cm, but one field steers all robots",
        )
    return units.pop()


class Robot(Model):
    """One robot: its start, its target, and its motion by the paper's equations (1)-(3)."""

    name: Name
    """Unique name of the robot: letters without accents (a to z, A to Z), digits, spaces, dots,
    underscores and hyphens, starting with a letter or digit.
    """
    start: Point
    """Start position [x, y] [length unit]."""
    heading: Angle = 0.0
    """Start heading theta, anticlockwise from +x [rad]."""
    target: Point
    """Target position [x, y] [length unit]."""
    via: tuple[Point, ...] = Field(default=(), max_length=100)
    """Way-points [x, y] before the target, in order [length unit].

    All robots pass their way-points together, so all have the same number of them.
    """
    a: TurningRate
    """Turning rate a towards the common direction [rad/s], in the paper's equation (3).

    It can also be a mapping, if it is proportional to the spec's `strength`.
    """
    speed: NonNegative
    """Speed v [length unit/s]."""
    color: str | None = Field(default=None, pattern=r"^(#[0-9a-fA-F]{6}|[a-z]{3,20})$")
    """Colour in figures: a CSS name or #rrggbb. Default: a colour from a colour-blind safe list."""

    @field_validator("color")
    @classmethod
    def _is_known(cls, color: str | None) -> str | None:
        is_name = color is not None and not color.startswith("#") and color not in NAMED_COLORS
        if is_name and color not in known_colors():
            raise PydanticCustomError(
                "unknown_color", "is unknown", {"known": list(known_colors())}
            )
        return color


class HoldSection(Model):
    """A hold after the arrival: robots on wheels stand, others circle near their targets."""

    radius: Positive
    """Distance from its target within which a robot has to stay [length unit]."""
    time: float = Field(gt=0, le=1e5, allow_inf_nan=False)
    """Duration of the hold [s]; it counts towards `controller.time_limit`."""


class Trials(Model):
    """How many trials a batch has, and the seed of all its random numbers."""

    count: int = Field(default=20, ge=1, le=1_000_000)
    """Number of trials."""
    seed: int = Field(default=1, ge=0, lt=2**64)
    """Seed of the random numbers of all trials: the same seed gives the same trials."""


class Reference(Model):
    """A published result that the statistics are compared with, in the spec's length unit."""

    source: str = Field(min_length=1, max_length=500)
    """Where the result was published."""
    n: int = Field(ge=2)
    """Number of trials."""
    mean: Length
    """Mean total error [length unit]."""
    std: Length
    """Standard deviation (n - 1) of the total error [length unit]."""


_RobotList = Annotated[tuple[Robot, ...], Field(min_length=1, max_length=1000)]
_PLANT_FIELD = KindSection(PLANTS, PlantSection, default="sim")
DEFAULT_CONTROLLER = "mpc"
_CONTROLLER_FIELD = KindSection(CONTROLLERS, ControllerSection, default=DEFAULT_CONTROLLER)


FIELDS_WITHOUT_EFFECT = frozenset({"trials", "description", "error_bound"})
"""Fields of an experiment that change no trial.

Batches that differ in these fields can be combined and compared.
"""


class Experiment(Model):
    """One experiment: all contents of a spec, a YAML file."""

    name: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """Name of the experiment and, by default, of its log folders: letters without accents (a to z,
    A to Z), digits, dots, underscores and hyphens, starting with a letter or digit.
    """
    description: str = ""
    """Description in one or two sentences."""
    units: Units = Units()
    """Units of all numbers."""
    arena: Arena
    """The field of view; starts and targets must lie in it."""
    robots: Annotated[_RobotList, OrTrialRobots(_RobotList)]
    """The robots, all steered by the one direction u.

    Instead of a list, this can be a mapping with `choose`: then each trial finds its robots.
    """
    strength: PositiveIfStated = None
    """Strength B of the field: in V/cm if robots have `a: {per_V_cm: ...}`, otherwise in mT.

    Coils need it. Turning rates a in rad/s apply at this strength.
    """
    chosen: Annotated[TrialRobots | None, OrTrialRobots(None)] = None
    """In a resolved spec, the mapping that was given as `robots`.

    Then `robots` holds placeholders until a trial has found its robots.
    """
    assign: Literal["given", "free"] = "given"
    """With `free`, any robot may go to any target.

    Targets are then assigned so that the sum of the squared distances from start to target is
    minimal, which minimises the motion that robots do not have in common. The resolved spec holds
    the assigned targets, and `given`.
    """
    hold: HoldSection | None = None
    """Task to stay near the targets after the arrival.

    Results report the fraction of the time that each robot is within the radius.
    """
    on_lost: Literal["stop", "drop", "replace"] = "stop"
    """What happens if a robot is lost.

    The trial ends (`stop`), goes on without the robot (`drop`), or goes on with the most similar
    free cell in its place (`replace`, which needs `robots: {choose: N}` and no obstacles). A robot
    is lost if it is untracked for `lab.limits.untracked_abort`. A robot on wheels is also lost if
    it is seen, but does not move while another drives for 5 s. A cell is also lost if it is about
    to leave the arena, has divided, or cannot be identified. The error of a dropped robot is the
    distance from its last pose to the target. In simulations, untracked robots are lost after 0.3
    s, but `stop` ends a trial only if a robot on wheels does not move.
    """
    obstacles: tuple[Obstacle, ...] = Field(default=(), max_length=1000)
    """Obstacles, which no robot may enter."""
    wheels: Wheels | None = None
    """Wheel geometry; if given, the log holds the wheel speeds of every command."""
    controller: Annotated[ControllerSection, _CONTROLLER_FIELD] = Field(
        default_factory=_CONTROLLER_FIELD.make
    )
    """The controller."""
    plant: Annotated[PlantSection, _PLANT_FIELD] = Field(default_factory=_PLANT_FIELD.make)
    """The plant; a simulation if no `type` is given."""
    lab: Annotated[LabSection, KindSection(PLANTS, LabSection, default="lab")] | None = None
    """The lab that `--plant lab` or `--plant emulated` uses instead of `plant`."""
    identified: str | None = Field(default=None, max_length=1000)
    """File written by `tetractl identify`, relative to the spec.

    Its dead time, and the turning rate a and speed of each robot, replace the spec's values.
    """
    trials: Trials = Trials()
    """Number and seed of the trials."""
    error_bound: Positive | None = None
    """Total error [length unit] above which a trial counts as far off.

    Tables show how many trials are far off. Default: 10 times the batch's median.
    """
    reference: Reference | None = None
    """A published result to compare with."""

    def __repr_args__(self) -> Iterator[tuple[str, object]]:
        yield from (("name", self.name), ("plant", self.plant.type), ("trials", self.trials.count))

    @model_validator(mode="after")
    def _with_assigned_targets(self) -> Self:
        """Assign the targets, and set `assign` to `given`, so that they are not assigned again.

        If each trial chooses its robots, store the rule in `chosen`, and put placeholders in the
        middle of the arena instead. Their targets are assigned later.
        """
        if isinstance(self.robots, TrialRobots):
            # placeholders in the arena's middle, until a trial's robots are known
            arena = self.arena
            middle = (arena.left + arena.width / 2, arena.bottom + arena.height / 2)
            placeholders = tuple(
                Robot(
                    name=robot.name,
                    start=middle,
                    target=robot.target,
                    a=robot.a,
                    speed=robot.speed,
                )
                for robot in self.robots.stand_ins
            )
            # allowed, although the model is immutable: it is not in use yet
            object.__setattr__(self, "chosen", self.robots)
            object.__setattr__(self, "robots", placeholders)
        if self.assign == "given" or self.chosen is not None:
            return self
        targets = [robot.target for robot in self.robots]
        target_indices = assign_targets(
            np.array([robot.start for robot in self.robots]), np.array(targets)
        )
        robots = tuple(
            robot.model_copy(update={"target": targets[i]})
            for robot, i in zip(self.robots, target_indices, strict=True)
        )
        object.__setattr__(self, "robots", robots)
        object.__setattr__(self, "assign", "given")
        return self

    @model_validator(mode="after")
    def _with_a_controller_for_the_robots(self) -> Self:
        speed = sum(robot.speed for robot in self.robots)
        fitted = self.controller.fitted(self.wheels is not None, speed)
        object.__setattr__(self, "controller", fitted)
        return self

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        """Refuse a spec if some of its fields contradict each other.

        This applies to unequal numbers of way-points, to `on_lost: replace` where it is not
        supported, and to a missing `strength`. Only the first contradiction is reported.
        """
        via_counts = {len(robot.via) for robot in self.robots}
        if len(via_counts) > 1:
            listed = " and ".join(map(str, sorted(via_counts)))
            message = (
                f"have {listed} way-points in via; all robots need the same number of way-points"
            )
            raise inconsistent("robots", message)
        if self.on_lost == "replace" and (self.chosen is None or self.obstacles):
            raise inconsistent(
                "on_lost",
                "can be used only with 'robots: {choose: N}' and without obstacles",
            )
        rates = tuple(robot.a for robot in self.robots)
        unit = strength_unit(rates)
        if self.strength is None and any(isinstance(a, PerStrength) for a in rates):
            raise inconsistent(
                "strength", f"is missing, because the a of robots is given per {unit}: add it"
            )
        return self

    @property
    def must_choose_robots(self) -> bool:
        """Whether each trial still has to choose its robots, for example among cells in a dish."""
        return self.chosen is not None and not self.chosen.are_found

    @property
    def gives_directions(self) -> bool:
        """Whether the spec gives the directions, and no controller decides.

        The directions may have been chosen in hindsight, so the errors say nothing about a
        controller.
        """
        return isinstance(self.controller, GivenDirections)

    @property
    def stated_robots(self) -> tuple[Robot, ...] | TrialRobots:
        """The robots as the spec states them: a list, or a rule by which each trial chooses them.

        They are the same for all trials of a spec.
        """
        return self.chosen.sought() if self.chosen else self.robots

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with the fields in `update` replaced. Their values are not validated.

        The copy computes its own `setup`, because `setup` depends on the plant.
        """
        copied = super().model_copy(update=update, deep=deep)
        vars(copied).pop("setup", None)
        return copied

    @cached_property
    def setup(self) -> Setup:
        """The numbers of the experiment as arrays, with one entry for each robot.

        Robots are in the spec's order, and lengths in its length unit.
        """
        starts = [(*robot.start, robot.heading) for robot in self.robots]
        control = self.controller
        lag_s = self.wheels.lag if self.wheels else 0.0
        if isinstance(self.plant, LabSection) and self.plant.lag is not None:
            lag_s = self.plant.lag
        return Setup(
            name=self.name,
            unit=self.units.length,
            metres=METRES[self.units.length],
            names=tuple(robot.name for robot in self.robots),
            colors=tuple(robot.color for robot in self.robots),
            starts=Poses.from_array(np.array(starts, dtype=np.float64)),
            targets=np.array([robot.target for robot in self.robots], dtype=np.float64),
            a=np.array(
                [turning_rate(robot.a, self.strength) for robot in self.robots], dtype=np.float64
            ),
            speed=np.array([robot.speed for robot in self.robots], dtype=np.float64),
            strength=self.strength,
            strength_unit=strength_unit(tuple(robot.a for robot in self.robots)),
            arena=self.arena.bounds,
            obstacles=tuple(obstacle.shape() for obstacle in self.obstacles),
            period_s=control.period,
            time_limit_s=control.time_limit,
            iterations_max=control.iterations_max,
            wheel_radius=self.wheels.radius if self.wheels else None,
            watchdog_s=(self.wheels and self.wheels.watchdog) or math.inf,
            lag_s=lag_s,
            body_radius=control.body_radius,
            sight=self.plant.sight,
            way_points=np.array([robot.via for robot in self.robots], dtype=np.float64)
            .reshape(len(self.robots), -1, 2)
            .swapaxes(0, 1),
            hold=HoldTask(self.hold.radius, self.hold.time) if self.hold else None,
            loss=self._loss,
        )

    @property
    def _loss(self) -> LossRule | None:
        """The rule by which robots count as lost.

        None if a lost robot stops the trial and the robots have no wheels. Then only the plant
        decides which robots are lost.
        """
        on_wheels = self.wheels is not None
        if self.on_lost == "stop" and not on_wheels:
            return None
        limits = self.plant.limits if isinstance(self.plant, LabSection) else LabLimits()
        return LossRule(
            limits.untracked_abort,
            replaces_lost=self.on_lost == "replace",
            includes_dead=on_wheels,
            ends_trial=self.on_lost == "stop",
        )


def assign_targets(starts: Floats, targets: Floats) -> list[int]:
    """Assign a target to each robot, so that the sum of the squared distances is minimal.

    This minimises the motion that robots do not have in common.

    Args:
        starts: Start positions, shape (N, 2).
        targets: Target positions, shape (M, 2), M at least N.

    Returns:
        Index of the target for each start, N entries.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and seldom needed

    squared_distances = np.square(starts[:, None] - targets).sum(axis=2)
    return linear_sum_assignment(squared_distances)[1].tolist()


def find_packages(spec: Model) -> dict[str, str]:
    """Find the packages other than tetractl that provide kinds used in a spec.

    Returns:
        The version of each package, by name. Empty if all kinds are built in.
    """
    used_kinds = (registry.kind(name) for registry, name in _find_kinds(spec))
    return {kind.package: kind.version for kind in used_kinds if kind.package}


def _find_kinds(value: Any) -> Iterator[tuple[Registry, str]]:
    """Yield the registry and the name of every kind that a part of the spec uses, at any depth.

    A kind that is used several times is yielded several times.
    """
    if isinstance(value, tuple):
        for entry in value:
            yield from _find_kinds(entry)
    if isinstance(value, TrialRobots):
        yield TRIAL_ROBOTS, value.key
    if isinstance(value, Model):
        fields = dict(value)
        name = fields.get("type")
        for registry in SPEC_REGISTRIES:  # two registries may have a kind of the same name
            if isinstance(name, str) and name in registry and type(value) is registry.load(name):
                yield registry, name
        for field, field_info in type(value).model_fields.items():
            field_value = fields[field]
            yield from _find_kinds(field_value)
            for annotation in field_info.metadata:
                if isinstance(annotation, KindName) and isinstance(field_value, str):
                    yield annotation.registry, field_value
                is_foreign = (
                    isinstance(annotation, KindSection)
                    and annotation.registry not in SPEC_REGISTRIES
                )
                if is_foreign and isinstance(
                    field_value, Model
                ):  # a registry that a package brings
                    yield annotation.registry, dict(field_value)["type"]
