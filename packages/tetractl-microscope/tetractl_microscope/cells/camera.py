"""The `cells` camera: tracks swimming cells in a microscope's pictures."""

import math
from collections import deque
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import FrameAddition, Health
from tetractl.core.poses import Bools, Floats, Grey, Pose
from tetractl.core.setup import Setup
from tetractl.experiment.lab_section import LabLimits
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.cell_watch import CellWatch, Identities
from tetractl_microscope.cells.cells_health import SeenDish, cell_count, dish_lines
from tetractl_microscope.cells.detect_cells import Light
from tetractl_microscope.cells.field_signals import FieldSignals
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR, WALL_UM, Piece
from tetractl_microscope.cells.identity_watch import SURE
from tetractl_microscope.cells.kernels.helix_steps import SPEED, WAY, A
from tetractl_microscope.cells.section import CellsSection, Lengths
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.organisms import named
from tetractl_microscope.pictures.picture_camera import Join, PictureCamera
from tetractl_microscope.pictures.whole_pictures import PictureLog

BACKGROUND = 15  # number of pictures from which the background is computed
WIDER = 1.5  # deviations found in films over those of the filter, which fits no cell's noise
MEAN_S = 2.0  # time from which a cell's speed is the mean since it was first seen [s]
ADDED = 1024  # most pictures queued; one per second is kept whole


