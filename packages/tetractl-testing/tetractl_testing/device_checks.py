"""Checks of a camera and an actuator.

Real devices only get checks that do not move a robot. Emulated devices are checked for everything
that the lab relies on.

    check_camera      building, opening, ten frames, health, leaving
                      with a scene also: frames show it; a hidden robot has no pose
    check_actuator    building; then, for emulated robots, `_SteeringChecks`: steering, a stop, a
                      turn, one robot held, an emergency stop, and a device that is gone
                      without robots only sending, to ports without a device
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
from tetractl.lab.serial_port import Ports, SerialPort
from tetractl.model.motion.exact import rates
from tetractl.spec.lab_section import ActuatorSection, CameraSection, LabLimits
from tetractl.spec.section_abilities import OnPort
from tetractl_testing.expect import expect, near, true

EMULATED_S = 120.0
"""Maximum time until an emulated device does what is expected, on a busy host [s]."""
REAL_S = 5.0
"""Maximum time until frames of a real camera arrive [s]."""
FRAMES = 10
"""Number of frames that are examined."""
LEFT_NS = SECOND // 20
"""Time after which a camera that was left must have no new frame [ns]."""
PLACE_M = 0.005
"""Maximum distance between a measured position and the true one [m]."""
HEADING = 0.05
"""Maximum difference between a measured heading and the true one [rad]."""
HEIGHT_M = 0.06
"""Height of the body of a robot on the floor [m], within a range of `HEIGHT_BAND_M`."""
HEIGHT_BAND_M = 0.05
TILT_MAX = 0.2
"""Maximum tilt of a robot on the floor [rad]."""
TURNING = 0.2
"""Maximum error of a turning rate against equation (3), relative to the largest rate."""
SPEED = 0.1
"""Maximum relative difference of a speed from the spec's."""
DIRECTION = 0.5
"""Direction in which robots are steered where any direction would do [rad]."""


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
    ports: Ports | None = None


@dataclass(frozen=True)
class MovedRobots:
    """The robots that an emulated actuator moves.

    Attributes:
        clock: The clock.
        moves: Returns which robots truly move, N entries.
        unplug: Disconnects the device. None if a missing device cannot be noticed, as in a network.
        ports: Creates the actuator's ports. None for the default.
    """

    clock: Clock
    moves: Callable[[], Sequence[bool]]
    unplug: Callable[[], None] | None
    ports: Ports | None = None


def check_camera(section: CameraSection, setup: Setup, scene: SeenRobots | None = None) -> None:
    """Check that a camera can be built and, if it can be opened, that its frames are valid.

    Args:
        section: The camera's section.
        setup: The constants of the experiment.
        scene: An emulated scene that the frames must show. None for a real camera.
    """
    calls: list[None] = []
    clock = scene.clock if scene else MonotonicClock()

    def wake() -> None:
        calls.append(None)

    def build() -> Camera:
        if scene is None or scene.ports is None:
            return section.build(setup, clock, wake)
        return resolve_name(section.device)(section, setup, clock, wake, scene.ports)

    camera = build()
    _members("camera", camera, Camera)
    with ExitStack() as stack:
        try:
            entered = stack.enter_context(camera)
        except AbortError as error:
            expect(f"the camera was not opened, so its frames were not checked ({error.message})")
            return
        true("__enter__: returns the camera", entered is camera)
        camera.frames()  # while it connects, it may not know its clock yet
        before = len(calls)
        frames = _next_frames(camera, clock, EMULATED_S if scene else REAL_S)
        now_ns = clock.now()
        woken = len(calls) - before
        if len(frames) < 2:
            expect("frames: at least 2", f"{len(frames)} in {now_ns / SECOND:.0f} s")
            return
        _check_frames(frames, now_ns, len(setup.names))
        enough = woken >= len(frames) - 1
        true("wake: is called after each frame", enough, f"{woken} of {len(frames)}")
        _check_health(camera, healthy=scene is not None)
        if scene is not None:
            _check_scene(camera, setup, scene, frames)
    if scene is not None:
        camera.frames()
        clock.sleep_until(clock.now() + LEFT_NS)
        true("__exit__: no frame comes afterwards", camera.frames() == [])
        _check_leaving(camera, build())


def _next_frames(camera: Camera, clock: Clock, patience_s: float) -> list[CameraFrame]:
    """Return the next FRAMES frames, oldest first, or fewer if they do not arrive in time.

    `patience_s` is the maximum time to wait [s].
    """
    frames: list[CameraFrame] = []

    def enough() -> bool:
        frames.extend(camera.frames())
        return len(frames) >= FRAMES

    wait_for(clock, enough, patience_s)
    return frames


