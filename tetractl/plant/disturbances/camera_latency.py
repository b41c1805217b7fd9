"""`{type: camera-latency}`: a frame reaches the host some time after its exposure."""

from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class CameraLatencySection(DisturbanceSection):
    """Every frame reaches the host after a latency that varies a little."""

    type: Literal["camera-latency"]
    mean: float = Field(ge=0, le=10, allow_inf_nan=False)
    """Mean time from exposure to arrival [s]."""
    deviation: float = Field(default=0.0, ge=0, le=1, allow_inf_nan=False)
    """Standard deviation of a frame's latency [s], normally distributed, truncated at 4 standard
    deviations."""
    late_share: Fraction = 0.0
    """Fraction of the frames that are late."""
    late_by: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Late frames are late by up to this, uniformly distributed [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "CameraLatency":
        """Return the latencies of one trial."""
        return CameraLatency(self, rng)


class CameraLatency(Disturbance):
    """Adds a latency to each frame."""

    def __init__(self, section: CameraLatencySection, rng: np.random.Generator) -> None:
        self._section, self._rng = section, rng

    def received(self, exposed_ns: int, received_ns: int) -> int:
        """Return the time of arrival with the latency added, never before the exposure."""
        section, rng = self._section, self._rng
        latency = section.mean + section.deviation * min(4.0, max(-4.0, rng.standard_normal()))
        if rng.random() < section.late_share:
            latency += section.late_by * rng.random()
        return received_ns + max(0, round(latency * SECOND))
