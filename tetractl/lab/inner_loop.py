"""The inner loop between the devices: it passes frames to the guard, and its decisions to robots.

The loop runs in its own thread, so that planning cannot delay a stop. It makes a step at every
camera frame. In each step, it takes the new frames, lets the guard decide, and transmits one of
these:

    a stop                    while some of STOPS remain: after an abort, and after `stop`
    the held action           in a run: at once if it is new or a robot must stop, otherwise at the
                              actuator's rate
    the direction of `idle`   before a run, to robots in a field that keeps turning
    nothing                   otherwise

What happens if something goes wrong:

    a frame is late or missing    the guard decides (`tetractl.lab.guard`)
    the camera, actuator or       the guard aborts. The first stop is sent in the same step, the
    guard raises an error, or     others in the following steps, and the loop continues
    returns an invalid value
    the actuator fails            the guard aborts. The stops are sent nevertheless, because robots
                                  on other ports may receive them
    emergency stop                the guard aborts for good. Stops are sent even after an abort, in
                                  a step that fails, or while a thread hangs
    the loop's thread hangs       `hold` and `between_steps` abort after HOLD_S. After STOP_S,
                                  `stop` sends stops without waiting for the thread

Threads: the loop's own thread makes the steps. The controller's thread calls `hold`,
`between_steps`, `stop`, `sent`, `warnings` and `restart`. A lock lets only one of them act at a
time. Times are in ns on the run's clock.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import NEVER, SECOND, Clock, next_due_ns
from tetractl.core.commands import Steer, Transmission, Turn
from tetractl.core.errors import AbortError, WrongValueError, text_of
from tetractl.core.poses import POSE_MAX, CameraFrame
from tetractl.core.protocols import Actuator, Camera
from tetractl.lab.device_abilities import HearsDirections
from tetractl.lab.frame_buffer import FrameBuffer
from tetractl.lab.guard import Guard, GuardState, Ruling
from tetractl.lab.guard_observer import build_guard
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import STOP_GAP_NS, STOPS
from tetractl.tools.worker import WAITING_MAX, drained

IDLE_STEP_S = 0.01
"""Maximum time between two steps if no frame arrives [s]."""
HOLD_TIMEOUT_S = 0.25
"""Time for which `hold` and `between_steps` wait for the loop's step to end [s].

Chosen, not measured.
"""
STOP_TIMEOUT_S = 1.0
"""Time for which `stop` waits for the loop's step to end [s].

