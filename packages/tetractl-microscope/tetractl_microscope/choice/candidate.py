"""The measured properties of a cell that may become a robot of a trial."""

from dataclasses import dataclass

from tetractl.core.poses import Pose

RESPONDS = 3.5  # standard deviations of a above 0: one cell of 4000 is there by chance


@dataclass(frozen=True, slots=True)
class RobotCandidate:
    """A cell of the dish that a trial can choose as a robot.

    Attributes:
        number: Number of the cell.
        pose: Its pose in the spec's coordinates.
        a: Its turning rate in the reference field [rad/s].
        a_sd: Standard deviation of the estimate of `a` [rad/s].
        speed: Its speed [length unit/s].
        speed_sd: Standard deviation of the estimate of `speed` [length unit/s].
        free: Whether it stayed away from the arena's edge while it was measured. If not, a wall may
            have turned it.
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
        """Whether the cell swims and responds to the field.

        Both its a and its speed must be greater than RESPONDS standard deviations. The test of the
        speed excludes objects that do not swim, such as specks, whose axis may seem to turn because
        of noise.
        """
        return self.a > RESPONDS * self.a_sd and self.speed > RESPONDS * self.speed_sd
