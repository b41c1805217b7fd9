"""Checks from the cells' turning whether the image is mirrored or rotated relative to the field.

A cell turns towards the field: its heading h and the field's direction u obey dh/dt = a sin(u - h).
If the image is rotated by f, h obeys dh/dt = a sin(u + f - h). If the image is mirrored, h obeys
dh/dt = a sin(-u + f - h) for some angle f. Both equations are fitted, and the one that explains
more of the turning decides (`fit_turning`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.core.protocols import LabSupervision
from tetractl.lab.rig import Rig
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.dish_abilities import require_cell_tracker
from tetractl_microscope.choice.section import Choice
from tetractl_microscope.choice.turn_field import create_rotating_field, turn_field
from tetractl_microscope.one_recording import EXPLAINED_FRACTION_MIN
from tetractl_microscope.sent_directions import FieldAt, compute_courses, fit_turning

CELLS_MIN = 3  # minimum number of cells that can show a rotation
ROTATION_SD_MIN = 3.0  # minimum rotation that counts as certain [standard deviations]
ROTATION_MAX_RAD = 0.15  # maximum rotation that is not reported [rad]
EXPLAINED_DIFFERENCE_MIN = 1e-6
"""Maximum difference of two explained fractions that counts as rounding.

A field that never changes explains the same fraction with and without mirroring.
"""


@dataclass(frozen=True, slots=True)
class Handedness:
    """The direction towards which cells turned, relative to the direction of the field.

    Attributes:
        cells: Number of cells.
        mirrored: Whether the cells turned towards the mirror image of the field.
        turned: Angle from the field's direction to the direction towards which the cells turned
            [rad].
        turned_sd: Standard deviation of `turned` [rad].
        explained: Fraction of the cells' turning that the field explains.
    """

    cells: int
    mirrored: bool
    turned: float
    turned_sd: float
    explained: float

    @property
    def rotated(self) -> bool:
        """Whether the cells certainly turn towards another direction than the field's direction.

        The angle between them must exceed ROTATION_MAX_RAD, and ROTATION_SD_MIN times its standard
        deviation.
        """
        return abs(self.turned) > max(ROTATION_MAX_RAD, ROTATION_SD_MIN * self.turned_sd)


def watch_turning(
    rig: Rig, choice: Choice, seed: int, supervision: LabSupervision
) -> tuple[list[RobotCandidate], Handedness | None]:
    """Turn the field of a connected lab, and watch how the cells turn.

    It raises the same errors as `turn_field`.

    Args:
        rig: The connected lab.
        choice: The spec's rule for choosing cells.
        seed: Seed of the field's rotation.
        supervision: The operator's emergency stop and cancel signal.

    Returns:
        The cells in view, and how they turned, or None if too few cells were seen for long enough.
    """
    seen_paths: dict[int, list[tuple[float, float, float]]] = {}
    tracker = require_cell_tracker(rig)

    def record_positions() -> None:
        newest = rig.loop.frames.newest
        if newest is None:
            return
        now_s = newest.frame.sampled_ns / SECOND
        for cell in tracker.candidates():
            path = seen_paths.setdefault(cell.number, [])
            if cell.free and (not path or now_s > path[-1][0]):
                path.append((now_s, cell.pose.x, cell.pose.y))

    try:
        cells = turn_field(rig, choice, seed, supervision, record_positions)
    finally:
        rig.loop.stop()  # also if it raises: devices close slowly, the camera first
    direction_at = create_rotating_field(choice.turn, seed)

    def field_at(times: Floats) -> NDArray[np.complex128]:
        directions = np.array([direction_at(round(time_s * SECOND)) for time_s in times])
        return np.exp(1j * directions)

    return cells, find_handedness([np.array(path) for path in seen_paths.values()], field_at)


def find_handedness(paths: Sequence[Floats], field: FieldAt) -> Handedness | None:
    """Determine whether cells turned towards a field, its mirror image, or a rotated direction.

    Args:
        paths: For each cell, times [s] and positions x, y, shape (K, 3).
        field: The field.

    Returns:
        The result. None for fewer than CELLS_MIN cells.
    """
    turned_courses = compute_courses(paths)
    if len(turned_courses) < CELLS_MIN:
        return None
    fit_to_field = fit_turning(turned_courses, field)
    fit_to_mirror_image = fit_turning(turned_courses, lambda times: field(times).conj())
    mirrored = fit_to_mirror_image[0] > fit_to_field[0] + EXPLAINED_DIFFERENCE_MIN
    explained_fraction, factors = fit_to_mirror_image if mirrored else fit_to_field
    turned = float(np.angle(factors.sum()))
    # a cell without a magnet has a short vector, and so little weight
    across_lengths = (factors * np.exp(-1j * turned)).imag
    total_length = max(abs(factors.sum()), 1e-9)
    angle_sd = float(np.linalg.norm(across_lengths) / total_length)
    return Handedness(len(turned_courses), mirrored, turned, angle_sd, explained_fraction)


def describe_handedness(turning: Handedness | None) -> tuple[list[str], str]:
    """Describe how cells turned in the field, and what is wrong with the image or the coils.

    Args:
        turning: How the cells turned. None if too few cells were seen.

    Returns:
        A list of problems, empty if the image agrees with the field, and a sentence on the
        turning.
    """
    if turning is None:
        return [
            f"the image cannot be checked, because fewer than {CELLS_MIN} cells were seen for 2 s "
            "while the field turned"
        ], "-"
    angle_text = f"with an offset of {turning.turned:+.2f} +- {1.96 * turning.turned_sd:.2f} rad"
    turning_text = (
        f"{100 * turning.explained:.0f} % of the turning of {turning.cells} cells is towards "
        + ("the mirror image of the field" if turning.mirrored else f"the field, {angle_text}")
    )
    if turning.explained < EXPLAINED_FRACTION_MIN:
        return [
            "the cells do not turn with the field: is the field on, and are the cells magnetised?"
        ], turning_text
    mirrored = (
        "the image is mirrored (change lab.camera.mirrored), or the current of one coil pair "
        "is reversed (change the sign of gain_mt_a)"
    )
    rotated = "subtract this angle from lab.camera.rotation, or add it to the coils' rotation"
    return describe_wrong_sides(turning, mirrored, rotated), turning_text


def describe_wrong_sides(turning: Handedness, mirrored: str, rotated: str) -> list[str]:
    """Describe how the field's directions seem to be mirrored or rotated, and how to mend them.

    Args:
        turning: How cells turned.
        mirrored: Cause or remedy if the cells turned to the opposite side.
        rotated: Cause or remedy if the cells turned towards a rotated direction.

    Returns:
        One sentence. Empty if the directions are right, or if cells do not turn with the field.
    """
    if turning.explained < EXPLAINED_FRACTION_MIN or not (turning.mirrored or turning.rotated):
        return []
    if turning.mirrored:
        return [f"cells turn right when the field turns left: {mirrored}"]
    angle_text = (
        f"{turning.turned:+.2f} +- {1.96 * turning.turned_sd:.2f} rad off the field's direction"
    )
    return [f"cells turn towards a direction that is {angle_text}: {rotated}"]
