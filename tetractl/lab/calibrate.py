"""Calibrate a robot with small motions: measure its wheels and its heading offset.

The result contains the gains and dead zones of the wheels, r (the distance from a wheel to the
centre), the heading offset, and whether the wheels are swapped. Any robot on two wheels can be
calibrated if its actuator is a `WheeledActuator` and the actuator's section describes its outputs
(`CalibratedSection`). An output is the number that is sent to a motor, in the actuator's own unit.

One wheel alone turns the robot about the other wheel, whatever the heading offset is:

    |turning rate| = k (|output| - dead zone),   k = gain / (2 r).

If both wheels turn, with outputs whose turning rates w1 and w2 cancel, the robot drives straight at
the speed v = r (|w1| + |w2|). This gives r. The direction of travel gives the heading offset, and
shows which way is forward. The x axis of the rigid body, turned by the spec's heading offset, must
point less than a right angle away from the robot's front. Beyond 60 degrees, the calibration fails.

The motions are made in this order: each motor channel alone, forwards and backwards, with growing
outputs (`_fit_channel`); then both channels straight ahead, away and back (`measure`). If frames
are missing after a motion, the motion is repeated. If the robot moves too far from its first
position, it is stopped, and AbortError is raised.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.clock import SECOND, wait_for
from tetractl.core.commands import Steer
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheel_commands import WheeledActuator
from tetractl.lab.actuators.wheeled_section import CalibratedSection, Found, FoundWheel
from tetractl.lab.frames import AcceptedFrame, TimedPose, collect_timed_poses
from tetractl.lab.rig import Rig
from tetractl.model.wheels import CountArray
from tetractl.spec.lab_section import LabLimits, LabSection, Measured

GAP_S = 0.06
"""Maximum time without a frame during a motion, if the camera is fast enough [s].

If it is exceeded, frames were missing. The guard's limit is longer.
"""
GAP_PERIODS = 2.5
"""Maximum time without a frame for slower cameras, in periods of their frames.

One frame may be missing.
"""
SETTLED_S = 0.2
"""Time after a change of the outputs until the wheels turn steadily [s]: five time constants."""
CHANNEL_S = 0.4
"""Time for which one motor channel is driven with one output [s]."""
STRAIGHT_S = 0.7
"""Time for which the robot is driven straight [s]."""
STAND_S = 0.25
"""Waiting time after which a stopped robot counts as standing still [s]."""
ATTEMPTS = 4
"""Number of attempts at a motion if frames are missing."""
FIRST_OUTPUT = 6
"""Minimum output with which a channel is driven, in 127ths of full speed."""
OUTPUT_STEP = 4
"""Step between two outputs of a channel, in 127ths of full speed."""
TURNING_MIN_RAD_S = 0.25
"""Turning rate below which a measurement is ignored, as noise or a wheel that sticks [rad/s]."""
POINTS_MIN = 3
"""Minimum number of measured turning rates for the fit of a channel."""
STRAIGHT_FRACTION = 0.6
"""Turning rate of each wheel while the robot drives straight, as a fraction of the maximum.

The maximum is the one of the slower wheel.
"""
RADII_MM = 5.0, 500.0
"""Range of possible distances from a wheel to the robot's centre [mm]."""
OFFSET_MAX_RAD = math.pi / 3
"""Maximum heading offset of a rigid body that a calibration accepts [rad]."""
AWAY_MAX_MM = 300.0
"""Maximum distance from the robot's first position, beyond which the calibration aborts [mm]."""
FASTEST_MM_S = 500.0
"""A speed that no robot has during calibration, for the guard [mm/s]."""
FASTEST_RAD_S = 12.0
"""A turning rate that no robot has during calibration, for the guard [rad/s]."""
SILENCE_S = 3
"""Maximum time between two changes of the outputs that the guard allows [s]."""
UNKNOWN_WHEEL_ERROR = 10.0
"""Limit `wheel_error` for a robot that is not calibrated yet: it allows any error of a wheel."""


