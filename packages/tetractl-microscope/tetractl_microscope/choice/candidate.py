"""A cell that may become a robot of a trial."""

from dataclasses import dataclass

from tetractl.core.poses import Pose

RESPONDS = 3.5  # standard deviations of a above 0: one cell of 4000 is there by chance


@dataclass(frozen=True, slots=True)
class RobotCandidate:
    """A cell of the dish that may become a robot.

    Attributes:
        number: Its number.
        pose: Its pose in the spec's unit.
        a: Its turning rate [rad/s].
        a_sd: Standard deviation of `a` [rad/s].
        speed: Its speed [length unit/s].
        speed_sd: Standard deviation of `speed` [length unit/s].
        free: Whether it stayed away from the arena's edge. Otherwise, a wall may have turned it.
    """

    number: int
    pose: Pose
    a: float
    a_sd: float
    speed: float
    speed_sd: float
    free: bool = True

    @property
    def magnetised(self) -> bool:
        """Whether the cell responds to the field.

        Its a and its speed must exceed 0 by RESPONDS standard deviations. The axis of an object
        that does not swim, such as a speck, may turn because of noise.
        """
        return self.a > RESPONDS * self.a_sd and self.speed > RESPONDS * self.speed_sd
