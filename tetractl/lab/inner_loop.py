"""The inner loop passes camera frames to the guard, and the guard's decisions to the actuator.

The loop makes a step at every camera frame, in its own thread, so that planning cannot delay a
stop. It sends a new direction or a stop at once, and repeats the last direction at the actuator's
rate.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

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
STOP_S = 1.0


class InnerLoop:
    """Runs a guard between a camera and an actuator. Times are ns on `clock`.

    `wake` is set by the camera after each frame, `emergency` by the operator. `frames` are the
    accepted frames. Without `start`, the caller must call `step`.
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
        self.guard, self.frames = guard, FrameBuffer()
        # function of time [ns]: the direction u [rad] sent before robots are steered
        self.idle: Callable[[int], float] | None = None
        self.last: Transmission | None = None
        self._camera, self._actuator, self._clock = camera, actuator, clock
        self._hearer = camera if isinstance(camera, HearsDirections) else None
        self._wake, self._emergency = wake, emergency
        self._lock = threading.Lock()
        self._held: Steer | Turn | None = None  # sent again and again
        self._new = False  # whether it is still to be sent
        # which robots were allowed to move by the last transmission
        self._let: tuple[bool, ...] = ()
        self._sent: deque[Transmission] = deque(maxlen=WAITING_MAX)
        self._warnings: deque[tuple[int, str]] = deque(maxlen=WAITING_MAX)
        self._aborted = False
        self._stop: Transmission | None = None  # the first since `stop` was called
        self._stops_left = 0
        self._next_ns = self._due_ns = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="inner loop", daemon=True)

    def start(self) -> None:
        """Start the loop's thread; nothing is sent before `hold` or `idle` gives a direction."""
        self._thread.start()

    def hold(self, action: Steer | Turn) -> Transmission:
        """Send an action from now on; return the first transmission that carries it.

        The transmission is a stop if the guard presently lets no robot move. AbortError with the
        guard's reason if no robot may move any more.
        """
        with self._locked(0.25) as locked:  # a step that takes longer hangs
            if not locked:
                self.guard.abort("the inner loop did not answer")
                raise AbortError(self.guard.reason)
            self.guard.start_run(self._clock.now())
            self.guard.note_direction(self._clock.now(), isinstance(action, Steer))
            self._held, self._new = action, True
            self._guarded_tick()
            if self._new or self.last is None:
                self.guard.abort("the guard lets no robot be steered")
            if self.last is None or self.guard.state is GuardState.ABORT:
                raise AbortError(self.guard.reason)
            return self.last

    def restart(self, guard: Guard) -> None:
        """Continue with the guard of newly found robots; forget the frames so far."""
        with self._lock:
            self.guard, self.frames = guard, FrameBuffer()

    def stop(self) -> Transmission | None:
        """Send a stop to every robot ten times within 200 ms; return the first, None if none could
        be sent; never raises."""
        with self._locked(STOP_S) as locked:
            self._held = self.idle = self._stop = None
            self.guard.end_run()
            self._stops_left, self._next_ns = STOPS, self._clock.now()
        while locked and self._stops_left:
            with self._locked(STOP_S) as locked:
                if locked:
                    self._guarded_tick()
            if self._stops_left:
                self._clock.sleep_until(self._next_ns)
        if not locked:  # the loop's thread hangs: send without the lock
            for _ in range(STOPS):
                with suppress(AbortError):
                    self._actuator.stop()
                self._clock.sleep_until(self._clock.now() + STOP_GAP_NS)
        return self._stop

    def step(self) -> None:
        """Check the new frames, and send a transmission if one is due."""
        with self._lock:
            self._guarded_tick()

    def turn(self) -> None:
        """Make the step that is due, at a frame and every `IDLE_S`, in the place of the thread."""
        now = self._clock.now()
        if self._wake.is_set() or now >= self._due_ns:
            self._wake.clear()
            self._due_ns = now + round(IDLE_S * SECOND)
            self.step()

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

    @contextmanager
    def _locked(self, timeout_s: float) -> Iterator[bool]:
        """Hold the lock during the `with` block; yield False if it is not free in time."""
        locked = self._lock.acquire(timeout=timeout_s)
        try:
            yield locked
        finally:
            if locked:
                self._lock.release()

    def _run(self) -> None:
        while not self._closing.is_set():
            self._wake.wait(IDLE_S)
            self._wake.clear()
            self.step()

    def _guarded_tick(self) -> None:
        """Make one step; an error during the step stops the robots, but not this loop."""
        try:
            self._tick()
        except (Exception, SystemExit) as error:
            reason = error.message if isinstance(error, AbortError) else text_of(error)
            now = self._clock.now()
            self.guard.abort(reason)
            if not self._aborted:
                self._aborted, self._stops_left, self._next_ns = True, STOPS, now
            if self._stops_left:  # here, as the next step may fail before its stop
                with suppress(Exception, SystemExit):
                    self._repeat_stop(now)
            fault = plugin_fault(error)  # slow, so after the stop
            if fault and self.guard.reason == reason:
                self.guard.correct_reason(fault.message)

    def _tick(self) -> None:
        guard, now = self.guard, self._clock.now()
        guard.check_awake(now)
        for frame in self._camera.frames():
            if not _holdable(frame, len(guard.rules.names)):
                text = "a frame that no log can hold"
                raise WrongValueError(self._camera, "a camera", text)
            if frame.received_ns < frame.sampled_ns:
                text = f"a frame received {frame.sampled_ns - frame.received_ns} ns before exposure"
                raise WrongValueError(self._camera, "a camera", text)
            if any(one > frame.sampled_ns for one in frame.exposed_ns):
                text = "a pose exposed after the time of its frame"
                raise WrongValueError(self._camera, "a camera", text)
            if (accepted := guard.check_frame(frame)) is not None:
                self.frames.append(accepted)
        if self._emergency.is_set() and not guard.emergency:
            guard.abort("emergency stop by the operator", emergency=True)
            self._stops_left, self._next_ns = STOPS, now  # after an abort, too: they latch
        if not isinstance(self._actuator.failure, str | None):
            raise WrongValueError(self._actuator, "an actuator", "a failure that is no text")
        ruling = guard.decide(now, self._camera.damaged, self._actuator.failure)
        self._warnings.extend((now, warning) for warning in ruling.warnings)
        if ruling.state is GuardState.ABORT and not self._aborted:
            self._aborted = True
            self._stops_left, self._next_ns = STOPS, now
        if self._stops_left:
            self._repeat_stop(now)
            guard.name_culprit()  # slow, so after the first stop
        elif ruling.state in (GuardState.RUN, GuardState.HOLD) and self._held is not None:
            self._steer(self._held, ruling, now)
        elif ruling.state in (GuardState.PREFLIGHT, GuardState.READY) and self.idle is not None:
            self._turn(self.idle(now), ruling, now)

    def _turn(self, direction: float, ruling: Ruling, now: int) -> None:
        """Send a direction to all robots before a run; send a stop if frames are missing."""
        if now < self._next_ns:
            return
        self._next_ns = now + self._actuator.period_ns
        newest, lost_ns = self.frames.newest, self.guard.rules.limits.stream_lost * SECOND
        if newest is None or now - newest.frame.received_ns > lost_ns:
            self._pass_on(self._actuator.stop())
            return
        every = (True,) * len(ruling.poses)
        sampled = newest.frame.sampled_ns
        self._pass_on(self._actuator.send(Steer(direction), ruling.poses, every, sampled))

    def _repeat_stop(self, now: int) -> None:
        if now < self._next_ns:
            return
        self._next_ns = now + STOP_GAP_NS
        self._stops_left -= 1
        try:
            sent = self._actuator.stop(emergency=self.guard.emergency)
            self._note(sent)
            self._stop = self._stop or sent
        except AbortError as error:  # a failed actuator cannot send the remaining stops either
            self._stops_left = 0
            self.guard.abort(error.message)

    def _steer(self, held: Steer | Turn, ruling: Ruling, now: int) -> None:
        """Send if the actuator's period has passed, the action is new, or a robot must stop."""
        stops_one = any(let and not may for let, may in zip(self._let, ruling.moving, strict=False))
        if now < self._next_ns and not self._new and not stops_one:
            return
        period = self._actuator.period_ns
        self._next_ns = max(self._next_ns + period, now + period // 2)
        if any(ruling.moving) or not self.guard.together:
            newest = self.frames.newest
            exposed_ns = 0 if newest is None else newest.frame.sampled_ns
            self._note(self._actuator.send(held, ruling.poses, ruling.moving, exposed_ns))
        else:
            self._note(self._actuator.stop())
        self._let, self._new = ruling.moving, False

    def _pass_on(self, sent: Transmission) -> None:
        """Report a transmission to a camera that identifies robots by their response."""
        if self._hearer is not None:
            self._hearer.steered(sent.direction, sent.sent_ns)

    def _note(self, sent: Transmission) -> None:
        if not _loggable(sent, len(self.guard.rules.names)):
            text = "a transmission that no log can hold"
            raise WrongValueError(self._actuator, "an actuator", text)
        now = self._clock.now()
        if not 0 <= sent.sent_ns <= now:
            text = f"a transmission sent at {sent.sent_ns} ns, not between 0 and now, {now} ns"
            raise WrongValueError(self._actuator, "an actuator", text)
        self.last = sent
        self._pass_on(sent)
        self._sent.append(sent)
        self.guard.note_transmission(sent.sent_ns, sent.speed.tolist(), sent.turning.tolist())


def _holdable(frame: CameraFrame, robots: int) -> bool:
    """Return whether a log can hold a camera's frame of N robots."""
    known = [(one.x, one.y, one.heading) for one in frame.poses if one is not None]
    times = frame.number, frame.sampled_ns, frame.received_ns, *frame.exposed_ns
    fit = len(frame.poses) == robots and len(frame.exposed_ns) in (0, robots)
    fit &= all(abs(value) <= POSE_MAX for p in known for value in p)
    return fit and all(isinstance(one, int) and abs(one) < NEVER for one in times)


def _loggable(sent: object, robots: int) -> bool:
    """Return whether an actuator returned what a log can hold of N robots."""
    if not (isinstance(sent, Transmission) and isinstance(sent.sent_ns, int)):
        return False
    speeds = (sent.speed, sent.turning, sent.left, sent.right)
    known = [np.asarray(one) for one in speeds if one is not None]
    fit = len(sent.moving) == robots and all(one.shape == (robots,) for one in known)
    return fit and all((np.abs(one) <= POSE_MAX).all() for one in known)
