"""Report what the guard would have done, without stopping any robot.

A `GuardObserver` gets the same frames, directions and transmissions as the guard of a run, and
passes them to a guard of its own. It records each pose that this guard refuses, each robot that it
stops, and each run that it ends. After each end, it continues with a new guard. In this way, checks
can be tuned on recordings and during a run.

An `ObservingGuard` is the guard of a run with `lab.limits.observe`. Its kernel (`lab.kernel`) acts
as always. Its statistical checks, which test motion and drift, only report: their limits depend on
how well wheels follow commands, which differs from lab to lab. Times are in ns on the run's clock.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Excess, Finding, RobotPlace, Warn
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.frames import AcceptedFrame
from tetractl.lab.guard import FRAME_REPEATS, Guard, GuardState, Ruling
from tetractl.lab.guard_checks import ChecksOf, GuardChecks, robot_checks
from tetractl.lab.guard_rules import GuardRules

STATISTICAL = ("motion", "drift", "wheels")
"""Names of the checks whose limits depend on how well robots follow their commands."""
REMEMBERED_NS = 2 * SECOND
"""Time for which transmissions are kept to pass them to a new guard [ns].

Checks look back for this time.
"""


class Action(StrEnum):
    """What a guard does about a fault, from the mildest action to the strongest."""

    REFUSES = "refuses a pose"
    STOPS = "stops the robot"
    ENDS = "ends the run"


@dataclass(frozen=True, slots=True)
class Intervention:
    """One action that the guard would have taken in a run: when, why, and about which robot.

    Attributes:
        t_ns: Time of the action [ns].
        act: What the guard would have done.
        check: Name of the check, or of the kernel's rule.
        robot: Name of the robot. Empty if the action concerns no robot, or all.
        text: The guard's reason.
        excess: The value and its limit. None if the check does not report them.
    """

    t_ns: int
    act: Action
    check: str
    robot: str
    text: str
    excess: Excess | None


@dataclass(frozen=True, slots=True)
class SentCommand:
    """A transmission: its time, and the commanded speeds and turning rates of the robots."""

    sent_ns: int
    speed: Sequence[float]
    turning: Sequence[float]


class GuardObserver:
    """Watches a run with a guard of its own, and records what this guard would have done.

    Call its methods as the inner loop calls the methods of a guard. After its guard has ended the
    run, a new guard begins as soon as it has seen all robots. A pose that stays refused, or a robot
    that stays stopped, counts once.

    Attributes:
        interventions: All interventions so far, the oldest first.
        watched_ns: For how long a guard has watched a run [ns].
    """

    def __init__(self, rules: GuardRules, checks_of: ChecksOf = robot_checks) -> None:
        self.rules = rules
        self.interventions: list[Intervention] = []
        self.watched_ns = 0
        self._checks_of = checks_of
        self._is_in_run = False
        self._watched_until_ns = 0
        self._recent_commands: deque[SentCommand] = deque()
        self._drives_ahead = True
        self._directed_ns = 0
        self._replace_guard()

    def _replace_guard(self) -> None:
        """Continue with a new guard, which has not seen any robot yet."""
        n_robots = len(self.rules.names)
        self._guard = Guard(self.rules, self._checks_of)
        self._guard.pass_preflight()
        for command in self._recent_commands:
            self._guard.record_transmission(command.sent_ns, command.speed, command.turning)
        self._refused = ("",) * n_robots
        self._moving = (True,) * n_robots

    def start_run(self, now_ns: int) -> None:
        """Begin to watch a run, unless one is watched already."""
        if not self._is_in_run:
            self._is_in_run = True
            self._watched_until_ns = now_ns
            self._guard.start_run(now_ns)

    def end_run(self) -> None:
        """Stop watching a run, because the robots were stopped."""
        self._is_in_run = False
        self._guard.end_run()

    def record_direction(self, now_ns: int, ahead: bool = True) -> None:
        """Record that the controller gave a direction; see `Guard.record_direction`."""
        self._directed_ns = now_ns
        self._drives_ahead = ahead
        self._guard.record_direction(now_ns, ahead)

    def record_step(self, now_ns: int, was_late: bool) -> None:
        """Record whether a control step that ended at `now_ns` [ns] missed its deadline."""
        self._guard.record_step(was_late)
        self._record_end(now_ns)

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record that an action was transmitted to the robots.

        Args:
            now_ns: Time of the transmission [ns].
            speed: The robots' speeds (N,) [length unit/s].
            turning: Their turning rates (N,) [rad/s].
        """
        self._recent_commands.append(SentCommand(now_ns, speed, turning))
        while self._recent_commands[0].sent_ns < now_ns - REMEMBERED_NS:
            self._recent_commands.popleft()
        self._guard.record_transmission(now_ns, speed, turning)

    def replace_robot(self, robot_index: int) -> None:
        """Continue with another body in place of a lost robot."""
        self._guard.replace_robot(robot_index)

    def check_frame(self, now_ns: int, frame: CameraFrame) -> None:
        """Pass a camera frame to the guard, and record the poses that the guard refuses.

        After an end of the run, the new guard begins to watch once it has seen all robots.
        """
        self._guard.check_frame(frame)
        is_new = self._guard.state is GuardState.READY
        if self._is_in_run and is_new and self._guard.is_tracking_all:
            self._guard.start_run(now_ns)
            self._guard.record_direction(self._directed_ns, self._drives_ahead)
            self._watched_until_ns = now_ns
        if self._is_in_run:
            self._record_refusals(now_ns)
            self._record_end(now_ns)

    def decide(self, now_ns: int) -> None:
        """Let the guard decide at `now_ns` [ns], and record which robots it would stop."""
        if not self._is_in_run or self._guard.state is GuardState.READY:
            return
        self.watched_ns += now_ns - self._watched_until_ns
        self._watched_until_ns = now_ns
        ruling = self._guard.decide(now_ns)
        if ruling.state is GuardState.RUN or ruling.state is GuardState.HOLD:
            self._record_stops(now_ns, ruling)
        self._record_end(now_ns)

    def _record_refusals(self, now_ns: int) -> None:
        """Record each robot whose poses the guard refuses since this frame."""
        reasons = self._guard.refusal_reasons
        for i, reason in enumerate(reasons):
            if reason and not self._refused[i]:
                excess = self._guard.refusal_excess(i)
                self._add_intervention(
                    now_ns, Action.REFUSES, i, reason, excess, name_check(reason, excess)
                )
        self._refused = reasons

    def _record_stops(self, now_ns: int, ruling: Ruling) -> None:
        """Record each robot that the guard stops since this decision."""
        for i, moves in enumerate(ruling.moving):
            if self._moving[i] and not moves and i not in self._guard.lost_robots:
                reason = self._refused[i]
                if reason:
                    excess = self._guard.refusal_excess(i)
                    self._add_intervention(
                        now_ns, Action.STOPS, i, reason, excess, name_check(reason, excess)
                    )
                elif self._guard.is_hidden(i):
                    self._add_intervention(
                        now_ns, Action.STOPS, i, "it is not tracked", None, "tracking"
                    )
                else:
                    self._add_intervention(
                        now_ns, Action.STOPS, i, "no new frame came", None, "frame"
                    )
        self._moving = ruling.moving

    def _record_end(self, now_ns: int) -> None:
        """If the guard has aborted the run, record this, and continue with a new guard."""
        guard = self._guard
        if guard.state is not GuardState.ABORT:
            return
        excess = guard.excess
        robot_index = excess.robot if excess is not None else None
        self._add_intervention(
            now_ns, Action.ENDS, robot_index, guard.reason, excess, name_check(guard.reason, excess)
        )
        self._replace_guard()

    def _add_intervention(
        self,
        t_ns: int,
        action: Action,
        robot: int | None,
        reason: str,
        excess: Excess | None,
        check: str,
    ) -> None:
        name = "" if robot is None else self.rules.names[robot]
        self.interventions.append(Intervention(t_ns, action, check, name, reason, excess))


