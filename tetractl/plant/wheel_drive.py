"""Move simulated robots on two wheels, with random errors of wheels and motors.

`SimHost` computes the wheel speeds that are sent. `WheelDrive` moves the robots that receive them,
by the paper's (21)-(23); see `model.wheels`. Wheels have a lag, and their gains and radii differ
from the spec's.
"""

import numpy as np

from tetractl.core import elementary
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.model.motion.rolling import MOVING
from tetractl.model.wheels import NO_NUMBERS, WheeledRobots
from tetractl.plant.random_streams import RandomStream, generator
from tetractl.plant.sim_section import SimSection
from tetractl.plant.wheel_host import SimHost
from tetractl.spec.disturbance import DelayedCommand

STANDSTILL_FRACTION = 1e-10
"""Speed below which wheels count as standing still, as a fraction of the fastest robot's speed."""


class WheelDrive(WheeledRobots):
    """The motion of N simulated robots on two wheels; a `Drive`.

    Turning rates and speeds are scaled by the ratio of the true value to the setup's value. The
    random walk of the headings has one step for each sample of the true path, not for each frame.

    Args:
        section: The fields of the simulation in the spec.
        setup: The constants of the experiment.
        a: True turning rates [rad/s], shape (N,).
        speed: True speeds [length unit/s], shape (N,).
        starts: Poses at the start.
        seed: Seed of all random numbers.
    """

    is_integrated = True

    def __init__(
        self,
        section: SimSection,
        setup: Setup,
        a: Floats,
        speed: Floats,
        starts: Poses,
        seed: np.random.SeedSequence,
    ) -> None:
        from tetractl.plant.drive_kernels import roll  # late: reading a spec needs no kernel

        wheels = section.drive
        assert wheels is not None, "the plant has no wheels"
        assert setup.wheel_radius is not None, "the wheels need a radius"
        random = generator(seed, RandomStream.BODIES)
        host = SimHost(wheels, setup, random)
        radii = setup.wheel_radius * (1 + wheels.radius_error * random.uniform(-1, 1, a.size))
        super().__init__(
            starts, radii, wheels.lag, STANDSTILL_FRACTION * float(setup.speed.max(initial=0.0))
        )
        self.roll = roll
        self.host = host
        self.gains = host.gains * np.array([setup.wheel_radius / radii, np.ones(a.size)])
        self.stopping_s = wheels.lag * -elementary.log(STANDSTILL_FRACTION) + 1 / section.truth_rate
        """Time from a stop until all wheels count as standing still [s]."""
        self._setup = setup
        self._heading_walk_rad = section.heading_noise / np.sqrt(section.truth_rate)
        """Standard deviation of the headings' random walk from one sample to the next [rad]."""
        self._walk_random = generator(seed, RandomStream.HEADINGS)
        self.vary(a, speed)

    @property
    def commanded(self) -> Floats:
        """1 for each robot whose last command makes it move, 0 for the others, shape (N,)."""
        return np.where(self.targets.any(axis=0), 1.0, 0.0)

    @property
    def moving(self) -> Floats:
        """1 for each robot that moves, 0 for each robot that stands still, shape (N,)."""
        return self.body[MOVING].copy()

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a [rad/s] and speeds [length unit/s], shape (N,), now.

        A robot with a = 0 and speed 0 counts as standing still.
        """
        setup = self._setup
        speed_factors = np.divide(
            speed, setup.speed, out=np.ones(speed.size), where=setup.speed > 0
        )
        self.scale(a / setup.a, speed_factors)
        self._is_able = (a > 0) | (speed > 0)
        self._store_moving()

    def advance(self, since_ns: int, times_ns: Times, samples: Bools) -> Floats:
        """Move the robots, and return x, y and heading (M, 3, N); see `Drive.advance`."""
        walk_deviates = NO_NUMBERS
        if self._heading_walk_rad > 0:
            walk_deviates = self._walk_random.standard_normal(
                (np.count_nonzero(samples), self._is_able.size)
            )
        return self.drive(since_ns, times_ns, samples, self._heading_walk_rad, walk_deviates)

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the wheels of the robots that received it."""
        assert command.wheels is not None, "the command must have wheel speeds"
        np.copyto(self.targets, command.wheels, where=command.reached)
        self._store_moving()

    def _store_moving(self) -> None:
        """Store which robots move, for the compiled function `roll` that advances them.

        A robot moves while it is commanded to move and is able to drive or turn.
        """
        self.body[MOVING] = self.commanded * self._is_able
