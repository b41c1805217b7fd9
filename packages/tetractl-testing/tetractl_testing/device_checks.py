"""Checks of a camera and an actuator.

For real devices, only checks run that do not move a robot. Emulated devices are checked for
everything that the lab relies on.

- `check_camera` checks building, opening, ten frames, health and closing. With an emulated scene,
  frames must also show this scene, and a hidden robot must have no pose.
- `check_actuator` checks building. With emulated robots, `_SteeringChecks` then check steering, a
  stop, a turn, one held robot, an emergency stop, and a disconnected device. Without robots, it
  only checks sending, to ports without a device.
"""

import math
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pkgutil import resolve_name
from threading import Thread
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND, Clock, MonotonicClock, wait_for
from tetractl.core.commands import Steer, Stop, Transmission, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Floats, Pose
from tetractl.core.protocols import Actuator, Camera, Device, Health
from tetractl.core.setup import Setup
from tetractl.lab.actuators.own_section import OwnSection
from tetractl.lab.guard_checks import ChecksOf
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.serial_port import PortFactory, SerialPort
from tetractl.model.motion.exact import rates
from tetractl.spec.lab_section import ActuatorSection, CameraSection, LabLimits
from tetractl.spec.section_abilities import OnPort
from tetractl_testing.expect import expect, expect_near, expect_true

EMULATED_TIMEOUT_S = 120.0
"""Maximum time until an emulated device does what is expected, on a busy host [s]."""
REAL_TIMEOUT_S = 5.0
"""Maximum time until frames of a real camera arrive [s]."""
FRAMES = 10
"""Number of camera frames that a check examines."""
SILENCE_NS = SECOND // 20
"""Time for which a camera that was left is watched for new frames [ns]."""
POSITION_ERROR_M = 0.005
"""Maximum distance between a measured position and the true one [m]."""
HEADING_ERROR_RAD = 0.05
"""Maximum difference between a measured heading and the true one [rad]."""
HEIGHT_M = 0.06
"""Height of the body of a robot on the floor [m]."""
HEIGHT_BAND_M = 0.05
"""Maximum difference of a measured height from HEIGHT_M [m]."""
TILT_MAX = 0.2
"""Maximum tilt of a robot on the floor [rad]."""
TURNING_ERROR = 0.2
"""Maximum error of a turning rate against equation (3), relative to the largest rate."""
SPEED_ERROR = 0.1
"""Maximum relative difference between a robot's speed and the spec's speed."""
DIRECTION_RAD = 0.5
"""Direction in which robots are steered if the direction does not matter [rad]."""


@dataclass(frozen=True)
class SeenRobots:
    """The robots that an emulated camera sees.

    Attributes:
        clock: The clock.
        poses: Returns the true poses in the spec's coordinates, shape (N, 3).
        hide: Hides a robot from the camera.
        ports: Creates the camera's port. None for the default.
    """

    clock: Clock
    poses: Callable[[], Floats]
    hide: Callable[[str], None]
    ports: PortFactory | None = None


@dataclass(frozen=True)
class MovedRobots:
    """The robots that an emulated actuator moves.

    Attributes:
        clock: The clock.
        moves: Returns whether each robot truly moves, N entries.
        unplug: Disconnects the device. None if nothing reports a missing device, as in a network.
        ports: Creates the actuator's ports. None for the default.
    """

    clock: Clock
    moves: Callable[[], Sequence[bool]]
    unplug: Callable[[], None] | None
    ports: PortFactory | None = None


def check_camera(section: CameraSection, setup: Setup, scene: SeenRobots | None = None) -> None:
    """Check that a camera can be built and, if it can be opened, that its frames are valid.

    Args:
        section: The camera's section.
        setup: The constants of the experiment.
        scene: An emulated scene that the frames must show. None for a real camera.
    """
    wake_calls: list[None] = []
    clock = scene.clock if scene else MonotonicClock()

    def wake() -> None:
        wake_calls.append(None)

    def build() -> Camera:
        if scene is None or scene.ports is None:
            return section.build(setup, clock, wake)
        return resolve_name(section.device)(section, setup, clock, wake, scene.ports)

    camera = build()
    _check_members("camera", camera, Camera)
    with ExitStack() as stack:
        try:
            entered = stack.enter_context(camera)
        except AbortError as error:
            expect(f"the camera was not opened, so its frames were not checked ({error.message})")
            return
        expect_true("__enter__: returns the camera", entered is camera)
        camera.frames()  # while it connects, it may not know its clock yet
        calls_before = len(wake_calls)
        frames = _next_frames(camera, clock, EMULATED_TIMEOUT_S if scene else REAL_TIMEOUT_S)
        now_ns = clock.now()
        wake_count = len(wake_calls) - calls_before
        if len(frames) < 2:
            expect("frames: at least 2", f"{len(frames)} in {now_ns / SECOND:.0f} s")
            return
        _check_frames(frames, now_ns, len(setup.names))
        is_woken = wake_count >= len(frames) - 1
        expect_true("wake: is called after each frame", is_woken, f"{wake_count} of {len(frames)}")
        _check_health(camera, healthy=scene is not None)
        if scene is not None:
            _check_scene(camera, setup, scene, frames)
    if scene is not None:
        camera.frames()
        clock.sleep_until(clock.now() + SILENCE_NS)
        expect_true("__exit__: no frame comes afterwards", camera.frames() == [])
        _check_leaving(camera, build())


