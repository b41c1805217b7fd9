"""The `cells` camera: it tracks swimming cells in the images of a microscope."""

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.clock import SECOND, Clock
from tetractl.core.poses import Bools, CameraFrame, Floats, FrameAddition, GreyImage, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import LabLimits
from tetractl.tools.worker import take_all
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.cell_watch import CellWatch, Identities
from tetractl_microscope.cells.cells_health import (
    SeenDish,
    count_cells,
    find_problems,
    measure_sharpness,
)
from tetractl_microscope.cells.field_record import FieldSignals
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR, WALL_REACH_UM, Piece
from tetractl_microscope.cells.identity_watch import KNOWN_PROBABILITY
from tetractl_microscope.cells.kernels.helix_steps import PATH_LENGTH, SPEED, A
from tetractl_microscope.cells.robot_cells import RobotCell, RobotCells
from tetractl_microscope.cells.section import CellsSection, Lengths
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.organisms import find_organism
from tetractl_microscope.pictures.picture_camera import OpenMemorySource, PictureCamera
from tetractl_microscope.pictures.searches import PictureSearch
from tetractl_microscope.pictures.whole_pictures import PictureLog

N_LEARNING_PARTS = 15  # number of parts of the learning time: one image of each part is used
LEARNING_PICTURES_MIN = 7  # minimum number of images for learning, if images arrive slowly
# Ratio of the errors in rendered films to the filter's standard deviations. The filter does not fit
# the noise of a cell.
SD_FACTOR = 1.5
MEAN_SPEED_MIN_S = 2.0  # time in view after which the mean speed is used instead of the present one
QUEUED_MAX = 1024  # maximum number of messages in a queue; beyond it, the oldest are dropped
LEVEL_STEP = 8  # step between the pixels whose median is the grey level of an image
NO_CELL = -1  # number of a robot's cell before all robots were seen in one picture


@dataclass(frozen=True, slots=True)
class FirstSight:
    """The moment at which a tracked cell came into view.

    Attributes:
        seconds: Time of the image that first showed the track [s].
        path_length_um: Distance that the cell had swum until then [um].
    """

    seconds: float
    path_length_um: float


@dataclass(frozen=True, slots=True)
class CellsInView:
    """The cells that were tracked in the newest image.

    The searching thread replaces this object as a whole, because another thread reads it.

    Attributes:
        cells: The cells.
        now_s: When the image was exposed [s].
        first_sights: For each track, since when it has been in view without a gap.
        moved_um: How far knocks have moved the content of the image [um], along its rows and up.
    """

    cells: Sequence[SeenCell] = ()
    now_s: float = 0.0
    first_sights: Mapping[int, FirstSight] = field(default_factory=dict)
    moved_um: tuple[float, float] = (0.0, 0.0)

    def followed_by(
        self, cells: Sequence[SeenCell], now_s: float, shift_um: tuple[float, float]
    ) -> "CellsInView":
        """Create the view of the next image, which keeps since when each cell is in view.

        Args:
            cells: The cells in that image.
            now_s: When it was exposed [s].
            shift_um: How far a knock has moved everything since the previous image [um].
        """
        first_sights = {
            cell.track: self.first_sights.get(
                cell.track, FirstSight(now_s, float(cell.mean[PATH_LENGTH]))
            )
            for cell in cells
        }
        moved_um = (self.moved_um[0] + shift_um[0], self.moved_um[1] + shift_um[1])
        return CellsInView(cells, now_s, first_sights, moved_um)

    def speed(self, cell: SeenCell) -> tuple[float, float]:
        """Estimate a cell's mean speed since it came into view.

        During its first MEAN_SPEED_MIN_S in view, the estimate is the filter's present speed.

        Returns:
            The speed and its standard deviation [um/s].
        """
        first_sight = self.first_sights[cell.track]
        visible_s = self.now_s - first_sight.seconds
        if visible_s > MEAN_SPEED_MIN_S:
            speed_um_s = float(cell.mean[PATH_LENGTH] - first_sight.path_length_um) / visible_s
            speed_sd_um_s = SD_FACTOR * float(cell.sd[PATH_LENGTH]) / visible_s
        else:
            speed_um_s = float(cell.mean[SPEED])
            speed_sd_um_s = SD_FACTOR * float(cell.sd[SPEED])
        return speed_um_s, math.hypot(speed_sd_um_s, SPEED_ERROR * speed_um_s)


