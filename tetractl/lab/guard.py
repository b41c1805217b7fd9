"""The guard decides, many times a second, which robots may move, and stops them after a fault.

It does no input or output and reads no clock: the inner loop gives it camera frames and times.

**Terms.** For each pose in a frame, exactly one of these is true:

    accepted    the guard takes it as the pose of its robot
    refused     it cannot be the robot's pose: it is too far from the last one, it contradicts the
                commands (the robot *disobeys*), or its body was lifted or set down (`robot_track`)
    unchanged   the camera repeats the measurement of an earlier frame
    missing     the frame contains no pose of the robot

and for each robot, at the newest frame:

    tracked     its last accepted pose is at most UNTRACKED_STOP_S old: it may move
    hidden      its last accepted pose is older: it must stop until a new one is accepted
    lost        the run continues without it, until another body replaces it. If the rules do not
                allow that, or if it was the last robot, the run is aborted instead

A *ghost* is a robot whose poses are refused for good, because the camera shows another body in its
place. Robots drive *ahead*, or turn on the spot and wait for a plan. The *rules* are the limits in
the spec. The *checks* depend on the kind of robots. The kernel (`lab.kernel`) contains the rules
that apply to every run, whatever the checks find.

**States of the guard**, and the calls that change them:

    preflight --pass_preflight--> ready --start_run--> run <--decide--> hold
                                    ^                   |                |
                                    +----- end_run -----+----------------+      any --abort--> abort

A run of the guard is shorter than a trial: it ends at each pause, and `start_run` begins the next
one. In `ready`, no robot moves: before a run, in a pause and after the run. In `hold`, one robot or
all are stopped because of a fault that may pass. Robots that can only be stopped together are still
steered while one of them is hidden. `abort` is final.

**What happens next, if**

    a pose jumps              it is refused (`robot_track`) if its distance from a pose of the last
                              second is more than twice what the speed explains plus `jump_mm`; the
                              same holds for the heading, plus JUMP_HEADING. After UNTRACKED_STOP_S
                              (lab_section) the robot is hidden, and stops. After `untracked_abort`
                              it is lost (3), or the run is aborted (10). If the pose stays, so that
                              it comes within reach, the robot disobeys
    a robot disobeys          its poses are refused if it has wheels (`motion_check`), and the run
                              is aborted once it is hidden. Poses of a cell are accepted, with a
                              warning
    a robot has no pose       the same as if its pose jumped
    no frame comes            all robots stop after `stale`. The run is aborted after `stream_lost`
                              (9)
    a control step is late    nothing. After `late_steps` late steps in a row, the run is aborted
    no plan comes             robots continue in the last direction. The run is aborted after the
                              silence that the rules allow (8)
    a robot stops working     on wheels, it disobeys because it does not move, once no command of
                              the last `delay` explains that. The run is aborted when it is hidden
                              (10), or after `untracked_abort` if its pose repeats to the bit. A run
                              that may lose robots (`on_lost` of the spec) continues without it
                              after `untracked_abort` (3). If it is a cell, the guard only warns; a
                              pose that repeats to the bit counts as on wheels
    a device fails            the run is aborted (2, 6)
    the operator stops all    the run is aborted for good (5). Ctrl-C only ends the run, by
                              `end_run`, after the control step

**Why a run is aborted.** The first reason counts. In one step of the inner loop, reasons are tested
in this order:

     1  this program was suspended                             check_awake
     2  the camera reports that a frame's poses are wrong      check_frame, for each frame
     3  a robot is lost, because it was not tracked            check_frame, if a run may lose robots
     4  a check finds a fault in the poses: they drift         check_frame, in the order of checks
     5  the operator stops all robots                          abort
     6  the actuator cannot send any more                      decide
     7  much of the camera's data is damaged                   decide (_check_camera_and_controller)
     8  the controller gives no direction                      the same
     9  no new frame comes                                     the same
    10  a robot disobeys, is not tracked or seen too rarely    decide (_check_tracking)
    11  a check finds robots too close to something            decide, in the order of checks

Between two steps, a run can also be aborted for late control steps (`record_step`), for a robot
that another part reports as lost (`lose_robot`), and by `abort` for faults that only other parts
can notice: a robot moves in a pause, or a device or the inner loop fails.

The inner loop makes the calls of a run, one at a time. Meanwhile, the controller's thread may call
`record_step` and `abort`. It may call `lose_robot` and `replace_robot` between two steps of the
loop. Lengths are in the spec's length unit. Times are in ns on the run's clock.
"""

