"""What moves simulated robots: the protocol of `DirectDrive`, `WheelDrive` and `CellDrive`."""

from typing import Protocol

from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.plant.wheel_host import SimHost


class Drive(Protocol):
    """N simulated robots: where they are, which command each holds, and how it moves them.

    `advance` moves them under what they hold; time passes for them nowhere else. In between,
    `apply` changes what some of them hold, `vary` what they are able to, and `poses` may be set.
    """

    @property
    def host(self) -> SimHost | None:
        """What computes the wheel speeds that are sent; None if the direction itself is sent."""
        ...

    @property
    def sampled(self) -> bool:
        """Whether the path is summed up from sample to sample, so that it depends on the times at
        which it is computed; otherwise it is known in closed form at any time."""
        ...

    @property
    def repeats_ns(self) -> int:
        """When the host transmits the held direction again [ns], NEVER if it does not."""
        ...

    @property
    def rest_s(self) -> float:
        """Time after a stop until the robots stand [s]."""
        ...

    @property
    def poses(self) -> Poses:
        """The present true poses."""
        ...

    @poses.setter
    def poses(self, poses: Poses) -> None: ...

    @property
    def gains(self) -> Floats:
        """By how much the robots' bodies change a and speed, a row each, (2, N): motors of another
        gain, wheels farther apart than the spec says."""
        ...

    @property
    def commanded(self) -> Floats:
        """1 for robots whose last command moves them, 0 for others, (N,)."""
        ...

    @property
    def moving(self) -> Floats:
        """1 for robots that move, 0 for robots that stand, (N,): a robot that is commanded to move
        stands if it is not able to."""
        ...

    def advance(self, since_ns: int, times_ns: Times, samples: Bools) -> Floats:
        """Move the robots from `since_ns`, the present time, to the last of the times (M,) [ns];
        return x, y, heading at each of them, (M, 3, N).

        `samples` (M,) is True for times at which the true path is sampled.
        """
        ...

    def apply(self, command: DelayedCommand) -> None:
        """Give a command to the robots that it reaches; the others hold what they held."""
        ...

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a [rad/s] and speeds [length unit/s] from now on, (N,)
        each; a robot with a = 0 and speed 0 stands."""
        ...
