"""`{type: frame-loss}`: whole camera frames never reach the host, alone or several in a row."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class FrameLossSection(DisturbanceSection):
    """Frames are lost in bursts of geometrically distributed length (Gilbert's model)."""

    type: Literal["frame-loss"]
    share: Annotated[float, Field(ge=0, le=0.5, allow_inf_nan=False)]
    """Share of all frames that are lost."""
    burst: Annotated[float, Field(ge=1, le=1000, allow_inf_nan=False)] = 1.0
    """Mean number of frames lost in a row."""

    @property
    def loses_frames(self) -> bool:
        """Whether there is anything to lose."""
        return self.share > 0

    def build(self, setup: Setup, rng: np.random.Generator) -> "FrameLoss":
        """Return the losses of one trial."""
        return FrameLoss(self, rng)


class FrameLoss(Disturbance):
    """A Markov chain of two states, frame by frame; the first frame is not lost."""

    def __init__(self, section: FrameLossSection, rng: np.random.Generator) -> None:
        self._begin = section.share / (1 - section.share) / section.burst
        self._end = 1 / section.burst
        self._rng = rng
        self._losing = False

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return the time of arrival unchanged, None for a frame that is lost."""
        lost, draw = self._losing, self._rng.random()
        self._losing = draw >= self._end if lost else draw < self._begin
        return None if lost else received_ns
