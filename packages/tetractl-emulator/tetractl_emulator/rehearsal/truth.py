"""The true course of a test run, and our program's view of it, as arrays.

A test run of a rehearsal is called a day. The emulation records its events as JSON lines, each with
its kind (`event`) and its time (`t_ns`):

| event     | recorded                        | content                                           |
| --------- | ------------------------------- | ------------------------------------------------- |
| `truth`   | at an exposure of the camera    | poses, wheels, how long each robot was unseen     |
| `command` | when it leaves the wire         | flags, driven robots, how long each was unseen    |
| `guard`   | when the guard's state changes  | the state: `wait`, `run`, `hold`, `abort` ...     |
| `fault`   | when a fault begins and ends    | the fault's row in the day's plan                 |

`Truth` converts these events and the trial's log to arrays. T counts exposures, N robots, C
commands, F frames of the log, K corners of a shape. Times are seconds since the emulation began,
lengths are in mm, and headings in rad. An exposure is identified by its row in arrays of length T.

The observer of a rehearsal shares no code with the guard, so distances are computed here.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Turn
from tetractl.core.errors import TetractlError
from tetractl.core.plan import PAUSE_S
from tetractl.core.poses import Bools, Floats, Integers
from tetractl.core.setup import Setup
from tetractl.core.shape import Shape
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog
from tetractl.spec.lab_section import LabLimits
from tetractl_emulator.fault_rows import FRAME_S
from tetractl_emulator.process import CONTINUE_NS
from tetractl_emulator.rehearsal.day import DayOutcome

RecordedEvent = Mapping[str, Any]
"""A recorded event: a row of the table above, as a mapping."""

RUN_FLAG = 1
"""Flag of a command: robots may be driven."""
EMERGENCY_FLAG = 2
"""Flag of a command: robots stop until they are switched off."""
RUNNING_BIT = 1
"""Bit of a robot's status: it obeys a command that drives it."""
LATCHED_BIT = 2
"""Bit of a robot's status: it has received an emergency stop."""
SILENT_BIT = 4
"""Bit of a robot's status: it has received no command for the time of its watchdog."""

DRIVING_STATES = ("run", "hold")
"""States of the guard in which it lets robots be driven."""
LATE_FRAMES = ("late_pictures", "late_frames", "reordered")
"""Names of the faults that make frames late by their field `by`."""
VISIBLE_SPEED_MM_S = 10.0
"""Minimum speed that a camera shows clearly within one second [mm/s]."""
VISIBLE_RATE_RAD_S = 0.1
"""Minimum turning rate that a camera shows clearly within one second [rad/s]."""
TRANSIT_S = 0.05
"""Maximum time from an event to its command at the robots [s].

It includes a step of our program (10 ms), a frame of the camera, the UART and the radio.
"""
FROM_ORIGIN_MM = 1000.0
"""Distance from the origin for which the speed of poses in a growing image is computed [mm]."""
NOISE_MM_S = 5.0
"""Speed that the poses of stationary robots seem to have because of noise; chosen [mm/s]."""
WHEEL_RADIUS = 0.04
"""Distance from a wheel to the robot's centre, if the spec has no wheels [length unit].

It is the distance of an m3pi robot in metres.
"""
NO_EXPOSURE = -1
"""Index that stands for an unknown exposure."""
EXPOSURE_MATCH_S = 0.02
"""Maximum difference between the time of an image and the time of its exposure [s]."""


@dataclass(frozen=True, slots=True)
class Violation:
    """A violation of an invariant in a randomised test run.

    Attributes:
        name: Name of the invariant.
        at_s: When it was violated [s].
        finding: What was observed.
    """

    name: str
    at_s: float
    finding: str


@dataclass(frozen=True, slots=True)
class TimeSpan:
    """A time interval.

    Attributes:
        began_s: When it began [s].
        ended_s: When it ended [s]. inf if it did not end.
    """

    began_s: float
    ended_s: float


