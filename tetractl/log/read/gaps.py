"""The gaps in a trial's log: missing camera frames and control steps."""

from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.log.read.trial_log import TrialLog


@dataclass(frozen=True, slots=True)
class Gap:
    """Numbers `first` to `last` are missing, between two times since the first direction [s]."""

    what: str
    first: int
    last: int
    since_s: float
    until_s: float

    def __str__(self) -> str:
        numbers = f"{self.first}" if self.first == self.last else f"{self.first} to {self.last}"
        plural = "" if self.first == self.last else "s"
        when = f"between {self.since_s:.3f} and {self.until_s:.3f} s"
        return f"{self.what}{plural} {numbers}, {when}"


def frame_gaps(log: TrialLog) -> list[Gap]:
    """Return the camera frames missing between those of a log, by their numbers."""
    numbers, times = log.frames, (log.mocap_ns - log.began_ns) / SECOND
    return [
        Gap(
            "camera frame",
            int(numbers[i]) + 1,
            int(numbers[i + 1]) - 1,
            float(times[i]),
            float(times[i + 1]),
        )
        for i in np.flatnonzero(np.diff(numbers) > 1)
    ]


def step_gaps(log: TrialLog) -> list[Gap]:
    """Return the control steps missing before, between and after those of a log."""
    ks = [step.k for step in log.steps]
    sent = [log.elapsed_s(step.command.sent_ns) for step in log.steps]
    if log.result and log.result.steps > (ks[-1] + 1 if ks else 0):
        ks.append(log.result.steps)
        sent.append(log.result.duration_s)
    pairs = zip([-1, *ks], ks, [0.0, *sent], sent, strict=False)
    return [
        Gap("control step", before + 1, k - 1, since, until)
        for before, k, since, until in pairs
        if k - before > 1
    ]
