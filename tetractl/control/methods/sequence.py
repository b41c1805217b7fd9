"""A controller that sends a given sequence of directions without feedback."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.control.methods.fixed_sequence import given_plan
from tetractl.control.methods.plain import PlainController, PlainSection
from tetractl.core.clock import SECOND
from tetractl.core.plan import Decision, End, Outcome, Problem
from tetractl.core.poses import Observation
from tetractl.core.setup import Setup
from tetractl.spec.base import ANGLE_MARK, Finite, NonNegative
from tetractl.spec.controller import ALONE, Host


class SequenceSection(PlainSection):
    """A given sequence of directions, one per control step, without a search."""

    type: Literal["sequence"] = "sequence"
    directions: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=100_000), ANGLE_MARK]
    """The direction of each control step [rad]; the robots are stopped after the last one."""
    remainder: NonNegative = 0.0
    """Time for which the last direction is held in addition to one control period [s]."""

    ahead: ClassVar[int] = 50
    """Maximum number of coming signals for which each step predicts the path."""

    def bounds(self) -> dict[str, str]:
        """Describe the number of directions for display, as {name: text}."""
        return {"directions": f"{len(self.directions)}"}

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> "SequenceController":
        """Create the controller of one trial; see `ControllerSection.build`."""
        return SequenceController(self, setup, key)


class SequenceController(PlainController):
    """The controller of one trial that sends the directions of its spec.

    Args:
        section: The fields of the controller in the spec.
        setup: The constants of the experiment.
        key: Only logged, because nothing is random.
    """

    def __init__(self, section: SequenceSection, setup: Setup, key: int) -> None:
        super().__init__(section, setup, key)
        self.section = section

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Decision:
        """Plan the next direction, or end the trial; see `PlainController.decided`.

        The predicted path contains up to `ahead` directions. After the last direction, the robots
        stop after the additional time `remainder`.
        """
        section = self.section
        if self.k == len(section.directions):
            delay_ns = round(section.remainder * SECOND)
            outcome = Outcome.SEQUENCE_COMPLETED
            return End(outcome, delay_ns) if delay_ns else outcome
        signals = np.array(section.directions[self.k : self.k + section.ahead])
        return given_plan(problem, signals, step_key)