def _next_frames(camera: Camera, clock: Clock, timeout_s: float) -> list[CameraFrame]:
    """Wait for the next FRAMES frames.

    Args:
        camera: The camera.
        clock: The clock.
        timeout_s: Maximum time to wait [s].

    Returns:
        The frames, oldest first. They are fewer if they do not arrive in time.
    """
    frames: list[CameraFrame] = []

    def has_enough_frames() -> bool:
        frames.extend(camera.frames())
        return len(frames) >= FRAMES

    wait_for(clock, has_enough_frames, timeout_s)
    return frames


def _check_frames(frames: Sequence[CameraFrame], now_ns: int, n_robots: int) -> None:
    """Check the order of frames that arrived by `now_ns`, and their numbers of poses."""
    numbers = [frame.number for frame in frames]
    times = [frame.sampled_ns for frame in frames]
    is_rising = numbers == sorted(set(numbers))
    expect_true("frames: numbers rise", is_rising, str(numbers))
    expect_true("frames: times rise", times == sorted(times), str(times))
    are_in_order = [frame.sampled_ns <= frame.received_ns <= now_ns for frame in frames]
    expect_true("frames: are received after their exposure", are_in_order)
    pose_counts = [len(frame.poses) for frame in frames]
    expect_true(
        "frames: have one pose per robot", np.equal(pose_counts, n_robots), f"{pose_counts}"
    )


def _check_scene(
    camera: Camera, setup: Setup, scene: SeenRobots, frames: Sequence[CameraFrame]
) -> None:
    """Check that the last frame shows a scene, and that a robot is untracked after it is hidden.

    No frame may have a fault or an unknown object. The robot that is hidden is the first one.
    """
    are_healthy = [frame.fault == "" and frame.unknown_objects == () for frame in frames]
    expect_true("frames: have no faults and no unknown objects", are_healthy)
    expect_true("damaged: 0", camera.damaged == 0, str(camera.damaged))
    poses = [pose for pose in frames[-1].poses if pose is not None]
    true_poses = scene.poses()
    expect_true("poses: show every robot", len(poses) == len(setup.names))
    if len(poses) < len(setup.names):
        return
    _check_poses(poses, true_poses, setup.metres)
    scene.hide(setup.names[0])
    last = frames[-1]

    def is_hidden() -> bool:
        nonlocal last
        for frame in camera.frames():
            last = frame
        return last.poses[0] is None

    expect_true(
        "poses: are None for a robot that is out of sight",
        wait_for(scene.clock, is_hidden, EMULATED_TIMEOUT_S),
    )
    others_tracked = [pose is not None for pose in last.poses[1:]]
    expect_true("poses: the other robots are still tracked", others_tracked)


def _check_poses(poses: Sequence[Pose], true_poses: Floats, metres: float) -> None:
    """Compare robots' poses with the true poses.

    Args:
        poses: The measured poses of N robots.
        true_poses: The true poses, shape (N, 3).
        metres: The length unit in metres.
    """
    measured = np.array([(pose.x, pose.y, pose.heading) for pose in poses])
    differences = measured - true_poses
    position_errors_m = np.hypot(differences[:, 0], differences[:, 1]) * metres
    heading_errors = np.remainder(differences[:, 2] + math.pi, math.tau) - math.pi
    expect_near(
        "poses: are in the spec's coordinates", position_errors_m, 0.0, 1.0, POSITION_ERROR_M
    )
    expect_near(
        "poses: have the headings of the robots", heading_errors, 0.0, 1.0, HEADING_ERROR_RAD
    )
    heights_m = [pose.height * metres for pose in poses if pose.height is not None]
    expectation = "poses: have the height of the body on the floor"
    expect_near(expectation, [HEIGHT_M, *heights_m], HEIGHT_M, 1.0, HEIGHT_BAND_M)
    are_upright = [pose.tilt is None or 0.0 <= pose.tilt < TILT_MAX for pose in poses]
    expect_true("poses: have the tilt of a robot on the floor", are_upright)


