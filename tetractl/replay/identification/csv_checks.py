"""Whether the poses and commands of a trial in CSV files can be what they say, and what is to be
said of them.

`judge` first goes through REFUSALS, in their order: each raises UsageError if files cannot be used,
and a mistake that would be taken for another stands before that other. Last it asks what turned the
robots, which depends on what is to be said of the clock. Then it collects REMARKS, each of which
returns what to say of files that can be used, None if there is nothing to say. Both lists stand at
the end, and all that is in them takes one `CsvRecording`.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Bools, Floats, turn_problem, wrap
from tetractl.replay.identification.measured_poses import jumps_of
from tetractl.replay.identification.motion_angle import PoseSteps, check_angle
from tetractl.replay.identification.one_recording import (
    Span,
    clock_remark,
    refuse_pause,
    refuse_sparse,
    refuse_times_apart,
)
from tetractl.replay.identification.sent_directions import (
    DELAYS_S,
    FOLLOWED,
    SentDirections,
    TurnedCourse,
    check_clock_rate,
    check_directions,
    check_rotation,
    courses_of_headings,
    image,
    other_readings,
)

# headings in degrees
ALONG = 0.5
"""Share of their ways that headings explain at least if they are in degrees; chosen."""
JUMP = 10.0
"""Median ways between two poses, above which a way is no motion but a wrong place; chosen."""

# headings that are copies of the directions that were sent
TURNED = 0.01
"""A heading is compared if it has turned by more than this since the pose before [rad]; chosen."""
ALIKE = 1e-3
"""It is a copy if a direction is as near as this, as none is that is measured [rad]; chosen."""
COPIES = 0.9
"""Share of the headings compared, above which they are copies; chosen."""
COPIES_MIN = 5
"""Least number of headings compared by which this is checked; chosen."""

# the angle between motion and heading
POSES_MIN = 20
"""Least number of poses by which it is evaluated; chosen."""

# remarks
NO_MEASUREMENT = 0.01
"""Share of a robot's poses that are no measurement, above which it is said; chosen."""
WAY_STEP_S = 0.5
"""Duration of the steps by which the robots' way is measured [s]: noise adds little to it."""


@dataclass(frozen=True, slots=True)
class CsvCommands:
    """What was sent at times `when` (C,) [s], as `u`, `twists` and `frame_age` of a `Track`."""

    when: Floats
    u: Floats
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    frame_age: float | None = None

    @property
    def are_directions(self) -> bool:
        """Whether robots were sent directions, not speeds and turning rates."""
        return self.twists.size == 0

    @property
    def until(self) -> float:
        """When the last command ends [s]: it acts for as long as is usual."""
        return float(self.when[-1]) + _usual_gap(self.when)


@dataclass(frozen=True, slots=True)
class CsvRecording:
    """A trial in CSV files: N robots with `names`, their poses at M times, and C commands.

    `time` (M,) and the times of commands count from `begin` [s], the first time of the poses'
    table. `poses` (M, N, 3) are x, y and heading; `is_stated` (M, N) tells which of them are, and
    `measured` (M, N) which are measurements. `row_times` are the times of the rows of each
    robot [s], also of those that state no pose. `receivers` are the robots that commands name,
    `not_sent_to` those of the poses' table that get none where others do, and `never_seen` those
    without any pose.
    """

    poses_path: Path
    commands_path: Path
    names: tuple[str, ...]
    begin: float
    time: Floats
    poses: Floats
    is_stated: Bools
    measured: Bools
    row_times: list[Floats]
    commands: CsvCommands
    receivers: Collection[str]
    not_sent_to: Collection[str]
    never_seen: Collection[str]

    @property
    def stated_time(self) -> Floats:
        """The times of the poses (M,) as their table states them [s]."""
        return self.begin + self.time

    @property
    def stated_when(self) -> Floats:
        """The times of the commands (C,) as their table states them [s]."""
        return self.begin + self.commands.when

    @property
    def poses_span(self) -> Span:
        """The stated times of the poses."""
        return Span(str(self.poses_path), self.begin, self.begin + float(self.time[-1]))

    @property
    def commands_span(self) -> Span:
        """The stated times of the commands, until the last one ends."""
        begin = self.begin + float(self.commands.when[0])
        return Span(str(self.commands_path), begin, self.begin + self.commands.until)


