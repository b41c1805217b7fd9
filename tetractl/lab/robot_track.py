"""What the guard remembers of one robot. Times are ns on the run's clock."""

from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.experiment.lab_section import UNTRACKED_STOP_S
from tetractl.lab.accepted_poses import AcceptedPoses

FORGIVEN = 0.25
"""Share of the time for which a robot is seen that is taken off the time for which it was not."""


@dataclass(slots=True)
class Absence:
    """For how long a robot was not seen in runs [ns], less `FORGIVEN` of the time it was seen."""

    unseen_ns: float = 0.0
    _counted_ns: int = 0  # time until which it is counted

    def leave_out(self, until_ns: int) -> None:
        """Count from a time on only: before it there was no run."""
        self._counted_ns = until_ns

    def count(self, now_ns: int, seen_until_ns: float) -> None:
        """Count up to a frame of a run, before its poses; the robot counts as seen until its last
        pose is too old."""
        unseen_ns = max(0.0, now_ns - max(self._counted_ns, seen_until_ns))
        seen_ns = now_ns - self._counted_ns - unseen_ns
        self.unseen_ns = max(0.0, self.unseen_ns + unseen_ns - FORGIVEN * seen_ns)
        self._counted_ns = now_ns


@dataclass(slots=True)
class RobotTrack:
    """What the guard remembers of one robot; a body that replaces a lost one has a track of its
    own.
    """

    name: str
    poses: AcceptedPoses
    newest_ns: int = 0
    """When the newest frame was exposed, 0 before the first: all that follows is as of then."""
    absence: Absence = field(default_factory=Absence)
    refused: str = ""
    """Why the newest pose was refused, "" if it was accepted or missing."""
    disobeys: bool = False
    """Whether it was refused since it moves as no command does."""
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
        why = f": {self.refused}" if self.refused else ""
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
        self.absence.leave_out(self.poses.last_ns)
        self.refused = ""
        self.disobeys = False
