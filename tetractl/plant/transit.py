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

    def __init__(self, robots: int, disturbances: Sequence[Disturbance]) -> None:
        self._disturbances = overriding(disturbances, Disturbance.sent)
        self._in_flight = list[DelayedCommand]()  # by `due_ns`
        self._last_ns = [0] * robots  # when the command sent last acts on each robot [ns]

    @property
    def settled_ns(self) -> int:
        """The time at which the last command sent so far acts on the last robot [ns]."""
        return max(self._last_ns, default=0)

    @property
    def next_ns(self) -> int:
        """The time at which the next command takes effect [ns]. NEVER if there is none."""
        return self._in_flight[0].due_ns if self._in_flight else NEVER_NS

    def send(self, command: DelayedCommand, now_ns: int) -> DelayedCommand:
        """Send a command at `now_ns`, and return it as disturbances have changed it.

        The result contains the time at which it takes effect and the robots that receive it.
        """
        for disturbance in self._disturbances:
            command = disturbance.sent(command)
        if command.late_ns is None and command.due_ns >= max(self.settled_ns, now_ns):
            # it acts on all robots at once, after every other one
            self._last_ns = [command.due_ns] * len(self._last_ns)
            self._in_flight.append(command)
        else:
            self._add_by_robot(command, now_ns)
        return command

    def pop(self) -> DelayedCommand:
        """Remove the command that takes effect next, and return it. There must be one."""
        return self._in_flight.pop(0)

    def _add_by_robot(self, command: DelayedCommand, now_ns: int) -> None:
        """Split a command into parts, one for each time at which it reaches some of the robots."""
        robots = len(self._last_ns)
        late_ns = [0] * robots if command.late_ns is None else command.late_ns.tolist()
        self._last_ns = [
            max(command.due_ns + robot_late_ns, robot_last_ns, now_ns)
            for robot_late_ns, robot_last_ns in zip(late_ns, self._last_ns, strict=True)
        ]
        for due_ns in sorted(set(self._last_ns)):
            due_now = np.array(self._last_ns) == due_ns
            partial_command = replace(command, due_ns=due_ns, reached=command.reached & due_now)
            insort(self._in_flight, partial_command, key=lambda queued: queued.due_ns)


class Watchdogs:
    """Timers that stop each of N robots that has received no command for `timeout_s`.

    `timeout_s` is inf if robots have no watchdogs. After a stop, the robot's watchdog is inactive
    until its next command.
    """

    def __init__(self, robots: int, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._expire_ns = [NEVER_NS] * robots
        self.next_ns = NEVER_NS
        """The time when the next watchdog expires [ns]. NEVER if none is active."""

    def restart(self, command: DelayedCommand) -> None:
        """Restart the watchdogs of the robots on which a command acts now.

        A stop makes the watchdogs inactive.
        """
        if self._timeout_s == math.inf:
            return
        if isinstance(command.action, Stop):
            expires_ns = NEVER_NS
        else:
            expires_ns = command.due_ns + round(self._timeout_s * SECOND)
        for i, reached in enumerate(command.reached.tolist()):
            if reached:
                self._expire_ns[i] = expires_ns
        self.next_ns = min(self._expire_ns)

    def stop(self, now_ns: int) -> DelayedCommand:
        """Return the stop of all robots whose timer expires at this time."""
        expired = np.array(self._expire_ns) == now_ns
        standstill = np.zeros((2, expired.size))
        return DelayedCommand(now_ns, now_ns, Stop(), expired, wheels=standstill)