It is longer than HOLD_S, because stops that are sent without waiting may come between the bytes of
a step that only takes long.
"""


@dataclass(slots=True)
class HeldAction:
    """The action, such as a direction, that the inner loop sends to the robots repeatedly.

    Attributes:
        action: The action.
        moving: Which robots it allowed to move when it was sent last. None before that.
    """

    action: Steer | Turn
    moving: tuple[bool, ...] | None = None


class InnerLoop:
    """The loop that lets a guard decide at each camera frame, and sends its decisions to robots.

    Without `start`, the caller must call `step` or `step_if_due`.

    Args:
        camera: The camera.
        actuator: The actuator.
        guard: The guard.
        clock: The clock for times [ns].
        wake: Set by the camera after each frame.
        emergency: Set by the operator for an emergency stop.

    Attributes:
        frames: The accepted frames.
        last: The last transmission of a run.
        driven_ns: Time of the last transmission that let a robot move [ns]. 0 before that.
        idle: Returns the direction u [rad] that is sent before robots are steered, at a time [ns].
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
        self.driven_ns = 0
        self._camera = camera
        self._actuator = actuator
        self._clock = clock
        self._direction_listener = camera if isinstance(camera, HearsDirections) else None
        self._wake = wake
        self._emergency = emergency
        self._lock = threading.Lock()
        self._held: HeldAction | None = None
        self._stops_left = 0
        """Number of stops that still have to be sent."""
        self._first_stop: Transmission | None = None
        """The first stop that was sent since `stop` was called. None before that."""
        self._abort_stops_begun = False
        """Whether the stops of the guard's abort have begun. They are sent only once."""
        self._operator_obeyed = False
        """Whether the stops of the operator's emergency stop have begun."""
        self._sent: deque[Transmission] = deque(maxlen=WAITING_MAX)
        self._warnings: deque[tuple[int, str]] = deque(maxlen=WAITING_MAX)
        self._transmit_ns = 0  # when the next transmission is due
        self._step_ns = 0  # when the next step without a frame is due
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._step_until_closed, name="inner loop", daemon=True
        )

    # ---- calls of the controller's thread ----

    def start(self) -> None:
        """Start the loop's thread.

        Nothing is sent before `hold` or `idle` gives a direction.
        """
        self._thread.start()

    def hold(self, action: Steer | Turn) -> Transmission:
        """Send an action repeatedly, starting now, and return the first transmission.

        The transmission is a stop if the guard presently lets no robot move.

        Raises:
            AbortError: If no robot may move any more, with the guard's reason, or if the loop
                stays within a step for too long.
        """
        with self.between_steps() as guard:
            guard.start_run(self._clock.now())
            guard.note_direction(self._clock.now(), isinstance(action, Steer))
            self._held = HeldAction(action)
            transmission = self._step_safely()
            if transmission is None:
                guard.abort("the guard lets no robot be steered")
            if transmission is None or guard.state is GuardState.ABORT:
                raise AbortError(guard.reason)
            return transmission

    @contextmanager
    def between_steps(self) -> Iterator[Guard]:
        """Pause the loop during the `with` block, in which its guard's robots may be changed.

        A step that has already read the list of robots continues with the old list.

        Raises:
            AbortError: If the loop stays within a step for too long.
        """
        with self._hold_lock(HOLD_TIMEOUT_S) as is_locked:
            if not is_locked:
                self.guard.abort("the inner loop did not answer")
                raise AbortError(self.guard.reason)
            yield self.guard

    def restart(self, rules: GuardRules) -> None:
        """Continue with a guard that has other rules, for example for newly found robots.

        All frames so far are forgotten.

        Raises:
            AbortError: If the loop stays within a step for too long.
        """
        with self.between_steps():
            self.guard = build_guard(rules, self.guard.checks_of)
            self.frames = FrameBuffer()
            self._abort_stops_begun = False  # this guard has not aborted
            self._operator_obeyed = False

    def stop(self) -> Transmission | None:
        """Send STOPS stops to every robot, STOP_GAP_NS apart, and return the first.

        It never raises. The result is None if no stop could be sent.
        """
        with self._hold_lock(STOP_TIMEOUT_S) as is_locked:
            # without the lock, too: a step that ends after all goes on with stops
            self._held = None
            self.idle = None
            self._first_stop = None
            self.guard.end_run()
            self._begin_stops(self._clock.now())
        if not is_locked:
            return self._stop_past_thread()
        while self._stops_left:
            with self._hold_lock(STOP_TIMEOUT_S) as is_locked:
                if not is_locked:
                    return self._stop_past_thread()
                self._step_safely()
            if self._stops_left:
                self._clock.sleep_until(self._transmit_ns)
        return self._first_stop

    def _stop_past_thread(self) -> Transmission | None:
        """Send the stops without the lock, because the loop's thread hangs.

        Returns:
            The first stop since `stop` was called. None if no stop could be sent.
        """
        first_stop = self._first_stop
        for _ in range(STOPS):
            # read here, as the step that hangs does not read the operator's key
            emergency = self.guard.emergency or self._emergency.is_set()
            with suppress(Exception, SystemExit):
                stop = self._actuator.stop(emergency=emergency)
                first_stop = first_stop or stop
            self._clock.sleep_until(self._clock.now() + STOP_GAP_NS)
        return first_stop

    def sent(self) -> list[Transmission]:
        """Return what was transmitted to the robots since the last call, oldest first."""
        return drained(self._sent)

    def warnings(self) -> list[tuple[int, str]]:
        """Return the guard's warnings since the last call, with the time of each [ns]."""
        return drained(self._warnings)

    def close(self) -> None:
        """End the loop's thread, without sending stops.

        It may be called twice and never raises.
        """
        self._closing.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    # ---- steps, by the loop's thread ----

    def step(self) -> None:
        """Check the new frames, and send a transmission if one is due."""
        with self._lock:
            self._step_safely()

    def step_if_due(self) -> None:
        """Make a step if one is due, at a frame or every `IDLE_STEP_S`.

        Call this if the loop has no thread.
        """
        now_ns = self._clock.now()
        if self._wake.is_set() or now_ns >= self._step_ns:
            self._wake.clear()
            self._step_ns = now_ns + round(IDLE_STEP_S * SECOND)
            self.step()

    def _step_until_closed(self) -> None:
        """Make steps until the loop is closed. This runs in the loop's thread."""
        while not self._closing.is_set():
            self._wake.wait(IDLE_STEP_S)
            self._wake.clear()
            self.step()

    @contextmanager
    def _hold_lock(self, timeout_s: float) -> Iterator[bool]:
        """Hold the lock during the `with` block; yield False if it is not free in time."""
        locked = self._lock.acquire(timeout=timeout_s)
        try:
            yield locked
        finally:
            if locked:
                self._lock.release()

    def _step_safely(self) -> Transmission | None:
        """Make one step. An error during the step stops the robots, but not this loop.

        Returns:
            The transmission of the held action. None if it was not sent.
        """
        try:
            return self._check_and_transmit()
        except (Exception, SystemExit) as error:
            reason = error.message if isinstance(error, AbortError) else text_of(error)
            now_ns = self._clock.now()
            self.guard.abort(reason)
            self._begin_stops_of_abort(now_ns)
            self._obey_operator(now_ns)  # here too, as every step may fail before it
            if self._stops_left:  # here, as the next step may fail before its stop
                with suppress(Exception, SystemExit):
                    self._repeat_stop(now_ns)
            return None

    def _check_and_transmit(self) -> Transmission | None:
        """Let the guard decide, and transmit what the table in the module's docstring requires.

        Returns:
            The transmission of the held action. None if it was not sent.
        """
        now_ns = self._clock.now()
        self.guard.check_awake(now_ns)
        self._take_frames()
        self._obey_operator(now_ns)
        failure: object = self._actuator.failure
        if not isinstance(failure, str | None):
            raise WrongValueError("an actuator", "a `failure` that is neither a string nor None")
        ruling = self.guard.decide(now_ns, self._camera.damaged, failure)
        self._warnings.extend((now_ns, warning) for warning in ruling.warnings)
        if ruling.state is GuardState.ABORT:
            self._begin_stops_of_abort(now_ns)
        if self._stops_left:
            self._repeat_stop(now_ns)
            self.guard.name_cause(self.frames)  # slow, so after the first stop
        elif ruling.state in (GuardState.RUN, GuardState.HOLD) and self._held is not None:
            return self._send_held(self._held, ruling, now_ns)
        elif ruling.state in (GuardState.PREFLIGHT, GuardState.READY) and self.idle is not None:
            self._send_idle(self.idle(now_ns), ruling, now_ns)
        return None

    def _take_frames(self) -> None:
        """Let the guard check the frames that have arrived, and keep those that it accepts.

        Raises WrongValueError for a frame that no log can hold.
        """
        for frame in self._camera.frames():
            fault = describe_frame_fault(frame, len(self.guard.rules.names))
            if fault:
                raise WrongValueError("a camera", fault)
            accepted = self.guard.check_frame(frame)
            if accepted is not None:
                self.frames.append(accepted)

    def _obey_operator(self, now_ns: int) -> None:
        """Start the stops of an emergency once, even after an abort, so that devices latch them."""
        if self._emergency.is_set() and not self._operator_obeyed:
            self._operator_obeyed = True
            self.guard.abort("emergency stop by the operator", emergency=True)
            self._begin_stops(now_ns)

    # ---- transmissions ----

    def _begin_stops(self, now_ns: int) -> None:
        """Plan to send a stop STOPS times, the first time at once."""
        self._stops_left = STOPS
        self._transmit_ns = now_ns

    def _begin_stops_of_abort(self, now_ns: int) -> None:
        """Plan to send the stops of an aborted run, unless that has been done."""
        if not self._abort_stops_begun:
            self._abort_stops_begun = True
            self._begin_stops(now_ns)

    def _repeat_stop(self, now_ns: int) -> None:
        """Send the next of the scheduled stops if it is due."""
        if now_ns < self._transmit_ns:
            return
        self._transmit_ns = now_ns + STOP_GAP_NS
        self._stops_left -= 1
        try:
            stop = self._actuator.stop(emergency=self.guard.emergency)
            self._record_transmission(stop)
            if self._first_stop is None:
                self._first_stop = stop
        except AbortError as error:  # robots at other ports may hear it, and need the rest, too
            self.guard.abort(error.message)

    def _send_held(self, held: HeldAction, ruling: Ruling, now_ns: int) -> Transmission | None:
        """Send the held action if the period has passed, the action is new, or a robot must stop.

        Returns:
            The transmission. None if nothing was sent.
        """
        if held.moving is not None and now_ns < self._transmit_ns:
            old_and_new = zip(held.moving, ruling.moving, strict=True)
            if not any(moved and not may_move for moved, may_move in old_and_new):
                return None
        if any(ruling.moving) or not self.guard.together:
            newest = self.frames.newest
            sampled_ns = 0 if newest is None else newest.frame.sampled_ns
            transmission = self._actuator.send(held.action, ruling.poses, ruling.moving, sampled_ns)
        else:  # robots that share a field are held still together, by a stop
            transmission = self._actuator.stop()
        self._record_transmission(transmission)
        self._transmit_ns = next_due_ns(
            self._transmit_ns, transmission.sent_ns, self._actuator.period_ns
        )
        held.moving = ruling.moving
        return transmission

    def _send_idle(self, direction: float, ruling: Ruling, now_ns: int) -> None:
        """Send a direction [rad] to all robots before a run; send a stop if frames are missing.

        Something is sent at most once per period of the actuator.
        """
        if now_ns < self._transmit_ns:
            return
        self._transmit_ns = now_ns + self._actuator.period_ns
        newest = self.frames.newest
        age_max_ns = self.guard.rules.limits.stream_lost * SECOND
        if newest is None or now_ns - newest.frame.received_ns > age_max_ns:
            self._report_to_camera(self._actuator.stop())
            return
        all_move = (True,) * len(ruling.poses)
        sampled_ns = newest.frame.sampled_ns
        transmission = self._actuator.send(Steer(direction), ruling.poses, all_move, sampled_ns)
        self._report_to_camera(transmission)
        # when a run starts, cells still turn by these directions
        self.guard.note_transmission(
            transmission.sent_ns, transmission.speed.tolist(), transmission.turning.tolist()
        )

    def _report_to_camera(self, transmission: Transmission) -> None:
        """Report a transmission to a camera that identifies robots by their response."""
        if self._direction_listener is not None:
            self._direction_listener.steered(transmission.direction, transmission.sent_ns)

    def _record_transmission(self, transmission: Transmission) -> None:
        """Record a transmission, and notify the camera and the guard of it."""
        fault = describe_transmission_fault(
            transmission, len(self.guard.rules.names), self._clock.now()
        )
        if fault:
            raise WrongValueError("an actuator", fault)
        self.last = transmission
        if transmission.speed.any() or transmission.turning.any():
            self.driven_ns = transmission.sent_ns
        self._report_to_camera(transmission)
        self._sent.append(transmission)
        self.guard.note_transmission(
            transmission.sent_ns, transmission.speed.tolist(), transmission.turning.tolist()
        )


