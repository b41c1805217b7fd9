"""What the guard remembers of one robot, and decides on its pose. Times are ns on the run's
clock."""

from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Finding
from tetractl.core.poses import Pose
from tetractl.experiment.lab_section import UNTRACKED_STOP_S
from tetractl.lab.accepted_poses import AcceptedPoses

FORGIVEN = 0.25
"""Share of the time for which a robot is seen that is taken off the time for which it was not."""


@dataclass(frozen=True, slots=True)
class PoseDecision:
    """What becomes of a robot's pose: it is `accepted`, or why it is `refused`, and whether that is
    since the robot disobeys; neither if there is none. `findings` are what checks found besides.
    """

    accepted: Pose | None = None
    refused: str = ""
    disobeys: bool = False
    findings: tuple[Finding, ...] = ()


MISSING = PoseDecision()
"""There is no pose."""


@dataclass(slots=True)
class RobotTrack:
    """What the guard remembers of one robot; a body that replaces a lost one has a track of its
    own.
    """

    name: str
    poses: AcceptedPoses
    newest_ns: int = 0
    """When the newest frame was exposed, 0 before the first: all that follows is as of then."""
    read_ns: int = 0
    """The time of its pose in that frame, or of the one accepted before if there is none."""
    is_new: bool = True
    """Whether that frame, if there is a pose in it, shows a new measurement."""
    unseen_ns: float = 0.0
    """For how long it was not seen in runs, less `FORGIVEN` of the time it was seen."""
    _counted_ns: int = 0
    """Time until which that is counted."""
    decision: PoseDecision = MISSING
    """What became of its newest pose."""
    ghost: str = ""
    """Why its poses are refused for good, "" if they are not."""
    lost_ns: int | None = None
    """When a robot that is lost was last seen [ns]; None for one that is not lost."""
    strayed: str = ""
    """How it was first seen to move in a pause, "" if it was not."""

    @property
    def lost(self) -> bool:
        """Whether the run goes on without the robot."""
        return self.lost_ns is not None

    @property
    def untracked_ns(self) -> int:
        """The age of the last accepted pose [ns]."""
        return self.newest_ns - self.poses.last_ns

    @property
    def untracked_text(self) -> str:
        """A text that the robot is not tracked, since when and, if known, why."""
        why = f": {self.decision.refused}" if self.decision.refused else ""
        return f"{self.name} is not tracked{why} ({self.untracked_ns / SECOND:.2f} s)"

    @property
    def hidden(self) -> bool:
        """Whether no pose was accepted for so long that the robot must stop."""
        return self.untracked_ns > UNTRACKED_STOP_S * SECOND

    @property
    def tracked(self) -> bool:
        """Whether the robot may move, as far as its pose is concerned."""
        return self.poses.last is not None and not self.lost and not self.hidden

    def start_run(self) -> None:
        """Forget how the robot moved before a run: it may have been carried."""
        self.poses.start_run()
        self._counted_ns = self.poses.last_ns
        self.decision = MISSING

    def read(self, newest_ns: int, read_ns: int, own_times: bool) -> None:
        """Take the times of the newest frame and of the robot's pose in it.

        Where poses have times of their own, a frame may show a pose again that was measured for one
        before: it is new only if it is later than that accepted, and than that read, last.
        """
        self.is_new = not own_times or read_ns > max(self.poses.last_ns, self.read_ns)
        self.newest_ns = newest_ns
        self.read_ns = read_ns

    def count_absence(self, stale_ns: float) -> None:
        """Count for how long the robot was not seen, up to the newest frame of a run, before its
        poses; it counts as seen until its last pose is `stale_ns` old."""
        seen_until_ns = self.poses.last_ns + stale_ns
        unseen_ns = max(0.0, self.newest_ns - max(self._counted_ns, seen_until_ns))
        seen_ns = self.newest_ns - self._counted_ns - unseen_ns
        self.unseen_ns = max(0.0, self.unseen_ns + unseen_ns - FORGIVEN * seen_ns)
        self._counted_ns = self.newest_ns
