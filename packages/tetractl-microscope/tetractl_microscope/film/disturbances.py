"""Notices light that wanders, large bodies such as bubbles, and a stage that drifts in a film."""

from collections.abc import Iterator

import cv2
import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl_microscope.cells.detect_cells import BlobFinder
from tetractl_microscope.cells.knocks import SIDE, shift_of

STEP_S = 0.2  # time between examined pictures [s]
EVERY = 5  # shifts are over so many
TILES = 4, 4  # tiles of a picture whose light is compared
WANDERS = 0.2  # range of a tile's share of the light above which the light wanders
# least width [lengths] of what is no cell, and for so many pictures in turn: fewer show a crowd
LARGE = 4.0
IN_TURN = 12
# a drift's greatest speed [lengths/s], and least number and share of shifts that are alike
FAST = 2.0
PAIRS = 3
ALIKE = 0.65


class Disturbances:
    """Examines some pictures of a film with cells `body_um` long [um], at `um_px` [um/px]."""

    def __init__(self, um_px: float, body_um: float) -> None:
        self._um_px = um_px
        self._body_um = body_um
        self._last_s = -np.inf
        self._lights: list[Floats] = []  # of each tile, as shares of the picture's
        self._turn: list[tuple[float, float]] = []  # times, widths of a large body
        self._wide: list[tuple[float, float]] = []  # the most of these in turn
        self._small: list[Grey] = []
        self._stills: list[tuple[float, Grey]] = []
        self._drifts: list[Floats] = []  # velocities of what does not swim [um/s]

    def examine(self, picture: Grey, seconds: float, finder: BlobFinder) -> None:
        """Examine a picture taken at a time [s], of which a finder has just found the blobs."""
        if seconds < self._last_s + STEP_S:
            return
        self._last_s = seconds
        scale = min(1.0, SIDE / max(picture.shape))
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        light = cv2.resize(small.astype(float), TILES, interpolation=cv2.INTER_AREA)
        level = light.mean()
        self._lights.append(light / level if level >= 1 else np.ones(TILES))
        sides = (min(cv2.boundingRect(region)[2:]) for region in finder.regions())
        wide = max(sides, default=0) * self._um_px
        large = wide > LARGE * self._body_um and not finder.light.lost
        if large:
            self._turn.append((seconds, wide))
            self._wide = max(self._wide, self._turn, key=len)
        else:
            self._turn = []
        self._small = [*self._small[-2:], np.asarray(small, np.uint8)]
        if len(self._lights) % EVERY == 3:  # the median of three pictures lacks what swims
            still = np.median(self._small, axis=0).astype(np.uint8)
            for before_s, before in self._stills:
                shift = np.array(shift_of(before, still)) * self._um_px / scale
                self._drifts.append(shift / (seconds - before_s))
            self._stills = [(seconds, still)]

    def lines(self) -> Iterator[str]:
        """Yield a line for each disturbance."""
        darkest, brightest = np.quantile(self._lights, [0.02, 0.98], axis=0)
        wander = float((brightest - darkest).max())
        if wander > WANDERS:
            yield (
                f"light wanders in the picture, by {100 * wander:.0f} % in a part of it: cells are "
                "missed there. Fix the lamp, let it warm up, and shield the dish"
            )
        if len(self._wide) >= IN_TURN:
            times, widths = np.transpose(self._wide)
            yield (
                f"something {np.median(widths):.0f} um wide, such as a bubble, moves or grows "
                f"for {np.ptp(times):.0f} s: cells near it may be missed, or change "
                "their numbers. Film without it"
            )
        slow = [drift for drift in self._drifts if np.hypot(*drift) < FAST * self._body_um]
        drift = np.median(slow or [(0.0, 0.0)], axis=0)
        speed = float(np.hypot(*drift))
        near = sum(np.hypot(*(other_drift - drift)) < speed / 2 for other_drift in slow)
        if near >= max(PAIRS, ALIKE * len(slow)):
            yield (
                f"what does not swim moves by {speed:.0f} um/s: the stage drifts or the medium "
                "flows, which is part of speeds and headings. Let the dish settle on a fixed stage"
            )
