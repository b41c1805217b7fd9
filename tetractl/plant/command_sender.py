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
from tetractl.plant.direct import find_aimed_directions
from tetractl.plant.sim_section import SimSection
from tetractl.plant.transit import Transit
from tetractl.spec.disturbance import DelayedCommand, Disturbance, overriding
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS

if TYPE_CHECKING:
    from tetractl.plant.wheel_host import SimHost

STOPS_MAX = 3000
"""Maximum number of stops that are sent until every robot has received one: for one minute."""


class CommandSender:
    """Sends commands to N simulated robots, and returns each command as the host logs it.

    A logged command contains which robots receive the command (`delivered`).

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
        self._held_action: Steer | Turn | FieldOff = FieldOff()

    @property
    def next_repeat_ns(self) -> int:
        """The time at which the host repeats the held action [ns]. NEVER_NS for no repetition."""
        return NEVER_NS if self._host is None else self._host.next_repeat_ns

    def send(
        self,
        now_ns: int,
        answered_frame: Observation,
        action: Steer | Turn | FieldOff | None = None,
    ) -> Command:
        """Send an action, or send the held action again with wheel speeds for this frame.

        Args:
            now_ns: The time of sending [ns].
            answered_frame: The frame that the command answers.
            action: The action to hold, starting now. None to repeat the held action.

        Returns:
            The command as the host logs it, with the robots that receive it in `delivered`.
        """
        if action is not None:
            self._held_action = action
        is_new = action is not None
        left_speed, right_speed, true_speeds = self._compute_wheel_speeds(
            now_ns, answered_frame, is_new
        )
        chances = self._random.uniform(size=len(self._setup.names))
        command = DelayedCommand(
            sent_ns=now_ns,
            due_ns=self._compute_due_ns(now_ns, answered_frame),
            action=self._held_action,
            reached=chances >= self._settings.lost_commands,
            wheels=true_speeds,
        )
        delivered_command = self._transit.send(command, now_ns)
        delivered = tuple(delivered_command.reached.tolist())
        return Command(self._held_action, now_ns, delivered, left_speed, right_speed)

    def send_stops(self, now_ns: int, answered_frame: Observation) -> Command:
        """Send a stop to every robot, and return the first stop.

        If stops may be lost, the stop is sent at least `STOP_COUNT` times, and until every robot
        has received one or STOPS_MAX stops were sent. `delivered` of the result is True for the
        robots that receive any of them.
        """
        n_robots = len(self._setup.names)
        if self._host is not None:
            self._host.halt(now_ns)
        is_received = np.zeros(n_robots, dtype=np.bool_)
        for k in range(STOPS_MAX if self._repeats_stops else 1):
            if k >= STOP_COUNT and is_received.all():
                break
            sent_ns = now_ns + k * STOP_GAP_NS
            stop = DelayedCommand(
                sent_ns=sent_ns,
                due_ns=self._compute_due_ns(sent_ns, answered_frame),
                action=Stop(),
                reached=np.ones(n_robots, dtype=np.bool_),
                wheels=np.zeros((2, n_robots)),
            )
            is_received |= self._transit.send(stop, now_ns).reached
        zero_speeds = np.zeros(n_robots) if self._setup.on_wheels else None
        delivered = tuple(is_received.tolist())
        return Command(Stop(), now_ns, delivered, zero_speeds, zero_speeds)

    def _compute_due_ns(self, sent_ns: int, answered_frame: Observation) -> int:
        """Compute when a command takes effect, if the spec's `dead_time` is the only delay [ns].

        The time is `dead_time` after the exposure of the frame that the command answers, but not
        earlier than the sending.
        """
        dead_time_ns = round(self._settings.dead_time * SECOND)
        return max(sent_ns, answered_frame.sampled_ns + dead_time_ns)

    def _compute_wheel_speeds(
        self, now_ns: int, answered_frame: Observation, is_new: bool
    ) -> tuple[Floats | None, Floats | None, Floats | None]:
        """Compute the wheel speeds for the held action [length unit/s].

        Returns:
            First the speeds of the left wheels and of the right wheels, shape (N,) each, as the
            host knows and logs them. None if the robots have no wheels. Then the true speeds of
            both wheels, shape (2, N). None if the robots receive the direction itself.
        """
        setup = self._setup
        if self._host is not None:
            known_speeds, true_speeds = self._host.transmit(
                now_ns, self._held_action, is_new, answered_frame
            )
            return known_speeds[0], known_speeds[1], true_speeds
        if setup.wheel_radius is None:
            return None, None, None
        # the robots have wheels, but wheels are not simulated: the speeds of (24)-(25) are logged
        headings = answered_frame.poses.heading
        sine = elementwise.sin(find_aimed_directions(self._held_action, headings) - headings)
        speed = np.zeros(headings.size) if isinstance(self._held_action, Turn) else setup.speed
        left_speed, right_speed = wheel_speeds(sine, setup.a, speed, setup.wheel_radius)
        return left_speed, right_speed, None
