"""Replay the frames and commands of a log to a guard, and report what it would have done.

A guard decides during a run which robots may move. A log contains only the poses that the guard of
the trial accepted. If it refused a pose, the robot is untracked in the log. Heights, tilts and
unknown bodies are not logged either.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pkgutil import resolve_name

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.guard import Guard
from tetractl.lab.guard_checks import ChecksOf, robot_checks
from tetractl.lab.guard_observer import GuardObserver, Intervention
from tetractl.lab.guard_rules import GuardRules
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.wheels import compute_body_velocity
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import LabLimits, LabSection

TICK_NS = SECOND // 100
"""Time between two decisions of the guard if nothing else happens, as in the inner loop [ns]."""
COMMON_CHECKS = ("frame", "direction", "tracking", "speed", "arena", "obstacle", "separation")
"""Names of the checks that apply to every log, in the order of the table."""
WHEEL_CHECKS = ("frozen", "motion", "drift", "wheels")
"""Names of the checks that compare poses with logged wheel speeds."""


@dataclass(frozen=True, slots=True)
class GuardReport:
    """The actions that a guard would have taken in a recorded trial.

    Attributes:
        interventions: All actions that the guard would have taken, the oldest first.
        watched_s: Time in which robots were driven [s].
        checks: Names of the checks that could find something in this log.
        began_ns: The time that users see as 0 [ns].
    """

    interventions: tuple[Intervention, ...]
    watched_s: float
    checks: tuple[str, ...]
    began_ns: int


@dataclass(frozen=True, slots=True, order=True)
class LogEvent:
    """A frame or a command of a log, which sorts in the order of the inner loop.

    If a frame and a command have the same time, the frame comes first.

    Attributes:
        t_ns: Time at which the frame was received or the command was sent [ns].
        is_command: Whether the event is a command. Otherwise, it is a frame.
        row: Index of the frame or of the command in the log.
    """

    t_ns: int
    is_command: bool
    row: int


def ordered_events(log: TrialLog) -> list[LogEvent]:
    """List the frames and commands of a log in the order in which they reached the guard.

    If a frame and a command have the same time, the frame comes first.
    """
    events = [LogEvent(int(t_ns), False, i) for i, t_ns in enumerate(log.received_ns)]
    events += [LogEvent(command.sent_ns, True, i) for i, command in enumerate(log.commands)]
    return sorted(events)


def camera_frame(log: TrialLog, row: int) -> CameraFrame:
    """Build the camera frame of a row of the log. Poses that were not accepted are None."""
    poses = tuple(
        Pose(*pose) if valid else None
        for pose, valid in zip(log.mocap[row].tolist(), log.valid[row], strict=True)
    )
    observation = log.sample(row).observation
    return CameraFrame(
        observation.frame,
        observation.sampled_ns,
        observation.received_ns,
        poses,
        exposed_ns=observation.exposed_ns,
    )


def lab_checks(experiment: Experiment) -> ChecksOf:
    """Return the checks that the guard makes in a spec's lab.

    If the spec has no lab, these are the checks for robots on wheels.
    """
    plant = experiment.plant
    return resolve_name(plant.actuator.checks) if isinstance(plant, LabSection) else robot_checks


def observe_log(log: TrialLog, limits: LabLimits | None = None) -> GuardReport:
    """Let the guard watch a trial again, and report what it would have done.

    Args:
        log: A trial of a lab, an emulated lab, or a simulation.
        limits: Limits to try. By default, the limits of the spec's lab, or the default limits if
            the spec has no lab.

    Returns:
        The guard's interventions, and the time for which it watched.
    """
    rules = GuardRules.from_setup(log.start.setup, limits or lab_limits(log))
    observer = GuardObserver(rules, lab_checks(log.experiment))
    deadline_missed_by_time = {step.command.sent_ns: step.deadline_missed for step in log.steps}
    ticked_ns = 0
    for event in ordered_events(log):
        for tick_ns in _ticks(ticked_ns, event.t_ns):
            observer.decide(tick_ns)
        ticked_ns = event.t_ns
        if event.is_command:
            command = log.commands[event.row]
            if not deadline_missed_by_time or command.sent_ns in deadline_missed_by_time:
                observer.record_step(
                    event.t_ns, deadline_missed_by_time.get(command.sent_ns, False)
                )
                _note_action(observer, command)
            elif isinstance(command.action, Stop):
                observer.end_run()
            note_speeds(observer, log, command)
        else:
            observer.check_frame(event.t_ns, camera_frame(log, event.row))
        observer.decide(event.t_ns)
    knows_speeds = any(command.left is not None for command in log.commands)
    checks = COMMON_CHECKS + (WHEEL_CHECKS if knows_speeds else ())
    watched_s = observer.watched_ns / SECOND
    return GuardReport(tuple(observer.interventions), watched_s, checks, log.began_ns)


def lab_limits(log: TrialLog) -> LabLimits:
    """Return the limits of a log's lab, or the default limits if the spec has no lab."""
    plant = log.experiment.plant
    return plant.limits if isinstance(plant, LabSection) else LabLimits()


def _ticks(since_ns: int, until_ns: int) -> Iterator[int]:
    """Yield the times of the guard's decisions between two events [ns], the events' times excluded.

    Nothing is yielded if `since_ns` is 0, which means that there is no earlier event.
    """
    if since_ns:
        yield from range(since_ns + TICK_NS, until_ns, TICK_NS)


def _note_action(observer: GuardObserver, command: Command) -> None:
    """Pass the controller's decision to the observer.

    A stop ends the run. Any other action starts it, and only `Steer` counts as a direction.
    """
    if isinstance(command.action, Stop):
        observer.end_run()
        return
    observer.start_run(command.sent_ns)
    observer.record_direction(command.sent_ns, isinstance(command.action, Steer))


def note_speeds(guard: Guard | GuardObserver, log: TrialLog, command: Command) -> None:
    """Pass the commanded motion of a logged command to a guard, if the log contains it.

    Args:
        guard: The guard, or the observer of one.
        log: The command's trial.
        command: The command.
    """
    wheel_radius = log.start.setup.wheel_radius
    if wheel_radius is not None and command.left is not None and command.right is not None:
        speed, turning = compute_body_velocity(command.left, command.right, wheel_radius)
        guard.record_transmission(command.sent_ns, speed.tolist(), turning.tolist())