def check_actuator(
    section: ActuatorSection, setup: Setup, robots: MovedRobots | None = None
) -> None:
    """Check that an actuator can be built and sends commands.

    Without emulated robots, an actuator with a field `port`, or of an `OwnSection`, sends to ports
    without a device.

    Args:
        section: The actuator's section.
        setup: The constants of the experiment.
        robots: Emulated robots, which are steered and stopped in every way. None if there are none.
    """
    contradictions = "; ".join(_list_contradictions(section, setup))
    expect("section: fits the spec's robots", contradictions)
    if contradictions:
        return
    clock = robots.clock if robots else MonotonicClock()

    def build() -> Actuator:
        if robots is None or robots.ports is None:
            return section.build(setup, clock)
        return resolve_name(section.device)(section, setup, clock, robots.ports)

    actuator = build()
    _check_members("actuator", actuator, Actuator)
    period_ns = actuator.period_ns
    halts = actuator.halts
    expect("period_ns: above 0", "" if period_ns > 0 else f"{period_ns}")
    expect("halts: is true or false", "" if isinstance(halts, bool) else repr(halts))
    expect("failure: is None before the device is opened", actuator.failure or "")
    if robots is None:
        _check_sending(section, setup)
        return
    with actuator as entered:
        expect_true("__enter__: returns the actuator", entered is actuator)
        statuses = actuator.poll(1.0)
        has_problems = any(status.problems for status in statuses)
        all_healthy = len(statuses) == len(setup.names) and not has_problems
        expect_true("poll: returns a status of each robot, without problems", all_healthy)
        _check_health(actuator, healthy=True)
        expect_true("poll, check: move no robot", not any(robots.moves()))
        _SteeringChecks(actuator, section, setup, robots).check()
    _check_leaving(actuator, build())


def _list_contradictions(section: ActuatorSection, setup: Setup) -> list[str]:
    """List the fields of a section that do not fit the robots, each with the reason.

    The list is empty if all of them fit.
    """
    contradictions: list[str] = []
    for loc, reason in section.contradictions(setup):
        field = ".".join(map(str, loc))
        contradictions.append(f"{field} {reason}".strip())
    return contradictions


def _check_sending(section: ActuatorSection, setup: Setup) -> None:
    """Check that an actuator can steer and stop without any device at its ports.

    Its port is a pseudo-terminal, or its robots have their own ports that accept everything.
    """
    no_robots = MovedRobots(MonotonicClock(), list, None)
    if isinstance(section, OwnSection):
        with resolve_name(section.device)(section, setup, no_robots.clock, _Nowhere) as actuator:
            _SteeringChecks(actuator, section, setup, no_robots).check_sent()
        return
    if not isinstance(section, OnPort) or type(section.port) is not str:  # but that of a network
        expect("send: not checked, because the section has no field `port` for a serial port")
        return
    with ExitStack() as stack:
        section_data = _with_port(section.model_dump(), _pseudo_terminal(stack))
        section_to_nowhere = type(section).model_validate(section_data)
        try:
            actuator = stack.enter_context(section_to_nowhere.build(setup, no_robots.clock))
        except AbortError as error:
            expect(
                "send: not checked, because the actuator refuses a port without a device "
                f"({error.message})"
            )
            return
        _SteeringChecks(actuator, section, setup, no_robots).check_sent()


def _with_port(data: Any, port: str) -> Any:
    """Replace each port in a section's data by this port, including the ports of single robots."""
    match data:
        case dict():
            return {
                key: port if key == "port" and type(value) is str else _with_port(value, port)
                for key, value in data.items()
            }
        case list() | tuple():
            return [_with_port(item, port) for item in data]
        case _:
            return data


def _pseudo_terminal(stack: ExitStack) -> str:
    """Create a pseudo-terminal that accepts all bytes until the stack is closed.

    Returns:
        The path of the pseudo-terminal.
    """
    import tty  # not on Windows

    our_end, device_end = os.openpty()
    tty.setraw(device_end)
    Thread(target=_drop_input, args=(our_end,), daemon=True).start()
    stack.callback(os.close, device_end)
    return os.ttyname(device_end)


def _drop_input(port: int) -> None:
    """Read from a pseudo-terminal, and drop the bytes, until its other end is closed.

    The port is closed afterwards.
    """
    with suppress(OSError), open(port, "rb", buffering=0) as file:
        while file.read(1000):
            pass


