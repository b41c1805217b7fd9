"""Checks of a camera and an actuator: of a real device those with which no robot moves, of an
emulated one all that the lab relies on.
"""

import math
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pkgutil import resolve_name
from threading import Thread

import numpy as np

from tetractl.core.clock import SECOND, Clock, MonotonicClock, wait_for
from tetractl.core.commands import Health, Steer, Stop, Transmission, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Floats, Pose
from tetractl.core.protocols import Actuator, Camera, Device
from tetractl.core.setup import Setup
from tetractl.experiment.lab_section import ActuatorSection, CameraSection, LabLimits
from tetractl.experiment.section_abilities import OnPort
from tetractl.lab.actuators.own_section import OwnSection
from tetractl.lab.guard_checks import ChecksOf
from tetractl.lab.rig import guard_rules
from tetractl.lab.serial_port import Ports, SerialPort
from tetractl.model.motion.exact import rates
from tetractl.testing.finding import Finding, Findings, near, true

EMULATED_S = 120.0  # in which an emulated device must do what it shall, on a host that is busy


@dataclass(frozen=True)
class SeenRobots:
    """What an emulated camera sees. `poses()` (N, 3) are true, in the spec's coordinates, and
    `hide(name)` puts a robot out of its sight. `ports` makes the camera's port, by default its own.
    """

    clock: Clock
    poses: Callable[[], Floats]
    hide: Callable[[str], None]
    ports: Ports | None = None


@dataclass(frozen=True)
class MovedRobots:
    """What an emulated actuator moves. `moves()` (N,) tells which robots truly move, and `unplug()`
    takes the device away, None if nothing can tell that it is gone, as in a network. `ports` makes
    the actuator's ports, by default its own."""

    clock: Clock
    moves: Callable[[], Sequence[bool]]
    unplug: Callable[[], None] | None
    ports: Ports | None = None


