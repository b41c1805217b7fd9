"""The `apriltag` camera: robots by their tags in pictures."""

from collections.abc import Callable
from dataclasses import replace

from tetractl.core.clock import Clock
from tetractl.core.commands import Health
from tetractl.core.poses import Grey
from tetractl.core.setup import Setup
from tetractl.lab.cameras.apriltag.health import State, health_of
from tetractl.lab.cameras.apriltag.section import AprilTagSection
from tetractl.lab.cameras.apriltag.track import Seen, Tracker
from tetractl.lab.cameras.pictures.picture_camera import PictureCamera


class AprilTagCamera(PictureCamera[Seen]):
    """Tracks N robots by their tags; a `Camera`.

    A robot is not tracked (None) while its tag is not seen, seen twice, or not of its size, and
    none is while the floor is not known.
    """

    def __init__(
        self,
        section: AprilTagSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(section, clock, wake)
        self.section = section
        self._tracker = Tracker(section, setup.names, setup.metres)

    def check(self) -> Health:
        """Examine some pictures and return the problems of source, floor and tags."""
        looks = self._look()
        floor = self._tracker.floor
        state = State(
            source=self.section.source_name,
            ended=self._ended,
            now_ns=self._clock.now(),
            rate_hz=None if self._feed is None else self._feed.rate_hz,
            size=self._size,
            plane=floor.plane or floor.misfit,
            damaged=self.damaged,
            skipped=self._skipped,
        )
        found = health_of(self.section, self._tracker.robots, looks, state)
        return replace(found, emulated=self.emulated)

    def _see(self, picture: Grey, exposed_ns: int) -> Seen:
        return self._tracker.see(picture)