@dataclass(frozen=True, slots=True)
class VisibleFault:
    """A fault that became visible.

    Attributes:
        span: The interval in which it was visible.
        fields: The fault's fields in the plan of the test run.
    """

    span: TimeSpan
    fields: RecordedEvent

    @property
    def name(self) -> str:
        """Name of the fault in a script, such as `ghost`."""
        return str(self.fields["fault"])

    @property
    def variant(self) -> str:
        """Name of the fault's variant in randomised test runs, such as `pose creeps`."""
        return str(self.fields["kind"])

    @property
    def is_kill(self) -> bool:
        """Whether this fault kills our process with SIGKILL. Other signals do not count."""
        return self.fields.get("signal") == "KILL"

    @property
    def speed_mm_s(self) -> float:
        """Speed at which a creeping fault moves a pose at FROM_ORIGIN_MM from the origin [mm/s]."""
        growth_mm = abs(self.fields.get("scale", 1.0) - 1.0) * FROM_ORIGIN_MM
        return (math.hypot(*self.fields.get("by", (0.0, 0.0))) + growth_mm) / FRAME_S

    @property
    def turn_rate_rad_s(self) -> float:
        """Absolute rate at which a creeping fault turns poses [rad/s]."""
        return abs(self.fields.get("turn", 0.0)) / FRAME_S


def time_s(event: RecordedEvent) -> float:
    """Return the time of a recorded event [s] on the clock of the emulation."""
    return float(event["t_ns"] / SECOND)


def nearest_exposures(
    stamps_s: Floats, exposures_s: Floats, suspended: Sequence[TimeSpan]
) -> Integers:
    """Find the exposure that is nearest to the time of each image, shape (F,).

    An image that arrives while our program is suspended waits, and gets its time only when the
    program reads it. Its exposure is therefore unknown.

    Args:
        stamps_s: Times of the images [s], shape (F,).
        exposures_s: Times of the exposures [s], shape (T,).
        suspended: Intervals in which our program was suspended.

    Returns:
        The index of the exposure of each image, shape (F,). NO_EXPOSURE if no exposure is near.
    """
    differences_s = np.abs(exposures_s[:, None] - stamps_s)
    is_certain = differences_s.min(axis=0) < EXPOSURE_MATCH_S
    for span in suspended:
        is_certain &= (stamps_s < span.began_s) | (stamps_s > span.ended_s)
    return np.where(is_certain, differences_s.argmin(axis=0), NO_EXPOSURE)


