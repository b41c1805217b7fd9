"""The true motion of simulated robots, advanced from event to event.

Between two events, every robot follows the same command, so its motion is known. The events are: a
command acts on robots, a watchdog expires, the host transmits again, or a camera frame is exposed,
if anything is sampled or varied at each frame. `TrueMotion.advance` goes from event to event, and
each step consists of the same stages, see `TrueMotion.stages`. The robots' `Drive` knows how they
move: `DirectDrive`, `WheelDrive` or `CellDrive`.

Units: times [ns], lengths in the spec's unit, headings [rad]; N robots.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import POSE_MAX, Bools, Floats, Poses, Times
from tetractl.core.trial import Note, Verdict
from tetractl.model.path_check import PathCheck
from tetractl.plant.command_sender import CommandSender
from tetractl.plant.sim_camera import SimCamera
from tetractl.plant.timetable import DueTimes, Timetable
from tetractl.plant.transit import Transit, Watchdogs
from tetractl.spec.disturbance import DelayedCommand, Disturbance, overriding

if TYPE_CHECKING:
    from tetractl.plant.wheel_host import SimHost

UNCHECKED_MAX = 200
"""Number of parts of the path that are collected before they are checked together.

A common check is quicker.
"""
NO_POSES = np.empty((0, 3, 0))
"""An empty array for the poses of a step in which no pose is computed."""


class Drive(Protocol):
    """The part of a simulation that moves N robots: their poses, and the command that each follows.

    `advance` moves the robots under their commands, and is the only method in which time passes for
    them. In between, `apply` gives a new command to some robots, `vary` changes their abilities,
    and `poses` can be set.
    """

    @property
    def host(self) -> "SimHost | None":
        """The host that computes wheel speeds. None if the direction itself is sent."""
        ...

    @property
    def sampled(self) -> bool:
        """Whether the path is integrated from sample to sample.

        Such a path depends on the times at which it is computed. If False, the path is known in
        closed form at any time.
        """
        ...

    @property
    def rest_s(self) -> float:
        """Maximum time from a stop until the robots stand still [s]."""
        ...

    @property
    def poses(self) -> Poses:
        """The present true poses of the simulated robots."""
        ...

    @poses.setter
    def poses(self, poses: Poses) -> None: ...

    @property
    def gains(self) -> Floats:
        """Factors by which the robots' bodies change a and speed, one row for each, shape (2, N).

        For example, motors have another gain, or wheels are further apart than the spec says.
        """
        ...

    @property
    def commanded(self) -> Floats:
        """1 for each robot that moves after its last command, 0 for the others, shape (N,)."""
        ...

    @property
    def moving(self) -> Floats:
        """1 for each robot that moves, 0 for each robot that stands still, shape (N,).

        A robot that is commanded to move may stand still, because it is stuck.
        """
        ...

    def advance(self, since_ns: int, times_ns: Times, samples: Bools) -> Floats:
        """Move the robots, and return their poses at given times.

        Args:
            since_ns: The present time [ns].
            times_ns: Times of the poses [ns], shape (M,). The robots move until the last of them.
            samples: Whether the true path is sampled at each time, shape (M,).

        Returns:
            x, y and heading, shape (M, 3, N).
        """
        ...

    def apply(self, command: DelayedCommand) -> None:
        """Give a command to the robots that it reaches. The others continue with theirs."""
        ...

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a [rad/s] and speeds [length unit/s], shape (N,) each.

        The change applies starting now. A robot with a = 0 and speed 0 stands still.
        """
        ...