def _check_frames(frames: Sequence[CameraFrame], now_ns: int, robots: int) -> None:
    """Check the order and the number of poses of frames that arrived by `now_ns`."""
    numbers = [frame.number for frame in frames]
    times = [frame.sampled_ns for frame in frames]
    rise = numbers == sorted(set(numbers))
    true("frames: numbers rise", rise, str(numbers))
    true("frames: times rise", times == sorted(times), str(times))
    in_order = [frame.sampled_ns <= frame.received_ns <= now_ns for frame in frames]
    true("frames: are received after their exposure", in_order)
    poses = [len(frame.poses) for frame in frames]
    true("frames: have one pose per robot", np.equal(poses, robots), f"{poses}")


def _check_scene(
    camera: Camera, setup: Setup, scene: SeenRobots, frames: Sequence[CameraFrame]
) -> None:
    """Check that the last frame shows a scene, and that a robot is untracked after it is hidden.

    No frame may have a fault or an unknown object. The robot that is hidden is the first one.
    """
    healthy = [frame.fault == "" and frame.unknown_objects == () for frame in frames]
    true("frames: have no faults and no unknown objects", healthy)
    true("damaged: 0", camera.damaged == 0, str(camera.damaged))
    poses = [pose for pose in frames[-1].poses if pose is not None]
    true_poses = scene.poses()
    true("poses: show every robot", len(poses) == len(setup.names))
    if len(poses) < len(setup.names):
        return
    _check_poses(poses, true_poses, setup.metres)
    scene.hide(setup.names[0])
    last = frames[-1]

    def hidden() -> bool:
        nonlocal last
        for frame in camera.frames():
            last = frame
        return last.poses[0] is None

    true(
        "poses: are None for a robot that is out of sight",
        wait_for(scene.clock, hidden, EMULATED_S),
    )
    others_go_on = [pose is not None for pose in last.poses[1:]]
    true("poses: the other robots are still tracked", others_go_on)


def _check_poses(poses: Sequence[Pose], true_poses: Floats, metres: float) -> None:
    """Compare robots' poses with the true poses (N, 3). `metres` is the length unit in metres."""
    measured = np.array([(pose.x, pose.y, pose.heading) for pose in poses])
    differences = measured - true_poses
    gaps_m = np.hypot(differences[:, 0], differences[:, 1]) * metres
    turned = np.remainder(differences[:, 2] + math.pi, math.tau) - math.pi
    near("poses: are in the spec's coordinates", gaps_m, 0.0, 1.0, PLACE_M)
    near("poses: have the headings of the robots", turned, 0.0, 1.0, HEADING)
    heights_m = [pose.height * metres for pose in poses if pose.height is not None]
    what = "poses: have the height of the body on the floor"
    near(what, [HEIGHT_M, *heights_m], HEIGHT_M, 1.0, HEIGHT_BAND_M)
    upright = [pose.tilt is None or 0.0 <= pose.tilt < TILT_MAX for pose in poses]
    true("poses: have the tilt of a robot on the floor", upright)


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
    wrong = "; ".join(_contradictions(section, setup))
    expect("section: fits the spec's robots", wrong)
    if wrong:
        return
    clock = robots.clock if robots else MonotonicClock()

    def build() -> Actuator:
        if robots is None or robots.ports is None:
            return section.build(setup, clock)
        return resolve_name(section.device)(section, setup, clock, robots.ports)

    actuator = build()
    _members("actuator", actuator, Actuator)
    period_ns = actuator.period_ns
    halts = actuator.halts
    expect("period_ns: above 0", "" if period_ns > 0 else f"{period_ns}")
    expect("halts: is true or false", "" if isinstance(halts, bool) else repr(halts))
    expect("failure: is None before the device is opened", actuator.failure or "")
    if robots is None:
        _check_sending(section, setup)
        return
    with actuator as entered:
        true("__enter__: returns the actuator", entered is actuator)
        statuses = actuator.poll(1.0)
        problems = any(status.problems for status in statuses)
        all_well = len(statuses) == len(setup.names) and not problems
        true("poll: returns a status of each robot, without problems", all_well)
        _check_health(actuator, healthy=True)
        true("poll, check: move no robot", not any(robots.moves()))
        _SteeringChecks(actuator, section, setup, robots).check()
    _check_leaving(actuator, build())


def _contradictions(section: ActuatorSection, setup: Setup) -> list[str]:
    """List the fields of a section that do not fit the robots, each with the reason.

    The list is empty if all of them fit.
    """
    texts: list[str] = []
    for loc, text in section.contradictions(setup):
        field = ".".join(map(str, loc))
        texts.append(f"{field} {text}".strip())
    return texts


