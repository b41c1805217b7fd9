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

UNCHECKED_PARTS_MAX = 200
"""Maximum number of parts of the path that wait for their check.

Checking many parts together is quicker than checking them one by one.
"""
NO_POSES = np.empty((0, 3, 0))
"""The poses of a step in which no pose is computed: an empty array."""


class Drive(Protocol):
    """A way to move N simulated robots: their poses, and the command that each robot follows.

    `advance` moves the robots under their commands, and is the only method in which time passes for
    them. In between, `apply` gives a new command to some robots, `vary` changes their abilities,
    and `poses` can be set.
    """

    @property
    def host(self) -> "SimHost | None":
        """The host that computes wheel speeds. None if the direction itself is sent."""
        ...

    @property
    def is_integrated(self) -> bool:
        """Whether the path is integrated from sample to sample, instead of known in closed form.

        An integrated path depends on the times at which it is computed.
        """
        ...

    @property
    def stopping_s(self) -> float:
        """Maximum time that the robots need to come to a standstill after a stop [s]."""
        ...

    @property
    def poses(self) -> Poses:
        """The present true poses of the simulated robots."""
        ...

    @poses.setter
    def poses(self, poses: Poses) -> None: ...

    @property
    def gains(self) -> Floats:
        """Ratios of the robots' true turning rates and speeds to the given ones, shape (2, N).

        For example, motors may have another gain, or wheels may be further apart than the spec
        says.
        """
        ...

    @property
    def commanded(self) -> Floats:
        """1 for each robot whose last command makes it move, 0 for the others, shape (N,)."""
        ...

    @property
    def moving(self) -> Floats:
        """1 for each robot that moves, 0 for each robot that stands still, shape (N,).

        A robot that is commanded to move may stand still, because it is stuck.
        """
        ...

    def advance(self, since_ns: int, times_ns: Times, samples: Bools) -> Floats:
        """Move the robots until the last of the given times, and return their poses at each time.

        Args:
            since_ns: The present time [ns].
            times_ns: Times of the poses [ns], shape (M,). The robots move until the last of them.
            samples: Whether the true path is sampled at each time, shape (M,).

        Returns:
            x, y and heading, shape (M, 3, N).
        """
        ...

    def apply(self, command: DelayedCommand) -> None:
        """Give a command to the robots that it reaches. Other robots keep their command."""
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
        self._moving_disturbances = overriding(disturbances, Disturbance.moved)
        self._varying_disturbances = overriding(disturbances, Disturbance.varied)
        self._a = a
        self._speed = speed
        # by the id of each varying disturbance: the robots that it holds still at present, (N,)
        self._held_by_id = {
            id(disturbance): np.zeros(a.size, dtype=np.bool_)
            for disturbance in self._varying_disturbances
        }
        self._applied_ns = -1  # the time up to which the disturbances have acted
        self.rates = (a, speed)
        """The present turning rates a [rad/s] and speeds [length unit/s], (N,) each."""
        self.has_effect = bool(self._moving_disturbances or self._varying_disturbances)
        """Whether any disturbance moves the robots or varies their rates."""

    def apply(self, drive: Drive, now_ns: int) -> None:
        """Apply the disturbances to the robots: move them, and vary their turning rates and speeds.

        The robots move as far as they are moved between the last call and `now_ns`. A second call
        with the same `now_ns` does nothing.
        """
        if now_ns == self._applied_ns:
            return
        seconds = (now_ns - max(self._applied_ns, 0)) / SECOND
        self._applied_ns = now_ns
        self._move(drive, seconds, now_ns / SECOND)
        if self._varying_disturbances:
            self._vary(drive, now_ns / SECOND)

    def _move(self, drive: Drive, seconds: float, time_s: float) -> None:
        """Let each disturbance move the robots.

        If a disturbance itself holds a robot still, the robot counts as moving for this disturbance
        while the robot is commanded to move.
        """
        moving = drive.moving
        commanded = drive.commanded
        for disturbance in self._moving_disturbances:
            counts_as_moving = moving
            if id(disturbance) in self._held_by_id:
                counts_as_moving = np.where(self._held_by_id[id(disturbance)], commanded, moving)
            drive.poses = disturbance.moved(drive.poses, counts_as_moving, seconds, time_s)

    def _vary(self, drive: Drive, time_s: float) -> None:
        """Let each disturbance vary the turning rates and speeds of the robots."""
        a = self._a
        speed = self._speed
        for disturbance in self._varying_disturbances:
            was_able = (a > 0) | (speed > 0)
            a, speed = disturbance.varied(a, speed, time_s)
            self._held_by_id[id(disturbance)] = was_able & (a == 0) & (speed == 0)
        self.rates = (a, speed)
        drive.vary(a, speed)