class MotionDisturbances:
    """The disturbances that move N robots, or vary their true turning rates a and speeds.

    Args:
        disturbances: The disturbances of the trial.
        a: Turning rates before they vary [rad/s], shape (N,).
        speed: Speeds before they vary [length unit/s], shape (N,).
    """

    def __init__(self, disturbances: Sequence[Disturbance], a: Floats, speed: Floats) -> None:
        self._moving = overriding(disturbances, Disturbance.moved)
        self._varying = overriding(disturbances, Disturbance.varied)
        self._a = a
        self._speed = speed
        # by the id of a disturbance that varies: the robots that it holds still at present, (N,)
        self._held = {
            id(disturbance): np.zeros(a.size, dtype=np.bool_) for disturbance in self._varying
        }
        self._acted_ns = -1  # the time up to which they have acted
        self.rates = (a, speed)
        """The present turning rates a [rad/s] and speeds [length unit/s], (N,) each."""
        self.any = bool(self._moving or self._varying)
        """Whether any disturbance moves the robots or varies their rates."""

    def act(self, drive: Drive, now_ns: int) -> None:
        """Apply the disturbances: move the robots, and vary a and speed starting now.

        The robots move by what has happened since the last call. If this has already been done for
        `now_ns`, nothing happens.
        """
        if now_ns == self._acted_ns:
            return
        seconds = (now_ns - max(self._acted_ns, 0)) / SECOND
        self._acted_ns = now_ns
        self._move(drive, seconds, now_ns / SECOND)
        if self._varying:
            self._vary(drive, now_ns / SECOND)

    def _move(self, drive: Drive, seconds: float, time_s: float) -> None:
        """Move the robots.

        If a disturbance itself holds a robot still, the robot counts as moving for that disturbance
        while it is commanded to move.
        """
        moving = drive.moving
        commanded = drive.commanded
        for disturbance in self._moving:
            counted = moving
            if id(disturbance) in self._held:
                counted = np.where(self._held[id(disturbance)], commanded, moving)
            drive.poses = disturbance.moved(drive.poses, counted, seconds, time_s)

    def _vary(self, drive: Drive, time_s: float) -> None:
        a = self._a
        speed = self._speed
        for disturbance in self._varying:
            able_before = (a > 0) | (speed > 0)
            a, speed = disturbance.varied(a, speed, time_s)
            self._held[id(disturbance)] = able_before & (a == 0) & (speed == 0)
        self.rates = (a, speed)
        drive.vary(a, speed)


@dataclass(slots=True)
class MotionStep:
    """One step of the simulated motion, from the present time to `end_ns`.

    Several things may happen at its end. They happen in the order of the fields below.
    """

    end_ns: int
    disturbed: bool
    """Whether disturbances act on the robots at the end of the step."""
    at_frame: bool
    """Whether a camera frame is exposed at the end of the step."""
    command: DelayedCommand | None
    """The command that takes effect at the end of the step. None if there is none."""
    repeats: bool
    """Whether the host transmits again at the end of the step.

    Never together with a command.
    """
    due: DueTimes | None = None
    """The M times at which poses are computed. The last is the time of the robots' new state.

    The stage `_move` sets it. It stays None if no pose is needed yet.
    """
    poses: Floats = field(default_factory=lambda: NO_POSES)
    """x, y and heading of the robots at these times, shape (M, 3, N)."""