def name_check(reason: str, excess: Excess | None) -> str:
    """Return the name of the guard check that gave a reason.

    It is the name in `excess` if there is one. Otherwise the text decides: "frozen" for a repeated
    frame, "height" for a body at a wrong height or tilt, and "other" for everything else.
    """
    if excess is not None:
        return excess.check
    if reason == FRAME_REPEATS:
        return "frozen"
    return "height" if reason.startswith("its body ") else "other"


# ---- in a run ----


class ObservingCheck(GuardCheck):
    """A wrapper of a statistical check that ignores most findings, so that it only observes.

    Three kinds of findings still count: warnings; motion in a pause, because robots have to stand
    still then; and a pose that repeats to the last bit, because it is not a new measurement.
    """

    def __init__(self, check: GuardCheck) -> None:
        self._check = check

    def start(self) -> None:
        """Start the wrapped check for a new run, so that it forgets all earlier observations."""
        self._check.start()

    def replace(self, robot: int) -> None:
        """Let the wrapped check forget a lost robot, because another body replaces it."""
        self._check.replace(robot)

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Pass a transmission on to the wrapped check; see `GuardCheck.record_transmission`."""
        self._check.record_transmission(now_ns, speed, turning)

    def record_exposures(self, times: tuple[int, ...]) -> None:
        """Pass the times at which a frame's poses were measured on to the wrapped check [ns]."""
        self._check.record_exposures(times)

    def check_repeat(self, robot: int) -> Iterable[Finding]:
        """Return the wrapped check's findings about a pose that repeats to the last bit."""
        return self._check.check_repeat(robot)

    def check_pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterable[Finding]:
        """Return the wrapped check's findings in a pause; see `GuardCheck.check_pause`."""
        return self._check.check_pause(robot, before, pose, now_ns)

    def check_pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Return only the wrapped check's warnings about a pose; see `GuardCheck.check_pose`.

        Any other finding restarts the check at this pose.
        """
        for finding in self._check.check_pose(robot, before, pose):
            if isinstance(finding, Warn):
                yield finding
            else:
                self._check.replace(robot)

    def check_frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> Iterator[Finding]:
        """Return only the wrapped check's warnings about a frame; see `GuardCheck.check_frame`."""
        for finding in self._check.check_frame(now_ns, times, poses):
            if isinstance(finding, Warn):
                yield finding

    def check_places(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Return only the wrapped check's warnings about places; see `GuardCheck.check_places`."""
        for finding in self._check.check_places(robots):
            if isinstance(finding, Warn):
                yield finding


def observe_only(checks: GuardChecks) -> GuardChecks:
    """Wrap the statistical checks of a list, so that they only observe."""
    wrapped_checks = [
        ObservingCheck(check) if check.statistical else check for check in checks.checks
    ]
    return replace(checks, checks=tuple(wrapped_checks))


class ObservingGuard(Guard):
    """A guard whose statistical checks only warn that they would have ended the run.

    The kernel's rules act as in any other guard.
    """

    def __init__(self, rules: GuardRules, checks_of: ChecksOf = robot_checks) -> None:
        super().__init__(rules, lambda rules: observe_only(checks_of(rules)))
        self.checks_of = checks_of
        self._observer = GuardObserver(rules, checks_of)
        self._reported = 0  # number of interventions that were looked at

    def start_run(self, now_ns: int) -> None:
        """Enter the state `run`, in which robots may move; see `Guard.start_run`."""
        super().start_run(now_ns)
        self._observer.start_run(now_ns)

    def end_run(self) -> None:
        """Return to the state `ready`; see `Guard.end_run`."""
        super().end_run()
        self._observer.end_run()

    def record_direction(self, now_ns: int, ahead: bool = True) -> None:
        """Record that the controller gave a direction; see `Guard.record_direction`."""
        super().record_direction(now_ns, ahead)
        self._observer.record_direction(now_ns, ahead)

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record a transmission; see `Guard.record_transmission`."""
        super().record_transmission(now_ns, speed, turning)
        self._observer.record_transmission(now_ns, speed, turning)

    def replace_robot(self, robot_index: int) -> None:
        """Continue with another body in place of a lost robot; see `Guard.replace_robot`."""
        super().replace_robot(robot_index)
        self._observer.replace_robot(robot_index)

    def check_frame(self, frame: CameraFrame) -> AcceptedFrame | None:
        """Check one camera frame, also with the observing guard; see `Guard.check_frame`."""
        accepted = super().check_frame(frame)
        self._observer.check_frame(frame.received_ns, frame)
        return accepted

    def decide(self, now_ns: int, damaged_count: int = 0, failure: str | None = None) -> Ruling:
        """Decide which robots may move, with warnings of the observer; see `Guard.decide`."""
        ruling = super().decide(now_ns, damaged_count, failure)
        self._observer.decide(now_ns)
        interventions = self._observer.interventions[self._reported :]
        self._reported += len(interventions)
        warnings = [
            f"observed: {describe_intervention(intervention)}"
            for intervention in interventions
            if intervention.act is Action.ENDS and intervention.check in STATISTICAL
        ]
        return replace(ruling, warnings=(*ruling.warnings, *warnings))


def build_guard(rules: GuardRules, checks_of: ChecksOf = robot_checks) -> Guard:
    """Create the guard of a run. With `lab.limits.observe`, its statistical checks only observe."""
    return (ObservingGuard if rules.limits.observe else Guard)(rules, checks_of)


def describe_intervention(intervention: Intervention) -> str:
    """Describe in a sentence what a check would have done, with its value and its limit."""
    excess = intervention.excess
    text = f"the {intervention.check} check would have ended the run: {intervention.text}"
    if excess is None:
        return text
    unit = f" {excess.unit}" if excess.unit else ""
    return f"{text} ({excess.value:.3g}{unit}, limit {excess.limit:.3g}{unit})"