def _check_sending(section: ActuatorSection, setup: Setup) -> None:
    """Check that an actuator can steer and stop without any device at its ports.

    Its port is a pseudo-terminal, or its robots have their own ports that accept everything.
    """
    nobody = MovedRobots(MonotonicClock(), list, None)
    if isinstance(section, OwnSection):
        with resolve_name(section.device)(section, setup, nobody.clock, _Nowhere) as actuator:
            _SteeringChecks(actuator, section, setup, nobody).check_sent()
        return
    if not isinstance(section, OnPort) or type(section.port) is not str:  # but that of a network
        expect("send: not checked, because the section has no field `port` for a serial port")
        return
    with ExitStack() as stack:
        everywhere = _at_port(section.model_dump(), _pseudo_terminal(stack))
        to_nowhere = type(section).model_validate(everywhere)
        try:
            actuator = stack.enter_context(to_nowhere.build(setup, nobody.clock))
        except AbortError as error:
            expect(
                "send: not checked, because the actuator refuses a port without a device "
                f"({error.message})"
            )
            return
        _SteeringChecks(actuator, section, setup, nobody).check_sent()


def _at_port(data: Any, port: str) -> Any:
    """Replace each port in a section's data by this port, including the ports of single robots."""
    match data:
        case dict():
            return {
                key: port if key == "port" and type(value) is str else _at_port(value, port)
                for key, value in data.items()
            }
        case list() | tuple():
            return [_at_port(entry, port) for entry in data]
        case _:
            return data


def _pseudo_terminal(stack: ExitStack) -> str:
    """Create a pseudo-terminal that accepts all bytes until the stack is closed.

    Return its path.
    """
    import tty  # not on Windows

    ours, theirs = os.openpty()
    tty.setraw(theirs)
    Thread(target=_swallow, args=(ours,), daemon=True).start()
    stack.callback(os.close, theirs)
    return os.ttyname(theirs)


def _swallow(port: int) -> None:
    """Read from a pseudo-terminal, and drop the bytes, until its other end is closed.

    The port is closed afterwards.
    """
    with suppress(OSError), open(port, "rb", buffering=0) as file:
        while file.read(1000):
            pass