class LearningPictures:
    """Collects images over the first `learning_s` [s], from which the background is computed.

    All images have the same shape, because the base class refuses others.
    """

    def __init__(self, learning_s: float) -> None:
        self._learning_s = learning_s
        self._pictures: list[GreyImage] = []
        self._first_ns: int | None = None

    def add(self, picture: GreyImage, exposed_ns: int) -> list[GreyImage]:
        """Add an image to the images for the background, if another image is due.

        Returns:
            All collected images, once there are enough to learn the background. Empty until then.
        """
        if self._first_ns is None:
            self._first_ns = exposed_ns
        passed_s = (exposed_ns - self._first_ns) / SECOND
        pictures = self._pictures
        is_due = passed_s >= len(pictures) * self._learning_s / N_LEARNING_PARTS
        if is_due:
            pictures = [*pictures, picture]
        is_enough = passed_s >= self._learning_s and len(pictures) >= LEARNING_PICTURES_MIN
        self._pictures = [] if is_enough else pictures
        return pictures if is_enough else []


class PictureReports:
    """The log messages and identities that belong to each image, in addition to its frame.

    Attributes:
        identities: How certainly the robots' cells are identified in each image, for `CellWatch`.
        additions: Additional log messages of each image.
    """

    def __init__(self) -> None:
        self.identities = deque[Identities](maxlen=QUEUED_MAX)
        self._whole = PictureLog()
        self.additions = deque[FrameAddition](maxlen=QUEUED_MAX)

    def add(
        self, picture: GreyImage, exposed_ns: int, background: GreyImage | None, probability: Floats
    ) -> None:
        """Record the log messages and the identities that belong to an image.

        Args:
            picture: The image.
            exposed_ns: When it was exposed [ns].
            background: The background. None while it is being learned.
            probability: Probability of the identity of each robot's cell, shape (N,).
        """
        messages = self._whole.messages(picture, exposed_ns, background)
        self.additions.append(FrameAddition(exposed_ns, messages))
        self.identities.append(Identities(exposed_ns, probability))