class TrueMotion:
    """Moves N robots in continuous time, exposes the camera's frames, and checks the true path.

    `repeated` contains the commands that the host has transmitted again.

    Args:
        drive: How the robots move.
        camera: The simulated camera.
        timetable: When events happen.
        transit: The commands on their way to the robots.
        watchdogs: The robots' watchdogs.
        disturbances: The disturbances of the motion.
        walk_rad: Standard deviation of a step of the headings' random walk, at each frame, for
            moving robots [rad]. 0 for no random walk.
        walking: Generator of the random walk.
        check: The check of the true path.
        sender: Sends commands, also when the host transmits again.
    """

    def __init__(
        self,
        *,
        drive: Drive,
        camera: SimCamera,
        timetable: Timetable,
        transit: Transit,
        watchdogs: Watchdogs,
        disturbances: MotionDisturbances,
        walk_rad: float,
        walking: np.random.Generator,
        check: PathCheck,
        sender: CommandSender,
    ) -> None:
        self.drive = drive
        self.camera = camera
        self.timetable = timetable
        self.transit = transit
        self._watchdogs = watchdogs
        self.disturbances = disturbances
        self._walk_rad = walk_rad
        self._walking = walking
        self._check = check
        self._unchecked: list[Floats] = []  # x, y, heading (M, 3, N) of parts of the path
        self._sender = sender
        self.repeated: list[Command | Note] = []
        self._frames_are_events = disturbances.any or walk_rad > 0
        self._now_ns = 0  # the time of the drive's poses
        self._advanced_ns = -1  # the last time to which `advance` was called
        self.stages: tuple[Callable[[MotionStep], None], ...] = (
            self._move,  # the robots, under what they hold
            self._disturb,  # where they have come to, and what they are able to
            self._record,  # the part of the path
            self._expose,  # the frames that are due, and those that have reached the host
            self._swerve,  # the headings' random walk, if a frame was due at the end
            self._act,  # the command, or the host's next transmission
        )
        """The functions that make up a step, in the order in which they are called."""

    def advance(self, until_ns: int) -> None:
        """Advance the simulated robots to the time `until_ns`, from event to event."""
        if until_ns == self._advanced_ns < self.transit.next_ns:
            return
        while True:
            step = self._next_step(until_ns)
            for stage in self.stages:
                stage(step)
            if step.end_ns == until_ns and step.command is None and not step.repeats:
                break
        self._advanced_ns = until_ns

    def _next_step(self, until_ns: int) -> MotionStep:
        """Plan the step to the next event, or to `until_ns`.

        If several events are due at the same time, a command comes first, then a watchdog, then the
        host.
        """
        frame_ns = self.timetable.next_frame_ns
        end_ns = min(until_ns, self._sender.repeats_ns, self._watchdogs.next_ns)
        if self._frames_are_events:
            end_ns = min(end_ns, frame_ns)
        command = None
        if self.transit.next_ns <= end_ns:
            command = self.transit.pop()
            end_ns = command.due_ns
        elif self._watchdogs.next_ns == end_ns:
            command = self._watchdogs.stop(end_ns)
        at_frame = end_ns == frame_ns
        return MotionStep(
            end_ns=end_ns,
            disturbed=self.disturbances.any and (at_frame or command is not None),
            at_frame=at_frame,
            command=command,
            repeats=command is None and end_ns == self._sender.repeats_ns,
        )

    def _move(self, step: MotionStep) -> None:
        """Move the robots to the end of the step, unless no pose is needed there.

        A drive that integrates its path moves only to the last time that is due, unless there is an
        event. Therefore the path does not depend on how often somebody reads the plant.
        """
        is_event = step.disturbed or step.repeats or step.command is not None
        stays = step.end_ns == self._now_ns and not (is_event and self._frames_are_events)
        stops_early = self.drive.sampled and not is_event
        if (stays or stops_early) and self.timetable.next_ns > step.end_ns:
            return
        due = self.timetable.take(step.end_ns, with_end=not stops_early)
        step.due = due
        step.poses = self.drive.advance(self._now_ns, due.times_ns, due.samples)
        self._now_ns = int(due.times_ns[-1])

    def _disturb(self, step: MotionStep) -> None:
        """Let the disturbances act. A frame at the end of the step already shows their effect."""
        if step.disturbed:
            self.disturbances.act(self.drive, step.end_ns)
            poses = self.drive.poses
            step.poses[-1] = poses.x, poses.y, poses.heading

    def _record(self, step: MotionStep) -> None:
        """Add a part of the true motion to the recorded path.

        Raises:
            WrongValueError: If no log can hold it.
        """
        if step.due is None:
            return
        poses = step.poses
        of_all_robots = self.drive.poses.x.shape == poses.shape[2:]
        if not (of_all_robots and (np.abs(poses) <= POSE_MAX).all()):  # not so for NaN
            raise WrongValueError(
                "a motion or disturbance",
                "a pose that cannot be logged: it is not finite or too large",
            )
        self._unchecked.append(poses)
        if len(self._unchecked) > UNCHECKED_MAX:
            self._check_path()

    def _check_path(self) -> None:
        if self._unchecked:
            path = np.concatenate(self._unchecked)
            self._check.add(path[:, 0], path[:, 1])
            self._unchecked = []

    def verdict(self) -> Verdict:
        """Return the verdict on the true path so far, with the present poses as the final ones."""
        self._check_path()
        return self._check.verdict(self.drive.poses)

    def _expose(self, step: MotionStep) -> None:
        """Expose the frames that are due in the step, and pass arrived frames to the host."""
        if step.due is not None:
            frames = step.due.frames.nonzero()[0]
            if frames.size:
                self.camera.expose(step.due.times_ns[frames], step.poses[frames])
        self.camera.receive(step.end_ns)

    def _swerve(self, step: MotionStep) -> None:
        """Turn each moving robot by one random step of its heading, after the frame."""
        if not step.at_frame or self._walk_rad == 0:
            return
        drive = self.drive
        before = drive.poses
        steps = self._walk_rad * self._walking.standard_normal(before.x.size) * drive.moving
        drive.poses = Poses(before.x, before.y, before.heading + steps)

    def _act(self, step: MotionStep) -> None:
        """Give the robots their command, or let the host transmit again."""
        if step.command is not None:
            self.drive.apply(step.command)
            self._watchdogs.restart(step.command)
        elif step.repeats:
            newest = self.camera.newest
            assert newest is not None, "a command is sent in answer to a frame"
            self.repeated.append(self._sender.send(step.end_ns, newest))