@dataclass
class Truth:
    """What truly happened in a randomised test run with N robots, derived from the recorded events.

    All properties are computed when they are first used.

    Attributes:
        day: The result of the test run.
        setup: The constants of the experiment.
        limits: The limits of the lab.
        watchdog_s: Time without a command after which a robot stops by itself [s].
        can_stand_still: Whether robots can stand still. False for cells.
    """

    day: DayOutcome
    setup: Setup
    limits: LabLimits
    watchdog_s: float
    can_stand_still: bool = True

    @property
    def unit_mm(self) -> float:
        """Size of the spec's length unit [mm]."""
        return self.setup.metres * 1000

    # What was recorded

    @cached_property
    def _events_by_kind(self) -> dict[str, list[RecordedEvent]]:
        """The recorded events of each kind, in the order of time."""
        by_kind = dict[str, list[RecordedEvent]]()
        for event in self.day.events:
            by_kind.setdefault(event["event"], []).append(event)
        return by_kind

    def events(self, kind: str, **facts: Any) -> list[RecordedEvent]:
        """Return the events of a kind that have all the given facts, in the order of time."""
        events_of_kind = self._events_by_kind.get(kind, [])
        return [event for event in events_of_kind if facts.items() <= event.items()]

    def first_event_s(self, kind: str, **facts: Any) -> float:
        """Return the time of the first event of a kind with these facts [s].

        The result is inf if there is no such event.
        """
        return min(map(time_s, self.events(kind, **facts)), default=np.inf)

    # Exposures

    @cached_property
    def exposures(self) -> list[RecordedEvent]:
        """The recorded events of the camera's T exposures, in the order of time."""
        return self.events("truth")

    @cached_property
    def times_s(self) -> Floats:
        """When each of the camera's T exposures happened, shape (T,) [s]."""
        return np.array([*map(time_s, self.exposures)])

    @cached_property
    def poses(self) -> Floats:
        """True poses at the exposures, shape (T, N, 3) [mm, mm, rad], in the spec's axes."""
        poses = np.array([exposure["poses"] for exposure in self.exposures])
        return poses.reshape(-1, len(self.setup.names), 3)

    @cached_property
    def wheel_speed_mm_s(self) -> Floats:
        """Absolute speed of each robot's faster wheel at the exposures, shape (T, N) [mm/s].

        It is 0 if the wheel speeds are unknown.
        """
        count = len(self.setup.names)
        at_rest = [[0.0, 0.0]] * count
        wheels = np.array([exposure.get("wheels", at_rest) for exposure in self.exposures])
        return np.abs(wheels).reshape(-1, count, 2).max(axis=2)

    @cached_property
    def unseen_s(self) -> Floats:
        """Time since the camera last showed each robot, at each exposure, shape (T, N) [s].

        It is 0 if it is unknown, for example in a dish with more cells than the steered ones.
        """
        count = len(self.setup.names)
        unknown = [0.0] * count
        rows = [exposure["unseen_ms"] for exposure in self.exposures]
        rows_of_robots = [row if len(row) == count else unknown for row in rows]
        return np.array(rows_of_robots).reshape(-1, count) / 1000

    def has_status(self, status_bit: int) -> Bools:
        """Check whether robots have a status flag at the exposures, shape (T, N).

        Args:
            status_bit: RUNNING_BIT, LATCHED_BIT or SILENT_BIT.

        Returns:
            Whether the flag is set. False if the status is unknown.
        """
        count = len(self.setup.names)
        unknown = [0] * count
        status = np.array([row.get("status", unknown) for row in self.exposures], dtype=int)
        return (status.reshape(-1, count) & status_bit) > 0

    @property
    def process_ended_s(self) -> float:
        """Time at which our process ended [s]. 0 if there was no exposure.

        The emulation continues for `CONTINUE_NS` after this time.
        """
        if not len(self.times_s):
            return 0.0
        return float(self.times_s[-1]) - CONTINUE_NS / SECOND

    # Commands

    @cached_property
    def commands(self) -> list[RecordedEvent]:
        """The recorded events of the C commands, in the order of time."""
        return self.events("command")

    @cached_property
    def commanded_s(self) -> Floats:
        """When each of the C recorded commands happened, shape (C,) [s]."""
        return np.array([*map(time_s, self.commands)])

    def driven_by(self, command: RecordedEvent) -> list[bool]:
        """Check which robots a recorded command lets drive.

        Returns:
            One entry for each robot. The list is empty if the command contains no motor speeds.
        """
        if "drives" in command:
            return command["drives"]
        may_run = bool(command["flags"] & RUN_FLAG)
        return [may_run and any(wheels) for wheels in command.get("wheels", ())]

    @cached_property
    def stop_commands_s(self) -> list[float]:
        """Times of the commands that let no robot drive [s], in the order of time."""
        return [time_s(command) for command in self.commands if not any(self.driven_by(command))]

    @cached_property
    def acting_s(self) -> Floats:
        """How long each command acts, shape (C,) [s].

        A command acts until the next command, or until the robots' watchdogs expire because no
        further command arrives.
        """
        next_s = np.append(self.commanded_s[1:], self.process_ended_s)
        return np.clip(next_s - self.commanded_s, 0.0, self.watchdog_s)

    @cached_property
    def undirected_s(self) -> Floats:
        """Time since the controller last gave a direction, at each command, shape (C,) [s].

        If robots were commanded to turn on the spot, the time counts from the end of their turn.
        The time is 0 before the first direction, without a log, and after the last direction in an
        incomplete log.
        """
        if self.trial is None or not self.trial.steps:
            return np.zeros(len(self.commanded_s))
        steps = self.trial.steps
        directed_s = np.array([step.command.sent_ns for step in steps]) / SECOND
        is_turn = [isinstance(step.command.action, Turn) for step in steps]
        turns_s = np.where(is_turn, PAUSE_S, 0.0)
        last_step = np.searchsorted(directed_s, self.commanded_s, "right") - 1
        is_known = last_step >= 0
        if self.trial.result is None:
            is_known &= last_step < len(directed_s) - 1
        since_s = self.commanded_s - directed_s[last_step] - turns_s[last_step]
        return np.where(is_known, np.maximum(0.0, since_s), 0.0)

    # States of the guard

    @cached_property
    def driven_spans(self) -> list[TimeSpan]:
        """The intervals in which the guard let robots be driven, in the order of time.

        An interval that is still open ends when our process ended. Intervals of no length are left
        out.
        """
        spans = list[TimeSpan]()
        began_s: float | None = None
        for event in self.events("guard"):
            may_drive = event["state"] in DRIVING_STATES
            if may_drive and began_s is None:
                began_s = time_s(event)
            elif not may_drive and began_s is not None:
                spans.append(TimeSpan(began_s, time_s(event)))
                began_s = None
        if began_s is not None and began_s < self.process_ended_s:
            spans.append(TimeSpan(began_s, self.process_ended_s))
        return [span for span in spans if span.began_s < span.ended_s]

    @cached_property
    def steering_began_s(self) -> float:
        """When the guard first let the controller steer [s]. inf if it never did."""
        return self.first_event_s("guard", state="run")

    @cached_property
    def abort_s(self) -> float:
        """Time of the guard's abort [s]. inf if there was none."""
        return self.first_event_s("guard", state="abort")

    @cached_property
    def driving_ended_s(self) -> float:
        """Time at which our program stopped driving robots for good [s].

        It is the time of the abort, or the time at which the guard left its driving states for
        good. It is inf if neither happened.
        """
        left_run_s = np.inf
        is_driving = False
        for event in self.events("guard"):
            was_driving = is_driving
            is_driving = event["state"] in DRIVING_STATES
            if is_driving:
                left_run_s = np.inf
            elif was_driving:
                left_run_s = time_s(event)
        return min(self.abort_s, left_run_s)

    @property
    def emergency_pressed_s(self) -> float:
        """Time of the first emergency stop by the operator [s]. inf if there was none."""
        return self.first_event_s("fault", name="emergency", phase="start")

    @cached_property
    def undriven_from_s(self) -> float:
        """Time from which no process drives robots any more [s].

        It is the time at which our program stopped driving, or the time at which a fault killed our
        process, whichever came first. It is inf if neither happened.
        """
        return min(
            [self.driving_ended_s, *(fault.span.began_s for fault in self.faults if fault.is_kill)]
        )

    # Faults

    @cached_property
    def faults(self) -> list[VisibleFault]:
        """The faults that became visible, in the order in which they became visible.

        The span of a fault that did not end has the end inf.
        """
        planned = self.day.plan.faults_in_order
        ended_s = {event["row"]: time_s(event) for event in self.events("fault", phase="end")}
        visible = list[VisibleFault]()
        for event in self.events("fault", phase="start"):
            row = event["row"]
            span = TimeSpan(time_s(event), ended_s.get(row, np.inf))
            visible.append(VisibleFault(span, dict(planned[row])))
        return visible

    def faults_of(self, *names: str) -> list[VisibleFault]:
        """Return the visible faults with one of these names, in the order of time."""
        return [fault for fault in self.faults if fault.name in names]

    def robot_index_of(self, fault: VisibleFault) -> int:
        """Return the index of the robot that has a fault, in the order of the spec."""
        return self.setup.names.index(fault.fields["robot"])

    def total_delay_s(self, *names: str) -> float:
        """Sum the delays that the visible faults with these names cause [s].

        All such faults of the test run count, even if they have ended. The sum is 0 if there are no
        such faults.
        """
        return sum(fault.fields["by"] for fault in self.faults_of(*names))

    def had_fault(self, *names: str) -> bool:
        """Check whether a fault with one of these names became visible during the test run."""
        return bool(self.faults_of(*names))

    @cached_property
    def was_killed(self) -> bool:
        """Whether a fault killed our process during this test run."""
        return any(fault.is_kill for fault in self.faults)

    @cached_property
    def creeping_faults(self) -> list[VisibleFault]:
        """The visible faults that move poses a little further with each frame."""
        return [
            fault
            for fault in self.faults
            if fault.name == "ghost" or fault.fields.get("creeps", False)
        ]

    @cached_property
    def faults_showing_motion(self) -> list[VisibleFault]:
        """The visible faults by which a camera clearly shows motion, even of stationary robots.

        The list is empty for cells, which cannot stand still.
        """
        return [
            fault
            for fault in (self.creeping_faults if self.can_stand_still else ())
            if fault.speed_mm_s > VISIBLE_SPEED_MM_S or fault.turn_rate_rad_s > VISIBLE_RATE_RAD_S
        ]

    @cached_property
    def false_poses_look_true(self) -> bool:
        """Whether false poses look like true poses in this test run, so that nothing reveals them.

        This is the case if false poses move no faster than a robot could move because its wheel
        speeds are wrong by `wheel_error`. It is also the case if the image crept before the run, so
        that all poses are measured in the displaced image.
        """
        setup = self.setup
        speed_error_mm_s = self.limits.wheel_error * float(setup.speed.max()) * self.unit_mm
        rate_error_rad_s = speed_error_mm_s / ((setup.wheel_radius or WHEEL_RADIUS) * self.unit_mm)
        for fault in self.creeping_faults:
            is_slow = (
                fault.speed_mm_s <= speed_error_mm_s + NOISE_MM_S
                and fault.turn_rate_rad_s <= rate_error_rad_s
            )
            was_before = fault.name == "picture" and fault.span.ended_s <= self.steering_began_s
            if is_slow or was_before:
                return True
        return False

    @cached_property
    def frozen_poses_look_stationary(self) -> bool:
        """Whether poses froze in this test run and looked like the poses of stationary robots.

        This is the case if the camera measures on a grid, and a fault repeated its poses or frames.
        """
        return self.setup.sight.has_grid and self.had_fault("repeat", "freeze")

    @cached_property
    def has_frame_numbers(self) -> bool:
        """Whether the camera numbers its frames. False if there were no exposures."""
        return any(exposure["frame"] for exposure in self.exposures)

    @cached_property
    def has_frame_times(self) -> bool:
        """Whether the camera's frames contain the times of their exposures.

        For example, the readings of a mat only have times of arrival.
        """
        return self.has_frame_numbers and not self.setup.sight.has_grid

    @cached_property
    def hidden_delay_s(self) -> float:
        """Maximum delay of a frame that the frame's time does not show [s].

        It is 0 if frames contain the times of their exposures, otherwise `longest_delay_s`.
        """
        return 0.0 if self.has_frame_times else self.longest_delay_s

    @cached_property
    def longest_delay_s(self) -> float:
        """Maximum delay of frames [s], because of faults or because they waited to be read.

        It is the sum over all such faults of the test run.
        """
        frames_late_s = self.total_delay_s(*LATE_FRAMES)
        suspended_s = sum(fault.fields["for"] for fault in self.faults_of("stopped"))
        busy_s = sum(fault.fields["seconds"] for fault in self.faults_of("busy"))
        return frames_late_s + suspended_s + busy_s

    # The log

    @cached_property
    def log(self) -> TrialLog | str:
        """The trial's log, or an error message if it cannot be read. "" if there is no log."""
        if self.day.log is None:
            return ""
        try:
            return trial_of(self.raw_log)
        except (TetractlError, ValueError, KeyError) as error:
            return f"{type(error).__name__}: {error}"

    @cached_property
    def raw_log(self) -> RawLog:
        """The raw records of the trial's log, which must exist.

        Raises:
            LogError: If the log has no records.
        """
        assert self.day.log is not None, "there is a log"
        return scan(self.day.log)

    @property
    def trial(self) -> TrialLog | None:
        """The trial's log. None if there is no log, or if it cannot be read."""
        return self.log if isinstance(self.log, TrialLog) else None

    @property
    def reason(self) -> str:
        """Why the trial was aborted or the run was refused. Empty if neither happened."""
        if self.trial is not None and self.trial.result is not None:
            result = self.trial.result
            return result.reason if result.outcome == "aborted" else ""
        error = re.search(r"^error: (?:trial 1: )?(.*)", self.day.output, re.MULTILINE)
        return error[1] if error else ""

    @cached_property
    def robots_named_at_end(self) -> set[str]:
        """The robots that the run named as still moving, or as not shown to stand still.

        Empty if it named none.
        """
        named = re.findall(
            r"th(?:is|ese) robots? (?:still moves?|stand still): ([^:;\n]*):", self.day.output
        )
        if "the cameras do not show that the robots stand" in self.day.output:
            named.append(", ".join(self.setup.names))
        return {name for names in named for name in names.split(", ")}

    # The log against the truth

    @cached_property
    def exposure_of_frame(self) -> Integers:
        """Index of the exposure of each of the F frames in the log, shape (F,).

        The exposure is found by the number of the frame. Images have no numbers, so their exposures
        are found by time. The index is NO_EXPOSURE if the exposure is unknown.
        """
        assert self.trial is not None, "a log was read"
        if self.has_frame_numbers:
            return self._exposures_by_number(self.trial)
        host_s = self.times_s.copy()
        for fault in self.faults_of("host_clock"):
            is_set = self.times_s >= fault.span.began_s
            host_s[is_set] += fault.fields["by"]
        suspended = [fault.span for fault in self.faults_of("stopped")]
        return nearest_exposures(self.trial.mocap_ns / SECOND, host_s, suspended)

    def _exposures_by_number(self, trial: TrialLog) -> Integers:
        """Find the exposure of each frame in a log by the frame's number, shape (F,).

        If several exposures have the number, the nearest in time counts. The index is NO_EXPOSURE
        if no exposure has the number.
        """
        numbers = np.array([exposure["frame"] for exposure in self.exposures])
        times_ns = self.times_s * SECOND
        row_of_frame = np.full(len(trial.frames), NO_EXPOSURE)
        for i, number in enumerate(trial.frames):
            rows = np.flatnonzero(numbers == number)
            if len(rows):  # a counter that goes back repeats numbers: the nearest in time is meant
                row_of_frame[i] = rows[np.abs(times_ns[rows] - trial.mocap_ns[i]).argmin()]
        return row_of_frame

    @property
    def has_exposure(self) -> Bools:
        """Whether the exposure of each frame in the log is known, shape (F,)."""
        return self.exposure_of_frame != NO_EXPOSURE

    @cached_property
    def logged_exposures(self) -> Integers:
        """Indices of the known exposures of frames in the log, in the order of the log."""
        return self.exposure_of_frame[self.has_exposure]

    @property
    def final_exposure(self) -> int:
        """Index of the exposure of the last frame in the log.

        After this exposure, people may move robots. If the exposure of no frame is known, the index
        is -1, which means the last exposure of all.
        """
        return int(self.logged_exposures[-1]) if len(self.logged_exposures) else -1

    @cached_property
    def accepted_poses(self) -> Floats:
        """The newest pose of each robot that our program had accepted, at each exposure.

        The shape is (T, N, 3) [mm, mm, rad]. The poses are NaN before the first accepted pose, and
        after the end of an incomplete log.
        """
        poses = np.full((len(self.times_s), len(self.setup.names), 3), np.nan)
        if self.trial is None or not len(self.trial.frames):
            return poses
        unit_mm = self.unit_mm
        logged = self.trial.mocap[self.has_exposure]
        poses[self.logged_exposures] = logged * (unit_mm, unit_mm, 1.0)
        end_row = len(poses)
        if self.trial.result is None:
            logged_rows = np.flatnonzero(~np.isnan(poses).all(axis=(1, 2)))
            end_row = int(logged_rows.max(initial=0))
        for row in range(1, end_row):
            poses[row] = np.where(np.isnan(poses[row]), poses[row - 1], poses[row])
        return poses

    @cached_property
    def is_fresh(self) -> Bools:
        """Whether the log contains a pose of each robot from each exposure, shape (T, N).

        All entries are False if there is no log.
        """
        fresh = np.zeros((len(self.times_s), len(self.setup.names)), bool)
        if self.trial is None:
            return fresh
        is_of_frame = self.trial.exposed_ns == self.trial.mocap_ns[:, None]
        is_fresh = self.trial.valid & is_of_frame
        fresh[self.logged_exposures] = is_fresh[self.has_exposure]
        return fresh

    @cached_property
    def is_repeated(self) -> Bools:
        """Whether each fresh pose equals the previously accepted pose, shape (T, N).

        The entries of the first exposure are False.
        """
        equal = np.zeros(self.is_fresh.shape, bool)
        equal[1:] = (self.accepted_poses[1:] == self.accepted_poses[:-1]).all(axis=-1)
        return equal & self.is_fresh

    @cached_property
    def position_error_mm(self) -> Floats:
        """Distance of the accepted position of each robot from its true position, (T, N) [mm].

        The distance is 0 before the first accepted pose.
        """
        offset = self.accepted_poses - self.poses
        return np.nan_to_num(np.hypot(offset[..., 0], offset[..., 1]))

    @cached_property
    def outside_mm(self) -> Floats:
        """How far each robot is outside the arena or inside an obstacle, shape (T, N) [mm].

        It is 0 for a robot at an allowed place. The centre of a robot must be inside the arena, as
        in the spec, and farther from obstacles than the body's radius.
        """
        arena = self.setup.arena
        x = self.poses[..., 0] / self.unit_mm
        y = self.poses[..., 1] / self.unit_mm
        beyond_rim = [arena.left - x, x - arena.right, arena.bottom - y, y - arena.top]
        inside = [
            self.setup.body_radius - distances_to_shape(obstacle, x, y)
            for obstacle in self.setup.obstacles
        ]
        return np.maximum(np.max(beyond_rim + inside, axis=0), 0.0) * self.unit_mm