def names_of(robots: Collection[str]) -> str:
    """Return the names of robots as text."""
    return ", ".join(printable(robot) or "rows without a robot" for robot in sorted(robots))


def _usual_gap(times: Floats) -> float:
    """Return the median time between increasing times, 0 for a single one."""
    if len(times) < 2:
        return 0.0
    gaps = np.diff(times)
    return float(np.median(gaps))


# ---- Refusals ----


def _refuse_headings_in_degrees(recording: CsvRecording) -> None:
    """Refuse headings in degrees: beyond a turn, and at one angle to the motion, there and back,
    only as degrees. Those of `tetractl export` count whole turns in rad.
    """
    beyond = float(np.abs(recording.poses[recording.is_stated][:, 2]).max(initial=0.0))
    problem = turn_problem(beyond)
    if problem is None:
        return
    along_rad = 0.0
    along_degrees = 0.0
    ways = 0.0
    for robot in range(len(recording.names)):
        x, y, heading = recording.poses[recording.is_stated[:, robot], robot].T
        way = np.diff(x + 1j * y)
        way *= np.abs(way) <= JUMP * np.median(np.abs(way))
        squares = way**2
        ways += float(np.abs(squares).sum())
        as_rad = heading[:-1]
        as_degrees = np.radians(as_rad)
        along_rad += abs((squares * np.exp(-2j * as_rad)).sum())
        along_degrees += abs((squares * np.exp(-2j * as_degrees)).sum())
    if along_degrees > max(along_rad, ALONG * ways):
        said, hint = problem
        raise UsageError(
            f"{recording.poses_path}: a heading of {beyond:g} {said}",
            f"{hint}, or name the column heading_deg",
        )


def _refuse_copied_directions(recording: CsvRecording) -> None:
    """Refuse headings that are the directions that were sent, at their times or a command before or
    after."""
    when = recording.commands.when
    newest = np.searchsorted(when, recording.time, side="right") - 1
    near = np.clip(newest[:, None] + np.array([-1, 0, 1]), 0, len(when) - 1)
    for robot, name in enumerate(recording.names):
        headings = recording.poses[:, robot, 2]
        off = np.abs(wrap(headings[:, None] - recording.commands.u[near])).min(axis=1)
        turned = np.abs(wrap(np.diff(headings))) > TURNED
        is_copy = off[1:][turned] < ALIKE
        if len(is_copy) >= COPIES_MIN and is_copy.mean() > COPIES:
            raise UsageError(
                f"{recording.poses_path}: the headings of {printable(name)} are the directions "
                "that were sent",
                "give the headings that were measured",
            )


def _refuse_sparse_poses(recording: CsvRecording) -> None:
    """Refuse poses too far apart, also those of the robot that is seen most often."""
    densest = min(recording.row_times, key=_usual_gap)
    refuse_sparse(str(recording.poses_path), densest)


def _refuse_long_pauses(recording: CsvRecording) -> None:
    """Refuse poses of two clocks, or days."""
    refuse_pause(str(recording.poses_path), recording.stated_time)


def _refuse_motion_beside_headings(recording: CsvRecording) -> None:
    """Refuse robots that follow directions and do not move along their headings."""
    if not recording.commands.are_directions:
        return
    for robot, name in enumerate(recording.names):
        rows = np.flatnonzero(recording.measured[:, robot])
        if len(rows) >= POSES_MIN:
            steps = PoseSteps.of(recording.time[rows], recording.poses[rows, robot])
            check_angle(str(recording.poses_path), printable(name), steps, steps.duration_s)


def _refuse_two_clocks(recording: CsvRecording) -> None:
    """Refuse commands none of which acts in the time of the poses."""
    refuse_times_apart(recording.poses_span, recording.stated_when, recording.commands_span)


def _refuse_other_turning(recording: CsvRecording, clock: str | None) -> None:
    """Refuse robots that turn by other directions than those that they were sent; and directions
    that explain little of their turning, unless what is said of the `clock` says why."""
    if not recording.commands.are_directions:
        return
    turned: list[TurnedCourse] = []
    for robot in range(len(recording.names)):
        rows = recording.measured[:, robot]
        turned += courses_of_headings(recording.stated_time[rows], recording.poses[rows, robot, 2])
    directions = SentDirections(recording.stated_when, recording.commands.u)
    poses_source = str(recording.poses_path)
    source = str(recording.commands_path)
    least_explained = 0.0
    if clock is None:
        least_explained = FOLLOWED
        check_clock_rate(source, turned, directions)
    readings = [
        image(poses_source, source, directions),
        *other_readings(source, directions, _usual_gap(recording.stated_time)),
    ]
    check_directions(poses_source, turned, directions, DELAYS_S, readings, least_explained)
    check_rotation(poses_source, source, turned, directions)


