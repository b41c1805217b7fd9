"""The simulated plant: true motion in continuous virtual time, a camera, and disturbances."""

import json
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.clock import SECOND, Clock, VirtualClock
from tetractl.core.commands import Command, Note, PlantInfo, Sample, Verdict
from tetractl.core.errors import AbortError
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.core.supervision import LabSupervision
from tetractl.experiment.base import Fraction, NonNegative, inconsistent
from tetractl.experiment.disturbance import DelayedCommand, Disturbance, DisturbanceSection
from tetractl.experiment.kinds import DISTURBANCES, MOTIONS
from tetractl.experiment.lab import STOP_GAP_NS, STOPS
from tetractl.experiment.plant import PlantSection
from tetractl.experiment.registry_fields import KindName, KindSection
from tetractl.experiment.yaml.problems import Loc
from tetractl.model.path_check import PathCheck
from tetractl.model.wheels import wheel_speeds
from tetractl.plant.direct import DirectDrive
from tetractl.plant.sim_camera import MeasurementNoise, SimCamera, due_ns
from tetractl.plant.wheel_host import WheelDriveSection
from tetractl.plant.wheels import WheelDrive

NO_FRAME_S = 60
POSES_MAX = 2_000_000  # of one control period, which are simulated together
UNJUDGED = 200  # stretches of the path that are judged together
WHEELS_KEY = 2**32 - 1
"""Spawn key of the wheels' draws; disturbances have those from 4 on."""


class SimSection(PlantSection):
    """A simulated plant in virtual time. Every disturbance is off by default and is drawn from the
    trial's seed."""

    simulated: ClassVar[bool] = True
    switches_field: ClassVar[bool] = True
    type: Literal["sim"] = "sim"
    motion: Annotated[str, KindName(MOTIONS)] = "exact"
    """`exact` follows (1)-(3); `arc` holds the wheel speeds of (24)-(25), computed from the newest
    frame, between two commands; `euler` moves by (4)-(6) themselves, on straight chords. Robots on
    `drive` ignore it."""
    drive: WheelDriveSection | None = None
    """Wheels between the direction and the robots; by default robots turn to the direction by
    themselves. Needs `wheels`."""
    camera_rate: float = Field(default=120.0, ge=1, le=10_000, allow_inf_nan=False)
    """Measurements a second [Hz]."""
    truth_rate: float = Field(default=960.0, ge=1, le=100_000, allow_inf_nan=False)
    """Samples a second of the true path that decides errors and obstacle violations [Hz]; at least
    the camera rate."""
    measurement_noise: MeasurementNoise = MeasurementNoise()
    """What the camera adds to the true poses."""
    heading_noise: NonNegative = 0.0
    """Random walk of the true heading of robots that move [rad/sqrt(s)]."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """From the exposure of the frame that a command answers, the newest when it is sent, to the
    robots' acting on it [s], as `controller.dead_time`; a command older than that acts when it is
    sent. A stop takes as long. What `drive` and `disturbances` delay comes on top."""
    lost_commands: Fraction = 0.0
    """Probability that a command never arrives at a robot and the one before it stays in force."""
    a_error: Fraction = 0.0
    """The true a is the spec's times 1 + e, with e uniform in [-a_error, a_error], drawn once a
    trial and robot."""
    speed_error: Fraction = 0.0
    """As `a_error`, for the speed."""
    disturbances: tuple[Annotated[DisturbanceSection, KindSection(DISTURBANCES)], ...] = Field(
        default=(), max_length=100
    )
    """Further disturbances, which act one after another."""

    @model_validator(mode="after")
    def _truth_is_as_fine_as_the_camera(self) -> Self:
        if self.truth_rate < self.camera_rate:
            message = f"must be at least camera_rate, {self.camera_rate:g}"
            raise inconsistent("truth_rate", message)
        return self

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield wheels that the experiment does not have, and periods of too many samples."""
        poses = setup.period_s * max(self.truth_rate, self.camera_rate) * len(setup.names)
        if poses > POSES_MAX:
            message = f"a control period of {setup.period_s:g} s has {poses:.3g} poses to simulate"
            yield ("truth_rate",), f"{message}, at most {POSES_MAX:g} are done at a time; lower it"
        if self.drive is not None and setup.wheel_radius is None:
            yield ("drive",), "needs 'wheels: {radius: ..}' of the experiment"

    @property
    def loses_frames(self) -> bool:
        """Whether any disturbance loses frames."""
        return any(disturbance.loses_frames for disturbance in self.disturbances)

    @property
    def planning_max_s(self) -> float:
        """Longest time from a control step's frame to its command [s]."""
        return sum(disturbance.planning_max_s for disturbance in self.disturbances)

    @property
    def disturbed(self) -> bool:
        """Whether any disturbance is on."""
        noise = self.measurement_noise
        sizes = (noise.position, noise.heading, self.heading_noise, self.dead_time)
        chances = (self.lost_commands, self.a_error, self.speed_error)
        return self.drive is not None or any((*sizes, *chances, *self.disturbances))

    def clock(self) -> Clock:
        """Return virtual time."""
        return VirtualClock()

    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> "SimPlant":
        """Return the simulation of one trial."""
        return SimPlant(self, setup, clock, seed)