class CellCamera(PictureCamera[SeenDish]):
    """Tracks N cells; a `Camera`.

    Once at least as many cells are in view as the spec has robots, the cells nearest to the starts
    become the robots. A lost cell is tracked again if it reappears within 3 s; if it reappears
    later, it is a stranger. `steered` tells the camera the common direction; without it, cells that
    have met are distinguished only by their paths.
    """

    def __init__(
        self,
        section: CellsSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        join: Join | None = None,
    ) -> None:
        super().__init__(section, clock, wake, join)
        self.section = section
        self._setup = setup
        self._organism = named(section.organism)
        self._moved_um = 0.0, 0.0  # by how much knocks have moved what the pictures show
        self._tracker = CellTracker(
            section.um_px,
            field_known=True,
            near_wall=self._near_wall,
            organism=self._organism,
        )
        self._cells: Sequence[SeenCell] = ()
        self._now = 0.0  # time of the newest picture [s]
        # for each track: time [s] and way [um] from which its mean speed is computed
        self._since: dict[int, tuple[float, float]] = {}
        self._pictures = PictureLog()
        self._added = deque[FrameAddition](maxlen=ADDED)
        self._identified = deque[Identities](maxlen=ADDED)
        self._first: list[Grey] = []
        self._first_ns: int | None = None
        self._identities: list[int] | None = None  # cell number per robot, once all were seen
        self.divided: set[int] = set()  # robots from whose blob another cell separated
        self._sent = FieldSignals()

    def steered(self, direction: float | None, sent_ns: int) -> None:
        """Record the common direction [rad, in the spec's axes] sent at `sent_ns`; None if the
        field was switched off.
        """
        self._sent.note(direction, sent_ns)

    def candidates(self) -> list[RobotCandidate]:
        """Return the cells in the newest picture whose identity is sure, with the filter's
        estimates of a and of the mean speed since each was first seen. Cells near the arena's edge
        are not free.
        """
        return [self._found(c) for c in self._cells if c.has_blob and c.probability >= SURE]

    def _found(self, cell: SeenCell) -> RobotCandidate:
        per_um = 1e-6 / self._setup.metres
        since, before = self._since.get(cell.track, (self._now, 0.0))
        a = float(cell.mean[A])
        seconds = self._now - since
        a_sd, speed_sd = (WIDER * float(cell.sd[i]) for i in (A, SPEED))
        speed = float(cell.mean[SPEED])
        if seconds > MEAN_S:
            speed = float(cell.mean[WAY] - before) / seconds
            speed_sd = WIDER * float(cell.sd[WAY]) / seconds
        speed_sd = math.hypot(speed_sd, SPEED_ERROR * speed) * per_um
        x, y = np.array([[cell.x], [cell.y]])
        free = not self._near_wall(x, y).item()
        a_sd = math.hypot(a_sd, A_ERROR * a)
        pose = self._pose_of(cell)
        return RobotCandidate(cell.identity, pose, a, a_sd, speed * per_um, speed_sd, free)

    def settle(self, setup: Setup, numbers: Sequence[int]) -> None:
        """Track the cells with these numbers as the robots of a setup from now on."""
        self._setup = setup
        self._identities = list(numbers)
        self.divided.clear()

    @property
    def robots(self) -> Sequence[int]:
        """The numbers of the robots' cells; empty before all were seen in one picture."""
        return tuple(self._identities or ())

    def replace(self, robot: int, number: int) -> None:
        """From now on, track the cell with this number as the robot with the index `robot`."""
        assert self._identities is not None, "only a robot that was seen can be replaced"
        self._identities[robot] = number
        self.divided.discard(robot)

    def additions(self) -> list[FrameAddition]:
        """Return the pictures of each frame since the last call, oldest first."""
        return [self._added.popleft() for _ in range(len(self._added))]

    def watch(self, setup: Setup, limits: LabLimits) -> CellWatch:
        """Return the watch of a trial with this setup's robots."""
        return CellWatch(self, self._identified, setup, limits.identity)

    def check(self) -> Health:
        """Examine some pictures; return problems, warnings and facts of source, light, focus and
        cells.
        """
        looks = self._look()
        problems, warnings = self._stream_lines(looks)
        width_px = self._organism.body_um[1] / self.section.um_px
        wrong, doubtful = dish_lines(self._setup.names, looks, width_px)
        facts = {
            "source": self.section.source_name,
            "scale": f"{self.section.um_px:g} um/px",
            "organism": self.section.organism,
            **self._stream_facts(looks),
            **({"cells": str(cell_count(looks))} if looks else {}),
            "opencv": cv2.__version__,
            "damaged": str(self.damaged),
            "skipped": str(self._skipped),
        }
        return Health((*problems, *wrong), (*warnings, *doubtful), facts, emulated=self.emulated)

    def _see(self, picture: Grey, exposed_ns: int) -> SeenDish | None:
        if self.section.mirrored:
            picture = np.asarray(cv2.flip(picture, 1), np.uint8)
        if self._tracker.finder.background is None:
            self._learn(picture, exposed_ns)
            return None
        cells = self._tracker.see(picture, exposed_ns / SECOND, self._field)
        columns, rows = self._tracker.finder.light.shift_px
        um_px = self.section.um_px
        self._moved_um = self._moved_um[0] + columns * um_px, self._moved_um[1] - rows * um_px
        self._cells = cells
        self._now = exposed_ns / SECOND
        since = self._since
        self._since = {c.track: since.get(c.track, (self._now, float(c.mean[WAY]))) for c in cells}
        identities = self._bound(cells)
        mothers = {born.divided for born in self._tracker.born}
        self.divided |= {i for i, identity in enumerate(identities) if identity in mothers}
        by_identity = {cell.identity: cell for cell in cells}
        robots = [by_identity.get(identity) for identity in identities]
        messages = self._pictures.messages(picture, exposed_ns, self._tracker.finder.background)
        sure = np.array([np.nan if cell is None else cell.probability for cell in robots])
        self._added.append(FrameAddition(exposed_ns, messages))
        self._identified.append(Identities(exposed_ns, sure))
        return SeenDish(
            poses=tuple(None if cell is None else self._pose_of(cell) for cell in robots),
            strangers=tuple(self._pose_of(c) for c in cells if c.identity not in identities),
            light=self._tracker.finder.light,
            level=float(np.median(picture[::8, ::8])),
            sharpness=_sharpness(picture, cells, self.section.um_px, self._tracker.finder.light),
            sure=min((cell.probability for cell in robots if cell is not None), default=0.0),
        )

    def _learn(self, picture: Grey, exposed_ns: int) -> None:
        """Collect pictures over the learning time, and then compute the background from them."""
        if self._first_ns is None:
            self._first_ns = exposed_ns
        passed = (exposed_ns - self._first_ns) / SECOND
        if passed >= len(self._first) * self.section.learning / BACKGROUND:
            fits = not self._first or picture.shape == self._first[0].shape
            self._first = [*self._first, picture] if fits else [picture]
        if passed >= self.section.learning and len(self._first) >= BACKGROUND // 2:
            self._tracker.finder.learn(self._first)
            self._first = []

    def _bound(self, cells: Sequence[SeenCell]) -> list[int]:
        """Return the numbers of the robots' cells; -1 before all of them were seen at once."""
        if self._identities is not None:
            return self._identities
        count = len(self._setup.names)
        if len(cells) < count:
            return [-1] * count
        starts = self._setup.starts.array()[:, :2]
        places = np.array([self._placed(c.x, c.y) for c in cells])
        gaps = np.linalg.norm(starts[:, None] - places[None], axis=-1)
        chosen = linear_sum_assignment(gaps)[1]
        self._identities = [cells[int(j)].identity for j in chosen]
        return self._identities

    def _pose_of(self, cell: SeenCell) -> Pose:
        """Return the pose of a cell in the spec's coordinates."""
        x, y = self._placed(cell.x, cell.y)
        return Pose(x, y, cell.heading + self.section.rotation)

    def _placed(self, x: Lengths, y: Lengths) -> tuple[Lengths, Lengths]:
        """Return positions in the spec's coordinates, which are the dish's: a knock moves neither
        targets nor walls.
        """
        off_x, off_y = self._moved_um
        return self.section.placed(x - off_x, y - off_y, self._setup.metres)

    def _near_wall(self, x: Floats, y: Floats) -> Bools:
        """Return whether a wall may turn cells at positions (R,) in the picture [um]."""
        inside = self._setup.arena.inside(*self._placed(x, y))
        return inside < WALL_UM * 1e-6 / self._setup.metres

    def _field(self, start: float, end: float) -> Sequence[Piece]:
        """Return the field between two times [s] in the picture's axes, by the directions sent."""
        return self._sent.pieces(start, end, self.section.rotation)


def _sharpness(
    picture: Grey, cells: Sequence[SeenCell], um_px: float, light: Light
) -> float | None:
    """Return the median, over cells, of the steepest slope of grey levels divided by the contrast
    [1/px]; None without cells.
    """
    if not light.contrast:
        return None
    steepest = []
    for cell in cells[:8]:
        column = round(cell.x / um_px)
        row = round(picture.shape[0] - cell.y / um_px)
        reach = round(0.7 * cell.long_um / um_px)
        part = picture[max(0, row - reach) : row + reach, max(0, column - reach) : column + reach]
        if min(part.shape) > 6:
            smooth = part[:, :-2].astype(float) + part[:, 1:-1] + part[:, 2:]
            slopes = np.abs(smooth[2:, 2:] - smooth[2:, :-2]) / 6
            steepest.append(float(np.quantile(slopes, 0.98)) / light.contrast)
    return float(np.median(steepest)) if steepest else None