class _Nowhere(SerialPort):
    """A port that accepts all bytes and leads to no device."""

    def open(self, exclusive: bool = True) -> None:
        """Do nothing."""

    def write(self, data: bytes) -> int:
        """Drop the bytes, and return the present time [ns]."""
        return self._clock.now()


class _SteeringChecks:
    """Checks of an open actuator, by the motion of its emulated robots."""

    def __init__(
        self,
        actuator: Actuator,
        section: ActuatorSection,
        setup: Setup,
        robots: MovedRobots,
    ) -> None:
        checks_of: ChecksOf = resolve_name(section.checks)
        self.moves_all_together = checks_of(GuardRules.from_setup(setup, LabLimits())).together
        self.actuator = actuator
        self.setup = setup
        self.robots = robots
        self.poses = [Pose(*map(float, row)) for row in setup.starts.array()]
        self.all_robots = (True,) * len(self.poses)

    def check(self) -> None:
        """Run all checks: steer, stop, turn, hold, stop in an emergency, and lose the device.

        The last one is left out if the robots cannot be unplugged.
        """
        actuator = self.actuator
        self.check_sent()
        self._steer_robots(DIRECTION_RAD, self.all_robots)
        has_moved = self._wait_for(lambda: all(self.robots.moves()))
        expect_true("steer: moves the robots", has_moved)
        self._check_stop("stop", actuator.stop())
        self._check_turn()
        if not self.moves_all_together:
            self._check_held()
        self._check_stop("emergency stop", actuator.stop(emergency=True))
        expect_true("failure: None", actuator.failure is None)
        if self.robots.unplug is None:
            expect("failure: not checked, because nothing shows that the device is gone")
            return
        self.robots.unplug()
        expect_true("failure: reports a device that is gone", self._wait_for(self._reports_failure))
        _check_aborts("steer", lambda: self._steer_robots(DIRECTION_RAD, self.all_robots))
        _check_aborts("stop", actuator.stop)

    def check_sent(self) -> None:
        """Steer in several directions, check the record of the commands, and then stop."""
        speed = self.setup.speed
        for direction in (0.0, 1.5, -2.5, DIRECTION_RAD):
            transmission = self._steer_robots(direction, self.all_robots)
            self._check_turning(
                "steer: turns the robots towards the direction", transmission, direction
            )
        # of the last one
        is_as_asked = (
            transmission.action == Steer(DIRECTION_RAD)
            and transmission.delivered == self.all_robots
        )
        expect_true("steer: action, robots", is_as_asked)
        age_ns = self.robots.clock.now() - transmission.sent_ns
        expect_true("steer: is sent at once", 0 <= age_ns <= SECOND)
        expect_near(
            "steer: states the speeds of the spec", transmission.speed, speed, speed, SPEED_ERROR
        )
        wheels = [wheel for wheel in (transmission.left, transmission.right) if wheel is not None]
        have_robot_shape = all(wheel.shape == speed.shape for wheel in wheels)
        are_numbers = all(isinstance(value, float) for value in transmission.outputs.values())
        expect_true(
            "steer: states wheels of shape (N,) or None, and outputs that are numbers",
            have_robot_shape and are_numbers,
        )
        transmission = self._steer_robots(
            DIRECTION_RAD, (self.moves_all_together, *self.all_robots[1:]), first_tracked=False
        )
        are_finite = np.isfinite([transmission.speed, transmission.turning]).all()
        expect_true("steer: works while a robot is not tracked", are_finite)
        expect_true("steer: then stop", self.actuator.stop().action == Stop())

    def _check_turning(
        self, expectation: str, transmission: Transmission, direction: float
    ) -> None:
        """Compare turning rates [rad/s] towards a direction [rad] with the paper's equation (3)."""
        setup = self.setup
        _, _, turning = rates(setup.starts.heading, direction, setup.a, setup.speed)
        expect_near(expectation, transmission.turning, turning, float(setup.a.max()), TURNING_ERROR)

    def _check_stop(self, name: str, transmission: Transmission) -> None:
        """Check that a stop is reported as a stop, and that robots stop if they can."""
        expect_true(f"{name}: reports that it stops the robots", transmission.action == Stop())
        if self.actuator.halts:
            is_stop = not (transmission.speed.any() or transmission.turning.any())
            expect_true(
                f"{name}: robots stand still", is_stop and self._wait_for(self._all_stand_still)
            )

    def _check_turn(self) -> None:
        """Check that robots that can stand still turn on the spot, and that others cannot."""
        turn = Turn(1.5)
        try:
            transmission = self.actuator.send(
                turn, self.poses, self.all_robots, self.robots.clock.now()
            )
        except AbortError as error:
            is_unexpected = self.actuator.halts or "on the spot" not in error.message
            problem = error.message if is_unexpected else ""
            expect("turn: only for robots that can stand still", problem)
            return
        is_as_asked = transmission.action == turn and transmission.delivered == self.all_robots
        expect_true(
            "turn: only for robots that can stand still", is_as_asked and self.actuator.halts
        )
        fastest = np.abs(transmission.speed).max()
        expect_true(
            "turn: turns robots on the spot", fastest < SPEED_ERROR * self.setup.speed.min()
        )
        self._check_turning("turn: turns robots towards the direction", transmission, turn.facing)

    def _check_held(self) -> None:
        """Check that the first robot can be held while the others move."""
        clock = self.robots.clock
        clock.sleep_until(clock.now() + self.actuator.period_ns)  # so that the turn has begun
        self.actuator.stop()
        self._wait_for(self._all_stand_still)
        transmission = self._steer_robots(DIRECTION_RAD, (False, *self.all_robots[1:]))
        is_held = not (
            transmission.delivered[0] or transmission.speed[0] or transmission.turning[0]
        )
        others_move = self._wait_for(lambda: all(self.robots.moves()[1:]))
        is_standing = others_move and not self.robots.moves()[0]
        expect_true("moving: holds one robot while the others move", is_held and is_standing)

    def _steer_robots(
        self, direction: float, moving: Sequence[bool], first_tracked: bool = True
    ) -> Transmission:
        """Wait for one period, then steer.

        Args:
            direction: Direction [rad].
            moving: Whether each robot is to move.
            first_tracked: Whether the first robot has a pose.

        Returns:
            What was sent.
        """
        clock = self.robots.clock
        clock.sleep_until(clock.now() + self.actuator.period_ns)
        poses = [self.poses[0] if first_tracked else None, *self.poses[1:]]
        return self.actuator.send(Steer(direction), poses, moving, clock.now())

    def _wait_for(self, condition: Callable[[], bool]) -> bool:
        """Wait for a condition, and return whether it holds within EMULATED_TIMEOUT_S."""
        return wait_for(self.robots.clock, condition, EMULATED_TIMEOUT_S)

    def _all_stand_still(self) -> bool:
        """Whether all robots stand still."""
        return not any(self.robots.moves())

    def _reports_failure(self) -> bool:
        """Send a command, unless a failure is known, and check whether the device reports one."""
        if self.actuator.failure is None:
            with suppress(AbortError):
                self._steer_robots(DIRECTION_RAD, self.all_robots)
        return self.actuator.failure is not None


