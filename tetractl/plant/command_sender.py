"""Send the commands of the host to simulated robots: new actions, repeated actions, and stops."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tetractl.core import elementwise
from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.commands import Command, FieldOff, Steer, Stop, Turn
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.model.motion.wheel_equations import wheel_speeds
from tetractl.plant.direct import aim
from tetractl.plant.sim_section import SimSection
from tetractl.plant.transit import Transit
from tetractl.spec.disturbance import DelayedCommand, Disturbance, overriding
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS

if TYPE_CHECKING:
    from tetractl.plant.wheel_host import SimHost

STOPS_MAX = 3000
"""Maximum number of stops sent while some robot has not received one. They take one minute."""


class CommandSender:
    """Sends commands to N simulated robots, and returns them as the host logs them.

    A logged command also says which robots receive it (`delivered`).

    Args:
        settings: The fields of the simulation in the spec.
        setup: The constants of the experiment.
        host: Computes wheel speeds. None for robots that receive the direction itself.
        transit: Receives the commands on their way to the robots.
        disturbances: The disturbances of the trial.
        random: Decides which transmissions are lost.
    """

    def __init__(
        self,
        settings: SimSection,
        setup: Setup,
        host: "SimHost | None",
        transit: Transit,
        disturbances: Sequence[Disturbance],
        random: np.random.Generator,
    ) -> None:
        self._settings = settings
        self._setup = setup
        self._host = host
        self._transit = transit
        self._random = random
        # a stop to robots without wheels can be lost only by a disturbance
        self._repeats_stops = host is not None or bool(overriding(disturbances, Disturbance.sent))
        self._held: Steer | Turn | FieldOff = FieldOff()

    @property
    def repeats_ns(self) -> int:
        """The time at which the host repeats the held action [ns]. NEVER_NS if it does not."""
        return NEVER_NS if self._host is None else self._host.repeats_ns

    def send(
        self, now_ns: int, answered: Observation, action: Steer | Turn | FieldOff | None = None
    ) -> Command:
        """Send an action, or send the held action again with wheel speeds for this frame.

        Args:
            now_ns: The time of sending [ns].
            answered: The frame that the command answers.
            action: The action to hold, starting now. None to repeat the held action.

        Returns:
            The command as the host logs it, with the robots that receive it in `delivered`.
        """
        if action is not None:
            self._held = action
        is_new = action is not None
        left_speed, right_speed, true_speeds = self._wheel_speeds(now_ns, answered, is_new)
        chances = self._random.uniform(size=len(self._setup.names))
        command = DelayedCommand(
            sent_ns=now_ns,
            due_ns=self._due_ns(now_ns, answered),
            action=self._held,
            reached=chances >= self._settings.lost_commands,
            wheels=true_speeds,
        )
        received = self._transit.send(command, now_ns)
        delivered = tuple(received.reached.tolist())
        return Command(self._held, now_ns, delivered, left_speed, right_speed)

    def send_stops(self, now_ns: int, answered: Observation) -> Command:
        """Send a stop to every robot, and return the first stop.

        If stops may be lost, the stop is sent at least `STOP_COUNT` times, and until every robot
        has received one or STOPS_MAX stops were sent. `delivered` of the result is True for the
        robots that receive any of them.
        """
        robots = len(self._setup.names)
        if self._host is not None:
            self._host.halt(now_ns)
        is_received = np.zeros(robots, dtype=np.bool_)
        for k in range(STOPS_MAX if self._repeats_stops else 1):
            if k >= STOP_COUNT and is_received.all():
                break
            sent_ns = now_ns + k * STOP_GAP_NS
            stop = DelayedCommand(
                sent_ns=sent_ns,
                due_ns=self._due_ns(sent_ns, answered),
                action=Stop(),
                reached=np.ones(robots, dtype=np.bool_),
                wheels=np.zeros((2, robots)),
            )
            is_received |= self._transit.send(stop, now_ns).reached
        standstill = np.zeros(robots) if self._setup.on_wheels else None
        received = tuple(is_received.tolist())
        return Command(Stop(), now_ns, received, standstill, standstill)

    def _due_ns(self, sent_ns: int, answered: Observation) -> int:
        """Compute when a command takes effect if `dead_time` is the only delay [ns].

        The time is `dead_time` after the exposure of the frame that the command answers, but not
        earlier than the sending.
        """
        dead_time_ns = round(self._settings.dead_time * SECOND)
        return max(sent_ns, answered.sampled_ns + dead_time_ns)

    def _wheel_speeds(
        self, now_ns: int, answered: Observation, is_new: bool
    ) -> tuple[Floats | None, Floats | None, Floats | None]:
        """Compute the wheel speeds for the held action [length unit/s].

        Returns:
            The speeds of the left wheels and of the right wheels, (N,) each, as the host knows and
            logs them; None without wheels. Then the true speeds of both, (2, N); None if the robots
            receive the direction itself.
        """
        setup = self._setup
        if self._host is not None:
            known_speeds, true_speeds = self._host.transmit(now_ns, self._held, is_new, answered)
            return known_speeds[0], known_speeds[1], true_speeds
        if setup.wheel_radius is None:
            return None, None, None
        # the robots have wheels, but wheels are not simulated: the speeds of (24)-(25) are logged
        headings = answered.poses.heading
        sine = elementwise.sin(aim(self._held, headings) - headings)
        speed = np.zeros(headings.size) if isinstance(self._held, Turn) else setup.speed
        left_speed, right_speed = wheel_speeds(sine, setup.a, speed, setup.wheel_radius)
        return left_speed, right_speed, None
