"""Checks by the cells' turning how picture and field lie to each other: mirrored, or rotated.

A cell turns towards the field: its heading h and the field's direction u obey dh/dt = a sin(u - h).
If the picture is rotated by f, h obeys dh/dt = a sin(u + f - h), and if it is mirrored,
dh/dt = a sin(-u + f - h) for some angle f. With s = +1 or -1 for the side, both are linear in
a cos f and a sin f,

    dh/dt = a cos f sin(s u - h) + a sin f cos(s u - h),

which are fitted to each cell by least squares. The side is that which explains more of the turning.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.core.protocols import LabSupervision
from tetractl.lab.rig import Rig
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.dish_abilities import tracker_of
from tetractl_microscope.choice.section import Choice
from tetractl_microscope.choice.turn_field import manoeuvre, turn_field

GRID_S = 0.05  # time step of the analysis
SMOOTH = 8  # steps over which a course is measured: a turn of a cell's helix takes about as long
LONGEST_GAP_S = 0.25  # a longer gap between two positions of a cell separates its path
STILL = 0.1  # turning rate [rad/s] that counts as unexplained in any case
EXPLAINED = 0.4  # least share of the turning that a response to the field explains
LEAST_CELLS = 3  # fewest cells that show a rotation
SURE = 3.0  # standard deviations by which a rotation must differ from 0
ALLOWED = 0.15  # rotation below which nothing is said [rad]

FieldAt = Callable[[Floats], NDArray[np.complex128]]
"""Function that returns the field at times [s] as x + iy, relative to the reference field."""


@dataclass(frozen=True, slots=True)
class Handedness:
    """How `cells` cells turned in the field: to its side, or to the other if `mirrored`; towards a
    direction off the field's by `turned` +- `turned_sd` [rad]. `explained` is the share of their
    turning that this explains.
    """

    cells: int
    mirrored: bool
    turned: float
    turned_sd: float
    explained: float

    @property
    def rotated(self) -> bool:
        """Whether the cells turn to a direction that is certainly not the field's."""
        return abs(self.turned) > max(ALLOWED, SURE * self.turned_sd)


def watch_turning(
    rig: Rig, choice: Choice, seed: int, supervision: LabSupervision
) -> tuple[list[RobotCandidate], Handedness | None]:
    """Turn the field of an entered rig; return the cells in view, and how they turned, None if too
    few of them were seen for long enough. Raises as `turn_field`.
    """
    seen_paths: dict[int, list[tuple[float, float, float]]] = {}
    tracker = tracker_of(rig)

    def on_look() -> None:
        if (newest := rig.frames.newest) is None:
            return
        now_s = newest.frame.sampled_ns / SECOND
        for cell in tracker.candidates():
            path = seen_paths.setdefault(cell.number, [])
            if cell.free and (not path or now_s > path[-1][0]):
                path.append((now_s, cell.pose.x, cell.pose.y))

    cells = turn_field(rig, choice, seed, supervision, on_look)
    rig.loop.stop()
    direction = manoeuvre(choice.turn, seed)

    def field(times: Floats) -> NDArray[np.complex128]:
        return np.exp(1j * np.array([direction(round(time_s * SECOND)) for time_s in times]))

    return cells, handedness([np.array(path) for path in seen_paths.values()], field)


