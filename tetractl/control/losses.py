"""Which of the last two commands arrived at each robot, by the turns seen since.

Of the commands that have begun to act, the last two arrived or got lost: four hypotheses a robot.
Each predicts the turn of every interval between two frames since the first of the two began to act;
the most probable one is believed, by

    sum_k r_k^2 / (2 sigma_k^2) - ln P(hypothesis),

with the residuals of the turns r_k, sigma_k as in `tetractl.control.identify`, and LOST for the
probability that a command gets lost. What is older is believed for good.

`add_doubts` is the reference of the compiled `tetractl.control.kernels.losses`, which must agree
with it.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from tetractl.control.delay import Predictor, turned
from tetractl.control.identify import HEADING_STD, HEADING_WALK
from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Observation, wrap
from tetractl.core.problem import Problem

LOST = 0.05  # probability that a command gets lost, before anything is seen
FRAMES = 12  # looked back over at most
HYPOTHESES = ((True, True), (True, False), (False, True), (False, False))
"""Whether the last command but one arrived, and the last."""
ARRIVED = np.array(HYPOTHESES)
DOUBT = np.array([-sum(np.log(1 - LOST if yes else LOST) for yes in one) for one in HYPOTHESES])


class Arrivals:
    """Believes in a predictor's commands, frame by frame.

    `lanes` are constants of the motion, `tetractl.model.motion.base.Lanes`.
    """

    def __init__(self, predictor: Predictor, lanes: Any) -> None:
        from tetractl.control.kernels.losses import add_doubts

        self._predictor, self._lanes = predictor, lanes
        self._add_doubts = add_doubts
        self._frames: deque[Observation] = deque(maxlen=FRAMES)

    def seen(self, observation: Observation) -> None:
        """Add a frame."""
        if not self._frames or observation.sampled_ns > self._frames[-1].sampled_ns:
            self._frames.append(observation)

    def believe(self, problem: Problem, bias: Floats) -> None:
        """Note in the predictor which of the last two commands arrived.

        `problem` has a and speed as known, and `bias` (N,) [rad] is each robot's heading bias.
        """
        predictor, now = self._predictor, self._frames[-1].sampled_ns
        acting = [one for one in predictor.recent if one.sent_ns + predictor.delay_ns < now]
        if len(acting) < 2:
            return
        last, acting = len(acting) - 1, acting[-2:]
        began = acting[0].sent_ns + predictor.delay_ns
        first = max((i for i, f in enumerate(self._frames) if f.sampled_ns <= began), default=None)
        if first is None:
            return
        frames = list(self._frames)[first:]
        doubt = np.repeat(DOUBT[:, None], len(problem.a), axis=1)
        self._add_doubts(doubt, problem, frames, predictor, last, bias, self._lanes)
        believed = ARRIVED[np.argmin(doubt, axis=0)]  # (N, 2)
        for one, arrived in zip(acting, believed.T, strict=True):
            one.arrived = arrived


def add_doubts(
    doubt: Floats,
    problem: Problem,
    frames: Sequence[Observation],
    predictor: Predictor,
    last: int,
    bias: Floats,
) -> None:
    """Add to doubt (H, N) by how much each hypothesis misses the turns between frames.

    The hypotheses are about the predictor's recent commands `last` - 1 and `last`; what is believed
    of these is ignored.
    """
    believed = [sent.arrived for sent in predictor.recent]
    for one, arrived in zip((last - 1, last), ARRIVED.T, strict=True):
        predictor.recent[one].arrived = arrived[:, None]  # by hypothesis
    for before, after in pairwise(frames):
        held = predictor.held(before.sampled_ns, after.sampled_ns)
        predicted = turned(problem, before.poses.heading, held, bias)
        t = (after.sampled_ns - before.sampled_ns) / SECOND
        sigma2 = 2 * HEADING_STD**2 + HEADING_WALK**2 * t
        missed = wrap(after.poses.heading - predicted)
        doubt += np.where(before.valid & after.valid, missed**2 / (2 * sigma2), 0.0)
    for sent, arrived in zip(predictor.recent, believed, strict=True):
        sent.arrived = arrived
