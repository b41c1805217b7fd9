"""Which of the last two commands arrived at each robot, by the turns seen since.

Of the commands that have begun to act, the last two arrived or got lost: four hypotheses a robot.
Each predicts the turn of every interval between two frames since the first of the two began to act;
the most probable one is believed, by

    sum_k r_k^2 / (2 sigma_k^2) - ln P(hypothesis),

with the residuals of the turns r_k, sigma_k as in `tetractl.control.identify`, and LOST for the
probability that a command gets lost. What is older is believed for good.
"""

from collections import deque
from itertools import pairwise

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
    """Believes in a predictor's commands, frame by frame."""

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor
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
        acting = [one for one in predictor.recent if one.sent_ns + predictor.delay_ns < now][-2:]
        if len(acting) < 2:
            return
        began = acting[0].sent_ns + predictor.delay_ns
        frames = list(self._frames)
        first = max((i for i, f in enumerate(frames) if f.sampled_ns <= began), default=None)
        if first is None:
            return
        frames = frames[first:]
        doubt = np.repeat(DOUBT[:, None], len(problem.a), axis=1)  # (H, N)
        for one, arrived in zip(acting, ARRIVED.T, strict=True):
            one.arrived = arrived[:, None]  # by hypothesis, for the predictions below
        for last, new in pairwise(frames):
            held = predictor.held(last.sampled_ns, new.sampled_ns)
            predicted = turned(problem, last.poses.heading, held, bias)
            t = (new.sampled_ns - last.sampled_ns) / SECOND
            sigma2 = 2 * HEADING_STD**2 + HEADING_WALK**2 * t
            missed = wrap(new.poses.heading - predicted)
            doubt += np.where(last.valid & new.valid, missed**2 / (2 * sigma2), 0.0)
        best = np.argmin(doubt, axis=0)
        believed = ARRIVED[best]  # (N, 2)
        for one, arrived in zip(acting, believed.T, strict=True):
            one.arrived = arrived