def _check_aborts(name: str, call: Callable[[], object]) -> None:
    """Check that a call raises AbortError after the device is gone. Other errors are passed on."""
    expectation = f"{name}: raises AbortError when the device is gone"
    problem = "none is raised"
    try:
        call()
    except AbortError:
        problem = ""
    expect(expectation, problem)


def _check_health(device: Device, healthy: bool) -> None:
    """Call the `check` of a device twice, as a run may do, and examine both reports.

    Args:
        device: The open device.
        healthy: Whether the device must report no problems.
    """
    reports: list[Health] = [device.check(), device.check()]
    facts = [fact for health in reports for fact in health.facts.values()]
    expect_true(
        "check: returns facts that are strings", all(isinstance(fact, str) for fact in facts)
    )
    if healthy:
        problems = [problem for health in reports for problem in health.problems]
        expect("check: no problems", "; ".join(problems))


def _check_leaving(closed_device: Device, unopened_device: Device) -> None:
    """Check that a device can be closed twice, and also before it was opened."""
    expectation = "__exit__: can be called again, and before __enter__"
    problem = ""
    try:
        for device in (closed_device, unopened_device, unopened_device):
            device.__exit__(None, None, None)
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
    expect(expectation, problem)


def _check_members(kind: str, device: Device, protocol: type) -> None:
    """Check that a device has all public members of a protocol, `__enter__` and `__exit__`.

    Only their names are compared.
    """
    members = [name for base in protocol.__mro__ for name in vars(base)]
    public_names = {name for name in members if not name.startswith("_")}
    required_names = public_names | {"__enter__", "__exit__"}
    missing = ", ".join(sorted(name for name in required_names if not hasattr(device, name)))
    expect(f"{kind}: has all members", f"lacks {missing}" if missing else "")
