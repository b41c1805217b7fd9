"""The inner loop between the devices: it passes frames to the guard, and its decisions to robots.

The loop runs in its own thread, so that planning cannot delay a stop. It makes a step at every
camera frame. In each step, it takes the new frames, lets the guard decide, and transmits one of
these:

    a stop                    while some of STOPS remain: after an abort, and after `stop`
    the held action           in a run: at once if it is new or a robot must stop, otherwise at the
                              actuator's rate
    `idle_direction`          before a run, to robots in a field that keeps turning
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
    the loop's thread hangs       `hold` and `between_steps` abort after HOLD_TIMEOUT_S. After
                                  STOP_TIMEOUT_S, `stop` sends stops without waiting for the thread

Threads: the loop's own thread makes the steps. The controller's thread calls `hold`,
`between_steps`, `stop`, `take_transmissions`, `take_warnings` and `restart`. A lock lets only one
of them act at a time. Times are in ns on the run's clock.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND, Clock, next_due_ns
from tetractl.core.commands import Steer, Transmission, Turn
from tetractl.core.errors import AbortError, WrongValueError, describe_error
from tetractl.core.poses import POSE_MAX, CameraFrame
from tetractl.core.protocols import Actuator, Camera
from tetractl.lab.device_abilities import HearsDirections
from tetractl.lab.frame_buffer import FrameBuffer
from tetractl.lab.guard import Guard, GuardState, Ruling
from tetractl.lab.guard_observer import build_guard
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS
from tetractl.tools.worker import QUEUE_MAX, take_all

IDLE_STEP_S = 0.01
"""Maximum time between two steps if no frame arrives [s]."""
HOLD_TIMEOUT_S = 0.25
"""Time for which `hold` and `between_steps` wait for the loop's step to end [s].

Chosen, not measured.
"""
STOP_TIMEOUT_S = 1.0
"""Time for which `stop` waits for the loop's step to end [s].

