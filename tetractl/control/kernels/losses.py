"""How little each robot's turns speak for lost commands: the twin of `tetractl.control.losses`."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tetractl.control.delay import Predictor
from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.motion import turn
from tetractl.control.kernels.options import KERNEL, inlined
from tetractl.control.kernels.turns import HEADING_STD, HEADING_WALK
from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Observation
from tetractl.core.problem import Problem
from tetractl.model.motion.polynomials import wrap

_wrap = inlined(wrap)


def add_doubts(
    doubt: Floats,
    problem: Problem,
    frames: Sequence[Observation],
    predictor: Predictor,
    last: int,
    bias: Floats,
    lanes: Any,
) -> None:
    """Do what `losses.add_doubts` does, to rounding; `lanes` are constants of the motion, `Lanes`,
    whose class decides how the robots turn."""
    recent, delay = predictor.recent, predictor.delay_ns
    _add_doubts(
        lanes,
        np.array([frame.sampled_ns for frame in frames], dtype=np.int64),
        np.array([frame.poses.heading for frame in frames]),
        np.array([frame.valid for frame in frames]),
        predictor.before,
        np.array([sent.sent_ns + delay for sent in recent], dtype=np.int64),
        np.array([sent.u for sent in recent]),
        np.array([sent.arrived for sent in recent]),
        last,
        problem.a,
        bias,
        doubt,
    )


@compiled(**KERNEL)
def _add_doubts(lanes, times, headings, valid, before, acts, u, arrived, last, a, bias, doubt):
    """Add to doubt (H, N) from F frames, C commands that act from acts (C,) [ns] on.

    times (F,) [ns]; headings (F, N) [rad]; valid (F, N); before (N,) is the direction [rad] held
    before the commands u (C,), NaN for a robot that stands; arrived (C, N).
    """
    for i in range(a.size):
        for f in range(times.size - 1):
            if not (valid[f, i] and valid[f + 1, i]):
                continue
            until = times[f + 1]
            t = (until - times[f]) / SECOND
            for h in range(doubt.shape[0]):
                heading, held, begin = headings[f, i], before[i], times[f]
                for c in range(acts.size + 1):
                    end = until if c == acts.size else min(acts[c], until)
                    if end > begin:
                        if not math.isnan(held):
                            seconds = (end - begin) / SECOND
                            heading = turn(lanes, heading, held + bias[i], a[i], seconds)
                        begin = end
                    if end == until:
                        break
                    came = h < 2 if c == last - 1 else h % 2 == 0 if c == last else arrived[c, i]
                    held = u[c] if came else held
                missed = _wrap(headings[f + 1, i] - heading)
                doubt[h, i] += missed**2 / (4 * HEADING_STD**2 + 2 * HEADING_WALK**2 * t)
