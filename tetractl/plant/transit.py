"""Commands on their way to simulated robots, and watchdogs that stop robots without commands."""

import math
from bisect import insort
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.commands import Stop
from tetractl.spec.disturbance import DelayedCommand, Disturbance, overriding


class Transit:
    """The commands in flight to N robots, in the order in which they take effect.

    Commands to one robot do not overtake each other: a command that would take effect before the
    previous one takes effect together with it.
    """

    def __init__(self, n_robots: int, disturbances: Sequence[Disturbance]) -> None:
        self._disturbances = overriding(disturbances, Disturbance.sent)
        self._in_flight = list[DelayedCommand]()  # by `due_ns`
        self._last_due_ns = [0] * n_robots  # when the last command sent takes effect on each robot

    @property
    def last_due_ns(self) -> int:
        """The time at which all commands sent so far have taken effect on all robots [ns]."""
        return max(self._last_due_ns, default=0)

    @property
    def next_due_ns(self) -> int:
        """The time at which the next command takes effect [ns]. NEVER_NS without such a command."""
        return self._in_flight[0].due_ns if self._in_flight else NEVER_NS

    def send(self, command: DelayedCommand, now_ns: int) -> DelayedCommand:
        """Send a command at `now_ns`, and return the command as the disturbances have changed it.

        The result contains the time at which the command takes effect, and the robots that receive
        the command.
        """
        for disturbance in self._disturbances:
            command = disturbance.sent(command)
        if command.late_ns is None and command.due_ns >= max(self.last_due_ns, now_ns):
            # the command acts on all robots at once, after every other command
            self._last_due_ns = [command.due_ns] * len(self._last_due_ns)
            self._in_flight.append(command)
        else:
            self._add_by_robot(command, now_ns)
        return command

    def pop(self) -> DelayedCommand:
        """Remove and return the command that takes effect next. A command must be in flight."""
        return self._in_flight.pop(0)

    def _add_by_robot(self, command: DelayedCommand, now_ns: int) -> None:
        """Queue a command in parts, one for each time at which it takes effect on some robots."""
        n_robots = len(self._last_due_ns)
        robot_delays_ns = [0] * n_robots if command.late_ns is None else command.late_ns.tolist()
        self._last_due_ns = [
            max(command.due_ns + robot_delay_ns, robot_last_due_ns, now_ns)
            for robot_delay_ns, robot_last_due_ns in zip(
                robot_delays_ns, self._last_due_ns, strict=True
            )
        ]
        for due_ns in sorted(set(self._last_due_ns)):
            is_due = np.array(self._last_due_ns) == due_ns
            partial_command = replace(command, due_ns=due_ns, reached=command.reached & is_due)
            insort(self._in_flight, partial_command, key=lambda queued: queued.due_ns)


class Watchdogs:
    """Timers that stop each of N robots if it receives no command for `timeout_s`.

    After a stop, a robot's watchdog is inactive until the robot's next command.

    Args:
        n_robots: Number of robots.
        timeout_s: Time without a command after which a robot stops [s]. inf if the robots have no
            watchdogs.
    """

    def __init__(self, n_robots: int, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._expiry_times_ns = [NEVER_NS] * n_robots
        self.next_expiry_ns = NEVER_NS
        """The time at which the next watchdog expires [ns]. NEVER_NS if no watchdog is active."""

    def restart(self, command: DelayedCommand) -> None:
        """Restart the watchdogs of the robots on which a command acts now.

        A stop makes the watchdogs inactive.
        """
        if self._timeout_s == math.inf:
            return
        if isinstance(command.action, Stop):
            expiry_ns = NEVER_NS
        else:
            expiry_ns = command.due_ns + round(self._timeout_s * SECOND)
        for i, reached in enumerate(command.reached.tolist()):
            if reached:
                self._expiry_times_ns[i] = expiry_ns
        self.next_expiry_ns = min(self._expiry_times_ns)

    def stop_expired(self, now_ns: int) -> DelayedCommand:
        """Create a stop for all robots whose watchdog expires at `now_ns`."""
        has_expired = np.array(self._expiry_times_ns) == now_ns
        zero_speeds = np.zeros((2, has_expired.size))
        return DelayedCommand(now_ns, now_ns, Stop(), has_expired, wheels=zero_speeds)
