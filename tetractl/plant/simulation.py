"""The simulated plant: true motion in continuous virtual time, a camera, and disturbances.

Between two commands the motion is known in closed form, so the true path is sampled, not
integrated: its error does not depend on the sampling rate.
"""

import json
from collections import deque
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.clock import SECOND, Clock, VirtualClock
from tetractl.core.commands import Command, Note, PlantInfo, Sample, Verdict
from tetractl.core.operators import Operators
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Model, NonNegative, inconsistent
from tetractl.experiment.choice import Choice, OneOf
from tetractl.experiment.disturbance import DisturbanceSection, Order
from tetractl.experiment.kinds import DISTURBANCES, MOTIONS
from tetractl.experiment.plant import PlantSection
from tetractl.model.motion.base import Held, Motion
from tetractl.model.obstacles import Obstacles
from tetractl.model.path_check import PathCheck
from tetractl.model.wheels import wheel_speeds


class MeasurementNoise(Model):
    """Standard deviations of what the camera measures, drawn anew in every frame."""

    position: NonNegative = 0.0
    """Of x and of y [length unit]."""
    heading: NonNegative = 0.0
    """Of the heading [rad]."""


class SimSection(PlantSection):
    """A simulated plant in virtual time. Every disturbance is off by default and is drawn from the
    trial's seed."""

    simulated: ClassVar[bool] = True
    type: Literal["sim"] = "sim"
    motion: Annotated[str, OneOf(MOTIONS)] = "exact"
    """`exact` follows (1)-(3); `arc` holds the wheel speeds of (24)-(25) between two commands;
    `euler` moves by (4)-(6) themselves, on straight chords."""
    camera_rate: float = Field(default=120.0, ge=1, le=10_000, allow_inf_nan=False)
    """Measurements a second [Hz]."""
    truth_rate: float = Field(default=960.0, ge=1, le=100_000, allow_inf_nan=False)
    """Samples a second of the true path that decides errors and obstacle violations [Hz]; at least
    the camera rate."""
    measurement_noise: MeasurementNoise = MeasurementNoise()
    """What the camera adds to the true poses."""
    heading_noise: NonNegative = 0.0
    """Random walk of the true heading [rad/sqrt(s)]."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """From measurement to actuation [s]; a stop takes as long."""
    lost_commands: Fraction = 0.0
    """Probability that a command never arrives and the one before it stays in force."""
    a_error: Fraction = 0.0
    """The true a is the spec's times 1 + e, with e uniform in [-a_error, a_error], drawn once a
    trial and robot."""
    speed_error: Fraction = 0.0
    """As `a_error`, for the speed."""
    disturbances: tuple[Annotated[DisturbanceSection, Choice(DISTURBANCES)], ...] = Field(
        default=(), max_length=100
    )
    """Further disturbances, which act one after another."""

    @model_validator(mode="after")
    def _truth_is_as_fine_as_the_camera(self) -> Self:
        if self.truth_rate < self.camera_rate:
            message = f"must be at least camera_rate, {self.camera_rate:g}"
            raise inconsistent("truth_rate", message)
        return self

    @property
    def disturbed(self) -> bool:
        """Whether any disturbance is on."""
        noise = self.measurement_noise
        sizes = (noise.position, noise.heading, self.heading_noise, self.dead_time)
        chances = (self.lost_commands, self.a_error, self.speed_error)
        return any((*sizes, *chances, *self.disturbances))

    def clock(self) -> Clock:
        """Return virtual time."""
        return VirtualClock()

    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, operators: Operators
    ) -> "SimPlant":
        """Return the simulation of one trial."""
        return SimPlant(self, setup, clock, seed)


class SimPlant:
    """A `Plant` of simulated robots; `seed` feeds every disturbance."""

    def __init__(
        self, section: SimSection, setup: Setup, clock: Clock, seed: np.random.SeedSequence
    ) -> None:
        self.spec = section
        self.wheel_radius = setup.wheel_radius
        self._motion: Motion = MOTIONS.load(section.motion)
        self.clock = clock
        streams = (np.random.default_rng(child) for child in seed.spawn(4))
        self._measuring, self._swerving, self._losing, erring = streams
        count = len(setup.names)
        self.nominal_a, self.nominal_speed = setup.a, setup.speed
        self.a = self.nominal_a * (1 + self.spec.a_error * erring.uniform(-1, 1, count))
        self.speed = self.nominal_speed * (1 + self.spec.speed_error * erring.uniform(-1, 1, count))
        self._disturbances = [
            disturbance.build(setup, np.random.default_rng(*seed.spawn(1)))
            for disturbance in section.disturbances
        ]
        for disturbance in self._disturbances:
            self.a, self.speed = disturbance.parameters(self.a, self.speed)
        self.poses = setup.starts
        self._held = Held(*(np.zeros(count) for _ in range(4)))
        self._orders: deque[Order] = deque()
        self._path_check = PathCheck(Obstacles.of(setup.obstacles), count)
        self._time = 0
        self._frames = 0  # frames exposed so far
        self._ticks = 0  # true samples judged so far
        self._fresh: list[Sample] = []
        self._newest: Observation | None = None
        self._stop: Command | None = None

    def open(self) -> PlantInfo:
        """Expose the first frame."""
        self._advance(self.clock.now())
        facts = {
            "true_a": json.dumps(self.a.tolist()),
            "true_speed": json.dumps(self.speed.tolist()),
        }
        return PlantInfo("sim", True, self.spec.camera_rate, facts)

    def observe(self) -> Observation:
        """Return the newest camera frame."""
        self._advance(self.clock.now())
        assert self._newest is not None, "open() exposes the first frame"
        return self._newest

    def steer(self, direction: float) -> Command:
        """Send u to every robot; each loses the command with probability `lost_commands`."""
        now = self.clock.now()
        self._advance(now)
        count = self.a.size
        reached = self._losing.uniform(size=count) >= self.spec.lost_commands
        order = Order(now + self._delay(), direction, reached)
        for disturbance in self._disturbances:
            order = disturbance.sent(order)
        self._send(order)
        left = right = None
        if self.wheel_radius is not None and self._newest:
            heading = self._newest.poses.heading
            left, right = wheel_speeds(
                heading, direction, self.nominal_a, self.nominal_speed, self.wheel_radius
            )
        return Command(direction, now, tuple(order.reached.tolist()), left, right)

    def samples(self) -> list[Sample]:
        """Return, once, every camera frame since the last call, oldest first."""
        self._advance(self.clock.now())
        fresh, self._fresh = self._fresh, []
        return fresh

    def news(self) -> list[Command | Note]:
        """Nothing is sent or noted but what `steer` returns."""
        return []

    def stop(self) -> Command:
        """Stop every robot after the dead time; a stop is repeated, so it is never lost."""
        if self._stop is None:
            now = self.clock.now()
            self._advance(now)
            count = self.a.size
            still = None if self.wheel_radius is None else np.zeros(count)
            self._stop = Command(None, now, (True,) * count, still, still)
            self._send(Order(now + self._delay(), None, np.ones(count, dtype=np.bool_)))
        return self._stop

    def settle(self) -> Verdict:
        """Wait for the stop to act and for one more camera frame, and judge the true path."""
        stopped = self._orders[-1].due_ns if self._orders else self.clock.now()
        self.clock.sleep_until(stopped + round(2 * SECOND / self.spec.camera_rate))
        self._advance(self.clock.now())
        entered = tuple(bool(e) for e in self._path_check.entered)
        return Verdict(self.poses, entered, tuple(self._path_check.clearance.tolist()))

    def close(self) -> None:
        """Nothing to release."""

    def _delay(self) -> int:
        return round(self.spec.dead_time * SECOND)

    def _send(self, order: Order) -> None:
        earliest = self._orders[-1].due_ns if self._orders else self._time
        self._orders.append(replace(order, due_ns=max(order.due_ns, earliest)))
        self._advance(self.clock.now())

    def _advance(self, until: int) -> None:
        """Move the robots on, block by block; nothing changes what is held inside a block."""
        noisy = self.spec.heading_noise > 0 or bool(self._disturbances)
        while True:
            frame = self._next_frame()
            end = min(until, frame) if noisy else until
            order = (
                self._orders.popleft() if self._orders and self._orders[0].due_ns <= end else None
            )
            reached = order.due_ns if order else end
            self._glide(reached)
            if noisy and reached == frame:
                self._disturb()
            if order:
                self._take(order)
            elif reached == until:
                return

    def _next_frame(self) -> int:
        return round(self._frames * SECOND / self.spec.camera_rate)

    def _take(self, order: Order) -> None:
        """Let an order act on the robots that received it."""
        got = order.reached
        held, heading = self._held, self.poses.heading
        if order.direction is None:
            held.moving = np.where(got, 0.0, held.moving)
            return
        held.direction = np.where(got, order.direction, held.direction)
        turning = self.a * np.sin(order.direction - heading)
        held.turning = np.where(got, turning, held.turning)
        held.course = np.where(got, heading, held.course)
        held.moving = np.where(got, 1.0, held.moving)

    def _disturb(self) -> None:
        """Add the random walk that the heading took since the last frame, and disturb the poses."""
        if self.spec.heading_noise > 0:
            self._swerve()
        seconds, moving = 1 / self.spec.camera_rate, self._held.moving
        for disturbance in self._disturbances:
            self.poses = disturbance.moved(self.poses, moving, seconds)

    def _swerve(self) -> None:
        step = self.spec.heading_noise / np.sqrt(self.spec.camera_rate)
        walk = step * self._swerving.standard_normal(self.a.size)
        self.poses = Poses(
            self.poses.x, self.poses.y, self.poses.heading + walk * self._held.moving
        )

    def _glide(self, end: int) -> None:
        """Move to `end` with everything held, exposing and judging what is due on the way."""
        frames, ticks = [], []
        while (due := self._next_frame()) <= end:
            frames.append((self._frames, due))
            self._frames += 1
        while (due := round(self._ticks * SECOND / self.spec.truth_rate)) <= end:
            ticks.append(due)
            self._ticks += 1
        times = np.unique(np.array([*(due for _, due in frames), *ticks, end], dtype=np.int64))
        x, y, heading = self._at((times - self._time)[:, None] / SECOND)
        self._path_check.add(x, y)
        for number, due in frames:
            i = np.searchsorted(times, due)
            self._expose(number, due, Poses(x[i], y[i], heading[i]))
        self._time, self.poses = end, Poses(x[-1], y[-1], heading[-1])

    def _at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Poses (M, N) after times t (M, 1) [s] from now, in closed form."""
        p, held = self.poses, self._held
        t = t * held.moving
        return self._motion.hold(p.x, p.y, p.heading, held, self.a, self.speed, t)

    def _expose(self, number: int, when: int, truth: Poses) -> None:
        """Take one camera frame."""
        noise = self.spec.measurement_noise
        measured = truth
        if noise.position > 0 or noise.heading > 0:
            x, y, heading = self._measuring.standard_normal((3, self.a.size))
            measured = Poses(
                truth.x + noise.position * x,
                truth.y + noise.position * y,
                truth.heading + noise.heading * heading,
            )
        valid = np.ones(self.a.size, dtype=np.bool_)
        for disturbance in self._disturbances:
            measured, valid = disturbance.measured(measured, valid, when / SECOND)
        if self._newest is not None and not valid.all():  # who is not tracked keeps the last pose
            last, now = self._newest.poses.array(), measured.array()
            measured = Poses.of(np.where(valid[:, None], now, last))
        self._newest = Observation(number, when, when, measured, valid)
        self._fresh.append(Sample(self._newest, truth))