class CellCamera(PictureCamera[SeenDish]):
    """A camera that tracks swimming cells in the images of a microscope; see `Camera`.

    Once at least as many cells are in view as the spec has robots, the cells nearest to the starts
    become the robots. A cell that is lost, after half a second without a blob, is an unknown object
    if it reappears. `steered` tells the camera the common direction. Without it, cells that have
    met are distinguished only by their paths.

    A thread of the base class searches the images: `_see` and what it calls. The trial's thread
    changes which cells are the robots, by `settle` and `replace`: `robot_cells` has the rule by
    which neither disturbs the other. A frame in which others were the robots is dropped.

    Args:
        section: The fields of the camera in the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        wake: Called after every new frame.
        join: Opens a source in memory; see `PictureCamera`. None for the spec's source.
    """

    def __init__(
        self,
        section: CellsSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        join: OpenMemorySource | None = None,
    ) -> None:
        super().__init__(section, clock, wake, join)
        self.section = section
        self._arena = setup.arena  # and its length unit: the same in each setup of a dish
        self._metres = setup.metres
        self._view = CellsInView()
        # built after what `_near_wall` needs: its filter calls that while it is built
        self._tracker = CellTracker(
            section.um_px,
            field_known=True,
            near_wall=self._near_wall,
            organism=find_organism(section.organism),
        )
        self._learning = LearningPictures(section.learning)
        self._robots = RobotCells(setup)
        self._reports = PictureReports()
        self._sent = FieldSignals()

    def steered(self, direction: float | None, sent_ns: int) -> None:
        """Record a direction that was sent to the cells.

        Args:
            direction: The common direction in the spec's axes [rad]. None if the field was switched
                off.
            sent_ns: When it was sent [ns].
        """
        self._sent.note(direction, sent_ns)

    def candidates(self) -> list[RobotCandidate]:
        """List the cells in the newest image that are identified with certainty.

        Each candidate has the filter's estimate of the turning rate a, and the mean speed since the
        cell came into view. Cells near the arena's edge are not `free`.
        """
        view = self._view
        identified_cells = [
            cell for cell in view.cells if cell.has_blob and cell.probability >= KNOWN_PROBABILITY
        ]
        return [self._candidate(cell, view) for cell in identified_cells]

    def _candidate(self, cell: SeenCell, view: CellsInView) -> RobotCandidate:
        """Convert a cell in view to a candidate, in the spec's coordinates and length unit.

        The candidate is not `free` if the cell is near a wall.
        """
        speed_um_s, speed_sd_um_s = view.speed(cell)
        unit_per_um = 1e-6 / self._metres
        a = float(cell.mean[A])
        a_sd = math.hypot(SD_FACTOR * float(cell.sd[A]), A_ERROR * a)
        is_near_wall = self._near_wall_in(view, np.array([cell.x]), np.array([cell.y]))[0]
        return RobotCandidate(
            number=cell.identity,
            pose=self._pose_of(cell, view),
            a=a,
            a_sd=a_sd,
            speed=speed_um_s * unit_per_um,
            speed_sd=speed_sd_um_s * unit_per_um,
            free=not is_near_wall,
        )

    def settle(self, setup: Setup, numbers: Sequence[int]) -> None:
        """Start to track the cells with these numbers as the robots of a setup.

        Args:
            setup: The constants of the experiment.
            numbers: Number of each robot's cell, in the order of the setup's robots.
        """
        robots = RobotCells(setup)
        robots.bind(numbers)
        self._robots = robots

    @property
    def robots(self) -> Sequence[int]:
        """The numbers of the robots' cells, in the setup's order.

        The sequence is empty until one image has shown all robots.
        """
        return self._robots.numbers

    @property
    def divided(self) -> Collection[int]:
        """The indices of the robots whose cell has divided."""
        return self._robots.divided

    def replace(self, robot: int, number: int) -> None:
        """Start to track another cell as a robot.

        Args:
            robot: Index of the robot.
            number: Number of the cell.
        """
        robots = self._robots
        assert robots.cells, "a cell can be replaced only after the camera has seen it"
        # the other robots' cells are the same objects: what is noted of them meanwhile is not lost
        cells = list(robots.cells)
        cells[robot] = RobotCell(number)
        self._robots = RobotCells(robots.setup, cells)

    def frames(self) -> list[CameraFrame]:
        """Return the frames since the last call.

        Frames in which other cells were the robots are dropped.
        """
        frames = self._searches.take_frames()
        return [frame for frame, dish in frames if dish.robots is self._robots]

    def additions(self) -> list[FrameAddition]:
        """Return the additional log messages of each frame since the last call, oldest first.

        Each message is returned once. The list is empty if there are no new messages.
        """
        return take_all(self._reports.additions)

    def watch(self, setup: Setup, limits: LabLimits) -> CellWatch:
        """Create the watch on the robots' identities for a trial with this setup."""
        return CellWatch(self, self._reports.identities, setup, limits.identity)

    def _health(self, searches: Sequence[PictureSearch[SeenDish]]) -> Health:
        """Find problems and warnings about light, focus and cells, and facts for the log."""
        width_px = find_organism(self.section.organism).body_um[1] / self.section.um_px
        problems, warnings = find_problems(self._robots.setup.names, searches, width_px)
        facts = {
            "scale": f"{self.section.um_px:g} um/px",
            "organism": self.section.organism,
            "opencv": cv2.__version__,
        }
        if searches:
            facts["cells"] = str(count_cells(searches))
        return Health(tuple(problems), tuple(warnings), facts)

    def _see(self, picture: GreyImage, exposed_ns: int) -> SeenDish | None:
        """Learn from an image, or track the cells in it.

        Returns:
            What the image shows. None while the background is being learned.
        """
        if self.section.mirrored:
            picture = np.asarray(cv2.flip(picture, 1), np.uint8)
        finder = self._tracker.finder
        if finder.background is None:
            pictures = self._learning.add(picture, exposed_ns)
            if pictures:
                finder.learn(pictures)
            return None
        now_s = exposed_ns / SECOND
        cells = self._tracker.track_image(picture, now_s, self._field)
        columns, rows = finder.light.shift_px
        shift_um = (columns * self.section.um_px, -rows * self.section.um_px)  # rows run down
        view = self._view.followed_by(cells, now_s, shift_um)
        self._view = view
        robots = self._take_robots(view)
        numbers = robots.numbers or (NO_CELL,) * len(robots.setup.names)
        cell_of_number = {cell.identity: cell for cell in cells}
        tracked = [cell_of_number.get(number) for number in numbers]
        probability = np.array([np.nan if cell is None else cell.probability for cell in tracked])
        self._reports.add(picture, exposed_ns, finder.background, probability)
        return SeenDish(
            robots=robots,
            poses=tuple(None if cell is None else self._pose_of(cell, view) for cell in tracked),
            unknown_objects=tuple(
                self._pose_of(cell, view) for cell in cells if cell.identity not in numbers
            ),
            light=finder.light,
            level=float(np.median(picture[::LEVEL_STEP, ::LEVEL_STEP])),
            sharpness=measure_sharpness(picture, cells, self.section.um_px, finder.light.contrast),
            certainty_min=min(
                (cell.probability for cell in tracked if cell is not None), default=0.0
            ),
        )

    def _take_robots(self, view: CellsInView) -> RobotCells:
        """Return the present robots, and record which cells they are and which have divided.

        This method is called once for each image, because the trial's thread may replace robots at
        any time.
        """
        robots = self._robots
        if not robots.cells:
            robots.bind(self._nearest_to_starts(view, robots.setup))
        mother_identities = {born.mother for born in self._tracker.born}
        for cell in robots.cells:
            if cell.number in mother_identities:
                cell.divided = True
        return robots

    def _nearest_to_starts(self, view: CellsInView, setup: Setup) -> Sequence[int]:
        """Find the numbers of the cells nearest to the robots' starts.

        The result is empty if there are fewer cells than robots.
        """
        if len(view.cells) < len(setup.names):
            return ()
        starts = setup.starts.array()[:, :2]
        places = np.array([self._to_spec(view, cell.x, cell.y) for cell in view.cells])
        distances = np.linalg.norm(starts[:, None] - places[None], axis=-1)
        nearest_indices = linear_sum_assignment(distances)[1]
        return [view.cells[int(j)].identity for j in nearest_indices]

    def _pose_of(self, cell: SeenCell, view: CellsInView) -> Pose:
        """Return the pose of a cell in view in the spec's coordinates."""
        x, y = self._to_spec(view, cell.x, cell.y)
        return Pose(x, y, cell.heading + self.section.rotation)

    def _to_spec(self, view: CellsInView, x_um: Lengths, y_um: Lengths) -> tuple[Lengths, Lengths]:
        """Convert positions in the image [um] to the spec's coordinates.

        These are the dish's coordinates: a knock moves neither targets nor walls.
        """
        shift_x_um, shift_y_um = view.moved_um
        return self.section.placed(x_um - shift_x_um, y_um - shift_y_um, self._metres)

    def _near_wall(self, x: Floats, y: Floats) -> Bools:
        """Check whether a wall may turn cells at positions (R,) in the image [um].

        The tracker calls this before it is known whether a knock has moved the newest image.
        """
        return self._near_wall_in(self._view, x, y)

    def _near_wall_in(self, view: CellsInView, x: Floats, y: Floats) -> Bools:
        """Find the positions in the image (R,) [um] that are within WALL_REACH_UM of a wall."""
        edge_distances = self._arena.depth_inside(*self._to_spec(view, x, y))
        return edge_distances < WALL_REACH_UM * 1e-6 / self._metres

    def _field(self, start_s: float, end_s: float) -> Sequence[Piece]:
        """Return the field between two times [s] in the image's axes, from the directions sent.

        It comes as pieces of constant field, oldest first.
        """
        return self._sent.record(self.section.rotation).pieces(start_s, end_s)
