"""The two kinds of model predictive control: as published (`pso-mpc`) and as recommended (`mpc`).

Both have the same fields and run `tetractl.control.mpc.Mpc`; their defaults differ.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import Field

from tetractl.control.mpc import MpcSection
from tetractl.control.mpc_section import Collision
from tetractl.core.registries import OPTIMIZERS
from tetractl.experiment.base import defaults
from tetractl.experiment.controller import OptimizerSection
from tetractl.experiment.registry_fields import KindSection

HELD_S = 0.2  # time for which a plan holds each signal: the paper's control period [s]
LONGEST_S = 160.0  # longest trial [s]
ACCEPTED = 0.45
"""Accepted error, as a fraction of the path that all robots together drive in a control period."""
_OPTIMIZER = KindSection(OPTIMIZERS, default="multistart")


class PsoMpc(MpcSection):
    """Algorithm 2 as published: the Euler model, particle swarms, obstacles tested at the predicted
    samples, 5 Hz, and no extensions. Every default is the paper's."""

    type: Literal["pso-mpc"] = "pso-mpc"


@defaults(
    test="swept",
    walls=True,
    separation=lambda given: 2 * given.get("radius", 0.0),
    adaptive=True,
    stop_before_collision=True,
    silence=1.0,
)
class SafeCollision(Collision):
    """How the planner avoids obstacles, the arena's edge, and other robots."""


@defaults(
    period=0.05,
    steps_max=lambda given: max(1, round(LONGEST_S / given.get("period", HELD_S))),
    hold=lambda given: max(1, round(HELD_S / given.get("period", HELD_S))),
    motion="exact",
    estimate=True,
    accept_error=lambda _: 0.0,
    stop_between=True,
    initial_lengths="geometric",
)
class RecommendedMpc(MpcSection):
    """The recommended controller: Algorithm 2 with the exact motion under a held direction, many
    polished starts in place of a particle swarm, identification while robots drive, paths that keep
    clear, and detours if robots would end too far from their targets. Every default is what we
    recommend for robots on wheels."""

    type: Literal["mpc"] = "mpc"
    collision: SafeCollision = SafeCollision()  # pyright: ignore[reportIncompatibleVariableOverride]
    """How the planner of `mpc` avoids obstacles, the arena's edge, and other robots. Robots without
    wheels neither pause nor count with silence by default."""
    optimizer: Annotated[OptimizerSection, _OPTIMIZER] = Field(default_factory=_OPTIMIZER.make)
    """The optimiser of each search."""

    def fitted(self, stands: bool, speed: float) -> Self:
        """Return the section with the defaults for robots of the given summed speed."""
        fitting: dict[str, Any] = {}
        if "accept_error" not in self.model_fields_set:
            fitting["accept_error"] = float(f"{ACCEPTED * self.period * speed:.2g}")
        if not stands:
            off = {"stop_before_collision": False, "silence": 0.0}
            left = {k: v for k, v in off.items() if k not in self.collision.model_fields_set}
            fitting["collision"] = self.collision.model_copy(update=left)
        return self.model_copy(update=fitting)
