"""Rotates the field of a connected lab, to find the cells that can be steered."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.core.protocols import LabSupervision
from tetractl.lab.rig import Rig
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.dish_abilities import require_cell_tracker
from tetractl_microscope.choice.section import Choice

JITTER = 0.4  # largest deviation of a direction from a multiple of a quarter turn [rad]


def create_rotating_field(turn_s: float, seed: int) -> Callable[[int], float]:
    """Create a rotating field in which cells swim in circles.

    The field turns in steps of about a quarter turn, always in the same sense. The steps are of
    unequal angles, so that a cell's response shows both its turning rate a and its dipole's angle.
    A cell with a turning rate a below 2 pi / `turn_s` lags behind the field.

    Args:
        turn_s: Duration of a whole turn [s].
        seed: Seed of the first direction and of the step angles.

    Returns:
        A function from time [ns] to the direction of the field [rad].
    """
    start_rad = float(np.random.default_rng(seed).uniform(-math.pi, math.pi))

    def direction(now_ns: int) -> float:
        k = int(4 * now_ns / SECOND / turn_s)
        jitter_rad = float(np.random.default_rng((seed, k)).uniform(-JITTER, JITTER))
        return math.remainder(start_rad + math.pi / 2 * k + jitter_rad, math.tau)

    return direction


def turn_field(
    rig: Rig,
    choice: Choice,
    seed: int,
    supervision: LabSupervision,
    on_look: Callable[[], None] = lambda: None,
) -> list[RobotCandidate]:
    """Rotate the field of a connected lab, and return the cells in view with their responses.

    Afterwards, the field keeps rotating until the caller stops it, even after an error.

    Args:
        rig: The connected lab.
        choice: The rule for choosing cells. It determines how long and how fast the field rotates.
        seed: Seed of the rotation.
        supervision: The operator's emergency stop and cancel signal.
        on_look: Called about every 50 ms.

    Raises:
        AbortError: If no images arrive, if they are searched too slowly to track the cells, if the
            actuator fails, or at an emergency stop.
        KeyboardInterrupt: If the operator cancels.
    """
    tracker = require_cell_tracker(rig)
    rig.loop.idle_direction = create_rotating_field(choice.turn, seed)
    numbers_near_wall: set[int] = set()
    start_ns = rig.clock.now()
    frames_before = rig.loop.frames.count
    while rig.clock.now() - start_ns < choice.seconds * SECOND:
        rig.clock.sleep_until(rig.clock.now() + SECOND // 20)
        numbers_near_wall |= {cell.number for cell in tracker.candidates() if not cell.free}
        on_look()
        if supervision.emergency.is_set():
            raise AbortError("emergency stop by the operator")
        if supervision.cancelled():
            raise KeyboardInterrupt
        failure = rig.actuator.failure
        if failure is not None:
            raise AbortError(failure)
        if rig.measure_silence_ns() > max(rig.limits.stream_lost, 1.0) * SECOND:
            raise AbortError(rig.loop.guard.explain_missing_frames(rig.measure_silence_ns()))
    candidates = tracker.candidates()
    cells = [
        replace(cell, free=cell.free and cell.number not in numbers_near_wall)
        for cell in candidates
    ]
    # a cell is recognised if it moves by at most 35 um between two pictures
    rate_min_hz = choice.speed * rig.setup.metres * 1e6 / 35.0
    rate_hz = (rig.loop.frames.count - frames_before) * SECOND / max(rig.clock.now() - start_ns, 1)
    if sum(cell.magnetised for cell in cells) < choice.choose and rate_hz < rate_min_hz:
        raise AbortError(
            f"only {rate_hz:.1f} images per second were searched, but {rate_min_hz:.0f} are needed "
            f"to follow cells that swim {choice.speed:g} {rig.setup.unit}/s",
            "stop other programs that keep this computer busy, or use smaller images, which take "
            "less time to search",
        )
    return cells
