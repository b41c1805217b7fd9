"""The simulated plant: true motion in continuous virtual time, a camera, and disturbances."""

import json
from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.clock import NEVER, SECOND, Clock, VirtualClock
from tetractl.core.commands import (
    Action,
    Command,
    FieldOff,
    Note,
    PlantInfo,
    Sample,
    Steer,
    Stop,
    Turn,
    Verdict,
)
from tetractl.core.errors import AbortError, WrongValueError
from tetractl.core.poses import Floats, Observation, Pose, Poses
from tetractl.core.protocols import LabSupervision
from tetractl.core.registries import DISTURBANCES, MOTIONS
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, NonNegative, inconsistent
from tetractl.experiment.choice import Choice, FoundRobots, RobotCandidate
from tetractl.experiment.disturbance import DelayedCommand, DisturbanceSection, overriding
from tetractl.experiment.lab_section import STOP_GAP_NS, STOPS
from tetractl.experiment.plant import PlantSection
from tetractl.experiment.registry_fields import KindName, KindSection
from tetractl.experiment.yaml.problems import Loc
from tetractl.model.motion.rolling import wheel_speeds
from tetractl.model.swimmers import A_LOG_SD, SPEED_LOG_SD
from tetractl.plant.cell_drive import CellDrive, CultureSection
from tetractl.plant.direct import DirectDrive, aim
from tetractl.plant.sim_camera import Beats, MeasurementNoise, SimCamera
from tetractl.plant.true_motion import Drive, TrueMotion
from tetractl.plant.wheel_drive import WheelDrive, WheelDriveSection

NO_FRAME_S = 60
CULTURE = 6  # number of simulated cells from which the robots are chosen
# spawn key of these cells' random numbers; `verify` repeats the plant's random numbers without them
FINDING = 1000
SURVEYED = 0.03  # relative error of the turning rate a and the speed that a survey measures
# largest number of repetitions of a stop command that was lost: those of one minute
STOPS_MAX = 3000
POSES_MAX = 2_000_000  # largest number of poses in a control period: they are stored together
WHEELS_KEY = 2**32 - 1
"""Spawn key of the wheels' random numbers; disturbances use the keys from 4 on."""


