"""The simulated plant: robots, a camera, a radio and disturbances in continuous virtual time.

Nothing happens between calls. Each call first advances the true motion to the clock's time. Virtual
time passes only while somebody sleeps on the clock. The caller sleeps from one control step to the
next. The plant sleeps while a command is planned and while the robots come to a standstill.

    SimPlant             what the host of the robots sees: frames, commands, verdict
      SimCamera          exposes frames of the true poses, which reach the host later
      CommandSender        sends commands to the robots, and repeats the held one
        SimHost          computes the wheel speeds of robots on wheels
      Transit            the commands in flight
      TrueMotion         moves the robots from event to event
        Drive            how they move: DirectDrive, WheelDrive or CellDrive
        Watchdogs        stop robots that receive nothing
        MotionDisturbances
        PathCheck        checks the true path against obstacles, walls and other robots

`SimSection` contains the fields of the spec, and `RandomStream` lists the random streams. A trial
depends only on its spec and seed.
"""

import json
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND, Clock
from tetractl.core.commands import Action, Command, Stop
from tetractl.core.errors import AbortError, WrongValueError
from tetractl.core.poses import Floats, Observation, Poses, Sample
from tetractl.core.registries import MOTIONS
from tetractl.core.setup import Setup
from tetractl.core.trial import Note, PlantInfo, Verdict
from tetractl.model.path_check import PathCheck
from tetractl.plant.command_sender import CommandSender
from tetractl.plant.direct import DirectDrive
from tetractl.plant.random_streams import RandomStream, generator
from tetractl.plant.sim_camera import SimCamera
from tetractl.plant.sim_section import SimSection
from tetractl.plant.timetable import Timetable
from tetractl.plant.transit import Transit, Watchdogs
from tetractl.plant.true_motion import Drive, MotionDisturbances, TrueMotion
from tetractl.spec.disturbance import Disturbance

NO_FRAME_TIMEOUT_S = 60
"""Maximum time to wait for a frame after the stop, before the trial is aborted [s]."""


def draw_robots(
    settings: SimSection,
    setup: Setup,
    disturbances: Sequence[Disturbance],
    random: np.random.Generator,
) -> tuple[Floats, Floats, Poses]:
    """Sample the true properties of the simulated robots.

    The spec's values are changed by random errors, and then by the disturbances.

    Args:
        settings: The section of the simulation.
        setup: The constants of the experiment.
        disturbances: The disturbances of the trial.
        random: The random generator.

    Returns:
        Turning rates a [rad/s], speeds [length unit/s] and start poses.
    """
    n_robots = len(setup.names)
    # in this order: it is part of the result
    a = setup.a * (1 + settings.a_error * random.uniform(-1, 1, n_robots))
    speed = setup.speed * (1 + settings.speed_error * random.uniform(-1, 1, n_robots))
    starts = setup.starts
    for disturbance in disturbances:
        a, speed = disturbance.parameters(a, speed)
        starts = disturbance.placed(starts)
    return a, speed, starts


def build_drive(
    settings: SimSection,
    setup: Setup,
    a: Floats,
    speed: Floats,
    starts: Poses,
    seed: np.random.SeedSequence,
) -> Drive:
    """Create the `Drive` that moves the simulated robots: wheels, cells, or the spec's motion.

    A trial imports only the drive that it uses.

    Args:
        settings: The section of the simulation.
        setup: The constants of the experiment.
        a: True turning rates before they vary [rad/s], shape (N,).
        speed: True speeds before they vary [length unit/s], shape (N,).
        starts: Poses at the start.
        seed: Seed of the trial's random streams.
    """
    if settings.drive is not None:
        from tetractl.plant.wheel_drive import WheelDrive

        return WheelDrive(settings, setup, a, speed, starts, seed)
    if settings.cells is not None:
        from tetractl.plant.cell_drive import CellDrive

        heading_noise = settings.heading_noise
        return CellDrive(settings.cells, setup, a, speed, starts, heading_noise, seed)
    return DirectDrive(MOTIONS.load(settings.motion), a, speed, starts)


