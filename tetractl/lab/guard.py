"""The guard: decides, at every tick, which robots may move. It does no I/O and reads no clock.

    preflight --ready()--> ready --go()--> run <--> hold
                             ^              |        |
                             +---- rest() --+--------+      any --> abort, for good

In `hold`, one robot or all are stopped because of a fault that may pass; robots that can only be
stopped together continue to be steered while one is not tracked. `abort` is final. Lengths are in
the spec's length unit, times ns on the run's clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Abort, Finding, Lose, Moved, Refuse, RobotPlace, Warn
from tetractl.core.plan import PAUSE_S
from tetractl.core.poses import CameraFrame, Pose
from tetractl.experiment.lab_section import UNTRACKED_STOP_S
from tetractl.lab.accepted_frame import AcceptedFrame
from tetractl.lab.culprit import Culprit
from tetractl.lab.damage_count import DamageCount
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_checks import ChecksOf, GuardChecks, robot_checks
from tetractl.lab.guard_records import GuardRules, GuardState, Ruling
from tetractl.lab.motion_check import REPEATS, STILL
from tetractl.lab.pose_filter import MotionLimits, PoseFilter

DAMAGED_MAX = 20  # number of damaged pictures or datagrams within a second


@dataclass(slots=True)
class Guard:
    """Decides by `rules` which of N robots may move, from all camera frames, at frequent ticks.

    `checks_of` makes the list of checks of the robots: of wheeled ones by default.
    """

    rules: GuardRules
    checks_of: ChecksOf = robot_checks
    state: GuardState = GuardState.PREFLIGHT
    reason: str = ""
    emergency: bool = False
    jumps: int = 0  # number of poses that were refused
    lost: dict[int, int] = field(default_factory=dict)  # robots, and when each was last seen [ns]
    outdated: int = 0  # frames dropped since the last start because they were not newer
    _filters: list[PoseFilter] = field(default_factory=list)
    _checks: GuardChecks = field(init=False)
    culprit: Culprit = field(init=False)
    _last_frame_ns: int | None = None
    _apart: bool = False  # whether the poses of the newest frame have times of their own
    _outdated_in_a_row: int = 0
    _behind_ns: int = 0  # age of the last outdated frame relative to the newest one
    _warned: set[str] = field(default_factory=set)
    _warnings: list[str] = field(default_factory=list)  # warnings not yet returned
    # robots seen to move in a pause as no command does, and how
    moved: dict[int, str] = field(default_factory=dict)
    _driven: bool = False  # whether `go` was called: robots are not carried any more
    _last_tick_ns: int | None = None
    _steered_ns: int = 0
    _ahead: bool = True
    _damaged: DamageCount = field(default_factory=DamageCount)
    _late: int = 0
    _disobedient: set[int] = field(default_factory=set)  # robots that disobeyed in the newest frame
    _ghosts: dict[int, str] = field(default_factory=dict)  # robots refused for good, and why

    def __post_init__(self) -> None:
        rules, limits, mm = self.rules, self.rules.limits, self.rules.mm
        low, high = limits.height_mm
        motion_limits = partial(
            MotionLimits,
            jump=limits.jump_mm / mm,
            jump_heading=0.7,
            lowest=low / mm,
            highest=high / mm,
            tilt=limits.tilt,
            mm=mm,
        )
        self._filters = [
            PoseFilter(motion_limits(speed, turning))
            for speed, turning in zip(rules.speeds, rules.turning, strict=True)
        ]
        self._checks = self.checks_of(rules)
        self.culprit = Culprit(rules.names, self.drift, mm)

    @property
    def drift(self) -> DriftCheck:
        """The check of motion over the whole trial."""
        return self._checks.drift

    @property
    def together(self) -> bool:
        """Whether no robot can be held still while the others move."""
        return self._checks.together

    @property
    def refused(self) -> tuple[str, ...]:
        """The reason why each robot's newest pose was refused (N,); "" if it was not refused."""
        return tuple(track.refused for track in self._filters)

    def limit(self, rules: GuardRules) -> None:
        """Use other rules from now on, before a run; poses and motion are compared by them, too."""
        self.rules = rules
        self.__post_init__()

    def ready(self) -> None:
        """Enter `ready`: the preflight has passed."""
        if self.state is GuardState.PREFLIGHT:
            self.state = GuardState.READY

    def go(self, now_ns: int) -> None:
        """Enter `run`, so that robots may move; only from `ready`."""
        if self.state is GuardState.READY:
            self.state = GuardState.RUN
            self._last_tick_ns = self._steered_ns = now_ns
            self._driven, self.outdated = True, 0
            for check in self._checks.checks:
                check.start()
            self._disobedient.clear()
            for track in self._filters:  # motion before the run is ignored: robots were carried
                track.forget()

    def rest(self) -> None:
        """Return to `ready`: the run has ended normally and the robots are stopped."""
        if self.state in (GuardState.RUN, GuardState.HOLD):
            self.state = GuardState.READY

    def abort(self, reason: str, emergency: bool = False, suspect: int | None = None) -> None:
        """Enter `abort`, for good; later calls do not change the reason. `suspect` is the robot
        whose poses may be false, None for no one robot."""
        self.emergency |= emergency
        if self.state is not GuardState.ABORT:
            self.state, self.reason = GuardState.ABORT, reason
            self.culprit.suspect = suspect
            limit, newest = UNTRACKED_STOP_S * SECOND, self._last_frame_ns or 0
            self._ghosts = {
                i: track.refused
                for i, track in enumerate(self._filters)
                if track.refused and newest - track.seen_ns > limit
            }

    def steered(self, now_ns: int, ahead: bool = True) -> None:
        """Record that the controller gave a direction; if not `ahead`, robots turn on the spot."""
        self._steered_ns, self._ahead = now_ns, ahead

    def late(self, missed: bool) -> None:
        """Count a control step that missed its deadline; abort after `late_steps` in a row."""
        self._late = self._late + 1 if missed and self._ahead else 0
        if self._late >= self.rules.limits.late_steps and self._active:
            self.abort(f"{self._late} control steps in a row were late")

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s]."""
        for check in self._checks.checks:
            check.sent(now_ns, speed, turning)

    def see(self, frame: CameraFrame) -> AcceptedFrame | None:
        """Check one camera frame; return it with the poses that are accepted.

        Returns None for a frame that was exposed before, or together with, a frame already checked;
        such a frame is dropped and counted.
        """
        if frame.fault:
            self.abort(frame.fault)
        now, newest = frame.sampled_ns, self._last_frame_ns
        if newest is not None and now <= newest:
            self.outdated += 1
            self._outdated_in_a_row += 1
            self._behind_ns = newest - now
            if self._active and self.outdated == 1:
                self._warn(f"a camera frame {self._behind()} was dropped")
            return None
        self._last_frame_ns, self._outdated_in_a_row = now, 0
        times = frame.times([track.seen_ns for track in self._filters])
        self._apart, judged = bool(frame.exposed_ns), self._checks.motion.times
        self._checks.motion.frame(times)
        self.culprit.see(now, frame.poses, times)
        fresh = list[bool]()
        gone_ns = self.rules.limits.untracked_abort * SECOND
        in_run = self._active  # a loss below may end the run: all poses were exposed before
        for i, track in enumerate(self._filters):
            if in_run:
                track.frame(now, self.rules.limits.stale * SECOND)
            if self.rules.goes_on and now - track.seen_ns >= gone_ns:
                self.lose(i, self._untracked(i, now))
        for i, (track, pose) in enumerate(zip(self._filters, frame.poses, strict=True)):
            same = frame.exposed_ns and times[i] <= max(track.seen_ns, judged[i])
            if pose is None or not same:
                self._disobedient.discard(i)
            if pose is None or i in self.lost:
                track.lost()
            elif same:
                pass  # the pose that was accepted or refused before
            elif not track.add(pose, times[i], self._fault(i, pose, times[i], in_run)):
                self.jumps += 1
            seen = pose is not None and i not in self.lost and not track.refused
            fresh.append(seen and now - track.seen_ns <= UNTRACKED_STOP_S * SECOND)
        poses = tuple(track.pose for track in self._filters)
        own = tuple(track.seen_ns for track in self._filters) if self._apart else ()
        accepted = AcceptedFrame(frame, poses, tuple(fresh), own)
        if self._active:
            for check in self._checks.checks:
                for finding in check.frame(now, times, accepted.poses):
                    self._take(finding)
        return accepted

    def lose(self, i: int, reason: str) -> None:
        """Continue without a lost robot; abort if the rules forbid that or no robot is left."""
        if i in self.lost or (self.rules.goes_on and self.state is GuardState.PREFLIGHT):
            return
        if not self.rules.goes_on or len(self.lost) + 1 == len(self._filters):
            self.abort(reason)
        else:
            self.lost[i] = self._filters[i].seen_ns
            self._warnings.append(f"{reason}: the run goes on without this robot")

    def replaced(self, i: int) -> None:
        """Continue with another body in place of a lost robot."""
        del self.lost[i]
        self._ghosts.pop(i, None)
        self._disobedient.discard(i)
        self.moved.pop(i, None)
        self._filters[i] = PoseFilter(self._filters[i].limits, seen_ns=self._last_frame_ns or 0)
        self._checks.motion.forget(i)

    def no_frame(self, silent_ns: int) -> str:
        """Return why no new frame has come for `silent_ns`: after an abort, its reason."""
        text = self.reason or f"no new camera frame for {silent_ns / SECOND:.2f} s"
        old = self._outdated_in_a_row if not self.reason else 0
        return f"{text}: {old} outdated frames came, the last {self._behind()}" if old else text

    def awake(self, now_ns: int) -> None:
        """Abort if nothing was decided for `stream_lost` before the time of a tick; to be called
        before frames are seen that waited meanwhile.
        """
        asleep_ns = 0 if self._last_tick_ns is None else now_ns - self._last_tick_ns
        if self._active and asleep_ns >= self.rules.limits.stream_lost * SECOND:
            self.abort(f"this program stood still for {asleep_ns / SECOND:.1f} s")
        self._last_tick_ns = now_ns

    def tick(self, now_ns: int, damaged: int = 0, failure: str | None = None) -> Ruling:
        """Decide which robots may move now.

        `damaged` is the number of pictures or datagrams so far that the camera could not read,
        `failure` is why the actuator cannot send any more, None if it can.
        """
        limits = self.rules.limits
        self.awake(now_ns)
        if failure:
            self.abort(failure)
        warnings: tuple[str, ...] = ()
        if self._active:
            warnings, self._warnings = tuple(self._warnings), []
        if (recent := self._damaged.recent(now_ns, damaged)) > DAMAGED_MAX and self._active:
            self.abort(f"{recent} damaged camera frames within a second")
        tracked = self._tracked()
        accepted = tuple(self._at_once(i) if ok else None for i, ok in enumerate(tracked))
        if self._active:
            silent_ns, steps = now_ns - self._steered_ns, limits.late_steps
            if self._ahead and silent_ns >= self.rules.silence_ns:
                silent = f"the controller gave no direction for {silent_ns / SECOND:.1f} s"
                self.abort(f"{steps} control steps in a row were late: {silent}")
            if (unseen_ns := now_ns - (self._last_frame_ns or 0)) >= limits.stream_lost * SECOND:
                self.abort(self.no_frame(unseen_ns))
            self._check_tracking()
            self._check_places(accepted)
            warnings, self._warnings = (*warnings, *self._warnings), []
        if not self._active:
            still = (False,) * len(self._filters)
            return Ruling(self.state, still, accepted, self.reason, warnings)
        fresh = now_ns - (self._last_frame_ns or 0) <= limits.stale * SECOND
        # a plan for robots that turn on the spot may take long: they wait for it, as in a pause
        turn_ns = round(PAUSE_S * SECOND) + self.rules.silence_ns
        fresh &= self._ahead or now_ns - self._steered_ns < turn_ns
        tracked = self._tracked()  # without those that were lost just now
        one_by_one = fresh and not self.together
        moving = tracked if one_by_one else (fresh,) * len(tracked)
        well = zip(moving, tracked, self._left, strict=True)
        held = any(left and not (move and seen) for move, seen, left in well)
        self.state = GuardState.HOLD if held else GuardState.RUN
        return Ruling(self.state, moving, accepted, "", warnings)

    def _behind(self) -> str:
        return f"exposed {self._behind_ns / SECOND:.2f} s before the newest frame"

    @property
    def _active(self) -> bool:
        return self.state in (GuardState.RUN, GuardState.HOLD)

    def _fault(self, i: int, pose: Pose, now_ns: int, in_run: bool) -> str:
        """Return why a pose of robot i, exposed in a run or not, is not accepted, "" if it is.

        Motion is compared with commands only while a run may move the robot. In a pause it is noted
        in `moved`, since a stop may be lost and sent again.
        """
        track = self._filters[i]
        before = track.pose
        fault = self._ghosts.get(i) or track.fault(pose, now_ns, self._driven)
        if fault or before is None:
            return fault
        if not in_run:
            if self._driven:
                for check in self._checks.checks:
                    for finding in check.pause(i, before, pose, now_ns):
                        self._take(finding)
            return ""
        if pose == before:  # a robot may stand, or a picture is frozen: not a motion to compare
            stays = track.refused == REPEATS or self._checks.motion.stays(i)
            return REPEATS if stays else ""
        fault = ""
        for check in self._checks.checks:
            for finding in check.pose(i, before, pose):
                if isinstance(finding, Refuse):
                    self._disobedient.add(i)
                    fault = fault or finding.text
                else:
                    self._take(finding)
        return fault

    def _take(self, finding: Finding) -> None:
        """Let a finding of a check take effect."""
        match finding:
            case Moved():
                self.moved.setdefault(finding.robot, finding.text)
            case Lose():
                self.lose(finding.robot, finding.text)
            case Warn():
                self._warn(finding.text)
            case Abort():
                suspect = finding.false[0] if len(finding.false) == 1 else None
                self.abort(finding.text, suspect=suspect)
                self._ghosts |= dict.fromkeys(finding.false, finding.text)

    def _at_once(self, i: int) -> Pose | None:
        """Return the accepted pose of robot i, brought to the newest frame's time if its own is
        earlier."""
        track = self._filters[i]
        late_ns = (self._last_frame_ns or 0) - track.seen_ns
        if track.pose is None or not self._apart or late_ns <= 0:
            return track.pose
        return self.drift.carried(i, track.pose, track.seen_ns, late_ns)

    def _warn(self, text: str) -> None:
        """Add a warning, unless it was given before."""
        if text not in self._warned:
            self._warned.add(text)
            self._warnings.append(text)

    def _tracked(self) -> tuple[bool, ...]:
        limit, newest = UNTRACKED_STOP_S * SECOND, self._last_frame_ns or 0
        # a stopped stream is reported as stopped, not as untracked robots
        return tuple(
            left and track.pose is not None and newest - track.seen_ns <= limit
            for left, track in zip(self._left, self._filters, strict=True)
        )

    def _check_tracking(self) -> None:
        limits, newest = self.rules.limits, self._last_frame_ns or 0
        for i, (name, track) in enumerate(zip(self.rules.names, self._filters, strict=True)):
            lost_ns = newest - track.seen_ns
            if not self._active:
                return  # aborted for a robot before this one
            if i in self.lost:
                continue
            still = self.rules.goes_on and track.refused == STILL  # lost, as one not tracked
            if i in self._disobedient and not still and lost_ns > UNTRACKED_STOP_S * SECOND:
                self.abort(f"{name} {track.refused}", suspect=i)
            elif lost_ns >= limits.untracked_abort * SECOND:
                self.lose(i, self._untracked(i, newest))
            # unseen for three times as long, though not all at once
            elif track.unseen_ns >= 3.0 * limits.untracked_abort * SECOND:
                self.lose(i, f"{name} is seen too rarely: it, or frames, are missing too often")

    @property
    def _left(self) -> tuple[bool, ...]:
        return tuple(i not in self.lost for i in range(len(self._filters)))

    def _untracked(self, i: int, now_ns: int) -> str:
        track = self._filters[i]
        why = f": {track.refused}" if track.refused else ""
        seconds = (now_ns - track.seen_ns) / SECOND
        return f"{self.rules.names[i]} is not tracked{why} ({seconds:.2f} s)"

    def _check_places(self, poses: Sequence[Pose | None]) -> None:
        """Check where the robots are, whose `poses` (N,) are those at the newest frame; nothing is
        looked for any more once the run is aborted."""
        reaction = self.rules.limits.reaction
        robots: list[RobotPlace] = []
        for i, (pose, track) in enumerate(zip(poses, self._filters, strict=True)):
            stands = i in self.lost or not self._ahead
            way = 0.0 if stands else self.rules.speeds[i] * reaction
            robots.append(RobotPlace(pose, track.pose, i in self.lost, way))
        for check in self._checks.checks:
            for finding in check.tick(robots):
                if not self._active:
                    return
                self._take(finding)
