"""The fields of the paper's Algorithm 2 in a spec.

`pso-mpc` has them as published. The recommended controller `mpc` extends them (`mpc_section`).
"""

from dataclasses import replace
from pkgutil import resolve_name
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from tetractl.control.methods.plain import PlainSection
from tetractl.core.plan import Limits, Problem
from tetractl.core.poses import Poses
from tetractl.core.protocols import Controller
from tetractl.core.registries import MOTIONS, OPTIMIZERS
from tetractl.core.setup import Setup
from tetractl.spec.base import NonNegative
from tetractl.spec.controller import ALONE, Host, OptimizerSection
from tetractl.spec.registry_fields import KindName, KindSection

_PSO = KindSection(OPTIMIZERS, OptimizerSection, default="pso")


class SearchFields(PlainSection):
    """The fields that `pso-mpc` and `mpc` share, with the paper's defaults."""

    controller: ClassVar[str]
    """The controller as "module:class", called with (section, setup, key, host)."""

    motion: Annotated[str, KindName(MOTIONS)] = "euler"
    """Predicted motion.

    `euler` is the paper's equations (4)-(6). `exact` is the closed form of (1)-(3) under a held
    direction.
    """
    horizon_max: int = Field(default=51, ge=1, le=2000)
    """Length of the longest sequence tried, in signals.

    In `pso-mpc` this applies to step 0, because its later sequences are never longer. A sequence of
    `length` signals is the paper's horizon h = length - 1.
    """
    obstacle_weight: NonNegative = 1000.0
    """Weight omega_p of the obstacle potential in the paper's equation (7) [length unit]."""
    optimizer: Annotated[OptimizerSection, _PSO] = Field(default_factory=_PSO.make)
    """The optimiser of each search."""

    @property
    def iterations_max(self) -> int:
        """Maximum number of iterations of one search for a sequence of signals."""
        return self.optimizer.iterations_max

    def bounds(self) -> dict[str, str]:
        """Describe the limits of horizons and evaluations for display, as {name: text}."""
        limits = {"horizons at step 0": f"1 ... {self.horizon_max} signals"}
        if evaluations_max := self.optimizer.evaluations_max:
            limits["cost evaluations of a horizon"] = f"at most {evaluations_max}"
        return limits

    def numbers_held(self, setup: Setup) -> int:
        """Estimate how many floats the longest search stores.

        The floats are the positions, velocities, best positions and poses of particles, and the
        Jacobian of a polish.
        """
        robots = len(setup.names)
        length = self.horizon_max
        swarm = 4 * self.optimizer.evaluations_min * (length + robots)
        residuals = robots * (2 + robots // 2 + len(setup.obstacles))
        return swarm + residuals * length

    def problem(self, setup: Setup, poses: Poses | None = None) -> Problem:
        """Return the problem for robots at given poses, or at their starts if `poses` is None.

        Obstacles are tested at the predicted samples, as in the paper's equation (13).
        """
        problem = replace(
            super().problem(setup), motion=self.motion, obstacle_weight=self.obstacle_weight
        )
        return problem if poses is None else replace(problem, poses=poses)

    def warm_up(self, setup: Setup) -> None:
        """Compile the planner's functions, by searching for one signal and predicting its path."""
        from tetractl.control.search.evaluate import compiled_prediction

        problem = self.problem(setup)
        search = self.optimizer.search(problem, 1, np.zeros(1), 0, Limits())
        compiled_prediction(problem, search.signals)

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> Controller:
        """Create the controller of one trial; see `ControllerSection.build`."""
        return resolve_name(self.controller)(self, setup, key, host)


class PsoMpc(SearchFields):
    """Algorithm 2 as published, without extensions. Every default is the paper's.

    It uses the Euler model and particle swarms, tests obstacles at the predicted samples, and runs
    at 5 Hz.
    """

    type: Literal["pso-mpc"] = "pso-mpc"
    steps_max: int = Field(default=100, ge=1, le=1_000_000)
    """Index of the last control step, k_max.

    Steps count from 0, so a trial has at most k_max + 1.
    """

    controller: ClassVar[str] = "tetractl.control.methods.algorithm2:Algorithm2"

    def fitted(self, stands: bool, speed: float) -> Self:
        """Return the section with a time limit that no trial of `steps_max` steps exceeds.

        A time limit given in the spec is kept.
        """
        if "time_limit" in self.model_fields_set:
            return self
        return self.model_copy(update={"time_limit": (self.steps_max + 1) * self.period})

    def bounds(self) -> dict[str, str]:
        """Describe the limits of steps, horizons and evaluations for display, as {name: text}."""
        return {"control steps of a trial": f"at most {self.steps_max + 1}"} | super().bounds()