class SimPlant:
    """A `Plant` of simulated robots; `seed` feeds every disturbance."""

    def __init__(
        self, section: SimSection, setup: Setup, clock: Clock, seed: np.random.SeedSequence
    ) -> None:
        self.spec, self.setup, self.clock = section, setup, clock
        streams = (np.random.default_rng(child) for child in seed.spawn(4))
        measuring, swerving, self._losing, erring = streams
        self._swerving = swerving
        count = len(setup.names)
        self.a = setup.a * (1 + section.a_error * erring.uniform(-1, 1, count))
        self.speed = setup.speed * (1 + section.speed_error * erring.uniform(-1, 1, count))
        disturbances = [
            disturbance.build(setup, np.random.default_rng(*seed.spawn(1)))
            for disturbance in section.disturbances
        ]
        self._disturbances = disturbances
        starts = setup.starts
        for disturbance in disturbances:
            self.a, self.speed = disturbance.parameters(self.a, self.speed)
            starts = disturbance.placed(starts)
        self._moving = [d for d in disturbances if type(d).moved is not Disturbance.moved]
        self._camera = SimCamera(
            self.a.size, section.camera_rate, section.measurement_noise, measuring, disturbances
        )
        self._drive = self._driven(starts, seed)
        self._by_frame = bool(self._moving) or (
            section.heading_noise > 0 and isinstance(self._drive, DirectDrive)
        )
        self._due: deque[DelayedCommand] = deque()
        self._path_check = PathCheck.of(setup)
        self._time = 0
        self._ticks = 0  # true samples taken so far
        self._path: list[tuple[Floats, Floats]] = []  # x, y of the samples not judged yet
        self._news: list[Command | Note] = []
        self._stop: Command | None = None
        self._repeats_stops = section.drive is not None or any(
            type(d).sent is not Disturbance.sent for d in disturbances
        )

    @property
    def poses(self) -> Poses:
        """The true poses now."""
        return self._drive.poses

    def open(self) -> PlantInfo:
        """Expose the first frame."""
        self._advance(self.clock.now())
        facts = {
            "true_a": json.dumps(self.a.tolist()),
            "true_speed": json.dumps(self.speed.tolist()),
        }
        return PlantInfo("sim", True, self.spec.camera_rate, facts)

    def observe(self) -> Observation:
        """Return the newest camera frame that the host has received."""
        self._advance(self.clock.now())
        newest = self._camera.newest
        assert newest is not None, "open() waits for the first frame"
        return newest

    def steer(self, direction: float | None) -> Command:
        """Send u to every robot, or switch the field off, after the time that planning takes."""
        answered = self.observe()
        now = self._plan()
        if isinstance(self._drive, WheelDrive):
            self._drive.host.direct(direction)
            command = self._transmit(now)
        else:
            command = self._send_direction(direction, now, answered)
        self._advance(now)
        return command

    def samples(self) -> list[Sample]:
        """Return, once, every camera frame received since the last call, oldest first."""
        self._advance(self.clock.now())
        return self._camera.samples()

    def news(self) -> list[Command | Note]:
        """Return, once, what was sent under a held direction since `steer` returned."""
        news, self._news = self._news, []
        return news

    def stop(self) -> Command:
        """Stop every robot, after the time that planning takes.

        The stop is repeated, so that it is not among the commands that are lost.
        """
        if self._stop is None:
            seen = self.observe()
            now = self._plan()
            count = self.a.size
            zeros = np.zeros(count)
            if isinstance(self._drive, WheelDrive):
                self._drive.host.halt()
            heard = np.zeros(count, dtype=np.bool_)
            for i in range(STOPS if self._repeats_stops else 1):
                sent = now + i * STOP_GAP_NS
                every, due = np.ones(count, dtype=np.bool_), self._due_ns(seen, sent)
                stop = DelayedCommand(due, None, every, seen.poses.heading, np.zeros((2, count)))
                heard |= self._dispatch(stop).reached
            still = None if self.setup.wheel_radius is None else zeros
            self._stop = Command(None, now, tuple(heard.tolist()), still, still)
            self._advance(now)
        return self._stop

    def settle(self) -> Verdict:
        """Wait until the robots stand and for a camera frame of it, and judge the true path."""
        stopped = self._due[-1].due_ns if self._due else self.clock.now()
        stand = stopped + round(self._drive.rest_s * SECOND)
        self.clock.sleep_until(stand + round(2 * SECOND / self.spec.camera_rate))
        self._advance(self.clock.now())
        self._await_frame(stand)
        self._judge()
        return self._path_check.verdict(self.poses)

    def close(self) -> None:
        """Nothing to release."""

    def _driven(self, starts: Poses, seed: np.random.SeedSequence) -> DirectDrive | WheelDrive:
        section, setup = self.spec, self.setup
        if section.drive is None:
            return DirectDrive(MOTIONS.load(section.motion), self.a, self.speed, starts)
        key = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, WHEELS_KEY))
        return WheelDrive(
            section.drive,
            setup,
            self.a,
            self.speed,
            starts,
            section.heading_noise,
            section.truth_rate,
            self._swerving,
            np.random.default_rng(key),
        )

    def _await_frame(self, since: int) -> None:
        """Wait until the host has a frame exposed at `since` or later [ns]."""
        patience = self.clock.now() + NO_FRAME_S * SECOND
        while self._camera.newest is None or self._camera.newest.sampled_ns < since:
            arriving = self._camera.arriving_ns
            self.clock.sleep_until(self._camera.next_ns if arriving is None else arriving)
            if self.clock.now() > patience:
                raise AbortError(f"no camera frame came for {NO_FRAME_S} s")
            self._advance(self.clock.now())

    def _plan(self) -> int:
        """Let the time of planning pass, and return the time then [ns]."""
        seconds = sum(disturbance.planning_s() for disturbance in self._disturbances)
        if seconds > 0:
            self.clock.sleep_until(self.clock.now() + round(seconds * SECOND))
        self._advance(self.clock.now())
        return self.clock.now()

    def _due_ns(self, answered: Observation, now: int) -> int:
        """Return when a command sent `now` in answer to a frame acts, by `dead_time` alone [ns]."""
        return max(now, answered.sampled_ns + round(self.spec.dead_time * SECOND))

    def _heard(self) -> Bools:
        """Draw which robots a command reaches."""
        return self._losing.uniform(size=self.a.size) >= self.spec.lost_commands

    def _send_direction(self, direction: float | None, now: int, answered: Observation) -> Command:
        headings = answered.poses.heading
        due = self._due_ns(answered, now)
        off = direction is None
        delayed = self._dispatch(
            DelayedCommand(due, direction, self._heard(), headings, field_off=off)
        )
        left = right = None
        setup = self.setup
        if setup.wheel_radius is not None:
            towards = headings if direction is None else direction
            left, right = wheel_speeds(headings, towards, setup.a, setup.speed, setup.wheel_radius)
        return Command(direction, now, tuple(delayed.reached.tolist()), left, right, off)

    def _transmit(self, now: int) -> Command:
        """Send wheel speeds computed from the newest frame that the host has."""
        drive, seen = self._drive, self._camera.newest
        assert isinstance(drive, WheelDrive), "only wheels are sent more than the direction"
        assert seen is not None, "open() waits for the first frame"
        sent, made = drive.host.speeds(now, seen)
        due = self._due_ns(seen, now)
        u = drive.host.direction
        delayed = DelayedCommand(due, u, self._heard(), seen.poses.heading, made, u is None)
        reached = tuple(self._dispatch(delayed).reached.tolist())
        return Command(u, now, reached, sent[0], sent[1], u is None)

    def _dispatch(self, command: DelayedCommand) -> DelayedCommand:
        """Put a command on its way, and return what becomes of it."""
        for disturbance in self._disturbances:
            command = disturbance.sent(command)
        earliest = self._due[-1].due_ns if self._due else self._time
        self._due.append(replace(command, due_ns=max(command.due_ns, earliest)))
        return command

    def _advance(self, until: int) -> None:
        """Move the robots on, block by block; nothing changes what is held inside a block."""
        while True:
            frame = self._camera.next_ns
            end = min(until, frame) if self._by_frame else until
            end = min(end, self._drive.repeats_ns)
            due = self._due.popleft() if self._due and self._due[0].due_ns <= end else None
            reached = due.due_ns if due else end
            disturbed = self._by_frame and reached == frame
            repeats = due is None and reached == self._drive.repeats_ns
            self._glide(reached, due is not None or disturbed or repeats)
            self._camera.receive(reached)
            if disturbed:
                self._disturb()
            if due:
                self._drive.take(due)
            elif repeats:
                self._news.append(self._transmit(reached))
            elif reached == until:
                return

    def _disturb(self) -> None:
        """Add the random walk that the heading took since the last frame, and disturb the poses."""
        drive, seconds = self._drive, 1 / self.spec.camera_rate
        moving = drive.moving
        if self.spec.heading_noise > 0 and isinstance(drive, DirectDrive):
            step = self.spec.heading_noise / np.sqrt(self.spec.camera_rate)
            walk = step * self._swerving.standard_normal(self.a.size)
            p = drive.poses
            drive.poses = Poses(p.x, p.y, p.heading + walk * moving)
        for disturbance in self._moving:
            drive.poses = disturbance.moved(drive.poses, moving, seconds)

    def _glide(self, end: int, event: bool) -> None:
        """Move to `end` with everything held, exposing and judging what is due on the way.

        Wheels, whose path is a sum, stop at the last sample before `end` unless something happens
        there: so it makes no difference how often they are looked at.
        """
        nothing_due = min(self._camera.next_ns, self._next_tick_ns) > end
        if end == self._time and nothing_due and not self._by_frame:  # a frame may move the robots
            return
        frames = self._camera.due(end)
        ticks = due_ns(self._ticks, self.spec.truth_rate, end)
        self._ticks += len(ticks)
        ends = [end] if event or isinstance(self._drive, DirectDrive) else []
        times = np.sort(np.concatenate([frames, ticks, np.array(ends, dtype=np.int64)]))
        times = times[np.diff(times, prepend=-1) > 0]  # as np.unique, in half the time
        if not len(times):
            return
        is_tick = np.zeros(len(times))
        is_tick[np.searchsorted(times, ticks)] = 1.0
        x, y, heading = self._drive.glide((times - self._time) / SECOND, is_tick)
        self._time = int(times[-1])
        self._path.append((x, y))
        if len(self._path) > UNJUDGED:
            self._judge()
        for due, i in zip(frames.tolist(), np.searchsorted(times, frames).tolist(), strict=True):
            self._camera.expose(due, Poses(x[i], y[i], heading[i]))

    @property
    def _next_tick_ns(self) -> int:
        """When the next true sample is taken [ns]."""
        return round(self._ticks * SECOND / self.spec.truth_rate)

    def _judge(self) -> None:
        """Judge the true path since the last call."""
        if self._path:
            x, y = (np.vstack(column) for column in zip(*self._path, strict=True))
            self._path_check.add(x, y)
            self._path = []
