"""The paper's Algorithm 2, exactly as published, with nothing added.

A *sequence* consists of signals: directions [rad] that all robots follow, each for one control
period. A good sequence brings all robots to their targets. At each control step k, counted from 0,
the controller makes several searches. It chooses the sequence with the lowest cost J, and sends its
first signal:

    k = 0    a search for each length from 1 to `horizon_max`, without a      lines 1 to 7
             start
    k > 0    the rest of the sequence chosen before, H signals, starts three  lines 8 to 26
             searches: from its last H - 1 signals, from all H signals, and
             from all H signals followed by a 0

The trial ends when all robots are near enough to their targets (line 13), after step k_max (line
9), or when all signals of the sequence have been sent.

Comments give the lines of the paper's Algorithm 2. The controller that we recommend is
`tetractl.control.methods.mpc`.
"""

import math
from collections.abc import Sequence

import numpy as np

from tetractl.control.estimation.estimator import StateEstimator
from tetractl.control.methods.algorithm2_section import PsoMpc
from tetractl.control.methods.fixed_sequence import make_plan
from tetractl.control.methods.trial_time import TrialTime
from tetractl.control.search.evaluate import compiled_prediction
from tetractl.control.search.rng import mix
from tetractl.core.commands import Command
from tetractl.core.plan import Decision, Limits, Outcome
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.spec.controller import Host


class Algorithm2:
    """The paper's controller, Algorithm 2 as published, in one trial.

    `plan` is called once a control step. Between two steps, it keeps the number of the next step,
    `k`, and `warm`, the remaining signals of the last chosen sequence.

    Args:
        section: The fields of the controller in the spec.
        setup: The constants of the experiment.
        key: Seed of all random numbers.
        host: Provides the timer, and wraps the optimiser.
    """

    def __init__(self, section: PsoMpc, setup: Setup, key: int, host: Host) -> None:
        self.section = section
        self.key = key
        self.optimizer = host.wrap(section.optimizer)
        self.estimator = StateEstimator(
            section.problem(setup), section.period, section.known(setup), loss=setup.loss
        )
        # by default k_max alone ends the trial: late steps take longer than their periods
        steps_s = (section.steps_max + 1) * section.period
        limit_s = section.time_limit if section.time_limit < steps_s else math.inf
        self.time = TrialTime(limit_s, section.period)
        self.warm: Floats | None = None
        """The remaining signals of the chosen sequence [rad], the paper's u_(warm).

        None before step 0.
        """
        self.k = 0

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Decide what to send in one control step, or end the trial; see `Controller.plan`."""
        problem = self.estimator.add_step(observation, last_command, earlier)  # line 12
        if self.section.arrived(problem.poses.distances(problem.targets)):  # line 13
            return Outcome.ARRIVED
        if self.k > self.section.steps_max:  # line 9
            return Outcome.STEPS_MAX
        self.time.add_step(observation, last_command)
        if self.time.is_over:
            return Outcome.TIME_LIMIT
        if self.warm is not None and len(self.warm) == 0:
            return Outcome.SEQUENCE_COMPLETED
        step_key = mix(self.key, self.k)
        searches = [
            self.optimizer.search(problem, length, start, mix(step_key, length), Limits())
            for length, start in self._starts()  # lines 3 and 21
        ]
        best_index = int(np.argmin([search.cost for search in searches]))  # lines 5 and 23
        prediction = compiled_prediction(problem, searches[best_index].signals)
        plan = make_plan(searches, best_index, step_key, prediction)
        self.warm = plan.signals[1:]  # lines 6 and 24
        self.k += 1
        return plan.extend_to_all(self.estimator.present, observation.poses)  # lines 7 and 25

    def _starts(self) -> list[tuple[int, Floats | None]]:
        """Return the length [signals] and the starting sequence of each search of this step.

        Searches of step 0 have no starting sequence (None). The comments give the paper's lines.
        """
        if self.warm is None:
            lengths = range(1, self.section.horizon_max + 1)  # line 2
            return [(length, None) for length in lengths]
        n_left = len(self.warm)  # H of line 10
        one_longer = (n_left + 1, np.append(self.warm, 0.0))  # line 17
        same_length = (n_left, self.warm)  # line 19
        if n_left == 1:
            return [same_length, one_longer]  # a sequence has at least one signal
        return [(n_left - 1, self.warm[1:]), same_length, one_longer]