import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import chain

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import (
    Abort,
    Excess,
    Finding,
    Lose,
    Moved,
    Refuse,
    RobotPlace,
    Warn,
)
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.abort_cause import RECENT_NS, AbortCause
from tetractl.lab.camera_stream import CameraStream
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.frame_buffer import FrameBuffer
from tetractl.lab.frames import AcceptedFrame
from tetractl.lab.guard_checks import ChecksOf, robot_checks
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.kernel import (
    ControlPace,
    check_direction,
    check_frame_age,
    check_program,
    check_tracking,
    compare_age,
    may_move,
)
from tetractl.lab.motion_check import COMPARED_MAX_NS, DOES_NOT_MOVE, POSE_REPEATS, PUSHED_QUESTION
from tetractl.lab.robot_track import MISSING, PoseDecision, RobotTrack

DAMAGED_MAX = 20
"""Maximum number of unreadable images or datagrams within a second that a run tolerates."""
BUSY_BEFORE = "control steps were late (is this computer busy?); afterwards, "
"""Beginning of a message that blames a robot or the camera, if control steps were late before."""
FRAME_REPEATS = "the frame repeats the previous frame to the last bit: is the camera frozen?"
RARELY_FACTOR = 3.0
"""Multiple of `untracked_abort` for which a robot may be unseen in total, with interruptions."""


class GuardState(StrEnum):
    """The states of the guard, from the preflight to the abort of a run."""

    PREFLIGHT = "preflight"
    READY = "ready"
    RUN = "run"
    HOLD = "hold"
    ABORT = "abort"


@dataclass(frozen=True, slots=True)
class Ruling:
    """The guard's decision in one step of the inner loop.

    Attributes:
        state: The guard's state.
        moving: Whether each robot may move, N entries.
        poses: Accepted pose of each robot, N entries. None if a robot is not tracked.
        warnings: New warnings for the operator.
    """

    state: GuardState
    moving: tuple[bool, ...]
    poses: tuple[Pose | None, ...]
    warnings: tuple[str, ...] = ()