class _Nowhere(SerialPort):
    """A port that accepts all bytes and leads to no device."""

    def open(self, alone: bool = True) -> None:
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
        self.together = checks_of(GuardRules.of(setup, LabLimits())).together
        self.actuator = actuator
        self.setup = setup
        self.robots = robots
        self.poses = [Pose(*map(float, row)) for row in setup.starts.array()]
        self.all = (True,) * len(self.poses)

    def check(self) -> None:
        """Run all checks: steer, stop, turn, hold, stop in an emergency, and lose the device.

        The last one is left out if the robots cannot be unplugged.
        """
        actuator = self.actuator
        self.check_sent()
        self._steer(DIRECTION, self.all)
        moved = self._wait(lambda: all(self.robots.moves()))
        true("steer: moves the robots", moved)
        self._check_stop("stop", actuator.stop())
        self._check_turn()
        if not self.together:
            self._check_held()
        self._check_stop("emergency stop", actuator.stop(emergency=True))
        true("failure: None", actuator.failure is None)
        if self.robots.unplug is None:
            expect("failure: not checked, because nothing shows that the device is gone")
            return
        self.robots.unplug()
        true("failure: reports a device that is gone", self._wait(self._failed))
        _check_aborts("steer", lambda: self._steer(DIRECTION, self.all))
        _check_aborts("stop", actuator.stop)

    def check_sent(self) -> None:
        """Steer in several directions, check the record of the commands, and then stop."""
        speed = self.setup.speed
        for direction in (0.0, 1.5, -2.5, DIRECTION):
            sent = self._steer(direction, self.all)
            self._check_turning("steer: turns the robots towards the direction", sent, direction)
        # of the last one
        as_asked = sent.action == Steer(DIRECTION) and sent.delivered == self.all
        true("steer: action, robots", as_asked)
        age_ns = self.robots.clock.now() - sent.sent_ns
        true("steer: is sent at once", 0 <= age_ns <= SECOND)
        near("steer: states the speeds of the spec", sent.speed, speed, speed, SPEED)
        wheels = [wheel for wheel in (sent.left, sent.right) if wheel is not None]
        of_each = all(wheel.shape == speed.shape for wheel in wheels)
        numbers = all(isinstance(value, float) for value in sent.outputs.values())
        true(
            "steer: states wheels of shape (N,) or None, and outputs that are numbers",
            of_each and numbers,
        )
        sent = self._steer(DIRECTION, (self.together, *self.all[1:]), first_tracked=False)
        finite = np.isfinite([sent.speed, sent.turning]).all()
        true("steer: works while a robot is not tracked", finite)
        true("steer: then stop", self.actuator.stop().action == Stop())

    def _check_turning(self, what: str, sent: Transmission, towards: float) -> None:
        """Compare turning rates [rad/s] towards a direction [rad] with the paper's equation (3)."""
        setup = self.setup
        _, _, turning = rates(setup.starts.heading, towards, setup.a, setup.speed)
        near(what, sent.turning, turning, float(setup.a.max()), TURNING)

    def _check_stop(self, name: str, stop: Transmission) -> None:
        """Check that a stop is reported as one, and that robots that can stand still do so."""
        true(f"{name}: reports that it stops the robots", stop.action == Stop())
        if self.actuator.halts:
            rests = not (stop.speed.any() or stop.turning.any())
            true(f"{name}: robots stand still", rests and self._wait(self._resting))

    def _check_turn(self) -> None:
        """Check that robots that can stand still turn on the spot, and that others cannot."""
        turn = Turn(1.5)
        try:
            sent = self.actuator.send(turn, self.poses, self.all, self.robots.clock.now())
        except AbortError as error:
            unfounded = self.actuator.halts or "on the spot" not in error.message
            problem = error.message if unfounded else ""
            expect("turn: only for robots that can stand still", problem)
            return
        as_asked = sent.action == turn and sent.delivered == self.all
        true("turn: only for robots that can stand still", as_asked and self.actuator.halts)
        fastest = np.abs(sent.speed).max()
        true("turn: turns robots on the spot", fastest < SPEED * self.setup.speed.min())
        self._check_turning("turn: turns robots towards the direction", sent, turn.facing)

    def _check_held(self) -> None:
        """Check that the first robot can be held while the others move."""
        clock = self.robots.clock
        clock.sleep_until(clock.now() + self.actuator.period_ns)  # so that the turn has begun
        self.actuator.stop()
        self._wait(self._resting)
        sent = self._steer(DIRECTION, (False, *self.all[1:]))
        held = not (sent.delivered[0] or sent.speed[0] or sent.turning[0])
        others_move = self._wait(lambda: all(self.robots.moves()[1:]))
        stands = others_move and not self.robots.moves()[0]
        true("moving: holds one robot while the others move", held and stands)

    def _steer(
        self, direction: float, moving: Sequence[bool], first_tracked: bool = True
    ) -> Transmission:
        """Wait for one period, then steer, and return what was sent.

        The direction is in radians. `first_tracked` says whether the first robot has a
        pose.
        """
        clock = self.robots.clock
        clock.sleep_until(clock.now() + self.actuator.period_ns)
        poses = [self.poses[0] if first_tracked else None, *self.poses[1:]]
        return self.actuator.send(Steer(direction), poses, moving, clock.now())

    def _wait(self, moving: Callable[[], bool]) -> bool:
        """Wait for a condition, and return whether it holds within EMULATED_S seconds."""
        return wait_for(self.robots.clock, moving, EMULATED_S)

    def _resting(self) -> bool:
        """Whether all robots stand still."""
        return not any(self.robots.moves())

    def _failed(self) -> bool:
        """Return whether the device reports a failure. If it does not yet, send a command first."""
        if self.actuator.failure is None:
            with suppress(AbortError):
                self._steer(DIRECTION, self.all)
        return self.actuator.failure is not None


def _check_aborts(name: str, call: Callable[[], object]) -> None:
    """Check that a call raises AbortError after the device is gone. Other errors are passed on."""
    what = f"{name}: raises AbortError when the device is gone"
    problem = "none is raised"
    try:
        call()
    except AbortError:
        problem = ""
    expect(what, problem)


def _check_health(device: Device, healthy: bool) -> None:
    """Call the `check` of a device twice, as a run may do, and examine both reports.

    Args:
        device: The open device.
        healthy: Whether the device must report no problems.
    """
    reports: list[Health] = [device.check(), device.check()]
    facts = [fact for health in reports for fact in health.facts.values()]
    true("check: returns facts that are strings", all(isinstance(fact, str) for fact in facts))
    if healthy:
        problems = [problem for health in reports for problem in health.problems]
        expect("check: no problems", "; ".join(problems))


def _check_leaving(closed: Device, unopened: Device) -> None:
    """Check that a device can be left twice, and that another can be left before it was entered."""
    what = "__exit__: can be called again, and before __enter__"
    problem = ""
    try:
        for device in (closed, unopened, unopened):
            device.__exit__(None, None, None)
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
    expect(what, problem)


def _members(what: str, device: Device, protocol: type) -> None:
    """Check that a device has all public members of a protocol, `__enter__` and `__exit__`.

    Only their names are compared.
    """
    members = [name for base in protocol.__mro__ for name in vars(base)]
    public = {name for name in members if not name.startswith("_")}
    needed = public | {"__enter__", "__exit__"}
    lacking = ", ".join(sorted(name for name in needed if not hasattr(device, name)))
    expect(f"{what}: has all members", f"lacks {lacking}" if lacking else "")