It is longer than HOLD_TIMEOUT_S, because stops that are sent without waiting may come between the
bytes of a step that only takes long.
"""


@dataclass(slots=True)
class HeldAction:
    """The action, such as a direction, that the inner loop sends to the robots repeatedly.

    Attributes:
        action: The action.
        moving: Whether each robot was allowed to move when the action was last sent, N entries.
            None before that.
    """

    action: Steer | Turn
    moving: tuple[bool, ...] | None = None


class InnerLoop:
    """The loop that lets a guard decide at each camera frame, and sends its decisions to robots.

    The loop runs in its own thread after `start`. Without `start`, the caller must call `step` or
    `step_if_due`.

    Args:
        camera: The camera.
        actuator: The actuator.
        guard: The guard.
        clock: The clock for times [ns].
        wake: Set by the camera after each frame.
        emergency: Set by the operator for an emergency stop.

    Attributes:
        guard: The guard that decides at present. `restart` replaces it.
        frames: The camera frames that the guard has accepted.
        last_transmission: The last transmission of a run. None before the first.
        last_driven_ns: Time of the last transmission that let a robot move [ns]. 0 before that.
        idle_direction: Returns the direction u [rad] that is sent before a run, at a time [ns].
            None to send nothing.
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
        self.idle_direction: Callable[[int], float] | None = None
        self.last_transmission: Transmission | None = None
        self.last_driven_ns = 0
        self._camera = camera
        self._actuator = actuator
        self._clock = clock
        self._direction_listener = camera if isinstance(camera, HearsDirections) else None
        self._wake = wake
        self._emergency = emergency
        self._lock = threading.Lock()
        self._held_action: HeldAction | None = None
        self._stops_left = 0
        """Number of stops that still have to be sent."""
        self._first_stop: Transmission | None = None
        """The first stop that was sent since `stop` was called. None before that."""
        self._abort_stops_begun = False
        """Whether the stops of the guard's abort have begun. They are sent only once."""
        self._emergency_stops_begun = False
        """Whether the stops of the operator's emergency stop have begun."""
        self._transmissions: deque[Transmission] = deque(maxlen=QUEUE_MAX)
        self._warnings: deque[tuple[int, str]] = deque(maxlen=QUEUE_MAX)
        self._transmit_ns = 0  # when the next transmission is due
        self._step_ns = 0  # when the next step without a frame is due
        self._is_closing = threading.Event()
        self._thread = threading.Thread(
            target=self._step_until_closed, name="inner loop", daemon=True
        )

    # ---- calls of the controller's thread ----

    def start(self) -> None:
        """Start the loop's thread.

        Nothing is sent before `hold` or `idle_direction` gives a direction.
        """
        self._thread.start()

    def hold(self, action: Steer | Turn) -> Transmission:
        """Start to send an action repeatedly, and return the first transmission.

        The first transmission is a stop if the guard presently lets no robot move.

        Args:
            action: The direction to drive in, or to turn to on the spot.

        Raises:
            AbortError: If no robot may move any more, with the guard's reason, or if the loop
                stays within a step for too long.
        """
        with self.between_steps() as guard:
            guard.start_run(self._clock.now())
            guard.record_direction(self._clock.now(), isinstance(action, Steer))
            self._held_action = HeldAction(action)
            transmission = self._step_safely()
            if transmission is None:
                guard.abort("the guard lets no robot be steered")
            if transmission is None or guard.state is GuardState.ABORT:
                raise AbortError(guard.reason)
            return transmission

    @contextmanager
    def between_steps(self) -> Iterator[Guard]:
        """Pause the loop during the `with` block, so that robots of its guard can be changed.

        The block gets the guard. A step that has already read the list of robots continues with the
        old list.

        Raises:
            AbortError: If the loop stays within a step for too long.
        """
        with self._hold_lock(HOLD_TIMEOUT_S) as is_locked:
            if not is_locked:
                self.guard.abort("the inner loop did not answer")
                raise AbortError(self.guard.reason)
            yield self.guard

    def restart(self, rules: GuardRules) -> None:
        """Continue with a new guard that has other rules, for example for newly found robots.

        The loop forgets all frames so far.

        Raises:
            AbortError: If the loop stays within a step for too long.
        """
        with self.between_steps():
            self.guard = build_guard(rules, self.guard.checks_of)
            self.frames = FrameBuffer()
            self._abort_stops_begun = False  # this guard has not aborted
            self._emergency_stops_begun = False

    def stop(self) -> Transmission | None:
        """End the run: send STOPS stops to every robot, STOP_GAP_NS apart.

        This method never raises.

        Returns:
            The first stop. None if no stop could be sent.
        """
        with self._hold_lock(STOP_TIMEOUT_S) as is_locked:
            # also without the lock: if the hanging step ends after all, it continues with stops
            self._held_action = None
            self.idle_direction = None
            self._first_stop = None
            self.guard.end_run()
            self._begin_stops(self._clock.now())
        if not is_locked:
            return self._stop_without_lock()
        while self._stops_left:
            with self._hold_lock(STOP_TIMEOUT_S) as is_locked:
                if not is_locked:
                    return self._stop_without_lock()
                self._step_safely()
            if self._stops_left:
                self._clock.sleep_until(self._transmit_ns)
        return self._first_stop

    def _stop_without_lock(self) -> Transmission | None:
        """Send the stops without the lock, because the loop's thread hangs.

        Returns:
            The first stop since `stop` was called. None if no stop could be sent.
        """
        first_stop = self._first_stop
        for _ in range(STOP_COUNT):
            # read here, as the step that hangs does not read the operator's key
            emergency = self.guard.emergency or self._emergency.is_set()
            with suppress(Exception, SystemExit):
                stop = self._actuator.stop(emergency=emergency)
                first_stop = first_stop or stop
            self._clock.sleep_until(self._clock.now() + STOP_GAP_NS)
        return first_stop

    def take_transmissions(self) -> list[Transmission]:
        """Return the transmissions to the robots since the last call, oldest first."""
        return take_all(self._transmissions)

    def take_warnings(self) -> list[tuple[int, str]]:
        """Return the guard's warnings since the last call, with the time of each [ns]."""
        return take_all(self._warnings)

    def close(self) -> None:
        """End the loop's thread, without sending stops.

        This method can be called twice, and never raises.
        """
        self._is_closing.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    # ---- steps, by the loop's thread ----

    def step(self) -> None:
        """Check the new frames, and send a transmission if one is due."""
        with self._lock:
            self._step_safely()

    def step_if_due(self) -> None:
        """Make a step if one is due: after each camera frame, and otherwise every IDLE_STEP_S.

        Call this method repeatedly if the loop has no thread.
        """
        now_ns = self._clock.now()
        if self._wake.is_set() or now_ns >= self._step_ns:
            self._wake.clear()
            self._step_ns = now_ns + round(IDLE_STEP_S * SECOND)
            self.step()

    def _step_until_closed(self) -> None:
        """Make steps until the loop is closed. This runs in the loop's thread."""
        while not self._is_closing.is_set():
            self._wake.wait(IDLE_STEP_S)
            self._wake.clear()
            self.step()

    @contextmanager
    def _hold_lock(self, timeout_s: float) -> Iterator[bool]:
        """Hold the lock during the `with` block; yield False if it is not free in time."""
        is_locked = self._lock.acquire(timeout=timeout_s)
        try:
            yield is_locked
        finally:
            if is_locked:
                self._lock.release()

    def _step_safely(self) -> Transmission | None:
        """Make one step. An error during the step stops the robots, but not this loop.

        Returns:
            The transmission of the held action. None if it was not sent.
        """
        try:
            return self._check_and_transmit()
        except (Exception, SystemExit) as error:
            reason = error.message if isinstance(error, AbortError) else describe_error(error)
            now_ns = self._clock.now()
            self.guard.abort(reason)
            self._begin_stops_of_abort(now_ns)
            self._begin_emergency_stops(now_ns)  # here too, as every step may fail before it
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
        self._check_new_frames()
        self._begin_emergency_stops(now_ns)
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
        elif ruling.state in (GuardState.RUN, GuardState.HOLD) and self._held_action is not None:
            return self._send_held(self._held_action, ruling, now_ns)
        elif (
            ruling.state in (GuardState.PREFLIGHT, GuardState.READY)
            and self.idle_direction is not None
        ):
            self._send_idle(self.idle_direction(now_ns), ruling, now_ns)
        return None

    def _check_new_frames(self) -> None:
        """Let the guard check the frames that have arrived, and keep the frames that it accepts.

        Raises WrongValueError if a frame has a value that cannot be logged.
        """
        for frame in self._camera.frames():
            fault = describe_frame_fault(frame, len(self.guard.rules.names))
            if fault:
                raise WrongValueError("a camera", fault)
            accepted = self.guard.check_frame(frame)
            if accepted is not None:
                self.frames.append(accepted)

    def _begin_emergency_stops(self, now_ns: int) -> None:
        """Start the stops of an emergency once, even after an abort, so that devices latch them."""
        if self._emergency.is_set() and not self._emergency_stops_begun:
            self._emergency_stops_begun = True
            self.guard.abort("emergency stop by the operator", emergency=True)
            self._begin_stops(now_ns)

    # ---- transmissions ----

    def _begin_stops(self, now_ns: int) -> None:
        """Schedule STOP_COUNT stops, the first one at once."""
        self._stops_left = STOP_COUNT
        self._transmit_ns = now_ns

    def _begin_stops_of_abort(self, now_ns: int) -> None:
        """Schedule the stops of an aborted run, unless they have been scheduled before."""
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
        except AbortError as error:  # robots at other ports still need the remaining stops
            self.guard.abort(error.message)

    def _send_held(self, held: HeldAction, ruling: Ruling, now_ns: int) -> Transmission | None:
        """Send the held action if the period has passed, the action is new, or a robot must stop.

        Returns:
            The transmission. None if nothing was sent.
        """
        if held.moving is not None and now_ns < self._transmit_ns:
            moved_and_may_move = zip(held.moving, ruling.moving, strict=True)
            if not any(moved and not may_move for moved, may_move in moved_and_may_move):
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
        """Send a direction [rad] to all robots before a run. If frames are missing, send a stop.

        At most one transmission is sent per period of the actuator.
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
        self.guard.record_transmission(
            transmission.sent_ns, transmission.speed.tolist(), transmission.turning.tolist()
        )

    def _report_to_camera(self, transmission: Transmission) -> None:
        """Report a transmission to the camera, if it identifies robots by their response."""
        if self._direction_listener is not None:
            self._direction_listener.steered(transmission.direction, transmission.sent_ns)

    def _record_transmission(self, transmission: Transmission) -> None:
        """Check and record a transmission, and report it to the camera and the guard."""
        fault = describe_transmission_fault(
            transmission, len(self.guard.rules.names), self._clock.now()
        )
        if fault:
            raise WrongValueError("an actuator", fault)
        self.last_transmission = transmission
        if transmission.speed.any() or transmission.turning.any():
            self.last_driven_ns = transmission.sent_ns
        self._report_to_camera(transmission)
        self._transmissions.append(transmission)
        self.guard.record_transmission(
            transmission.sent_ns, transmission.speed.tolist(), transmission.turning.tolist()
        )


# ---- what devices may return ----


def describe_frame_fault(frame: CameraFrame, n_robots: int) -> str:
    """Describe why a camera frame cannot be used: a value is invalid, or its times contradict.

    Args:
        frame: The frame.
        n_robots: Number of robots.

    Returns:
        The end of an error message. Empty if the frame is valid.
    """
    integers = [frame.number, frame.sampled_ns, frame.received_ns, *frame.exposed_ns]
    poses = [pose for pose in frame.poses if pose is not None]
    is_loggable = (
        len(frame.poses) == n_robots
        and len(frame.exposed_ns) in (0, n_robots)
        and all(_are_loggable((pose.x, pose.y, pose.heading)) for pose in poses)
        and all(_is_loggable_integer(number) for number in integers)
    )
    if not is_loggable:
        return "a frame that cannot be logged: a number is missing, not finite or too large"
    if frame.received_ns < frame.sampled_ns:
        early_ns = frame.sampled_ns - frame.received_ns
        return f"a frame that was received {early_ns} ns before it was exposed"
    if any(exposed_ns > frame.sampled_ns for exposed_ns in frame.exposed_ns):
        return "a pose that was exposed later than its frame"
    return ""


def describe_transmission_fault(transmission: object, n_robots: int, now_ns: int) -> str:
    """Describe what is wrong with a transmission that an actuator reports.

    Args:
        transmission: The value that the actuator returned. It should be a `Transmission`.
        n_robots: Number of robots.
        now_ns: The present time [ns].

    Returns:
        The end of an error message. Empty if the transmission is valid.
    """
    unloggable_message = (
        "a transmission that cannot be logged: a number is missing, not finite or too large"
    )
    if not isinstance(transmission, Transmission):
        return unloggable_message
    if not _is_loggable_integer(transmission.sent_ns) or len(transmission.delivered) != n_robots:
        return unloggable_message
    for speeds in (transmission.speed, transmission.turning, transmission.left, transmission.right):
        if speeds is not None and not (
            np.shape(speeds) == (n_robots,) and _are_loggable(np.asarray(speeds))
        ):
            return unloggable_message
    if not 0 <= transmission.sent_ns <= now_ns:
        return (
            f"a transmission that was sent at {transmission.sent_ns} ns, but this time must be "
            f"from 0 to the present time, {now_ns} ns"
        )
    return ""


def _is_loggable_integer(number: object) -> bool:
    """Check whether a value fits into a log as an integer: a Python int below NEVER in magnitude.

    Integers of NumPy are not accepted.
    """
    return isinstance(number, int) and abs(number) < NEVER_NS


def _are_loggable(values: Iterable[float]) -> bool:
    """Check whether all values are numbers that fit into a log."""
    return all(abs(value) <= POSE_MAX for value in values)