class SimSection(PlantSection):
    """A simulated plant in virtual time. All disturbances are off by default, and depend only on
    the trial's seed."""

    simulated: ClassVar[bool] = True
    switches_field: ClassVar[bool] = True
    type: Literal["sim"] = "sim"
    motion: Annotated[str, KindName(MOTIONS)] = "exact"
    """By equations of the paper: `exact` follows (1)-(3); `arc` holds the wheel speeds of
    (24)-(25), computed from the newest frame, between two commands; `euler` moves by (4)-(6), on
    straight chords. Ignored with `drive`."""
    drive: WheelDriveSection | None = None
    """Wheels by which robots turn towards the direction; by default robots turn by the paper's
    equation (3), without wheels. Needs the experiment's field `wheels`."""
    cells: CultureSection | None = None
    """Simulates swimming cells in place of points that move by `motion`, which is then ignored."""
    camera_rate: float = Field(default=120.0, ge=1, le=10_000, allow_inf_nan=False)
    """Rate of measurements [Hz]."""
    truth_rate: float = Field(default=960.0, ge=1, le=100_000, allow_inf_nan=False)
    """Sampling rate of the true path, by which errors and obstacle violations are computed [Hz]; at
    least the camera rate."""
    measurement_noise: MeasurementNoise = MeasurementNoise()
    """Standard deviations of the camera's noise."""
    heading_noise: NonNegative = 0.0
    """Random walk of the true heading of robots that move [rad/sqrt(s)]."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Time from the exposure of the frame used for a command or stop until the robots act on it
    [s], as in `controller.dead_time`; a command sent after this time acts at once. Delays of
    `drive` and `disturbances` are added."""
    lost_commands: Fraction = 0.0
    """Probability that a robot does not receive a command and keeps following the previous one."""
    a_error: Fraction = 0.0
    """The true turning rate a is the spec's times 1 + e, with e uniform in [-a_error, a_error],
    drawn once per trial and robot."""
    speed_error: Fraction = 0.0
    """The true speed is the spec's times 1 + e, with e uniform in [-speed_error, speed_error],
    drawn once per trial and robot.
    """
    disturbances: tuple[Annotated[DisturbanceSection, KindSection(DISTURBANCES)], ...] = Field(
        default=(), max_length=100
    )
    """Further disturbances, each applied to the result of the one before."""

    @model_validator(mode="after")
    def _truth_is_as_fine_as_the_camera(self) -> Self:
        if self.truth_rate < self.camera_rate:
            message = f"must be at least camera_rate, {self.camera_rate:g}"
            raise inconsistent("truth_rate", message)
        return self

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield location and text of each contradiction in the wheels or sampling rates."""
        poses = setup.period_s * max(self.truth_rate, self.camera_rate) * len(setup.names)
        if poses > POSES_MAX:
            message = f"gives {poses:.3g} poses in a control period of {setup.period_s:g} s"
            yield ("truth_rate",), f"{message}; at most {POSES_MAX:g} are allowed; lower the rate"
        if self.drive is not None and self.cells is not None:
            yield ("cells",), "have no wheels; leave out 'drive' or 'cells'"
        if self.drive is not None and setup.wheel_radius is None:
            yield ("drive",), "needs the experiment's field 'wheels: {radius: ..}'"
        rate = 1 / setup.period_s if self.drive is None else self.drive.rate or 1 / setup.period_s
        if rate * setup.watchdog_s <= 1:
            message = f"at {rate:g} Hz robots with a watchdog of {setup.watchdog_s:g} s would stop"
            yield ("drive",), f"{message} between two commands; shorten controller.period"

    @property
    def loses_frames(self) -> bool:
        """Whether any disturbance loses frames."""
        return any(disturbance.loses_frames for disturbance in self.disturbances)

    @property
    def planning_max_s(self) -> float:
        """Longest time from a control step's frame to its command [s]."""
        return sum(disturbance.planning_max_s for disturbance in self.disturbances)

    @property
    def sampling_hz(self) -> float:
        """The rate of the true poses [Hz]."""
        return self.truth_rate

    @property
    def disturbed(self) -> bool:
        """Whether the plant has any disturbance."""
        noise = self.measurement_noise
        sizes = (noise.position, noise.heading, self.heading_noise, self.dead_time)
        chances = (self.lost_commands, self.a_error, self.speed_error)
        made = self.drive is not None or self.cells is not None
        return made or any((*sizes, *chances, *self.disturbances))

    def clock(self) -> Clock:
        """Return a new virtual clock."""
        return VirtualClock()

    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> "SimPlant":
        """Return the simulation of one trial."""
        return SimPlant(self, setup, clock, seed)

    def find(
        self,
        choice: Choice,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        supervision: LabSupervision,
    ) -> FoundRobots:
        """Return random cells scattered in the arena, with turning rates and speeds as a survey
        would measure them."""
        own = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, FINDING))
        random, arena = np.random.default_rng(own), setup.arena
        count = max(CULTURE, choice.choose)
        x = random.uniform(arena.left + arena.width / 8, arena.right - arena.width / 8, count)
        y = random.uniform(arena.bottom + arena.height / 8, arena.top - arena.height / 8, count)
        heading = random.uniform(-np.pi, np.pi, count)
        a = choice.a * np.exp(random.normal(0, A_LOG_SD, count))
        speed = choice.speed * np.exp(random.normal(0, SPEED_LOG_SD, count))
        rows = zip(*(each.tolist() for each in (x, y, heading, a, speed)), strict=True)
        cells = [
            RobotCandidate(i + 1, Pose(*place), a, SURVEYED * a, speed, SURVEYED * speed)
            for i, (*place, a, speed) in enumerate(rows)
        ]

        def build(numbers: Sequence[int], chosen: Setup) -> SimPlant:
            return SimPlant(self, chosen, clock, seed)

        return FoundRobots(cells, build, lambda: None)


