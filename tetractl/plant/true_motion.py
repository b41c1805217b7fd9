"""The true motion of simulated robots: commands in transit, disturbances, camera, path check."""

import math
from bisect import insort
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.commands import Stop
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import POSE_MAX, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand, Disturbance, overriding
from tetractl.model.path_check import PathCheck
from tetractl.plant.cell_drive import CellDrive
from tetractl.plant.direct import DirectDrive
from tetractl.plant.sim_camera import Beats, SimCamera
from tetractl.plant.wheel_drive import WheelDrive

Drive = DirectDrive | WheelDrive | CellDrive
UNCHECKED = 200  # number of parts of the path after which they are checked together


class Transit:
    """The commands on their way to the N robots of one trial, in the order in which they act."""

    def __init__(self, robots: int, disturbances: Sequence[Disturbance]) -> None:
        self.disturbances = overriding(disturbances, "sent")
        self._queue = list[DelayedCommand]()
        # times at which the last command sent acts on each robot [ns]
        self._acting_ns = [0] * robots

    @property
    def settled_ns(self) -> int:
        """The time when the last command sent so far acts on the last robot [ns]."""
        return max(self._acting_ns, default=0)

    @property
    def next_ns(self) -> int:
        """The time when the next command acts [ns], NEVER for none."""
        return self._queue[0].due_ns if self._queue else NEVER

    def send(self, command: DelayedCommand, now: int) -> DelayedCommand:
        """Send a command `now` [ns], and return the command as the robots will receive it."""
        for disturbance in self.disturbances:
            command = disturbance.sent(command)
        robots = len(self._acting_ns)
        if command.late_ns is None and command.due_ns >= max(self.settled_ns, now):
            self._acting_ns = [command.due_ns] * robots
            self._queue.append(command)
            return command
        late = [0] * robots if command.late_ns is None else command.late_ns.tolist()
        self._acting_ns = [
            max(command.due_ns + each, acting, now)
            for each, acting in zip(late, self._acting_ns, strict=True)
        ]
        for when in sorted(set(self._acting_ns)):
            reached = command.reached & (np.array(self._acting_ns) == when)
            part = replace(command, due_ns=when, reached=reached)
            insort(self._queue, part, key=lambda one: one.due_ns)
        return command

    def pop(self) -> DelayedCommand:
        """Remove and return the next command."""
        return self._queue.pop(0)