class SimPlant:
    """Simulated robots, used as the `Plant` of a trial.

    Calls come in this order: `open` exposes the first frame; then `observe` and `send` for each
    control step, and `samples` and `events` at any time; `stop` once, and `settle` after it. The
    public attributes are for code that needs the truth. Nothing changes them from outside.

    Args:
        settings: The fields of the simulation in the spec.
        setup: The constants of the experiment.
        clock: The clock, which this plant advances.
        seed: Seed of all random numbers.
    """

    def __init__(
        self, settings: SimSection, setup: Setup, clock: Clock, seed: np.random.SeedSequence
    ) -> None:
        n_robots = len(setup.names)
        disturbances = [
            disturbance.build(setup, generator(seed, RandomStream.DISTURBANCES + k))
            for k, disturbance in enumerate(settings.disturbances)
        ]
        self.settings = settings
        self.setup = setup
        self.clock = clock
        self.disturbances = disturbances
        random = generator(seed, RandomStream.PARAMETERS)
        a, speed, starts = draw_robots(settings, setup, disturbances, random)
        self.a = a
        """The true turning rates before disturbances vary them [rad/s], shape (N,)."""
        self.speed = speed
        """The true speeds before disturbances vary them [length unit/s], shape (N,)."""
        drive = build_drive(settings, setup, a, speed, starts, seed)
        self.drive = drive
        """The part that moves the robots."""
        self.camera = SimCamera(
            n_robots, settings.measurement_noise, disturbances, generator(seed, RandomStream.CAMERA)
        )
        """The simulated camera that measures the robots' poses."""
        heading_walk_rad = (
            0.0  # a drive with an integrated path makes the walk's steps at its samples instead
        )
        if not drive.is_integrated:
            heading_walk_rad = float(settings.heading_noise / np.sqrt(settings.camera_rate))
        transit = Transit(n_robots, disturbances)
        self._sender = CommandSender(
            settings,
            setup,
            drive.host,
            transit,
            disturbances,
            generator(seed, RandomStream.RADIO),
        )
        self._motion = TrueMotion(
            drive=drive,
            camera=self.camera,
            timetable=Timetable(settings.camera_rate, settings.truth_rate),
            transit=transit,
            watchdogs=Watchdogs(n_robots, setup.watchdog_s),
            disturbances=MotionDisturbances(disturbances, self.a, self.speed),
            heading_walk_rad=heading_walk_rad,
            walk_random=generator(seed, RandomStream.HEADINGS),
            path_check=PathCheck.for_setup(setup),
            sender=self._sender,
        )
        self._first_stop: Command | None = None

    @property
    def poses(self) -> Poses:
        """The present true poses of the simulated robots, without noise."""
        return self.drive.poses

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """The present true turning rates [rad/s] and speeds [length unit/s], (N,) each."""
        return self._motion.disturbances.rates

    def open(self) -> PlantInfo:
        """Prepare the simulation, and expose its first camera frame.

        The facts of the result contain the true turning rates and speeds.
        """
        self._catch_up()
        a, speed = self.drive.gains * np.array([self.a, self.speed])
        facts = {
            "true_a": json.dumps(a.tolist()),
            "true_speed": json.dumps(speed.tolist()),
        }
        return PlantInfo(
            kind="sim", simulated=True, camera_rate_hz=self.settings.camera_rate, facts=facts
        )

    def observe(self) -> Observation:
        """Return the newest camera frame that the host has received."""
        self._catch_up()
        return self._newest_frame()

    def send(self, action: Action) -> Command:
        """Let the planning time pass, then send an action to every robot.

        A stop is repeated until every robot has received a stop. The command answers the frame on
        which it was planned. However, the host of robots on wheels computes the wheel speeds at the
        moment of sending, from the newest frame.
        """
        planned_frame = self.observe()
        self._sleep_planning_time()
        now_ns = self.clock.now()
        if isinstance(action, Stop):
            command = self._sender.send_stops(now_ns, planned_frame)
        elif self.drive.host is None:
            command = self._sender.send(now_ns, planned_frame, action)
        else:
            command = self._sender.send(now_ns, self._newest_frame(), action)
        self._catch_up()
        return command

    def samples(self) -> list[Sample]:
        """Return every camera frame received since the last call, oldest first."""
        self._catch_up()
        return self.camera.take_samples()

    def events(self) -> list[Command | Note]:
        """Return the commands that the host has repeated since the last call, oldest first."""
        repeated = self._motion.repeated_commands
        self._motion.repeated_commands = []
        return repeated

    def stop(self) -> Command:
        """Send a stop to all robots. Later calls only return the command of the first call."""
        if self._first_stop is None:
            self._first_stop = self.send(Stop())
        return self._first_stop

    def settle(self) -> Verdict:
        """Wait until a frame shows all robots standing still, and check the true path.

        Raises:
            AbortError: If no frame arrives within NO_FRAME_TIMEOUT_S.
        """
        stopped_ns = max(self._motion.transit.last_due_ns, self.clock.now())
        standstill_ns = stopped_ns + round(self.drive.stopping_s * SECOND)
        two_frames_ns = round(2 * SECOND / self.settings.camera_rate)
        self.clock.sleep_until(standstill_ns + two_frames_ns)
        self._catch_up()
        self._await_frame(standstill_ns)
        return self._motion.verdict()

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _catch_up(self) -> None:
        """Advance the simulated robots to the time that the virtual clock shows."""
        self._motion.advance(self.clock.now())

    def _newest_frame(self) -> Observation:
        """Return the newest frame that the host has received. `open` must have been called."""
        newest = self.camera.newest
        assert newest is not None, "there is no frame: call open() first"
        return newest

    def _await_frame(self, exposed_min_ns: int) -> None:
        """Wait until the host has received a frame exposed at `exposed_min_ns` or later.

        Raises:
            AbortError: If no such frame arrives within NO_FRAME_TIMEOUT_S.
        """
        give_up_ns = self.clock.now() + NO_FRAME_TIMEOUT_S * SECOND
        camera = self.camera
        while camera.newest is None or camera.newest.sampled_ns < exposed_min_ns:
            next_arrival_ns = camera.next_arrival_ns
            if next_arrival_ns is None:
                self.clock.sleep_until(self._motion.timetable.next_frame_ns)
            else:
                self.clock.sleep_until(next_arrival_ns)
            if self.clock.now() > give_up_ns:
                raise AbortError(f"no camera frame has arrived for {NO_FRAME_TIMEOUT_S} s")
            self._catch_up()

    def _sleep_planning_time(self) -> None:
        """Sleep for the planning time. Without a disturbance, the planning time is 0."""
        now_ns = self.clock.now()
        planning_s = sum(
            disturbance.planning_s(now_ns / SECOND) for disturbance in self.disturbances
        )
        if not 0 <= planning_s < NEVER_NS / SECOND:  # NaN, too
            value_text = f"a planning time of {planning_s} s"
            raise WrongValueError("a disturbance", value_text)
        self.clock.sleep_until(now_ns + round(planning_s * SECOND))
        self._catch_up()