def distances_to_shape(shape: Shape, x: Floats, y: Floats) -> Floats:
    """Compute the distances of points to a shape. A distance is negative inside the shape.

    A shape is the polygon of its K corners, grown by its radius. A circle has one corner. Points
    are complex numbers. The point of an edge from a to b that is nearest to p is a + s (b - a),
    where s is Re((p - a) / (b - a)) clipped to [0, 1]. The point p is inside if the angles under
    which it sees the edges add up to a full turn.

    Args:
        shape: The shape.
        x: x of the points, any shape.
        y: y of the points, the same shape as `x`.

    Returns:
        The distances, the same shape as `x`, in the unit of the points.
    """
    points = x + 1j * y
    corners = shape.corners[:, 0] + 1j * shape.corners[:, 1]
    if len(corners) == 1:
        return np.abs(points - corners[0]) - shape.radius
    distance = np.full(points.shape, np.inf)
    turned_rad = np.zeros(points.shape)
    for edge_start, edge_end in zip(corners, np.roll(corners, -1), strict=True):
        edge_fraction = np.clip(((points - edge_start) / (edge_end - edge_start)).real, 0.0, 1.0)
        to_edge = np.abs(points - edge_start - edge_fraction * (edge_end - edge_start))
        distance = np.minimum(distance, to_edge)
        turned_rad += np.angle((edge_end - points) * np.conj(edge_start - points))
    is_inside = np.abs(turned_rad) > np.pi
    return np.where(is_inside, -distance, distance) - shape.radius