class TrueMotion:
    """Moves N robots in continuous time, exposes the camera's frames and checks the true path.

    `a` and `speed` (N,) are the trial's values, before disturbances vary them. `heading_walk`
    [rad] is the random walk of the headings of robots without wheels, drawn from `walking`
    at each frame; `beats` are the times of frames and samples. `repeat(now)` is called at each time
    [ns] at which the drive repeats a transmission.
    """

    def __init__(
        self,
        setup: Setup,
        a: Floats,
        speed: Floats,
        drive: Drive,
        camera: SimCamera,
        beats: Beats,
        disturbances: Sequence[Disturbance],
        heading_walk: float,
        walking: np.random.Generator,
        repeat: Callable[[int], None],
    ) -> None:
        self.drive, self.path_check = drive, PathCheck.of(setup)
        self._camera, self._disturbances, self._repeat = camera, disturbances, repeat
        self._a, self._speed = a, speed
        self.rates = a, speed  # present a and speed
        self._moving = overriding(disturbances, "moved")
        self._varying = overriding(disturbances, "varied")
        # per disturbance in `_varying`: which robots it holds, (N,)
        self._held = [np.zeros(len(setup.names), dtype=np.bool_) for _ in self._varying]
        self._walk, self._walking = heading_walk, walking
        self._disturbs = bool(self._moving or self._varying)
        self._by_frame = self._disturbs or heading_walk > 0
        self.beats = beats
        self.transit = Transit(len(setup.names), disturbances)
        self._watchdog_s = setup.watchdog_s
        self._stopping_ns = [NEVER] * len(setup.names)  # times of the watchdogs [ns]
        self._stops_ns = NEVER  # the first of them
        self._time = 0
        self._reached = -1  # the last time to which `advance` was called [ns]
        self._disturbed_ns = -1  # time up to which the disturbances have acted
        self._path: list[Floats] = []  # x, y, heading (M, 3, N) of samples not yet checked

    def advance(self, until: int) -> None:
        """Advance the robots to `until` [ns], in intervals with constant held commands."""
        if until == self._reached < self.transit.next_ns:
            return
        while True:
            frame, stopping = self.beats.next_frame_ns, self._stops_ns
            repeating = self.drive.repeats_ns
            end = min(until, repeating, stopping, frame if self._by_frame else until)
            command = None
            if self.transit.next_ns <= end:
                command = self.transit.pop()
            elif end == stopping:
                command = self._silent(end)
            reached = command.due_ns if command else end
            disturbed = self._disturbs and (reached == frame or command is not None)
            repeats = command is None and reached == repeating
            self._move(reached, command is not None or disturbed or repeats, disturbed)
            self._camera.receive(reached)
            if self._walk > 0 and reached == frame:
                self._swerve()
            if command:
                self._apply(command)
            elif repeats:
                self._repeat(reached)
            elif reached == until:
                self._reached = until
                return

    def _apply(self, command: DelayedCommand) -> None:
        """Apply a command to the robots that it reaches."""
        self.drive.apply(command)
        if self._watchdog_s < math.inf:
            silent_ns = command.due_ns + round(self._watchdog_s * SECOND)
            until = NEVER if isinstance(command.action, Stop) else silent_ns
            reached = zip(command.reached.tolist(), self._stopping_ns, strict=True)
            self._stopping_ns = [until if got else before for got, before in reached]
            self._stops_ns = min(self._stopping_ns)

    def _silent(self, now: int) -> DelayedCommand:
        """Return a stop command for the robots whose watchdog expires now [ns]."""
        silent = np.array(self._stopping_ns) == now
        return DelayedCommand(now, now, Stop(), silent, wheels=np.zeros((2, silent.size)))

    def _swerve(self) -> None:
        """Apply the random walk of the headings over one frame period."""
        drive, p = self.drive, self.drive.poses
        walk = self._walk * self._walking.standard_normal(p.x.size) * drive.moving
        drive.poses = Poses(p.x, p.y, p.heading + walk)

    def _disturb(self, now: int) -> None:
        """Apply the disturbances up to `now` [ns] to the true poses, and vary turning rates and
        speeds from then on."""
        if now == self._disturbed_ns:
            return
        drive, time_s = self.drive, now / SECOND
        seconds = (now - max(self._disturbed_ns, 0)) / SECOND
        self._disturbed_ns = now
        moves, commanded = drive.moving, drive.commanded
        for disturbance in self._moving:
            moving = moves
            for one, held in zip(self._varying, self._held, strict=True):
                if one is disturbance:  # where it holds a robot itself: the command
                    moving = np.where(held, commanded, moves)
            drive.poses = disturbance.moved(drive.poses, moving, seconds, time_s)
        if self._varying:
            a, speed = self._a, self._speed
            for i, disturbance in enumerate(self._varying):
                able = (a > 0) | (speed > 0)
                a, speed = disturbance.varied(a, speed, time_s)
                self._held[i] = able & (a == 0) & (speed == 0)
            self.rates = a, speed
            drive.vary(a, speed)

    def _move(self, end: int, event: bool, disturbed: bool) -> None:
        """Advance to `end` under held commands; expose frames and take samples due until then.

        If `disturbed`, the disturbances act at `end`, before a frame is exposed at that time. A
        drive that sums up its path advances only to the last sample before `end`, unless there is
        an `event` at `end`, so that the result does not depend on how often the plant is read.
        """
        still = end == self._time and not (event and self._by_frame)
        open_end = self.drive.sampled and not event
        if (still or open_end) and self.beats.next_ns > end:
            return
        times, (frames, ticks) = self.beats.due(end, ends=not open_end)
        path = self.drive.advance(self._time, times, ticks)
        self._time = int(times[-1])
        if disturbed:
            self._disturb(end)
            p = self.drive.poses
            path[-1] = p.x, p.y, p.heading
        fits = self.drive.poses.x.shape == path.shape[2:]
        if not (fits and (np.abs(path) <= POSE_MAX).all()):  # not so for NaN
            raise WrongValueError(self, "a motion or disturbance", "a pose that no log can hold")
        self._path.append(path)
        if len(self._path) > UNCHECKED:
            self.check()
        exposed = frames.nonzero()[0]
        if exposed.size:
            self._camera.expose(times[exposed], path[exposed])

    def check(self) -> None:
        """Check the true path since the last call."""
        if self._path:
            path = np.concatenate(self._path)
            self.path_check.add(path[:, 0], path[:, 1])
            self._path = []
