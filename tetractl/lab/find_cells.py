"""Finds cells that can be steered: turns the field, and observes each cell's response."""

import math
from collections.abc import Callable, Container

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.core.protocols import LabSupervision
from tetractl.experiment.choice import Choice, FoundCell
from tetractl.lab.cameras.cells.cell import SeenCell
from tetractl.lab.cameras.cells.helix import SPEED, WALL_UM, A
from tetractl.lab.rig import Rig

LOOK_NS = SECOND // 20
JITTER = 0.4  # largest deviation of a direction from a multiple of a quarter turn [rad]
STEP_UM = 35.0  # largest motion of a cell between two pictures in which it is recognised
SURE = 0.9  # least probability of the identity of a cell that may be chosen


def manoeuvre(turn_s: float, seed: int) -> Callable[[int], float]:
    """Return a function from time [ns] to the direction [rad] of a field that makes cells circle.

    The field turns once in `turn_s` [s], always in the same sense, in four steps of unequal angles:
    a cell's response shows its turning rate a and its dipole's angle. A cell with a turning rate a
    below 2 pi / `turn_s` lags behind the field.
    """
    start = float(np.random.default_rng(seed).uniform(-math.pi, math.pi))

    def direction(now_ns: int) -> float:
        k = int(4 * now_ns / SECOND / turn_s)
        off = float(np.random.default_rng((seed, k)).uniform(-JITTER, JITTER))
        return math.remainder(start + math.pi / 2 * k + off, math.tau)

    return direction


def turn_field(
    rig: Rig,
    choice: Choice,
    seed: int,
    supervision: LabSupervision,
    on_look: Callable[[], None] = lambda: None,
) -> list[FoundCell]:
    """Turn the field of an entered rig for the time in `choice`; return the cells in view.

    The field continues to turn afterwards. `on_look` is called about every 50 ms. AbortError if no
    pictures arrive, if they are searched too slowly to follow the cells, if the actuator fails, or
    at an emergency stop; KeyboardInterrupt if the operator cancels.
    """
    rig.loop.idle = manoeuvre(choice.turn, seed)
    walled: set[int] = set()
    began, before = rig.clock.now(), rig.frames.count
    while rig.clock.now() - began < choice.seconds * SECOND:
        rig.clock.sleep_until(rig.clock.now() + LOOK_NS)
        walled |= {cell.number for cell in found_cells(rig, walled) if not cell.free}
        on_look()
        if supervision.emergency.is_set():
            raise AbortError("emergency stop by the operator")
        if supervision.cancelled():
            raise KeyboardInterrupt
        if (failure := rig.actuator.failure) is not None:
            raise AbortError(failure)
        if rig.silent_ns() > max(rig.limits.stream_lost, 1.0) * SECOND:
            raise AbortError(rig.guard.no_frame(rig.silent_ns()))
    cells = found_cells(rig, walled)
    least = choice.speed * rig.setup.metres * 1e6 / STEP_UM
    rate = (rig.frames.count - before) * SECOND / max(rig.clock.now() - began, 1)
    if sum(cell.magnetised for cell in cells) < choice.choose and rate < least:
        raise AbortError(
            f"{rate:.1f} pictures per second were searched; to follow cells that swim "
            f"{choice.speed:g} {rig.setup.unit}/s, {least:.0f} are needed",
            "do other programs keep this computer busy? searching smaller pictures takes less time",
        )
    return cells


def free_cells(rig: Rig) -> list[FoundCell]:
    """Return the cells that follow the field, are away from the walls, and are not robots."""
    taken = rig.camera.robots  # type: ignore[attr-defined]
    cells = [cell for cell in found_cells(rig) if cell.magnetised and cell.free]
    return [cell for cell in cells if cell.number not in taken]


def found_cells(rig: Rig, walled: Container[int] = ()) -> list[FoundCell]:
    """Return the cells in the newest picture whose identity is sure, with the filter's estimates.

    Cells whose numbers are in `walled`, or that are near the arena's edge, are marked as not free.
    """
    seen: list[SeenCell] = rig.camera.cells  # type: ignore[attr-defined]
    per_um = 1e-6 / rig.setup.metres
    found = []
    for cell in seen:
        if cell.found and cell.probability >= SURE:
            a_sd, speed_sd = (math.sqrt(cell.covariance[i, i]) for i in (A, SPEED))
            a, speed = float(cell.mean[A]), float(cell.mean[SPEED]) * per_um
            pose: Pose = rig.camera.pose_of(cell)  # type: ignore[attr-defined]
            inside = rig.setup.arena.inside(np.array([pose.x]), np.array([pose.y])).item()
            free = cell.identity not in walled and inside > WALL_UM * per_um
            number = cell.identity
            found.append(FoundCell(number, pose, a, a_sd, speed, speed_sd * per_um, free))
    return found