class SimPlant:
    """A `Plant` of simulated robots; `seed` determines all disturbances."""

    def __init__(
        self, section: SimSection, setup: Setup, clock: Clock, seed: np.random.SeedSequence
    ) -> None:
        self.section, self.setup, self.clock = section, setup, clock
        streams = (np.random.default_rng(child) for child in seed.spawn(4))
        measuring, swerving, self.losing, erring = streams
        self._swerving = swerving
        count = len(setup.names)
        self.a = setup.a * (1 + section.a_error * erring.uniform(-1, 1, count))
        self.speed = setup.speed * (1 + section.speed_error * erring.uniform(-1, 1, count))
        disturbances = [
            disturbance.build(setup, np.random.default_rng(*seed.spawn(1)))
            for disturbance in section.disturbances
        ]
        self.disturbances = disturbances
        self._planning = overriding(disturbances, "planning_s")
        starts = setup.starts
        for disturbance in disturbances:
            self.a, self.speed = disturbance.parameters(self.a, self.speed)
            starts = disturbance.placed(starts)
        self._news: list[Command | Note] = []
        self.camera = SimCamera(count, section.measurement_noise, measuring, disturbances)
        key = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, WHEELS_KEY))
        self.wheels = self._on_wheels(starts, key)
        self.drive: Drive = self.wheels or self._without_wheels(starts, key)
        walk = section.heading_noise / np.sqrt(section.camera_rate)
        self.motion = TrueMotion(
            setup,
            self.a,
            self.speed,
            self.drive,
            self.camera,
            Beats(section.camera_rate, section.truth_rate),
            disturbances,
            0.0 if self.drive.sampled else float(walk),
            swerving,
            lambda now: self._news.append(self._transmit(now, None)),
        )
        self._stop: Command | None = None
        self._held: Steer | Turn | FieldOff = FieldOff()  # sent last, and repeated
        self._repeats_stops = section.drive is not None or bool(overriding(disturbances, "sent"))

    @property
    def poses(self) -> Poses:
        """The present true poses."""
        return self.drive.poses

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """The present true turning rates [rad/s] and speeds [length unit/s], (N,) each."""
        return self.motion.rates

    def open(self) -> PlantInfo:
        """Expose the first frame."""
        self.motion.advance(self.clock.now())
        facts = {
            "true_a": json.dumps(self.a.tolist()),
            "true_speed": json.dumps(self.speed.tolist()),
        }
        return PlantInfo("sim", True, self.section.camera_rate, facts)

    def observe(self) -> Observation:
        """Return the newest camera frame that the host has received."""
        self.motion.advance(self.clock.now())
        newest = self.camera.newest
        assert newest is not None, "there is no frame: call open() first"
        return newest

    def send(self, action: Action) -> Command:
        """After the planning time, send a command to every robot; a stop is repeated until every
        robot has received it."""
        seen = self.observe()
        now = self._plan()
        if isinstance(action, Stop):
            return self._halt(now, seen)
        self._held = action
        command = self._transmit(now, seen)
        self.motion.advance(now)
        return command

    def samples(self) -> list[Sample]:
        """Return every camera frame received since the last call, oldest first."""
        self.motion.advance(self.clock.now())
        return self.camera.samples()

    def news(self) -> list[Command | Note]:
        """Return the commands sent under a held direction since the last call, oldest first."""
        news, self._news = self._news, []
        return news

    def stop(self) -> Command:
        """Send a stop, once."""
        if self._stop is None:
            self._stop = self.send(Stop())
        return self._stop

    def _halt(self, now: int, seen: Observation) -> Command:
        """Stop every robot."""
        count = self.a.size
        zeros = np.zeros(count)
        if self.drive.host is not None:
            self.drive.host.halt(now)
        heard = np.zeros(count, dtype=np.bool_)
        for i in range(STOPS_MAX if self._repeats_stops else 1):
            if i >= STOPS and heard.all():
                break
            sent = now + i * STOP_GAP_NS
            command = DelayedCommand(
                sent,
                self._due_ns(seen, sent),
                Stop(),
                np.ones(count, dtype=np.bool_),
                headings=seen.poses.heading,
                wheels=np.zeros((2, count)),
            )
            heard |= self.motion.transit.send(command, now).reached
        still = None if self.setup.wheel_radius is None else zeros
        self.motion.advance(now)
        return Command(Stop(), now, tuple(heard.tolist()), still, still)

    def settle(self) -> Verdict:
        """Wait until the robots stand and a frame shows them standing, and check the true path."""
        stopped = max(self.motion.transit.settled_ns, self.clock.now())
        stand = stopped + round(self.drive.rest_s * SECOND)
        self.clock.sleep_until(stand + round(2 * SECOND / self.section.camera_rate))
        self.motion.advance(self.clock.now())
        self._await_frame(stand)
        self.motion.check()
        return self.motion.path_check.verdict(self.poses)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _without_wheels(self, starts: Poses, key: np.random.SeedSequence) -> Drive:
        section = self.section
        if section.cells is None:
            return DirectDrive(MOTIONS.load(section.motion), self.a, self.speed, starts)
        random, walk = np.random.default_rng(key), section.heading_noise
        return CellDrive(section.cells, self.setup, self.a, self.speed, starts, walk, random)

    def _on_wheels(self, starts: Poses, key: np.random.SeedSequence) -> WheelDrive | None:
        section, random = self.section, np.random.default_rng(key)
        if section.drive is None:
            return None
        given = self.setup, self.a, self.speed, starts, section.heading_noise, section.truth_rate
        return WheelDrive(section.drive, *given, self._swerving, random)

    def _await_frame(self, since: int) -> None:
        """Wait until the host has a frame exposed at `since` or later [ns]."""
        patience = self.clock.now() + NO_FRAME_S * SECOND
        while self.camera.newest is None or self.camera.newest.sampled_ns < since:
            arriving = self.camera.arriving_ns
            self.clock.sleep_until(
                self.motion.beats.next_frame_ns if arriving is None else arriving
            )
            if self.clock.now() > patience:
                raise AbortError(f"no camera frame arrived for {NO_FRAME_S} s")
            self.motion.advance(self.clock.now())

    def _plan(self) -> int:
        """Advance by the planning time, and return the new time [ns]."""
        self.clock.sleep_until(self.planned_ns(self.clock.now()))
        self.motion.advance(self.clock.now())
        return self.clock.now()

    def planned_ns(self, now: int) -> int:
        """Return the time [ns] at which a command planned from `now` on is sent."""
        took_s = sum(one.planning_s(now / SECOND) for one in self._planning)
        if not 0 <= took_s < NEVER / SECOND:
            raise WrongValueError(self, "a disturbance", f"a planning time of {took_s} s")
        return now + round(took_s * SECOND)

    def _due_ns(self, answered: Observation, now: int) -> int:
        """Return the time [ns] at which a command sent `now` in answer to a frame acts if
        `dead_time` is the only delay."""
        return max(now, answered.sampled_ns + round(self.section.dead_time * SECOND))

    def _transmit(self, now: int, seen: Observation | None) -> Command:
        """Send the held action, or the wheel speeds for it in answer to the newest frame."""
        held, host, setup = self._held, self.drive.host, self.setup
        new = seen is not None
        if host is not None:  # each transmission has the wheel speeds for the newest frame
            seen = self.camera.newest
        assert seen is not None, "there is no frame: call open() first"
        headings = seen.poses.heading
        towards = aim(held, headings)
        drives = not isinstance(held, Turn)
        left = right = made = None
        if host is not None:
            (left, right), made = host.speeds(new, now, headings, seen.sampled_ns, towards, drives)
        elif setup.wheel_radius is not None:
            speed, radius = setup.speed * drives, setup.wheel_radius
            left, right = wheel_speeds(np.sin(towards - headings), setup.a, speed, radius)
        heard = self.losing.uniform(size=self.a.size) >= self.section.lost_commands
        due = self._due_ns(seen, now)
        command = DelayedCommand(now, due, held, heard, None, headings, made)
        reached = tuple(self.motion.transit.send(command, now).reached.tolist())
        return Command(held, now, reached, left, right)