def handedness(paths: Sequence[Floats], field: FieldAt) -> Handedness | None:
    """Return how cells turned in a field; `paths` (K, 3) are their times [s] and positions x, y.
    None for fewer than LEAST_CELLS cells.
    """
    pieces = [piece for path in paths for piece in _pieces(path)]
    if len(pieces) < LEAST_CELLS:
        return None
    turns = [_turns(piece, field) for piece in pieces]
    total = sum(float(way @ way) + STILL**2 * len(way) for way, _ in turns)
    sides = []
    for side in (0, 1):
        fits = [np.linalg.lstsq(bases[side], way, rcond=None)[0] for way, bases in turns]
        off = [way - bases[side] @ fit for (way, bases), fit in zip(turns, fits, strict=True)]
        unexplained = sum(float(residual @ residual) + STILL**2 * len(residual) for residual in off)
        sides.append((1 - unexplained / total, np.array([complex(*fit) for fit in fits])))
    mirrored = sides[1][0] > sides[0][0]
    explained, vectors = sides[mirrored]
    turned = float(np.angle(vectors.sum()))
    # a cell without a magnet has a short vector, and so little weight
    across = (vectors * np.exp(-1j * turned)).imag
    total_length = max(abs(vectors.sum()), 1e-9)
    spread = float(np.linalg.norm(across) / total_length)
    return Handedness(len(turns), bool(mirrored), turned, spread, explained)


def handedness_lines(turning: Handedness | None) -> tuple[list[str], str]:
    """Return problems, and a text on how the cells turned."""
    if turning is None:
        return [f"fewer than {LEAST_CELLS} cells were seen for 2 s while the field turned"], "-"
    off = f"{turning.turned:+.2f} +- {1.96 * turning.turned_sd:.2f} rad off it"
    text = (
        f"{100 * turning.explained:.0f} % of the turning of {turning.cells} cells is towards "
        + ("the mirror image of the field" if turning.mirrored else f"the field, {off}")
    )
    if turning.explained < EXPLAINED:
        return ["the cells do not turn with the field: is there a field, have cells magnets?"], text
    mirrored = (
        "the picture is mirrored (change lab.camera.mirrored), or one coil pair's current is "
        "reversed (the sign of gain_mt_a)"
    )
    rotated = "subtract this from lab.camera.rotation, or add it to the coils' rotation"
    return wrong_sides(turning, mirrored, rotated), text


def wrong_sides(turning: Handedness, mirrored: str, rotated: str) -> list[str]:
    """Return what is wrong with the field's directions, each with its cause or cure."""
    if turning.explained < EXPLAINED or not (turning.mirrored or turning.rotated):
        return []
    if turning.mirrored:
        return [f"cells turn right where the field turns left: {mirrored}"]
    off = f"{turning.turned:+.2f} +- {1.96 * turning.turned_sd:.2f} rad off the field's"
    return [f"cells turn to a direction {off}: {rotated}"]


def _pieces(path: Floats) -> list[Floats]:
    """Return the pieces (K, 3) of a path without a longer gap that last 2 s or more."""
    if len(path) < 2:
        return []
    cuts = np.flatnonzero(np.diff(path[:, 0]) > LONGEST_GAP_S) + 1
    return [piece for piece in np.split(path, cuts) if np.ptp(piece[:, 0]) > 2.0]


def _turns(piece: Floats, field: FieldAt) -> tuple[Floats, tuple[Floats, Floats]]:
    """Return the turning of a cell's course (M,) [rad/s], and for either side the rates (M, 2) that
    a = 1 gives with f = 0 and with f = pi / 2.
    """
    times = np.arange(piece[0, 0], piece[-1, 0], GRID_S)
    x, y = (np.interp(times, piece[:, 0], piece[:, k]) for k in (1, 2))
    places = x + 1j * y
    course = np.unwrap(np.angle(places[SMOOTH:] - places[:-SMOOTH]))
    acts = field(times[SMOOTH // 2 : SMOOTH // 2 + len(course)])
    box = np.ones(SMOOTH) / SMOOTH  # a course is a mean, and so is what turns it

    def rates(acting: NDArray[np.complex128]) -> Floats:
        mean = np.convolve(acting * np.exp(-1j * course), box, "same")[SMOOTH:-SMOOTH]
        return np.stack([mean.imag, mean.real], axis=1)

    way = np.gradient(course, GRID_S)[SMOOTH:-SMOOTH]
    return way, (rates(acts), rates(acts.conj()))