def check_camera(section: CameraSection, setup: Setup, scene: SeenRobots | None = None) -> Findings:
    """Check that a camera can be built and, if it can be opened, that its frames are valid; before
    a `scene` also that they show it.
    """
    woken: list[None] = []
    clock = scene.clock if scene else MonotonicClock()

    def build() -> Camera:
        given = setup, clock, lambda: woken.append(None)
        if scene is None or scene.ports is None:
            return section.build(*given)
        return resolve_name(section.device)(section, *given, scene.ports)

    camera = build()
    yield _members("camera", camera, Camera)
    with ExitStack() as stack:
        try:
            entered = stack.enter_context(camera)
        except AbortError as error:
            yield Finding(f"not opened, so its frames are not checked ({error.message})")
            return
        yield true("__enter__: returns the camera", entered is camera)
        camera.frames()  # while it connects, it may not know its clock yet
        before = len(woken)
        found = _frames(camera, clock, EMULATED_S if scene else 5.0)
        now, calls = clock.now(), len(woken) - before
        if len(found) < 2:
            yield Finding("frames: at least 2", f"{len(found)} in {now / SECOND:.0f} s")
            return
        numbers, times = [one.number for one in found], [one.sampled_ns for one in found]
        yield true("frames: numbers rise", numbers == sorted(set(numbers)), str(numbers))
        yield true("frames: times rise", times == sorted(times), str(times))
        due = [one.sampled_ns <= one.received_ns <= now for one in found]
        yield true("frames: received after their exposure", due)
        count = [len(one.poses) for one in found]
        yield true("frames: one pose per robot", np.equal(count, len(setup.names)), f"{count}")
        yield true("wake: after each frame", calls >= len(found) - 1, f"{calls} of {len(found)}")
        yield from _check_health(camera, healthy=scene is not None)
        if scene is not None:
            yield from _check_scene(camera, setup, scene, found)
    if scene is not None:
        camera.frames()
        clock.sleep_until(clock.now() + SECOND // 20)
        yield true("__exit__: no frame comes afterwards", camera.frames() == [])
        yield from _check_leaving(camera, build())


def _frames(camera: Camera, clock: Clock, patience_s: float) -> list[CameraFrame]:
    """Return the next ten frames, at most those that come in a time [s]."""
    found: list[CameraFrame] = []

    def enough() -> bool:
        found.extend(camera.frames())
        return len(found) >= 10

    wait_for(clock, enough, patience_s)
    return found


def _check_scene(
    camera: Camera, setup: Setup, scene: SeenRobots, found: Sequence[CameraFrame]
) -> Findings:
    healthy = [one.fault == "" and one.strangers == () for one in found]
    yield true("frames: neither a fault nor a stranger", healthy)
    yield true("damaged: 0", camera.damaged == 0, str(camera.damaged))
    seen, true_poses = [pose for pose in found[-1].poses if pose is not None], scene.poses()
    yield true("poses: of every robot", len(seen) == len(setup.names))
    if len(seen) < len(setup.names):
        return
    shown = np.array([(pose.x, pose.y, pose.heading) for pose in seen])
    gaps = np.hypot(*(shown - true_poses)[:, :2].T) * setup.metres
    turned = np.remainder(shown[:, 2] - true_poses[:, 2] + math.pi, math.tau) - math.pi
    # within 5 mm and 0.05 rad
    yield near("poses: in the spec's coordinates", gaps, 0.0, 1.0, 0.005)
    yield near("poses: headings of the robots", turned, 0.0, 1.0, 0.05)
    heights = [pose.height * setup.metres for pose in seen if pose.height is not None]
    yield near("poses: height of the body on the floor", [0.06, *heights], 0.06, 1.0, 0.05)
    tilted = [pose.tilt is None or 0.0 <= pose.tilt < 0.2 for pose in seen]
    yield true("poses: tilt of a robot on the floor", tilted)
    scene.hide(setup.names[0])
    last: list[CameraFrame] = []

    def hidden() -> bool:
        last[:] = camera.frames()[-1:] or last
        return bool(last) and last[0].poses[0] is None

    yield true("poses: None for a robot out of sight", wait_for(scene.clock, hidden, EMULATED_S))
    yield true("poses: those of the others go on", [pose is not None for pose in last[0].poses[1:]])


def check_actuator(
    section: ActuatorSection, setup: Setup, robots: MovedRobots | None = None
) -> Findings:
    """Check that an actuator can be built; emulated `robots` are steered and stopped in every way.
    Without them, an actuator with a field `port`, or of an `OwnSection`, sends to ports behind
    which there is nothing.
    """
    wrong = [
        f"{'.'.join(map(str, loc))} {text}".strip() for loc, text in section.contradictions(setup)
    ]
    yield Finding("section: fits the spec's robots", "; ".join(wrong))
    if wrong:
        return
    clock, ports = (robots.clock, robots.ports) if robots else (MonotonicClock(), None)

    def build() -> Actuator:
        if ports is None:
            return section.build(setup, clock)
        return resolve_name(section.device)(section, setup, clock, ports)

    actuator = build()
    yield _members("actuator", actuator, Actuator)
    halts = actuator.halts
    yield Finding("period_ns: above 0", "" if actuator.period_ns > 0 else f"{actuator.period_ns}")
    yield Finding("halts: true or false", "" if isinstance(halts, bool) else repr(halts))
    yield Finding("failure: None before the device is opened", actuator.failure or "")
    if robots is None:
        yield from _check_sending(section, setup)
        return
    with actuator as entered:
        yield true("__enter__: returns the actuator", entered is actuator)
        statuses = actuator.poll(1.0)
        asked = len(statuses) == len(setup.names) and not any(one.problems for one in statuses)
        yield true("poll: a status of each robot, without problems", asked)
        yield from _check_health(actuator, healthy=True)
        yield true("poll, check: nothing moves", not any(robots.moves()))
        yield from _Steered(actuator, section, setup, robots).check()
    yield from _check_leaving(actuator, build())


def _check_sending(section: ActuatorSection, setup: Setup) -> Findings:
    """Steer and stop by an actuator whose port is a pseudo-terminal, which takes what it sends, or
    robots at ports of their own that take everything."""
    clock = MonotonicClock()
    if isinstance(section, OwnSection):
        with resolve_name(section.device)(section, setup, clock, _Nowhere) as actuator:
            yield from _Steered(actuator, section, setup, MovedRobots(clock, list, None)).sent()
        return
    if not isinstance(section, OnPort) or type(section.port) is not str:  # but that of a network
        yield Finding("send: not called, as the section has no field `port` for a serial port")
        return
    ours, theirs = os.openpty()
    import tty  # not on Windows

    tty.setraw(theirs)
    Thread(target=_swallow, args=(ours,), daemon=True).start()
    fake = section.model_copy(update={"port": os.ttyname(theirs)})
    with ExitStack() as stack:
        stack.callback(os.close, theirs)
        try:
            actuator = stack.enter_context(fake.build(setup, clock))
        except AbortError as error:
            yield Finding(
                f"send: not called, as a port without a device is refused ({error.message})"
            )
            return
        yield from _Steered(actuator, section, setup, MovedRobots(clock, list, None)).sent()


def _swallow(port: int) -> None:
    """Read from a pseudo-terminal until its other end is closed."""
    with suppress(OSError), open(port, "rb", buffering=0) as file:
        while file.read(1000):
            pass


class _Nowhere(SerialPort):
    """A port that takes everything, and behind which there is nothing."""

    def open(self, alone: bool = True) -> None:
        """Do nothing."""

    def write(self, data: bytes) -> int:
        """Take bytes."""
        return self._clock.now()


class _Steered:
    """An actuator that is open, and the robots it moves."""

    def __init__(
        self,
        actuator: Actuator,
        section: ActuatorSection,
        setup: Setup,
        robots: MovedRobots,
    ) -> None:
        checks_of: ChecksOf = resolve_name(section.checks)
        self.together = checks_of(guard_rules(setup, LabLimits())).together
        self.actuator, self.setup, self.robots = actuator, setup, robots
        self.poses = [Pose(*map(float, row)) for row in setup.starts.array()]
        self.all = (True,) * len(self.poses)

    def steer(self, direction: float, moving: Sequence[bool], first: bool = True) -> Transmission:
        """Steer, with the first robot tracked or not, and let a period pass."""
        clock = self.robots.clock
        clock.sleep_until(clock.now() + self.actuator.period_ns)
        poses = [self.poses[0] if first else None, *self.poses[1:]]
        return self.actuator.send(Steer(direction), poses, moving, clock.now())

    def wait(self, moving: Callable[[], bool]) -> bool:
        """Wait until robots move as they should; return whether they do."""
        return wait_for(self.robots.clock, moving, EMULATED_S)

    def resting(self) -> bool:
        """Whether all robots stand still."""
        return not any(self.robots.moves())

    def turning(self, what: str, turning: Floats, towards: float) -> Finding:
        """Check the turning rates [rad/s] towards a direction [rad] by the paper's equation (3)."""
        setup = self.setup
        wished = rates(setup.starts.heading, towards, setup.a, setup.speed)[2]
        return near(what, turning, wished, float(self.setup.a.max()), 0.2)

    def sent(self) -> Findings:
        """Steer, and check what was sent; then stop."""
        clock, speed = self.robots.clock, self.setup.speed
        for direction in (0.0, 1.5, -2.5, 0.5):
            sent = self.steer(direction, self.all)
            yield self.turning("steer: robots turn towards the direction", sent.turning, direction)
        yield true("steer: action, robots", (sent.action, sent.moving) == (Steer(0.5), self.all))
        yield true("steer: sent now", 0 <= clock.now() - sent.sent_ns <= SECOND)
        yield near("steer: speeds of the spec", sent.speed, speed, speed, 0.1)
        wheels = [each is None or each.shape == speed.shape for each in (sent.left, sent.right)]
        outputs = all(isinstance(value, float) for value in sent.outputs.values())
        yield true("steer: wheels (N,) or None; outputs are numbers", all(wheels) and outputs)
        sent = self.steer(0.5, (self.together, *self.all[1:]), first=False)
        finite = np.isfinite([sent.speed, sent.turning]).all()
        yield true("steer: past a robot that is not tracked", finite)
        yield true("steer: then stop", self.actuator.stop().action == Stop())

    def check(self) -> Findings:
        """Steer, stop, turn, hold, stop in an emergency, and lose the device."""
        actuator = self.actuator
        yield from self.sent()
        self.steer(0.5, self.all)
        moved = self.wait(lambda: all(self.robots.moves()))
        yield true("steer: robots move", moved)
        yield from self.stopped("stop", actuator.stop())
        yield from self.turned()
        if not self.together:
            clock = self.robots.clock
            clock.sleep_until(clock.now() + actuator.period_ns)  # so that the turn has begun
            actuator.stop()
            self.wait(self.resting)
            sent = self.steer(0.5, (False, *self.all[1:]))
            held = not (sent.moving[0] or sent.speed[0] or sent.turning[0])
            held &= self.wait(lambda: all(self.robots.moves()[1:])) and not self.robots.moves()[0]
            yield true("moving: one robot is held, the others move", held)
        yield from self.stopped("emergency stop", actuator.stop(emergency=True))
        yield true("failure: None", actuator.failure is None)
        if self.robots.unplug is None:
            yield Finding("failure: not checked, as nothing tells that the device is gone")
            return
        self.robots.unplug()
        yield true("failure: a device that is gone", self.wait(self.failed))
        for name, call in (("steer", lambda: self.steer(0.5, self.all)), ("stop", actuator.stop)):
            try:
                call()
                yield Finding(f"{name}: AbortError when the device is gone", "none is raised")
            except AbortError:
                yield Finding(f"{name}: AbortError when the device is gone")

    def stopped(self, name: str, stop: Transmission) -> Findings:
        """Check a stop."""
        yield true(f"{name}: says that it stops", stop.action == Stop())
        if self.actuator.halts:
            still = not (any(stop.moving) or stop.speed.any() or stop.turning.any())
            yield true(f"{name}: robots stand still", still and self.wait(self.resting))

    def turned(self) -> Findings:
        """Check that robots that halt turn on the spot, and that others cannot."""
        try:
            sent = self.actuator.send(Turn(1.5), self.poses, self.all, self.robots.clock.now())
        except AbortError as error:
            odd = self.actuator.halts or "on the spot" not in error.message
            yield Finding("turn: robots that halt, no others", error.message if odd else "")
            return
        said = (sent.action, sent.moving) == (Turn(1.5), self.all)
        yield true("turn: robots that halt, no others", said and self.actuator.halts)
        yield true("turn: on the spot", np.abs(sent.speed).max() < 0.1 * self.setup.speed.min())
        yield self.turning("turn: towards the direction", sent.turning, 1.5)

    def failed(self) -> bool:
        """Whether the device says that it failed, which it may find out by sending."""
        if self.actuator.failure is None:
            with suppress(AbortError):
                self.steer(0.5, self.all)
        return self.actuator.failure is not None


def _check_health(device: Device, healthy: bool) -> Findings:
    found: list[Health] = [device.check(), device.check()]  # as often as it is asked
    facts = all(isinstance(value, str) for one in found for value in one.facts.values())
    yield true("check: facts are text", facts)
    if healthy:
        yield Finding(
            "check: no problems", "; ".join(text for one in found for text in one.problems)
        )


def _check_leaving(left: Device, unopened: Device) -> Findings:
    """Leave a device once more that was left, and one twice that was never entered."""
    what = "__exit__: may be called again, and before __enter__"
    try:
        for device in (left, unopened, unopened):
            device.__exit__(None, None, None)
    except Exception as error:
        yield Finding(what, f"{type(error).__name__}: {error}")
    else:
        yield Finding(what)


def _members(what: str, device: Device, protocol: type) -> Finding:
    names = {name for base in protocol.__mro__ for name in vars(base) if not name.startswith("_")}
    names |= {"__enter__", "__exit__"}
    lacking = ", ".join(sorted(name for name in names if not hasattr(device, name)))
    return Finding(f"{what}: all members", f"lacks {lacking}" if lacking else "")
