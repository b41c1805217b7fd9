"""The inner loop: from the held direction and the freshest headings to wheel commands.

It runs in a thread of its own, at every camera frame, and asks the guard each time; commands go
out at the radio's rate, stops at once. Planning is somebody else's business and cannot delay it.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Floats, Pose
from tetractl.lab.actuators.m3pi.broadcast import Counts
from tetractl.lab.actuators.m3pi.command import Drivetrain, Residue, wheel_counts
from tetractl.lab.actuators.m3pi.command import wheel_speeds as speeds_of_counts
from tetractl.lab.actuators.m3pi.protocols import STOP, Voice
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cameras.optitrack.client import NatNetClient
from tetractl.lab.guard import Guard, Ruling, State
from tetractl.model.motion.exact import step as exact
from tetractl.model.wheels import body_velocity, wheel_speeds

T = TypeVar("T")

IDLE_S = 0.01
STOPS = 10
STOP_GAP_NS = SECOND // 50  # ten stops over 200 ms
RADIO_NS = 7_000_000  # from handing over a broadcast at 57600 baud to the wheels
AHEAD_MAX_NS = SECOND // 10  # further ahead no heading is predicted
KEPT = 100_000


@dataclass(frozen=True, slots=True)
class Body:
    """What turns a direction into counts for one robot: a [rad/s], v and r [mm], drivetrain."""

    a: float
    speed: float
    radius: float
    drivetrain: Drivetrain


@dataclass(frozen=True, slots=True)
class Sent:
    """One transmission: when it left [ns], the direction (None: a stop), the counts by robot.

    `left`, `right` (N,) are the wheel speeds those counts ask for [mm/s]; `moving` tells which
    were let run; `exposed_ns` when the newest camera frame behind it was exposed.
    """

    t_ns: int
    direction: float | None
    counts: tuple[Counts, ...]
    left: Floats
    right: Floats
    moving: tuple[bool, ...]
    exposed_ns: int


class Drive:
    """The thread and what it holds. Times are ns on `clock`."""

    def __init__(
        self,
        bodies: Sequence[Body],
        millimetres: float,
        client: NatNetClient,
        link: Link,
        voice: Voice,
        guard: Guard,
        clock: Clock,
        period_ns: int,
        operator: threading.Event,
        on_snapshot: Callable[[CameraFrame, Guard], None] = lambda snapshot, guard: None,
    ) -> None:
        self.guard = guard
        self.wake = threading.Event()
        self._bodies, self._mm = tuple(bodies), millimetres
        self._a = np.array([body.a for body in bodies])
        self._speed = np.array([body.speed for body in bodies])
        self._radius = np.array([body.radius for body in bodies])
        self._client, self._link, self._voice, self._clock = client, link, voice, clock
        self._period_ns, self._operator, self._on_snapshot = period_ns, operator, on_snapshot
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._direction: float | None = None
        self._manual: tuple[Counts, ...] | None = None
        self._residues = [Residue()] * len(self._bodies)
        self._sent: deque[Sent] = deque(maxlen=KEPT)
        self._warnings: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self._last: Sent | None = None
        self._orders = 0  # directions given
        self._obeyed = 0  # directions that went out
        self._stops_left = 0
        self._next_ns = 0
        self._exposed_ns = 0
        self._resting = True
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="drive", daemon=True)

    def start(self) -> None:
        """Begin to watch; nothing is sent before the first direction."""
        self._thread.start()

    def steer(self, direction: float, timeout_s: float = 0.25) -> Sent:
        """Hold a direction [rad] from now on; return the first transmission that carries it.

        AbortError with the guard's reason where it lets nothing move any more.
        """
        return self._order(direction, None, timeout_s)

    def hold(self, counts: Sequence[Counts], timeout_s: float = 0.25) -> Sent:
        """Send these counts from now on, for moving robots without a controller."""
        return self._order(None, tuple(counts), timeout_s)

    def stop(self, timeout_s: float = 1.0) -> None:
        """Stop every robot, ten times over 200 ms; never raises."""
        with self._lock:
            self._direction = self._manual = None
            self._resting = True
            self.guard.rest()
            self._stops_left = STOPS
            self.wake.set()
            done = self._thread.is_alive() and self._changed.wait_for(
                lambda: self._stops_left == 0 or self._link.failure is not None, timeout_s
            )
        if not done:
            self._shout()

    def sent(self) -> list[Sent]:
        """Return, once, every transmission since the last call, oldest first."""
        return _drained(self._sent)

    def warnings(self) -> list[tuple[int, str]]:
        """Return, once, what the guard warned of since the last call, with its time."""
        return _drained(self._warnings)

    def close(self) -> None:
        """End the thread; idempotent, never raises."""
        self._closing.set()
        self.wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _order(
        self, direction: float | None, manual: tuple[Counts, ...] | None, timeout_s: float
    ) -> Sent:
        with self._lock:
            self.guard.go(self._clock.now())
            self.guard.steered(self._clock.now())
            self._direction, self._manual = direction, manual
            self._resting = False
            self._orders += 1
            wanted = self._orders
            self.wake.set()
            self._changed.wait_for(
                lambda: self._obeyed >= wanted or self.guard.state is State.ABORT, timeout_s
            )
            if self.guard.state is State.ABORT:
                raise AbortError(self.guard.reason)
            if self._obeyed < wanted or self._last is None:
                self.guard.abort("the drive thread did not answer")
                raise AbortError(self.guard.reason)
            return self._last

    def _run(self) -> None:
        while not self._closing.is_set():
            self.wake.wait(IDLE_S)
            self.wake.clear()
            with self._lock:
                try:
                    self._tick()
                except AbortError as error:
                    self.guard.abort(str(error))
                except Exception as error:  # a bug must stop the robots, not this thread
                    self.guard.abort(f"{type(error).__name__}: {error}")
                    self._stops_left = STOPS
                self._changed.notify_all()

    def _tick(self) -> None:
        guard, now = self.guard, self._clock.now()
        before = guard.state
        for snapshot in self._client.drain():
            guard.see(snapshot)
            self._exposed_ns = snapshot.sampled_ns
            self._on_snapshot(snapshot, guard)
        if self._operator.is_set():
            guard.abort("emergency stop by the operator", emergency=True)
        ruling = guard.tick(now, self._client.stream.counts.bad, self._link.failure)
        self._warnings.extend((now, warning) for warning in ruling.warnings)
        if ruling.state is State.ABORT and before is not State.ABORT:
            self._stops_left = STOPS
            self._next_ns = now
        if self._stops_left:
            self._repeat_stop(now)
        elif ruling.state in (State.RUN, State.HOLD) and not self._resting:
            self._drive(ruling, now)

    def _repeat_stop(self, now: int) -> None:
        if now < self._next_ns and self._stops_left < STOPS:
            return
        self._next_ns = now + STOP_GAP_NS
        self._stops_left -= 1
        voice, still = self._voice, (STOP,) * len(self._bodies)
        t_ns = voice.emergency() if self.guard.emergency else voice.stop()
        self._note(t_ns, None, still, (False,) * len(still))

    def _drive(self, ruling: Ruling, now: int) -> None:
        """Send what the robots shall do now, if it is time, new, or stops one of them."""
        stops_one = self._last is not None and any(
            was and not may for was, may in zip(self._last.moving, ruling.moving, strict=True)
        )
        if now < self._next_ns and self._obeyed == self._orders and not stops_one:
            return
        self._next_ns = max(self._next_ns + self._period_ns, now + self._period_ns // 2)
        counts = self._counts(ruling, now)
        t_ns = self._voice.drive(counts)
        self._note(t_ns, self._direction, counts, ruling.moving)
        self._obeyed = self._orders

    def _counts(self, ruling: Ruling, now: int) -> tuple[Counts, ...]:
        if self._manual is not None:
            wished = self._manual
        elif self._direction is not None:
            wished = self._towards(self._direction, ruling.poses, now)
        else:
            wished = (STOP,) * len(self._bodies)
        return tuple(pair if may else STOP for pair, may in zip(wished, ruling.moving, strict=True))

    def _towards(
        self, direction: float, poses: Sequence[Pose | None], now: int
    ) -> tuple[Counts, ...]:
        """Turn the direction into counts by (24)-(25), at the headings the command will meet.

        Those are predicted over the age of the frame and the radio's time by the exact step of (3).
        """
        ahead = min(AHEAD_MAX_NS, now - self._exposed_ns + RADIO_NS) / SECOND
        seen = np.array([0.0 if pose is None else pose.heading for pose in poses])
        nowhere, u = np.zeros(len(poses)), np.array(direction)
        _, _, heading = exact(nowhere, nowhere, seen, u, self._a, self._speed, ahead)
        left, right = wheel_speeds(heading, u, self._a, self._speed, self._radius)
        found: list[Counts] = []
        for i, pose in enumerate(poses):
            if pose is None:
                self._residues[i] = Residue()
                found.append(STOP)
                continue
            train, owed = self._bodies[i].drivetrain, self._residues[i]
            counts, self._residues[i] = wheel_counts(float(left[i]), float(right[i]), train, owed)
            found.append(counts)
        return tuple(found)

    def _note(
        self,
        t_ns: int,
        direction: float | None,
        counts: tuple[Counts, ...],
        moving: tuple[bool, ...],
    ) -> None:
        speeds = np.array(
            [
                speeds_of_counts(pair, body.drivetrain)
                for pair, body in zip(counts, self._bodies, strict=True)
            ]
        )
        left, right = speeds.T
        self._last = Sent(t_ns, direction, counts, left, right, moving, self._exposed_ns)
        self._sent.append(self._last)
        speed, turning = body_velocity(left, right, self._radius)
        self.guard.told(t_ns, (speed / self._mm).tolist(), turning.tolist())

    def _shout(self) -> None:
        """Stop from the caller's thread where the drive's own cannot."""
        for _ in range(STOPS):
            try:
                self._voice.stop()
            except AbortError:
                return
            self._clock.sleep_until(self._clock.now() + STOP_GAP_NS)


def _drained(queue: deque[T]) -> list[T]:
    items: list[T] = []
    while queue:
        items.append(queue.popleft())
    return items