class Guard:
    """Decides, from all camera frames, which of N robots may move.

    Args:
        rules: The limits, and the properties of robots, arena and camera.
        checks_of: Creates the checks for the robots. By default, the checks for robots on wheels.

    Attributes:
        state: The guard's state. Several threads may change it.
        reason: Why the run was aborted. Empty before that.
        excess: The value that led to the abort, and its limit. None if the reason has no number.
        emergency: Whether robots have to latch their stops, so that they stay stopped until they
            are switched off and on. Either the operator has pressed the emergency stop, or plain
            stops have not held the robots.
        refusal_count: Number of poses that were refused so far.
    """

    drift: DriftCheck
    """The check of the robots' motion over the whole trial."""
    together: bool
    """Whether all robots share one signal, so that none can be held still while others move."""

    def __init__(self, rules: GuardRules, checks_of: ChecksOf = robot_checks) -> None:
        self.rules = rules
        self.checks_of = checks_of
        self.refusal_count = 0
        self.state = GuardState.PREFLIGHT
        self.reason = ""
        self.excess: Excess | None = None
        self.emergency = False
        self._state_lock = threading.Lock()
        self._suspect: int | None = None  # the robot that seems to be at fault for an abort
        self._stream = CameraStream()
        self._pace = ControlPace()
        self._warnings: list[str] = []  # warnings that no ruling contains yet
        self._warned: set[str] = set()  # warnings that are given only once
        self._robots = [RobotTrack(name, rules, i) for i, name in enumerate(rules.names)]
        created_checks = checks_of(rules)
        self._checks = created_checks.checks
        self.drift = created_checks.drift
        self.together = created_checks.together

    # ---- what others may know ----

    @property
    def refusal_reasons(self) -> tuple[str, ...]:
        """The reason why each robot's newest pose was refused (N,), or ""."""
        return tuple(robot.decision.refusal for robot in self._robots)

    @property
    def is_tracking_all(self) -> bool:
        """Whether every robot has a recent accepted pose, and none is lost."""
        return all(robot.is_tracked for robot in self._robots)

    def is_hidden(self, robot: int) -> bool:
        """Check whether a robot has to stop because no pose of it was accepted for too long."""
        return self._robots[robot].is_hidden

    def refusal_excess(self, robot: int) -> Excess | None:
        """Return the value that led to the refusal of a robot's newest pose, with its limit.

        The result is None if the pose was not refused, or if the reason has no number.
        """
        return self._robots[robot].decision.excess

    @property
    def lost_robots(self) -> dict[int, int]:
        """The lost robots, as {index: time when it was last seen [ns]}.

        The robot that was last seen the longest time ago comes first.
        """
        lost_ns = {i: robot.lost_ns for i, robot in enumerate(self._robots)}
        times_and_robots = [(ns, i) for i, ns in lost_ns.items() if ns is not None]
        return {i: ns for ns, i in sorted(times_and_robots)}

    @property
    def pause_motions(self) -> dict[int, str]:
        """The robots that moved in a pause, as {index: how it moved}."""
        return {i: robot.pause_motion for i, robot in enumerate(self._robots) if robot.pause_motion}

    @property
    def dropped_frame_count(self) -> int:
        """Number of frames dropped since the run started, because newer ones came first."""
        return self._stream.dropped_count

    @property
    def _is_in_run(self) -> bool:
        """Whether a run is on: robots may move, or are held because of a fault that may pass."""
        state = self.state
        return state is GuardState.RUN or state is GuardState.HOLD

    def explain_missing_frames(self, silent_ns: int) -> str:
        """Return a message that explains why no new frame has come for `silent_ns` [ns].

        After an abort, this is the reason of the abort.
        """
        return self.reason or self._stream.describe_silence(silent_ns)

    # ---- states ----

    def pass_preflight(self) -> None:
        """Enter the state `ready`, after the checks before a run have passed."""
        if self.state is GuardState.PREFLIGHT:
            self._enter(GuardState.READY)

    def start_run(self, now_ns: int) -> None:
        """Enter the state `run`, in which robots may move.

        This is possible only from `ready`; in any other state, nothing happens.
        """
        if self.state is not GuardState.READY:
            return
        self._enter(GuardState.RUN)
        self._pace.last_step_ns = now_ns
        self._pace.last_direction_ns = now_ns
        self._pace.has_begun = True
        self._stream.dropped_count = 0
        for check in self._checks:
            check.start()
        for robot in self._robots:
            robot.start_run()

    def _enter(self, state: GuardState) -> None:
        """Enter a state.

        If the run is aborted, even by another thread at this moment, nothing happens.
        """
        with self._state_lock:
            if self.state is not GuardState.ABORT:
                self.state = state

    def end_run(self) -> None:
        """Return to `ready`: the run has ended normally and the robots are stopped."""
        if self._is_in_run:
            self._enter(GuardState.READY)

    def abort(
        self,
        reason: str,
        emergency: bool = False,
        suspect: int | None = None,
        excess: Excess | None = None,
    ) -> None:
        """Abort the run for good. Later calls do not change the reason.

        Robots that are hidden because their poses are refused become ghosts: their poses are
        refused for good.

        Args:
            reason: The reason.
            emergency: Whether robots must latch the stops.
            suspect: Index of the robot that seems to have failed. None if it is not a single robot.
            excess: The value that is beyond its limit. None if the reason has no number.
        """
        with self._state_lock:
            self.emergency |= emergency
            if self.state is GuardState.ABORT:
                return
            self.reason = reason
            self.excess = excess
            self._suspect = suspect
            self.state = GuardState.ABORT
        for robot in self._robots:
            if robot.decision.refusal and robot.is_hidden:
                robot.ghost_reason = robot.decision.refusal

    def name_cause(self, frames: FrameBuffer) -> None:
        """Find the cause of an abort, and correct its reason if the suspect is not the cause.

        This is done once. It uses the last frames, and it is slow, so it is done after the robots
        were stopped.
        """
        suspect = self._suspect
        if suspect is None:
            return
        self._suspect = None
        recent = [accepted.frame for accepted in frames.recent(RECENT_NS)]
        cause = AbortCause(self.rules, self.drift, recent)
        reason = cause.explain(suspect, self.reason) or self.reason
        self.reason = self._add_explanation(reason, recent[-1].received_ns)

    def lose_robot(self, robot_index: int, reason: str, excess: Excess | None = None) -> None:
        """Continue the run without a robot, or abort it if that is not allowed.

        The run is also aborted if no other robot is left. Nothing happens if the robot is lost
        already.

        Args:
            robot_index: Index of the robot.
            reason: Why it is lost.
            excess: The value and its limit. None if the reason has no number.
        """
        robot = self._robots[robot_index]
        if robot.is_lost or (self.rules.may_lose_robots and self.state is GuardState.PREFLIGHT):
            return
        remaining_tracks = [
            track for track in self._robots if track is not robot and not track.is_lost
        ]
        if not self.rules.may_lose_robots or not remaining_tracks:
            self.abort(self._add_explanation(reason, self._pace.last_step_ns or 0), excess=excess)
            return
        robot.lost_ns = robot.last_pose_ns
        self._warnings.append(f"{reason}: the run goes on without this robot")

    def replace_robot(self, robot_index: int) -> None:
        """Continue the run with another body in place of a lost robot."""
        lost_track = self._robots[robot_index]
        seen_ns = lost_track.newest_frame_ns  # it counts as seen now
        self._robots[robot_index] = RobotTrack(
            lost_track.name, self.rules, robot_index, last_pose_ns=seen_ns, newest_frame_ns=seen_ns
        )
        for check in self._checks:
            check.replace(robot_index)

    # ---- what controller and actuator did ----

    def record_direction(self, now_ns: int, ahead: bool = True) -> None:
        """Record that the controller gave a direction.

        Args:
            now_ns: When it gave the direction [ns].
            ahead: Whether robots drive in the direction. Otherwise, they turn to it on the spot.
        """
        self._pace.last_direction_ns = now_ns
        self._pace.drives_ahead = ahead

    def record_step(self, was_late: bool) -> None:
        """Record whether a control step missed its deadline.

        The run is aborted after `late_steps` late steps in a row while robots drive.
        """
        pace = self._pace
        pace.late_steps = pace.late_steps + 1 if was_late and pace.drives_ahead else 0
        pace.last_late_ns = pace.last_step_ns if was_late else pace.last_late_ns
        if pace.late_steps >= self.rules.limits.late_steps and self._is_in_run:
            excess = Excess("late steps", pace.late_steps, self.rules.limits.late_steps)
            reason = f"{pace.late_steps} control steps in a row were late: is this computer busy?"
            self.abort(reason, excess=excess)

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record that an action was transmitted to the robots.

        Args:
            now_ns: When the action was sent [ns].
            speed: Commanded speed of each robot [length unit/s], N entries.
            turning: Commanded turning rate of each robot [rad/s], N entries.
        """
        for check in self._checks:
            check.record_transmission(now_ns, speed, turning)

    # ---- each step of the inner loop: check_awake, check_frame for each new frame, decide ----

    def check_awake(self, now_ns: int) -> None:
        """Abort the run if this program was suspended: it has made no step for `stream_lost`.

        Call this method before the frames are checked that have waited in the meantime.
        """
        excess = check_program(self.rules, self._pace, now_ns)
        if self._is_in_run and excess is not None:
            reason = (
                f"this program stood still for {excess.value:.1f} s: did the computer sleep, or "
                "was the process suspended?"
            )
            self.abort(reason, excess=excess)
        self._pace.last_step_ns = now_ns

    def check_frame(self, frame: CameraFrame) -> AcceptedFrame | None:
        """Check one camera frame, and return it with the poses that are accepted.

        The result is None if the frame was not exposed after all frames checked before. Such a
        frame is dropped and counted.

        The decisions on all poses of the frame use only what was accepted before this frame. Then
        all decisions take effect, and finally the checks compare the robots with each other.
        Whether a run is on is determined once, at the beginning, because the poses were exposed
        during the run, even if one of them ends it.
        """
        if frame.fault:
            self.abort(frame.fault)
        if not self._stream.add_frame(frame, self._pace.has_begun):
            if self._is_in_run and self._stream.dropped_count == 1:
                self._warn_once(f"dropped a late camera frame: it was {self._stream.outdated_text}")
            return None
        was_in_run = self._is_in_run
        times_ns = frame.times([robot.last_pose_ns for robot in self._robots])
        for robot, read_ns in zip(self._robots, times_ns, strict=True):
            robot.record_times(frame.sampled_ns, read_ns, has_own_times=bool(frame.exposed_ns))
        for check in self._checks:
            check.record_exposures(times_ns)
        if was_in_run:
            for robot in self._robots:
                robot.count_absence(self.rules.limits.stale * SECOND)
        if self.rules.may_lose_robots:  # what a frame shows after so long may be another body
            for i, robot in enumerate(self._robots):
                excess = check_tracking(self.rules, i, robot.untracked_ns)
                if excess is not None:
                    self.lose_robot(i, robot.untracked_message, excess)
        decisions = [self._decide_pose(i, pose, was_in_run) for i, pose in enumerate(frame.poses)]
        self._record_poses(decisions)
        accepted = self._combine_accepted(frame)
        for check in self._checks:
            if self._is_in_run:  # up to the first abort
                self._apply(check.check_frame(frame.sampled_ns, times_ns, accepted.poses))
        return accepted

    def decide(self, now_ns: int, damaged_count: int = 0, failure: str | None = None) -> Ruling:
        """Decide which robots may move now. During a run, first look for reasons to end it.

        The controller's thread may end or abort a run at any time. Robots may move only if the run
        still exists after everything has been decided.

        Args:
            now_ns: The present time.
            damaged_count: Number of images or datagrams so far that the camera could not read.
            failure: Why the actuator cannot send any more. None if it can.
        """
        self.check_awake(now_ns)
        if failure:
            self.abort(failure)
        self._stream.damaged.add(now_ns, damaged_count)
        recently_damaged = self._stream.damaged.recent
        poses = tuple(self._predict_pose(i, robot) for i, robot in enumerate(self._robots))
        none_move = (False,) * len(self._robots)
        moving = none_move
        warnings: tuple[str, ...] = ()
        if self._is_in_run:
            self._check_run(now_ns, recently_damaged, poses)
            warnings = tuple(self._warnings)
            self._warnings.clear()
            moving = self._find_movable(now_ns)
        if self._is_in_run:
            all_in_order = all(
                robot.is_lost or (moves and robot.is_tracked)
                for robot, moves in zip(self._robots, moving, strict=True)
            )
            self._enter(GuardState.RUN if all_in_order else GuardState.HOLD)
        state = self.state
        if state is not GuardState.RUN and state is not GuardState.HOLD:
            moving = none_move
        return Ruling(state, moving, poses, warnings)

    # ---- a frame ----

    def _decide_pose(
        self, robot_index: int, pose: Pose | None, is_in_run: bool
    ) -> PoseDecision | None:
        """Decide whether to accept the pose of a robot in the newest frame.

        The result is None if the decision was made in an earlier frame. Only the checks remember
        anything about the pose. The first row that fits decides:

            there is none, or the run continues without the robot   missing
            it is the measurement of an earlier frame               None
            the robot is a ghost, or cannot have come there         refused
            the frame repeats the last one of a noisy camera        refused
            it is the robot's first one, or no run has begun yet    accepted
            a run has begun, but is paused: it may show a motion    accepted, and checks note it
            it equals the last one to the bit, so no motion         as checks find
            it shows a motion, which commands explain or not        as checks find

        A robot that moves in a pause may not have received the stop, so the stop is sent again. A
        robot with a repeated pose may be standing still. However, if its commands must have moved
        it by now, the camera shows a frozen image. Then equal poses are refused until a different
        one arrives, whatever is commanded in the meantime.
        """
        robot = self._robots[robot_index]
        last_pose = robot.last_pose
        if pose is None or robot.is_lost:
            return MISSING
        if not robot.is_new:
            return None
        refusal = robot.find_refusal(pose, robot.newest_pose_ns, self._pace.has_begun)
        if refusal is None and self._stream.repeats:
            refusal = Refuse(robot_index, FRAME_REPEATS)
        if refusal is not None:
            return PoseDecision(refusal=refusal.text, excess=refusal.excess)
        if last_pose is None or not self._pace.has_begun:
            return PoseDecision(pose)
        checks = self._checks
        if not is_in_run:
            findings = [
                check.check_pause(robot_index, last_pose, pose, robot.newest_pose_ns)
                for check in checks
            ]
            return PoseDecision(pose, findings=tuple(chain(*findings)))
        repeats = pose == last_pose
        if repeats and robot.decision.refusal == POSE_REPEATS:
            return PoseDecision(refusal=POSE_REPEATS, excess=robot.decision.excess)
        findings_by_check = [
            check.check_repeat(robot_index)
            if repeats
            else check.check_pose(robot_index, last_pose, pose)
            for check in checks
        ]
        findings = tuple(chain(*findings_by_check))
        for finding in findings:  # the first that refuses gives the reason, all have seen the pose
            if isinstance(finding, Refuse):
                return PoseDecision(None, finding.text, not repeats, findings, finding.excess)
        return PoseDecision(pose, findings=findings)

    def _record_poses(self, decisions: Sequence[PoseDecision | None]) -> None:
        """Apply the decisions on the poses of all robots, and then the findings of the checks."""
        for robot, decision in zip(self._robots, decisions, strict=True):
            if decision is None:
                continue
            robot.decision = decision
            if decision.refusal:
                self.refusal_count += 1
            if decision.accepted is not None:
                robot.accept(decision.accepted, robot.newest_pose_ns)
        for decision in decisions:
            if decision is not None:
                self._apply(decision.findings)

    def _combine_accepted(self, frame: CameraFrame) -> AcceptedFrame:
        """Combine a camera frame with the poses of it that the guard has accepted."""
        poses: list[Pose | None] = []
        is_fresh: list[bool] = []
        times_ns: list[int] = []
        for robot, pose in zip(self._robots, frame.poses, strict=True):
            is_in_frame = pose is not None and not robot.decision.refusal
            poses.append(robot.last_pose)
            is_fresh.append(is_in_frame and not robot.is_lost and not robot.is_hidden)
            times_ns.append(robot.last_pose_ns)
        own_times = tuple(times_ns) if frame.exposed_ns else ()
        return AcceptedFrame(frame, tuple(poses), tuple(is_fresh), own_times)

    # ---- a tick ----

    def _check_run(self, now_ns: int, damaged_count: int, poses: Sequence[Pose | None]) -> None:
        """Look for a reason to end the run, in the order of the module's table.

        Stop at the first one.
        """
        self._check_camera_and_controller(now_ns, damaged_count)
        if self._is_in_run:
            self._check_tracking()
        if not self._is_in_run:
            return
        places = self._describe_places(poses)  # without the robots that were lost just now
        for check in self._checks:
            self._apply(check.check_places(places))
            if not self._is_in_run:
                return

    def _check_camera_and_controller(self, now_ns: int, damaged_count: int) -> None:
        """Abort if the camera or the controller has failed.

        The camera has failed if much of its data cannot be read, or if no frame has arrived for
        `stream_lost`. The controller has failed if robots drive by an old direction. No robot is to
        blame for these faults.
        """
        rules = self.rules
        no_direction = check_direction(rules, self._pace, now_ns)
        no_frame = check_frame_age(rules, self._stream.newest_ns, now_ns)
        if damaged_count > DAMAGED_MAX:
            excess = Excess("damaged frames", damaged_count, DAMAGED_MAX)
            self.abort(f"{damaged_count} damaged camera frames within a second", excess=excess)
        elif no_direction is not None:
            late_text = f"{rules.limits.late_steps} control steps in a row were late"
            silence_text = f"the controller gave no direction for {no_direction.value:.1f} s"
            self.abort(f"{late_text}: {silence_text}", excess=no_direction)
        elif no_frame is not None:
            reason = self._stream.describe_silence(now_ns - self._stream.newest_ns)
            self.abort(self._add_explanation(reason, now_ns), excess=no_frame)

    def _check_tracking(self) -> None:
        """Handle robots that disobey their commands or are not tracked: lose them, or abort.

        If a robot disobeys for as long as it takes to stop it, the run is aborted. If a robot is
        untracked for `untracked_abort`, or is seen too rarely, it is lost. A run that may lose
        robots also loses a robot that does not move.
        """
        absence_max_ns = RARELY_FACTOR * self.rules.limits.untracked_abort * SECOND
        for i, robot in enumerate(self._robots):
            if robot.is_lost:
                continue
            decision = robot.decision
            may_stand_still = self.rules.may_lose_robots and decision.refusal == DOES_NOT_MOVE
            tracking_excess = check_tracking(self.rules, i, robot.untracked_ns)
            absence_excess = compare_age("tracking", robot.unseen_ns, absence_max_ns, i)
            if decision.disobeys and robot.is_hidden and not may_stand_still:
                reason = f"{robot.name} {decision.refusal}"
                self.abort(reason, suspect=i, excess=decision.excess)
            elif tracking_excess is not None:
                self.lose_robot(i, robot.untracked_message, decision.excess or tracking_excess)
            elif absence_excess is not None:
                rarely_seen_text = (
                    "is seen too rarely: the camera sends too few frames, or too few of them "
                    "show this robot"
                )
                self.lose_robot(i, f"{robot.name} {rarely_seen_text}", absence_excess)
            if self.state is GuardState.ABORT:
                return

    def _predict_pose(self, robot_index: int, robot: RobotTrack) -> Pose | None:
        """Return a robot's accepted pose, predicted to the time of the newest frame.

        An older pose is predicted with the commands that were sent. The result is None if the robot
        is hidden or lost.
        """
        pose = robot.last_pose
        if pose is None or not robot.is_tracked:
            return None
        newest = self._stream.newest
        has_own_times = newest is not None and bool(newest.exposed_ns)
        if not has_own_times or robot.untracked_ns <= 0:
            return pose
        return self.drift.predict_pose(robot_index, pose, robot.last_pose_ns, robot.untracked_ns)

    def _describe_places(self, poses: Sequence[Pose | None]) -> list[RobotPlace]:
        """Describe where the robots are, given their `poses` (N,) at the newest frame."""
        places: list[RobotPlace] = []
        for robot, pose, speed in zip(self._robots, poses, self.rules.speeds, strict=True):
            stands_still = robot.is_lost or not self._pace.drives_ahead
            stopping_distance = 0.0 if stands_still else speed * self.rules.limits.reaction
            places.append(
                RobotPlace(
                    robot.last_pose if robot.is_lost else pose, robot.is_lost, stopping_distance
                )
            )
        return places

    def _find_movable(self, now_ns: int) -> tuple[bool, ...]:
        """Decide which robots may move during a run, N entries.

        If robots can only be stopped together, all may move or none.
        """
        any_may_move = may_move(self.rules, self._pace, self._stream.newest_ns, now_ns)
        if self.together:
            return (any_may_move,) * len(self._robots)
        return tuple(any_may_move and robot.is_tracked for robot in self._robots)

    # ---- findings ----

    def _apply(self, findings: Iterable[Finding]) -> None:
        """Apply findings of the checks, up to the first abort."""
        for finding in findings:
            if self.state is GuardState.ABORT:
                return
            match finding:
                case Refuse():
                    pass  # part of the decision on a pose
                case Moved():
                    robot = self._robots[finding.robot]
                    robot.pause_motion = robot.pause_motion or finding.text
                case Lose():
                    self.lose_robot(finding.robot, finding.text, finding.excess)
                case Warn():
                    self._warn_once(finding.text)
                case Abort():
                    self.abort(finding.text, suspect=finding.suspect, excess=finding.excess)
                    for i in finding.false:
                        self._robots[i].ghost_reason = finding.text

    def _warn_once(self, warning: str) -> None:
        """Add a warning of the guard, unless the same one was given before."""
        if warning not in self._warned:
            self._warned.add(warning)
            self._warnings.append(warning)

    def _add_explanation(self, reason: str, now_ns: int) -> str:
        """Extend a reason that blames a robot or the camera by another possible explanation.

        The explanation may be late control steps just before, or slow frames. The text then does
        not ask whether the robot was pushed.
        """
        last_late_ns = self._pace.last_late_ns
        if last_late_ns is not None and now_ns - last_late_ns <= COMPARED_MAX_NS:
            return BUSY_BEFORE + reason.removesuffix(PUSHED_QUESTION)
        slow_hint = self._stream.slow_hint
        return reason.removesuffix(PUSHED_QUESTION) + slow_hint if slow_hint else reason