# ---- what devices may return ----


def describe_frame_fault(frame: CameraFrame, robots: int) -> str:
    """Return a message about what makes a camera's frame of N robots unusable.

    The message is empty if nothing is wrong.
    """
    numbers = [frame.number, frame.sampled_ns, frame.received_ns, *frame.exposed_ns]
    poses = [pose for pose in frame.poses if pose is not None]
    is_loggable = (
        len(frame.poses) == robots
        and len(frame.exposed_ns) in (0, robots)
        and all(_are_loggable((pose.x, pose.y, pose.heading)) for pose in poses)
        and all(_is_loggable_integer(number) for number in numbers)
    )
    if not is_loggable:
        return "a frame that cannot be logged: a number is missing, not finite or too large"
    if frame.received_ns < frame.sampled_ns:
        return f"a frame received {frame.sampled_ns - frame.received_ns} ns before exposure"
    if any(exposed_ns > frame.sampled_ns for exposed_ns in frame.exposed_ns):
        return "a pose exposed after the time of its frame"
    return ""


def describe_transmission_fault(transmission: object, robots: int, now_ns: int) -> str:
    """Return a message about what is wrong with a transmission that an actuator reports.

    The message is empty if nothing is wrong.

    Args:
        transmission: The value that the actuator returned. It should be a `Transmission`.
        robots: Number of robots.
        now_ns: The present time [ns].
    """
    unloggable = (
        "a transmission that cannot be logged: a number is missing, not finite or too large"
    )
    if not isinstance(transmission, Transmission):
        return unloggable
    if not _is_loggable_integer(transmission.sent_ns) or len(transmission.delivered) != robots:
        return unloggable
    for speeds in (transmission.speed, transmission.turning, transmission.left, transmission.right):
        if speeds is not None and not (
            np.shape(speeds) == (robots,) and _are_loggable(np.asarray(speeds))
        ):
            return unloggable
    if not 0 <= transmission.sent_ns <= now_ns:
        return (
            f"a transmission sent at {transmission.sent_ns} ns, not between 0 and now, {now_ns} ns"
        )
    return ""


def _is_loggable_integer(number: object) -> bool:
    """Check whether a value is a Python int below NEVER in magnitude, so that it fits into a log.

    Integers of NumPy are not accepted.
    """
    return isinstance(number, int) and abs(number) < NEVER


def _are_loggable(values: Iterable[float]) -> bool:
    """Check whether all values are numbers that fit into a log."""
    return all(abs(value) <= POSE_MAX for value in values)