@dataclass(frozen=True, slots=True)
class SteadyMotion:
    """A steady motion of a robot, fitted to its poses.

    Attributes:
        turning: Turning rate [rad/s], positive anticlockwise.
        along: Speed along the heading [mm/s].
        across: Speed to the left of the heading [mm/s].
    """

    turning: float
    along: float
    across: float


@dataclass(frozen=True, slots=True)
class Channel:
    """The calibration of one motor channel: how its output becomes the speed of a wheel.

    An output above the dead zone turns the robot at the rate sign * k * (output - dead_zone)
    [rad/s], anticlockwise if positive.

    Attributes:
        sign: Direction of turning for positive outputs: 1 for anticlockwise, -1 for clockwise.
        k: Turning rate per output above the dead zone [rad/s].
        dead_zone: Maximum output at which the wheel does not turn.
    """

    sign: int
    k: float
    dead_zone: int

    def output(self, turning_rad_s: float) -> int:
        """Return the absolute output that turns the robot at an absolute rate [rad/s]."""
        return round(turning_rad_s / self.k) + self.dead_zone


def calibrate_robots(
    section: CalibratedSection,
    lab: LabSection,
    make_rig: Callable[[LabLimits, Setup], Rig],
    setup: Setup,
    names: Sequence[str],
    limit: int,
    report: Callable[[str], None],
) -> Measured:
    """Measure robots one after another with small motions; see `ActuatorSection.calibrate`.

    Args:
        section: The actuator's section of the spec.
        lab: The lab's section of the spec.
        make_rig: Creates the connected lab for limits and a setup with one robot.
        setup: The constants of the experiment.
        names: Names of the robots to measure.
        limit: Maximum speed of the wheels, in 127ths of full speed.
        report: Shows a line about the progress to the operator.

    Returns:
        The measured fields of the spec, with a summary of each robot.
    """
    offsets = []
    wheels = []
    summaries = []
    emulated: tuple[str, ...] = ()
    for name in names:
        report(f"{name}: measuring")
        offset_before = lab.camera.heading_offset(name)
        limits = lab.limits.model_copy(update={"wheel_error": UNKNOWN_WHEEL_ERROR})
        rig = make_rig(limits, setup.select_robots([setup.names.index(name)]))
        bench = _CalibrationBench(section, rig, offset_before or 0.0, limit)
        try:
            bench.open()
            for question in rig.actuator.check().questions:
                report(f"warning: {question}")
            measured = bench.measure()
            emulated = rig.list_emulated(rig.camera.check(), rig.actuator.check())
        finally:
            bench.close()
        if offset_before is not None:
            offsets.append({"name": name, "heading_offset": measured.heading_offset})
        wheels.append({"name": name, **section.measured(measured)})
        summaries.append(f"{name}: {measured}")
    camera = {"robots": offsets} if offsets else {}
    return Measured(camera, {"robots": wheels}, tuple(summaries), emulated)


