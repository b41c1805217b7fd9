"""What ends a run, or a robot's part in it, whatever the robots are: one function a cause, each a
pure function of the `Situation` at a tick. `RUN_CHECKS` is their order.

Times are ns on the run's clock.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Abort, Finding, Lose
from tetractl.lab.camera_stream import Outdated, no_frame_text, with_outdated
from tetractl.lab.guard_records import GuardRules
from tetractl.lab.motion_faults import DOES_NOT_MOVE

DAMAGED_MAX = 20
"""Most pictures or datagrams of a second that may be damaged."""
RARELY = 3.0
"""A robot may be unseen for so many times `untracked_abort`, though not all at once."""


@dataclass(frozen=True, slots=True)
class RobotSituation:
    """A robot at a tick: for how long its last accepted pose is the last (`untracked_ns`) and for
    how long it was not seen in all (`unseen_ns`), at the newest frame.
    """

    name: str
    lost: bool
    refused: str  # why its newest pose was refused, "" if it was not
    disobeys: bool  # whether that is since it moves as no command does
    hidden: bool  # whether it has been untracked for so long that it must stop
    untracked_ns: int
    unseen_ns: float


@dataclass(frozen=True, slots=True)
class Situation:
    """A run at a tick: for how long the controller has given no direction and the camera no frame,
    how many pictures or datagrams were damaged within a second, and the robots (N,).
    """

    rules: GuardRules
    undirected_ns: int
    ahead: bool  # whether robots drive ahead; else they turn on the spot, and wait for a plan
    frameless_ns: int
    outdated: Outdated
    damaged: int
    robots: tuple[RobotSituation, ...]


def damaged_frames(now: Situation) -> Iterator[Finding]:
    """Abort if the camera sends much that cannot be read."""
    if now.damaged > DAMAGED_MAX:
        yield Abort(f"{now.damaged} damaged camera frames within a second")


def silent_controller(now: Situation) -> Iterator[Finding]:
    """Abort if robots drive ahead by an old direction."""
    if now.ahead and now.undirected_ns >= now.rules.silence_ns:
        silent = f"the controller gave no direction for {now.undirected_ns / SECOND:.1f} s"
        yield Abort(f"{now.rules.limits.late_steps} control steps in a row were late: {silent}")


def silent_camera(now: Situation) -> Iterator[Finding]:
    """Abort if no frame has come for `stream_lost`; it is then no robot that is not tracked."""
    if now.frameless_ns >= now.rules.limits.stream_lost * SECOND:
        yield Abort(with_outdated(no_frame_text(now.frameless_ns), now.outdated))


def untracked_robots(now: Situation) -> Iterator[Finding]:
    """For each robot that is not lost: abort if it disobeys for as long as stops it; lose it if it
    is not tracked for `untracked_abort`, or if it is seen too rarely.

    A run that may lose robots loses one that does not move as any other that is not tracked.
    """
    limit_ns = now.rules.limits.untracked_abort * SECOND
    for i, robot in enumerate(now.robots):
        if robot.lost:
            continue
        stuck = now.rules.goes_on and robot.refused == DOES_NOT_MOVE
        if robot.disobeys and robot.hidden and not stuck:
            yield Abort(f"{robot.name} {robot.refused}", suspect=i)
        elif robot.untracked_ns >= limit_ns:
            yield Lose(i, untracked_text(robot))
        elif robot.unseen_ns >= RARELY * limit_ns:
            rarely = "is seen too rarely: it, or frames, are missing too often"
            yield Lose(i, f"{robot.name} {rarely}")


def untracked_text(robot: RobotSituation) -> str:
    """Return a text that a robot is not tracked, since when and, if known, why."""
    why = f": {robot.refused}" if robot.refused else ""
    return f"{robot.name} is not tracked{why} ({robot.untracked_ns / SECOND:.2f} s)"


RunCheck = Callable[[Situation], Iterator[Finding]]

RUN_CHECKS: tuple[RunCheck, ...] = (
    damaged_frames,
    silent_controller,
    silent_camera,
    untracked_robots,
)
"""In this order; the first abort is the reason of the run's end."""
