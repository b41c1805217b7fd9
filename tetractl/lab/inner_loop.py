"""The inner loop passes camera frames to the guard, and the guard's decisions to the actuator.

The loop makes a step at every camera frame, in its own thread, so that planning cannot delay a
stop. In each step it takes the new frames, lets the guard decide, and transmits one of these:

    a stop                    while some of ten are left: after an abort, and after `stop`
    the action that is held   in a run: at once if it is new or a robot must stop, else at the
                              actuator's rate
    the direction of `idle`   before a run, to robots in a field that turns meanwhile
    nothing                   otherwise

Threads: the loop's own makes the steps; the controller's calls `hold`, `stop`, `sent`, `warnings`
and `restart`. A lock lets one of them act at a time. If the loop's thread hangs, `stop` sends
without the lock. Times are ns on the run's clock.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import NEVER, SECOND, Clock
from tetractl.core.commands import Steer, Transmission, Turn
from tetractl.core.errors import AbortError, WrongValueError, text_of
from tetractl.core.plugin_fault import plugin_fault
from tetractl.core.poses import POSE_MAX, CameraFrame
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.worker import WAITING_MAX, drained
from tetractl.experiment.lab_section import STOP_GAP_NS, STOPS
from tetractl.lab.accepted_frame import FrameBuffer
from tetractl.lab.device_abilities import HearsDirections
from tetractl.lab.guard import Guard
from tetractl.lab.guard_records import GuardState, Ruling

IDLE_S = 0.01
"""Longest time between two steps without a frame [s]."""
HOLD_S = 0.25
"""Time after which a step hangs [s]: a direction is refused then."""
STOP_S = 1.0
"""Time after which a step hangs [s]: a stop is sent without it then."""


@dataclass(slots=True)
class HeldAction:
    """The action that is sent again and again, and whether it was not sent yet."""

    action: Steer | Turn
    is_new: bool = True


@dataclass(slots=True)
class StopSeries:
    """The stops that are left to send, the first that was sent since `stop` was called, and whether
    the abort of this run has had its stops.
    """

    left: int = 0
    first: Transmission | None = None
    of_abort: bool = False


class InnerLoop:
    """Runs a guard between a camera and an actuator.

    `wake` is set by the camera after each frame, `emergency` by the operator. `frames` are the
    accepted frames, `last` is the last transmission. `idle` is a function of time [ns]: the
    direction u [rad] sent before robots are steered. Without `start`, the caller must call `step`.
    """

    def __init__(
        self,
        camera: Camera,
        actuator: Actuator,
        guard: Guard,
        clock: Clock,
        wake: threading.Event,
        emergency: threading.Event,
    ) -> None:
        self.guard = guard
        self.frames = FrameBuffer()
        self.idle: Callable[[int], float] | None = None
        self.last: Transmission | None = None
        self._camera = camera
        self._actuator = actuator
        self._clock = clock
        self._hearer = camera if isinstance(camera, HearsDirections) else None
        self._wake = wake
        self._emergency = emergency
        self._lock = threading.Lock()
        self._held: HeldAction | None = None
        self._stops = StopSeries()
        # which robots were allowed to move by the last transmission of a held action
        self._let_move: tuple[bool, ...] = ()
        self._sent: deque[Transmission] = deque(maxlen=WAITING_MAX)
        self._warnings: deque[tuple[int, str]] = deque(maxlen=WAITING_MAX)
        self._transmit_ns = 0  # when the next transmission is due
        self._step_ns = 0  # when the next step without a frame is due
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="inner loop", daemon=True)

    # ---- calls of the controller's thread ----

    def start(self) -> None:
        """Start the loop's thread; nothing is sent before `hold` or `idle` gives a direction."""
        self._thread.start()

    def hold(self, action: Steer | Turn) -> Transmission:
        """Send an action from now on; return the first transmission that carries it.

        The transmission is a stop if the guard presently lets no robot move. AbortError with the
        guard's reason if no robot may move any more.
        """
        with self._locked(HOLD_S) as locked:
            if not locked:
                self.guard.abort("the inner loop did not answer")
                raise AbortError(self.guard.reason)
            self.guard.start_run(self._clock.now())
            self.guard.note_direction(self._clock.now(), isinstance(action, Steer))
            held = HeldAction(action)
            self._held = held
            self._guarded_tick()
            if held.is_new or self.last is None:
                self.guard.abort("the guard lets no robot be steered")
            if self.last is None or self.guard.state is GuardState.ABORT:
                raise AbortError(self.guard.reason)
            return self.last

    def restart(self, guard: Guard) -> None:
        """Continue with the guard of newly found robots; forget the frames so far."""
        with self._lock:
            self.guard = guard
            self.frames = FrameBuffer()

    def stop(self) -> Transmission | None:
        """Send a stop to every robot ten times within 200 ms; return the first, None if none could
        be sent; never raises."""
        with self._locked(STOP_S) as locked:
            self._held = None
            self.idle = None
            self._stops.first = None
            self.guard.end_run()
            self._begin_stops(self._clock.now())
        while locked and self._stops.left:
            with self._locked(STOP_S) as locked:
                if locked:
                    self._guarded_tick()
            if self._stops.left:
                self._clock.sleep_until(self._transmit_ns)
        if not locked:  # the loop's thread hangs: send without the lock
            for _ in range(STOPS):
                with suppress(AbortError):
                    self._actuator.stop()
                self._clock.sleep_until(self._clock.now() + STOP_GAP_NS)
        return self._stops.first

    def sent(self) -> list[Transmission]:
        """Return the transmissions since the last call, oldest first."""
        return drained(self._sent)

    def warnings(self) -> list[tuple[int, str]]:
        """Return the guard's warnings since the last call, each as (time [ns], text)."""
        return drained(self._warnings)

    def close(self) -> None:
        """End the loop's thread; may be called twice, never raises."""
        self._closing.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    # ---- steps, by the loop's thread ----

    def step(self) -> None:
        """Check the new frames, and send a transmission if one is due."""
        with self._lock:
            self._guarded_tick()

    def turn(self) -> None:
        """Make the step that is due, at a frame and every `IDLE_S`, in the place of the thread."""
        now = self._clock.now()
        if self._wake.is_set() or now >= self._step_ns:
            self._wake.clear()
            self._step_ns = now + round(IDLE_S * SECOND)
            self.step()

    def _run(self) -> None:
        while not self._closing.is_set():
            self._wake.wait(IDLE_S)
            self._wake.clear()
            self.step()

    @contextmanager
    def _locked(self, timeout_s: float) -> Iterator[bool]:
        """Hold the lock during the `with` block; yield False if it is not free in time."""
        locked = self._lock.acquire(timeout=timeout_s)
        try:
            yield locked
        finally:
            if locked:
                self._lock.release()

    def _guarded_tick(self) -> None:
        """Make one step; an error during the step stops the robots, but not this loop."""
        try:
            self._tick()
        except (Exception, SystemExit) as error:
            reason = error.message if isinstance(error, AbortError) else text_of(error)
            now = self._clock.now()
            self.guard.abort(reason)
            self._begin_stops_of_abort(now)
            if self._stops.left:  # here, as the next step may fail before its stop
                with suppress(Exception, SystemExit):
                    self._repeat_stop(now)
            fault = plugin_fault(error)  # slow, so after the stop
            if fault and self.guard.reason == reason:
                self.guard.correct_reason(fault.message)

    def _tick(self) -> None:
        now = self._clock.now()
        self.guard.check_awake(now)
        self._take_frames()
        self._obey_operator(now)
        failure = self._failure()
        ruling = self.guard.decide(now, self._camera.damaged, failure)
        self._warnings.extend((now, warning) for warning in ruling.warnings)
        if ruling.state is GuardState.ABORT:
            self._begin_stops_of_abort(now)
        self._transmit(ruling, now)

    def _take_frames(self) -> None:
        """Let the guard check the frames that have come, and keep those that it accepts."""
        for frame in self._camera.frames():
            fault = frame_fault(frame, len(self.guard.rules.names))
            if fault:
                raise WrongValueError(self._camera, "a camera", fault)
            accepted = self.guard.check_frame(frame)
            if accepted is not None:
                self.frames.append(accepted)

    def _obey_operator(self, now: int) -> None:
        """Begin the stops of an emergency, also after an abort: devices latch them."""
        if self._emergency.is_set() and not self.guard.emergency:
            self.guard.abort("emergency stop by the operator", emergency=True)
            self._begin_stops(now)

    def _failure(self) -> str | None:
        """Return why the actuator cannot send any more, None if it can."""
        failure: object = self._actuator.failure
        if not isinstance(failure, str | None):
            raise WrongValueError(self._actuator, "an actuator", "a failure that is no text")
        return failure

    # ---- transmissions ----

    def _transmit(self, ruling: Ruling, now: int) -> None:
        """Transmit what the table above says, if it is due."""
        if self._stops.left:
            self._repeat_stop(now)
            self.guard.name_culprit()  # slow, so after the first stop
        elif ruling.state in (GuardState.RUN, GuardState.HOLD) and self._held is not None:
            self._steer(self._held, ruling, now)
        elif ruling.state in (GuardState.PREFLIGHT, GuardState.READY) and self.idle is not None:
            self._turn_field(self.idle(now), ruling, now)

    def _begin_stops(self, now: int) -> None:
        """Let ten stops be sent, the first at once."""
        self._stops.left = STOPS
        self._transmit_ns = now

    def _begin_stops_of_abort(self, now: int) -> None:
        """Let the stops of an abort be sent, once."""
        if not self._stops.of_abort:
            self._stops.of_abort = True
            self._begin_stops(now)

    def _repeat_stop(self, now: int) -> None:
        """Send the next of the stops if it is due."""
        if now < self._transmit_ns:
            return
        self._transmit_ns = now + STOP_GAP_NS
        self._stops.left -= 1
        try:
            sent = self._actuator.stop(emergency=self.guard.emergency)
            self._note(sent)
            if self._stops.first is None:
                self._stops.first = sent
        except AbortError as error:  # a failed actuator cannot send the remaining stops either
            self._stops.left = 0
            self.guard.abort(error.message)

    def _steer(self, held: HeldAction, ruling: Ruling, now: int) -> None:
        """Send if the actuator's period has passed, the action is new, or a robot must stop."""
        if now < self._transmit_ns and not held.is_new and not self._some_must_stop(ruling):
            return
        period_ns = self._actuator.period_ns
        self._transmit_ns = max(self._transmit_ns + period_ns, now + period_ns // 2)
        if any(ruling.moving) or not self.guard.together:
            newest = self.frames.newest
            exposed_ns = 0 if newest is None else newest.frame.sampled_ns
            self._note(self._actuator.send(held.action, ruling.poses, ruling.moving, exposed_ns))
        else:
            self._note(self._actuator.stop())
        self._let_move = ruling.moving
        held.is_new = False

    def _some_must_stop(self, ruling: Ruling) -> bool:
        """Return whether a robot that was allowed to move by the last transmission is not now."""
        pairs = zip(self._let_move, ruling.moving, strict=False)  # none before the first
        return any(before and not now for before, now in pairs)

    def _turn_field(self, direction: float, ruling: Ruling, now: int) -> None:
        """Send a direction to all robots before a run; send a stop if frames are missing."""
        if now < self._transmit_ns:
            return
        self._transmit_ns = now + self._actuator.period_ns
        newest = self.frames.newest
        lost_ns = self.guard.rules.limits.stream_lost * SECOND
        if newest is None or now - newest.frame.received_ns > lost_ns:
            self._pass_on(self._actuator.stop())
            return
        all_move = (True,) * len(ruling.poses)
        sampled_ns = newest.frame.sampled_ns
        self._pass_on(self._actuator.send(Steer(direction), ruling.poses, all_move, sampled_ns))

    def _pass_on(self, sent: Transmission) -> None:
        """Report a transmission to a camera that identifies robots by their response."""
        if self._hearer is not None:
            self._hearer.steered(sent.direction, sent.sent_ns)

    def _note(self, sent: Transmission) -> None:
        """Keep a transmission, and let camera and guard know of it."""
        fault = transmission_fault(sent, len(self.guard.rules.names), self._clock.now())
        if fault:
            raise WrongValueError(self._actuator, "an actuator", fault)
        self.last = sent
        self._pass_on(sent)
        self._sent.append(sent)
        self.guard.note_transmission(sent.sent_ns, sent.speed.tolist(), sent.turning.tolist())


# ---- what devices may return ----


def frame_fault(frame: CameraFrame, robots: int) -> str:
    """Return what is wrong with a camera's frame of N robots, "" if nothing is."""
    if not _holdable(frame, robots):
        return "a frame that no log can hold"
    if frame.received_ns < frame.sampled_ns:
        return f"a frame received {frame.sampled_ns - frame.received_ns} ns before exposure"
    if any(exposed_ns > frame.sampled_ns for exposed_ns in frame.exposed_ns):
        return "a pose exposed after the time of its frame"
    return ""


def _holdable(frame: CameraFrame, robots: int) -> bool:
    """Return whether a log can hold a camera's frame of N robots."""
    if len(frame.poses) != robots or len(frame.exposed_ns) not in (0, robots):
        return False
    for pose in frame.poses:
        if pose is not None and not _all_small((pose.x, pose.y, pose.heading)):
            return False
    times: tuple[object, ...] = (
        frame.number,
        frame.sampled_ns,
        frame.received_ns,
        *frame.exposed_ns,
    )
    return all(isinstance(time, int) and abs(time) < NEVER for time in times)


def transmission_fault(sent: object, robots: int, now_ns: int) -> str:
    """Return what is wrong with what an actuator says that it has sent, "" if nothing is."""
    if not (isinstance(sent, Transmission) and _loggable(sent, robots)):
        return "a transmission that no log can hold"
    if not 0 <= sent.sent_ns <= now_ns:
        return f"a transmission sent at {sent.sent_ns} ns, not between 0 and now, {now_ns} ns"
    return ""


def _loggable(sent: Transmission, robots: int) -> bool:
    """Return whether a log can hold a transmission to N robots."""
    sent_ns: object = sent.sent_ns
    if not isinstance(sent_ns, int) or len(sent.moving) != robots:
        return False
    for speeds in (sent.speed, sent.turning, sent.left, sent.right):
        if speeds is None:
            continue
        if np.shape(speeds) != (robots,) or not _all_small(np.asarray(speeds)):
            return False
    return True


def _all_small(values: Iterable[float]) -> bool:
    """Return whether all values are numbers of a size that logs hold."""
    return all(abs(value) <= POSE_MAX for value in values)