class _CalibrationBench:
    """The set-up for the calibration of one robot: camera, actuator, and a guard.

    The guard checks camera frames as it does in a run. Call `open` first, then `measure`, and
    finally `close`, whatever has failed.
    """

    def __init__(self, section: CalibratedSection, rig: Rig, offset: float, limit: int) -> None:
        if not isinstance(rig.actuator, WheeledActuator):
            raise AbortError(
                f"the actuator {type(rig.actuator).__name__} cannot be calibrated, because "
                "its robots do not have two wheels"
            )
        self.rig = rig
        self.actuator = rig.actuator
        (self.name,) = rig.setup.names
        self._offset_before = offset
        self._dead_zone_max = section.dead_zone_max
        self._scale, self.limit = section.outputs(self.name, limit)
        self._home: Pose | None = None
        """The robot's first position in this calibration. None before its first frame."""
        self._frames_late_s = 0.0
        """How much later than GAP_S a frame may come with this camera [s]."""
        rules_of_fast_robots = replace(
            rig.loop.guard.rules,
            speeds=(FASTEST_MM_S / rig.mm_per_unit,),
            turning=(FASTEST_RAD_S,),
            silence_ns=SILENCE_S * SECOND,
        )
        rig.loop.restart(rules_of_fast_robots)

    def open(self) -> None:
        """Connect to the camera and the robots before a calibration.

        Raises:
            AbortError: Unless the robot is tracked and answers.
        """
        rig = self.rig
        rig.open()
        problems = rig.camera.check().problems
        if problems:
            raise AbortError("; ".join(problems))
        (status,) = rig.actuator.poll(1.0)
        problems = rig.actuator.check().problems
        if problems:
            raise AbortError("; ".join(problems))
        if status.answers is False:  # None: it cannot answer
            raise AbortError(
                f"{self.name} does not answer", "run `tetractl lab check` to find the cause"
            )
        rig.loop.guard.pass_preflight()

    def close(self) -> None:
        """Stop the robot, and release camera and actuator."""
        try:
            self.rig.loop.stop()
        except KeyboardInterrupt:  # stop the robot even if Ctrl-C interrupts the stop once
            self.rig.loop.stop()
            raise
        finally:
            self.rig.close()

    def measure(self) -> Found:
        """Move the robot in small motions, and return its measured values.

        Raises:
            AbortError: If the guard stops the robot, frames are missing, or the values are
                impossible.
        """
        channels = [self._fit_channel(0), self._fit_channel(1)]
        rates_max = [channel.k * (self.limit - channel.dead_zone) for channel in channels]
        outputs = [channel.output(STRAIGHT_FRACTION * min(rates_max)) for channel in channels]
        # signs of the outputs for which the two turning rates cancel
        signs = np.array([1, -channels[0].sign * channels[1].sign])
        straight_outputs = signs * np.array(outputs)
        forwards = self._measure_motion(straight_outputs, STRAIGHT_S)
        backwards = self._measure_motion(-straight_outputs, STRAIGHT_S)
        if forwards.along < 0:
            signs = -signs
            forwards, backwards = backwards, forwards
        self._stop_and_wait()
        radius = self._compute_radius(forwards, channels, outputs)
        offset = self._compute_offset(forwards, backwards)
        wheels = [
            FoundWheel(round(2 * radius * channel.k, 4), channel.dead_zone, sign < 0)
            for channel, sign in zip(channels, signs.tolist(), strict=True)
        ]
        # a right wheel that drives forwards turns the robot to the left
        swapped = channels[0].sign * int(signs[0]) > 0
        left_wheel, right_wheel = reversed(wheels) if swapped else wheels
        whole_offset = math.remainder(self._offset_before + offset, math.tau)
        return Found(
            heading_offset=round(whole_offset, 5),
            radius_mm=round(radius, 3),
            left=left_wheel,
            right=right_wheel,
            swap=swapped,
        )

    def _compute_radius(
        self, straight: SteadyMotion, channels: Sequence[Channel], outputs: Sequence[int]
    ) -> float:
        """Compute the distance r from a wheel to the centre [mm], from v = r (|w1| + |w2|).

        Raises AbortError if the distance is outside RADII_MM.
        """
        speed_mm_s = math.hypot(straight.along, straight.across)
        rates = [
            channel.k * (output - channel.dead_zone)
            for channel, output in zip(channels, outputs, strict=True)
        ]
        radius_mm = speed_mm_s / sum(rates)
        radius_min_mm, radius_max_mm = RADII_MM
        if not radius_min_mm < radius_mm < radius_max_mm:
            raise AbortError(
                f"{self.name}: the measured distance from a wheel to the robot's centre, "
                f"{radius_mm:.0f} mm, is impossible; check that the wheels roll freely"
            )
        return radius_mm

    def _compute_offset(self, forwards: SteadyMotion, backwards: SteadyMotion) -> float:
        """Compute the direction of travel in the body's frame [rad].

        A drift that is the same in both motions cancels. Raises AbortError beyond OFFSET_MAX_RAD.
        """
        offset = math.atan2(forwards.across - backwards.across, forwards.along - backwards.along)
        if abs(offset) > OFFSET_MAX_RAD:
            raise AbortError(
                f"{self.name}: the heading of the rigid body is {math.degrees(offset):.0f} "
                "degrees off the robot's front",
                "set an approximate heading_offset in the spec, or define the rigid body "
                "again in the camera software",
            )
        return offset

    def _fit_channel(self, channel: int) -> Channel:
        """Drive motor channel 0 or 1 in both directions, and fit its factor k and its dead zone.

        The outputs grow from motion to motion.
        """
        outputs = list[int]()
        rates = list[float]()  # means of both directions
        for step in range(FIRST_OUTPUT, int(self.limit / self._scale) + 1, OUTPUT_STEP):
            output = round(step * self._scale)
            rate = self._measure_rate(channel, output)
            if abs(rate) > TURNING_MIN_RAD_S:
                outputs.append(output)
                rates.append(rate)
        self._stop_and_wait()
        if len(rates) < POINTS_MIN:
            raise AbortError(
                f"{self.name}: motor channel {channel + 1} hardly turns the robot, even with "
                f"an output of {self.limit}",
                "is the battery charged, and is the motor connected? If so, raise --limit",
            )
        slope, intercept = np.polyfit(outputs, np.abs(rates), 1)
        turns_both_ways = min(rates) < 0 < max(rates)
        if slope <= 0 or turns_both_ways:
            raise AbortError(
                f"{self.name}: motor channel {channel + 1} does not turn the robot steadily; "
                "charge the battery, and check the wheel"
            )
        dead_zone = min(self._dead_zone_max, max(0, round(-intercept / slope)))
        # the line through the dead zone that has the least squares
        beyond_dead_zone = np.array(outputs) - dead_zone
        k = float(beyond_dead_zone @ np.abs(rates) / (beyond_dead_zone @ beyond_dead_zone))
        return Channel(1 if rates[0] > 0 else -1, k, dead_zone)

    def _measure_rate(self, channel: int, output: int) -> float:
        """Measure the turning rate that an output of one channel causes [rad/s].

        The result is the mean of both directions of turning, so that a drift of the robot cancels.
        """
        counts = np.zeros(2, dtype=np.int64)
        counts[channel] = output
        forwards = self._measure_motion(counts, CHANNEL_S).turning
        backwards = self._measure_motion(-counts, CHANNEL_S).turning
        return (forwards - backwards) / 2

    def _measure_motion(self, counts: CountArray, duration_s: float) -> SteadyMotion:
        """Send outputs for a time [s], and measure the motion once the wheels turn steadily.

        If frames were missing, the motion is repeated, because the guard may have stopped the
        robot.
        """
        for _ in range(ATTEMPTS):
            first_count = self.rig.loop.frames.count
            start_ns = self._send_outputs(counts)
            end_ns = start_ns + round((duration_s + 2 * self._frames_late_s) * SECOND)
            remaining_s = (end_ns - self.rig.clock.now()) / SECOND
            wait_for(self.rig.clock, self._abort_if_astray, remaining_s)
            self._raise_abort()
            frames, _ = self.rig.loop.frames.since(first_count)
            self._frames_late_s = max(self._frames_late_s, _excess_delay_s(frames))
            poses = [pose for pose in collect_timed_poses(frames, 0) if pose.exposed_ns >= start_ns]
            times_ns = [start_ns, *(pose.exposed_ns for pose in poses), end_ns]
            gap_max_ns = (GAP_S + self._frames_late_s) * SECOND
            if max(np.diff(times_ns)) <= gap_max_ns:  # none are missing
                return _fit_steady_motion(
                    poses, start_ns + round(SETTLED_S * SECOND), self.rig.mm_per_unit
                )
            # drive back, so that the robot stays near its place
            self._send_outputs(-counts)
            wait_for(self.rig.clock, self._abort_if_astray, duration_s)
        raise AbortError(
            f"{self.name}: too many camera frames are missing; check the camera and the network"
        )

    def _send_outputs(self, counts: CountArray) -> int:
        """Send outputs (2,) repeatedly, and return the time at which they are first sent [ns]."""
        self.actuator.held_outputs = counts[:, None]
        return self.rig.loop.hold(Steer(0.0)).sent_ns

    def _stop_and_wait(self) -> None:
        """Stop the wheels, and wait until the robot stands still."""
        self._send_outputs(np.zeros(2, dtype=np.int64))
        self.rig.clock.sleep_until(self.rig.clock.now() + round(STAND_S * SECOND))

    def _abort_if_astray(self) -> bool:
        """Abort the calibration if the robot is too far from its first position.

        Returns:
            Whether the calibration has been aborted, for this or another reason.
        """
        guard = self.rig.loop.guard
        newest = self.rig.loop.frames.newest
        pose = None if newest is None else newest.poses[0]
        if pose is not None:
            self._home = self._home or pose
            away_mm = pose.distance_to(self._home) * self.rig.mm_per_unit
            if away_mm > AWAY_MAX_MM:
                guard.abort(f"the robot is {away_mm:.0f} mm from its first position")
        return bool(guard.reason)

    def _raise_abort(self) -> None:
        """Raise AbortError if the guard has aborted the calibration."""
        if self.rig.loop.guard.reason:
            raise AbortError(f"{self.name}: {self.rig.loop.guard.reason}")


