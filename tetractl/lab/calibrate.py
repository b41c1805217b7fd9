"""Measures a robot's wheel gains, dead zones, r (the distance from a wheel to the centre), heading
offset, and whether its wheels are swapped, by small motions.

The actuator is any of robots on two wheels (`WheeledActuator`) whose section says what it sends
(`WheeledSection`). One wheel alone turns the robot about the other: |turning rate| = k (|output| -
dead zone) with k = gain / (2 r), for any heading offset. Both wheels together, with outputs whose
turning rates w1 and w2 cancel, drive the robot straight at the speed v = r (|w1| + |w2|), which
gives r; the direction of travel gives the heading offset and which way is forward. The rigid body's
x axis, turned by the spec's heading offset, must point less than a right angle away from the
robot's front; beyond 60 degrees the calibration fails.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from tetractl.core.clock import SECOND, wait_for
from tetractl.core.commands import Steer
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.core.setup import Setup
from tetractl.experiment.lab_section import LabLimits, LabSection, Measured
from tetractl.lab.accepted_frame import AcceptedFrame
from tetractl.lab.actuators.wheel_commands import WheeledActuator
from tetractl.lab.actuators.wheeled_section import Found, FoundWheel, WheeledSection
from tetractl.lab.rig import Rig
from tetractl.model.wheels import Counts

STARTS, TURNED = 8, 0.03  # starts from rest, and by how much a robot has moved then [rad]
GAP_S = 0.06  # longest time without a frame, of cameras that are fast enough [s]


@dataclass(frozen=True, slots=True)
class DrivenPath:
    """A steady motion: turning rate [rad/s], speeds along and to the left of the heading [mm/s]."""

    turning: float
    along: float
    across: float


@dataclass(frozen=True, slots=True)
class Channel:
    """One motor channel: an output above the dead zone turns the robot at the rate
    sign * k * (output - dead_zone) [rad/s], anticlockwise if positive.
    """

    sign: int
    k: float
    dead_zone: int

    def output(self, turning: float) -> int:
        """Return the absolute output at which the robot turns at an absolute rate [rad/s]."""
        return round(turning / self.k) + self.dead_zone


def calibrate_robots(
    section: WheeledSection,
    lab: LabSection,
    make_rig: Callable[[LabLimits, Setup], Rig],
    setup: Setup,
    names: Sequence[str],
    limit: int,
    report: Callable[[str], None],
) -> Measured:
    """Measure the named robots one after another with outputs up to `limit` 127ths of full speed.

    AbortError, with the reason, if a robot cannot be measured.
    """
    offsets = []
    wheels = []
    lines = []
    emulated: tuple[str, ...] = ()
    for name in names:
        report(f"{name}: measuring")
        known = lab.camera.heading_offset(name)
        # before it is calibrated, a wheel may do anything
        limits = lab.limits.model_copy(update={"wheel_error": 10.0})
        rig = make_rig(limits, setup.only([setup.names.index(name)]))
        bench = _Bench(section, rig, known or 0.0, limit)
        try:
            bench.open()
            for question in rig.actuator.check().questions:
                report(f"warning: {question}")
            found = bench.measure()
            waits = bench.first_motions()
            emulated = rig.emulated(rig.camera.check(), rig.actuator.check())
        finally:
            bench.close()
        if known is not None:
            offsets.append({"name": name, "heading_offset": found.heading_offset})
        wheels.append({"name": name, **section.measured(found)})
        lines += [f"{name}: {found}", f"{name}: {latency_line(waits)}"]
    camera = {"robots": offsets} if offsets else {}
    return Measured(camera, {"robots": wheels}, tuple(lines), emulated)


class _Bench:
    """The calibration of one robot; the guard checks camera frames as in a run."""

    def __init__(self, section: WheeledSection, rig: Rig, offset: float, limit: int) -> None:
        assert isinstance(rig.actuator, WheeledActuator), "its section says that it has wheels"
        self.rig, self.actuator, self.clock = rig, rig.actuator, rig.clock
        (self.name,) = rig.setup.names
        self._home: Pose | None = None
        self._slow_s = 0.0  # by how much frames are later than GAP_S
        self._offset, self._dead_zone_max = offset, section.dead_zone_max
        self._scale, self.limit = section.outputs(self.name, limit)
        guard = rig.guard
        fastest = (500.0 / self.rig.mm,), (12.0,)  # faster than any robot during calibration
        guard.change_rules(
            replace(guard.rules, speeds=fastest[0], turning=fastest[1], silence_ns=3 * SECOND)
        )

    def open(self) -> None:
        """Connect; AbortError unless the robot is tracked and answers."""
        rig = self.rig.__enter__()
        if problems := rig.camera.check().problems:
            raise AbortError("; ".join(problems))
        (status,) = rig.actuator.poll(1.0)
        if problems := rig.actuator.check().problems:
            raise AbortError("; ".join(problems))
        if status.answers is False:  # None: it cannot answer
            raise AbortError(
                f"{self.name} does not answer", "find the cause with `tetractl lab check`"
            )
        rig.guard.pass_preflight()

    def close(self) -> None:
        """Stop the robot and release the devices."""
        try:
            self.rig.loop.stop()
        except KeyboardInterrupt:  # stop the robot even if Ctrl-C interrupts the stop once
            self.rig.loop.stop()
            raise
        finally:
            self.rig.close()

    def measure(self) -> Found:
        """Move the robot and return its measured values."""
        channels = [self._channel(0), self._channel(1)]
        turning = 0.6 * min(channel.k * (self.limit - channel.dead_zone) for channel in channels)
        sizes = [channel.output(turning) for channel in channels]
        # signs of the outputs for which the two turning rates cancel
        signs = [1, -channels[0].sign * channels[1].sign]
        away, back = (self._run(_pair([k * s for s in signs], sizes), 0.7) for k in (1, -1))
        here = away
        if away.along < 0:
            here, back = back, away
            signs = [-sign for sign in signs]
        self._stand()
        speed = math.hypot(here.along, here.across)
        rates = [c.k * (size - c.dead_zone) for c, size in zip(channels, sizes, strict=True)]
        radius = speed / sum(rates)
        if not 5.0 < radius < 500.0:
            raise AbortError(
                f"{self.name}: measured an impossible distance of {radius:.0f} mm from a wheel to "
                "the robot's centre; do the wheels roll freely?"
            )
        offset = math.atan2(here.across - back.across, here.along - back.along)
        if abs(offset) > math.pi / 3:
            raise AbortError(
                f"{self.name}: its rigid body points {math.degrees(offset):.0f} degrees off its "
                "front",
                "set an approximate heading_offset in the spec, or redefine the rigid body in the "
                "camera software",
            )
        wheels = [
            FoundWheel(round(2 * radius * c.k, 4), c.dead_zone, sign < 0)
            for c, sign in zip(channels, signs, strict=True)
        ]
        swap = channels[0].sign * signs[0] > 0  # a right wheel driving forward turns the robot left
        left, right = reversed(wheels) if swap else wheels
        whole = math.remainder(self._offset + offset, math.tau)
        return Found(round(whole, 5), round(radius, 3), left, right, swap)

    def first_motions(self) -> list[float]:
        """Start the robot STARTS times from rest by a turn on the spot; return the times [s] from
        the sending until the first picture in which it has turned by TURNED is here."""
        waits = list[float]()
        for k in range(STARTS):
            self._stand()
            rest = [pose.heading for f in self.rig.frames.last(SECOND // 10) if (pose := f.pose(0))]
            first = self.rig.frames.count
            if not rest:
                continue
            sent_ns = self._hold(_pair((-1, 1) if k % 2 else (1, -1), (self.limit, self.limit)))
            began = rest[-1]
            enough = max(TURNED, 3 * float(np.ptp(np.unwrap(rest))))

            def turned(since: int = first, from_rad: float = began, by: float = enough) -> int:
                for frame in self.rig.frames.since(since)[0]:
                    pose = frame.pose(0)
                    if pose and abs(math.remainder(pose.heading - from_rad, math.tau)) > by:
                        return frame.frame.received_ns
                return 0

            wait_for(self.clock, lambda: bool(turned()) or self._strayed(), 1.0)
            if self.rig.guard.reason:
                raise AbortError(f"{self.name}: {self.rig.guard.reason}")
            if arrived_ns := turned():
                waits.append((arrived_ns - sent_ns) / SECOND)
        self._stand()
        return waits

    def _channel(self, which: int) -> Channel:
        """Drive motor channel 0 or 1 with growing outputs in both directions; fit k and dead zone
        to the turning rates.
        """
        points: list[tuple[int, float]] = []
        signs: list[float] = []
        for step in range(6, int(self.limit / self._scale) + 1, 4):
            rates, count = [], round(step * self._scale)
            for sign in (1, -1):
                counts = [0, 0]
                counts[which] = sign * count
                rates.append(sign * self._run((counts[0], counts[1]), 0.4).turning)
            rate = sum(rates) / 2
            if abs(rate) > 0.25:  # rad/s: slower is noise, or a wheel that sticks
                points.append((count, abs(rate)))
                signs.append(rate)
        self._stand()
        if len(points) < 3:  # too few for the fit of a line
            raise AbortError(
                f"{self.name}: motor channel {which + 1} hardly turns the robot with up to "
                f"{self.limit} of its unit",
                "is the robot's battery charged and the motor connected? If so, raise --limit",
            )
        counts, rates = np.array(points).T
        slope, start = np.polyfit(counts, rates, 1)
        if slope <= 0 or len({rate > 0 for rate in signs}) > 1:
            raise AbortError(
                f"{self.name}: motor channel {which + 1} does not turn the robot steadily; "
                "charge the battery and check the wheel"
            )
        dead = min(self._dead_zone_max, max(0, round(-start / slope)))
        steps = counts - dead
        return Channel(1 if signs[0] > 0 else -1, float(steps @ rates / (steps @ steps)), dead)

    def _run(self, counts: Counts, seconds: float) -> DrivenPath:
        """Hold outputs for a time [s]; return the motion after the wheels have settled.

        If frames were missing, the motion is repeated, since the guard may have stopped the robot.
        """
        for _ in range(4):
            first = self.rig.frames.count
            began = self._hold(counts)
            end = began + round((seconds + 2 * self._slow_s) * SECOND)
            wait_for(self.clock, self._strayed, (end - self.clock.now()) / SECOND)
            if self.rig.guard.reason:
                raise AbortError(f"{self.name}: {self.rig.guard.reason}")
            came, _ = self.rig.frames.since(first)
            frames = [f for f in came if f.exposed(0) >= began]
            seen = [(f.exposed(0), pose) for f in frames if (pose := f.pose(0)) is not None]
            times = [began, *(t for t, _ in seen), end]
            self._slow_s = max(self._slow_s, _slow(came))
            if max(np.diff(times)) <= (GAP_S + self._slow_s) * SECOND:  # otherwise frames miss
                # the wheels turn steadily 0.2 s after the start of a burst
                return _steady(seen, began + round(0.2 * SECOND), self.rig.mm)
            # drive back, so that the robot stays near its place
            self._hold(_pair((-1, -1), counts))
            wait_for(self.clock, self._strayed, seconds)
        raise AbortError(
            f"{self.name}: too many camera frames are missing; check the camera and the network"
        )

    def _hold(self, counts: Counts) -> int:
        """Set the outputs to send; return the time of their first transmission [ns]."""
        self.actuator.held = np.array([counts]).T
        return self.rig.loop.hold(Steer(0.0)).sent_ns

    def _stand(self) -> None:
        self._hold((0, 0))
        self.clock.sleep_until(self.clock.now() + SECOND // 4)

    def _strayed(self) -> bool:
        """Abort the calibration if the robot is too far from its first position; return whether it
        has been aborted.
        """
        guard, newest = self.rig.guard, self.rig.frames.newest
        if newest is not None and (pose := newest.poses[0]) is not None:
            self._home = self._home or pose
            away = math.hypot(pose.x - self._home.x, pose.y - self._home.y) * self.rig.mm
            if away > 300.0:  # mm
                guard.abort(f"the robot is {away:.0f} mm from its first position")
        return bool(guard.reason)


def latency_line(waits: Sequence[float]) -> str:
    """Return the mean of times to a first motion [s], with its 95 % interval, as text."""
    if len(waits) < 2:
        return "no first motion was seen"
    mean, half = np.mean(waits), stdtrit(len(waits) - 1, 0.975) * np.std(waits, ddof=1)
    ends = f"{mean - half / len(waits) ** 0.5:.3f} to {mean + half / len(waits) ** 0.5:.3f}"
    return (
        f"first motion seen {mean:.3f} s ({ends}, n {len(waits)}) after sending: radio, wheels "
        f"until they have turned it by {TURNED:g} rad, exposure, and the picture's way here"
    )


def _slow(came: Sequence[AcceptedFrame]) -> float:
    """Return by how much [s] it takes longer than GAP_S until a frame two and a half periods after
    another is here."""
    if len(came) < 3:
        return 0.0
    late_ns = np.median([f.frame.received_ns - f.exposed(0) for f in came])
    period_ns = np.median(np.diff([f.exposed(0) for f in came]))
    return max(0.0, float(2.5 * period_ns + late_ns) / SECOND - GAP_S)


def _steady(poses: list[tuple[int, Pose]], since_ns: int, mm: float) -> DrivenPath:
    """Return the steady motion fitted to (time [ns], pose) pairs from `since_ns` on; `mm` is the
    spec's length unit in millimetres.
    """
    seen = [(t, pose) for t, pose in poses if t >= since_ns]
    t = np.array([t for t, _ in seen]) / SECOND
    x, y, raw = np.array([(p.x, p.y, p.heading) for _, p in seen]).T
    heading = np.unwrap(raw)
    turning = float(np.polyfit(t - t[0], heading, 1)[0])
    middle = (heading[1:] + heading[:-1]) / 2
    dx, dy = np.diff(x) * mm, np.diff(y) * mm
    span = t[-1] - t[0]
    along = float(np.sum(dx * np.cos(middle) + dy * np.sin(middle)) / span)
    across = float(np.sum(dy * np.cos(middle) - dx * np.sin(middle)) / span)
    return DrivenPath(turning, along, across)


def _pair(signs: Sequence[int], sizes: Sequence[int]) -> Counts:
    return signs[0] * sizes[0], signs[1] * sizes[1]