@dataclass(slots=True)
class MotionStep:
    """One step of the simulated motion, from the present time to `end_ns`.

    Several things may happen at its end. They happen in the order of the fields below.
    """

    end_ns: int
    is_disturbed: bool
    """Whether disturbances act on the robots at the end of the step."""
    ends_at_frame: bool
    """Whether a camera frame is exposed at the end of the step."""
    command: DelayedCommand | None
    """The command that takes effect at the end of the step. None if there is none."""
    host_transmits: bool
    """Whether the host transmits again at the end of the step.

    This is False if a command takes effect at the end of the step.
    """
    due_times: DueTimes | None = None
    """The M times at which poses are computed. The last time is the time of the robots' new state.

    The stage `_move_robots` sets this field. None if no pose is needed yet.
    """
    poses: Floats = field(default_factory=lambda: NO_POSES)
    """x, y and heading of the robots at these times, shape (M, 3, N)."""


class TrueMotion:
    """Moves N simulated robots in continuous time, exposes camera frames, and checks the true path.

    `repeated_commands` contains the commands that the host has transmitted again.

    Args:
        drive: How the robots move.
        camera: The simulated camera.
        timetable: When events happen.
        transit: The commands on their way to the robots.
        watchdogs: The robots' watchdogs.
        disturbances: The disturbances of the motion.
        heading_walk_rad: Standard deviation of a step of the headings' random walk, which moving
            robots make at each frame [rad]. 0 for no random walk.
        walk_random: Generator of the random walk.
        path_check: The check of the true path.
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
        heading_walk_rad: float,
        walk_random: np.random.Generator,
        path_check: PathCheck,
        sender: CommandSender,
    ) -> None:
        self.drive = drive
        self.camera = camera
        self.timetable = timetable
        self.transit = transit
        self._watchdogs = watchdogs
        self.disturbances = disturbances
        self._heading_walk_rad = heading_walk_rad
        self._walk_random = walk_random
        self._path_check = path_check
        self._unchecked_parts: list[Floats] = []  # x, y, heading (M, 3, N) of parts of the path
        self._sender = sender
        self.repeated_commands: list[Command | Note] = []
        self._frames_are_events = disturbances.has_effect or heading_walk_rad > 0
        self._now_ns = 0  # the time of the drive's poses
        self._advanced_ns = -1  # the last time to which `advance` was called
        self.stages: tuple[Callable[[MotionStep], None], ...] = (
            self._move_robots,  # under the commands that they hold
            self._apply_disturbances,  # which change the poses, turning rates and speeds
            self._record_path,  # the part of the path in this step
            self._expose_frames,  # the due frames; the host receives arrived frames
            self._step_heading_walk,  # if a frame was due at the end of the step
            self._deliver_command,  # or let the host transmit again
        )
        """The functions that make up a step, in the order in which they are called."""

    def advance(self, until_ns: int) -> None:
        """Advance the simulated robots to the time `until_ns`, from event to event."""
        if until_ns == self._advanced_ns < self.transit.next_due_ns:
            return
        while True:
            step = self._plan_step(until_ns)
            for stage in self.stages:
                stage(step)
            if step.end_ns == until_ns and step.command is None and not step.host_transmits:
                break
        self._advanced_ns = until_ns

    def _plan_step(self, until_ns: int) -> MotionStep:
        """Plan the step to the next event, or to `until_ns`.

        If several events are due at the same time, a command comes first, then a watchdog, then the
        host.
        """
        frame_ns = self.timetable.next_frame_ns
        end_ns = min(until_ns, self._sender.next_repeat_ns, self._watchdogs.next_expiry_ns)
        if self._frames_are_events:
            end_ns = min(end_ns, frame_ns)
        command = None
        if self.transit.next_due_ns <= end_ns:
            command = self.transit.pop()
            end_ns = command.due_ns
        elif self._watchdogs.next_expiry_ns == end_ns:
            command = self._watchdogs.stop_expired(end_ns)
        ends_at_frame = end_ns == frame_ns
        return MotionStep(
            end_ns=end_ns,
            is_disturbed=self.disturbances.has_effect and (ends_at_frame or command is not None),
            ends_at_frame=ends_at_frame,
            command=command,
            host_transmits=command is None and end_ns == self._sender.next_repeat_ns,
        )

    def _move_robots(self, step: MotionStep) -> None:
        """Move the robots to the end of the step, unless no pose is needed there.

        A drive that integrates its path moves only to the last time that is due, unless there is an
        event. Therefore the path does not depend on how often somebody reads the plant.
        """
        is_event = step.is_disturbed or step.host_transmits or step.command is not None
        is_over = step.end_ns == self._now_ns and not (is_event and self._frames_are_events)
        may_stop_early = self.drive.is_integrated and not is_event
        if (is_over or may_stop_early) and self.timetable.next_ns > step.end_ns:
            return
        due_times = self.timetable.take_until(step.end_ns, with_end=not may_stop_early)
        step.due_times = due_times
        step.poses = self.drive.advance(self._now_ns, due_times.times_ns, due_times.has_sample)
        self._now_ns = int(due_times.times_ns[-1])

    def _apply_disturbances(self, step: MotionStep) -> None:
        """Let the disturbances act, before a frame at the end of the step is exposed."""
        if step.is_disturbed:
            self.disturbances.apply(self.drive, step.end_ns)
            poses = self.drive.poses
            step.poses[-1] = poses.x, poses.y, poses.heading

    def _record_path(self, step: MotionStep) -> None:
        """Add the step's poses to the recorded path.

        Raises:
            WrongValueError: If a pose cannot be logged, because it is not finite or too large.
        """
        if step.due_times is None:
            return
        poses = step.poses
        has_all_robots = self.drive.poses.x.shape == poses.shape[2:]
        if not (has_all_robots and (np.abs(poses) <= POSE_MAX).all()):  # not so for NaN
            raise WrongValueError(
                "a motion or disturbance",
                "a pose that cannot be logged: it is not finite or too large",
            )
        self._unchecked_parts.append(poses)
        if len(self._unchecked_parts) > UNCHECKED_PARTS_MAX:
            self._check_path()

    def _check_path(self) -> None:
        """Check all parts of the path that were not checked yet."""
        if self._unchecked_parts:
            path = np.concatenate(self._unchecked_parts)
            self._path_check.add(path[:, 0], path[:, 1])
            self._unchecked_parts = []

    def verdict(self) -> Verdict:
        """Return the verdict on the true path so far, with the present poses as the final ones."""
        self._check_path()
        return self._path_check.verdict(self.drive.poses)

    def _expose_frames(self, step: MotionStep) -> None:
        """Expose the frames that are due in the step, and let the host receive arrived frames."""
        if step.due_times is not None:
            frame_rows = step.due_times.has_frame.nonzero()[0]
            if frame_rows.size:
                self.camera.expose(step.due_times.times_ns[frame_rows], step.poses[frame_rows])
        self.camera.receive(step.end_ns)

    def _step_heading_walk(self, step: MotionStep) -> None:
        """Turn each moving robot by a step of its heading's random walk, after a frame."""
        if not step.ends_at_frame or self._heading_walk_rad == 0:
            return
        drive = self.drive
        poses = drive.poses
        turns_rad = (
            self._heading_walk_rad * self._walk_random.standard_normal(poses.x.size) * drive.moving
        )
        drive.poses = Poses(poses.x, poses.y, poses.heading + turns_rad)

    def _deliver_command(self, step: MotionStep) -> None:
        """Give the step's command to the robots, or let the host transmit again."""
        if step.command is not None:
            self.drive.apply(step.command)
            self._watchdogs.restart(step.command)
        elif step.host_transmits:
            newest = self.camera.newest
            assert newest is not None, "a command is sent in answer to a frame"
            self.repeated_commands.append(self._sender.send(step.end_ns, newest))