def _excess_delay_s(frames: Sequence[AcceptedFrame]) -> float:
    """Compute by how much the wait for a frame of this camera can exceed GAP_S [s].

    One frame may be missing, so the next one comes GAP_PERIODS after the last. The result is 0 for
    fast cameras, and for fewer than three frames.
    """
    if len(frames) < 3:
        return 0.0
    latency_ns = np.median([frame.frame.received_ns - frame.pose_time_ns(0) for frame in frames])
    period_ns = np.median(np.diff([frame.pose_time_ns(0) for frame in frames]))
    return max(0.0, float(GAP_PERIODS * period_ns + latency_ns) / SECOND - GAP_S)


def _fit_steady_motion(
    poses: Sequence[TimedPose], since_ns: int, mm_per_unit: float
) -> SteadyMotion:
    """Fit a steady motion to the poses since the time `since_ns`.

    The turning rate is the slope of the headings. To compute the speeds, each displacement is split
    into its parts along and across the heading in the middle of the displacement. The sums of these
    parts are divided by the time. `mm_per_unit` is the spec's length unit in millimetres.
    """
    settled_poses = [timed for timed in poses if timed.exposed_ns >= since_ns]
    times_s = np.array([timed.exposed_ns for timed in settled_poses]) / SECOND
    x = np.array([timed.pose.x for timed in settled_poses])
    y = np.array([timed.pose.y for timed in settled_poses])
    heading = np.unwrap([timed.pose.heading for timed in settled_poses])
    turning = float(np.polyfit(times_s - times_s[0], heading, 1)[0])
    mean_headings = (heading[1:] + heading[:-1]) / 2
    dx = np.diff(x) * mm_per_unit
    dy = np.diff(y) * mm_per_unit
    span_s = times_s[-1] - times_s[0]
    cos = np.cos(mean_headings)
    sin = np.sin(mean_headings)
    along = float(np.sum(dx * cos + dy * sin) / span_s)
    across = float(np.sum(dy * cos - dx * sin) / span_s)
    return SteadyMotion(turning, along, across)