# ---- Remarks ----


def _poses_left_out(recording: CsvRecording) -> str | None:
    """Return of which robots a share above NO_MEASUREMENT of the poses is no measurement."""
    said: list[str] = []
    counts_stated = recording.is_stated.sum(axis=0).tolist()
    counts_measured = recording.measured.sum(axis=0).tolist()
    for name, stated, measured in zip(recording.names, counts_stated, counts_measured, strict=True):
        share = 1 - measured / max(stated, 1)
        if share > NO_MEASUREMENT:
            said.append(f"{share:.1%} of {printable(name)}")
    if not said:
        return None
    return (
        f"{recording.poses_path}: poses that repeat the one before, or jump away and back, are "
        f"left out: {', '.join(said)}"
    )


def _jumps(recording: CsvRecording) -> str | None:
    """Return which robots are suddenly elsewhere, and when first."""
    jumped: list[str] = []
    for robot, name in enumerate(recording.names):
        rows = np.flatnonzero(recording.measured[:, robot])
        times = recording.stated_time[rows]
        jumps = jumps_of(times, recording.poses[rows, robot])
        if len(jumps):
            jumped.append(f"{printable(name)} at {times[jumps[0]]:.2f} s")
    if not jumped:
        return None
    return (
        f"{recording.poses_path}: poses jump and stay there: {', '.join(jumped)}: is it another "
        "robot from then on, or was it carried?"
    )


def _robots_without_commands(recording: CsvRecording) -> str | None:
    """Return which robots are sent nothing where others are."""
    if not recording.not_sent_to:
        return None
    return (
        f"{recording.commands_path}: no command is for {names_of(recording.not_sent_to)}; commands "
        f"are for {names_of(recording.receivers)}"
    )


def _robots_without_poses(recording: CsvRecording) -> str | None:
    """Return which robots are never seen."""
    if not recording.never_seen:
        return None
    return f"{recording.poses_path}: no pose is of {names_of(recording.never_seen)}"


def _clock(recording: CsvRecording) -> str | None:
    """Return what to say of commands that act at other times than the robots are seen."""
    return clock_remark(
        recording.poses_span,
        recording.stated_when,
        recording.commands_span,
        _share_of_way(recording),
    )


def _share_of_way(recording: CsvRecording) -> float:
    """Return the share of their way that robots drive while commands act, in steps of WAY_STEP_S:
    robots that stand before their first command and after their last need none."""
    time = recording.time
    _, rows = np.unique(time // WAY_STEP_S, return_index=True)  # the first pose in each step
    moved = np.diff(recording.poses[rows, :, :2], axis=0)
    way = np.nansum(np.hypot(moved[..., 0], moved[..., 1]), axis=1)
    first_s = float(recording.commands.when[0])
    acts = (time[rows[1:]] > first_s) & (time[rows[:-1]] < recording.commands.until)
    if not way.any():
        return 1.0
    return float(way[acts].sum() / way.sum())


# ---- All checks, in their order ----

REFUSALS: tuple[Callable[[CsvRecording], None], ...] = (
    _refuse_headings_in_degrees,
    _refuse_copied_directions,
    _refuse_sparse_poses,
    _refuse_long_pauses,
    _refuse_motion_beside_headings,
    _refuse_two_clocks,
)
REMARKS: tuple[Callable[[CsvRecording], str | None], ...] = (
    _poses_left_out,
    _jumps,
    _robots_without_commands,
    _robots_without_poses,
)


def judge(recording: CsvRecording) -> tuple[str, ...]:
    """Return what is to be said of a recording; UsageError if it cannot be used."""
    for refuse in REFUSALS:
        refuse(recording)
    clock = _clock(recording)
    _refuse_other_turning(recording, clock)
    remarks = [*(remark_on(recording) for remark_on in REMARKS), clock]
    return tuple(remark for remark in remarks if remark is not None)
